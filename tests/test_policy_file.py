"""A policy file holds a network to the last bit, and a damaged one does not fly."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from damaged_json import damaged
from maidenflight.errors import InputError
from maidenflight.parameters import GEOMETRY
from maidenflight.policy import Policy, untrained_policy
from maidenflight.policy_file import from_json, read_policy, to_json, write_policy
from maidenflight.simulator.controllers import interface
from maidenflight.simulator.controllers.interface import ControlInterface
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.tasks.look_ahead import LookAhead
from noisy_policy import noisy

KEY = jax.random.key(0)
SPEC = PolicySpec(history=1, hidden=(3,))
SMALL = json.loads(to_json(noisy(KEY, SPEC)))


@pytest.mark.parametrize(
    "spec",
    [
        PolicySpec(),
        PolicySpec(history=1, look_ahead=LookAhead(4, 0.05), hidden=(3,)),
        PolicySpec(history=3, hidden=()),
        PolicySpec(memory=5, hidden=(8, 6)),
    ],
)
def test_a_policy_reads_back_bit_by_bit(tmp_path, spec):
    made = noisy(KEY, spec)
    file = read_policy(write_policy(tmp_path / "policy.json", made, {"seed": 1}))
    back = file.policy
    assert (file.name, file.record, file.spec, file.interface) == (
        "policy",
        {"seed": 1},
        spec,
        made.interface,
    )
    assert jax.tree.structure(back) == jax.tree.structure(made)
    for old, new in zip(jax.tree.leaves(made), jax.tree.leaves(back), strict=True):
        assert new.dtype == np.float32
        np.testing.assert_array_equal(
            np.asarray(old).view(np.uint32), np.asarray(new).view(np.uint32)
        )
    points = spec.look_ahead.points
    assert back.layer_sizes == (20 * spec.history + 3 * points, *spec.hidden, 4)
    assert ("look_ahead" in json.loads(to_json(made))) == (points > 0)
    assert ("gru" in json.loads(to_json(made))) == (spec.memory > 0)


def test_a_file_says_what_its_policy_was_trained_for_where_its_record_does():
    rows = {name: [0.1, -0.1, 0.1, -0.1] for name in GEOMETRY}
    settings = {"task": "hover", "updates": 3}
    record = {"hover": 0.5, "rotors": rows, "settings": settings}
    file = from_json(to_json(untrained_policy(KEY), record))
    assert (file.task, file.hover, file.rotors, file.settings) == ("hover", 0.5, rows, settings)
    for wrong in ({}, {"hover": 1.5, "rotors": {**rows, "rotor_x": [0.1]}, "settings": 3}):
        file = from_json(to_json(untrained_policy(KEY), wrong))
        assert (file.task, file.hover, file.rotors, file.settings) == (None, None, None, {})


@pytest.mark.parametrize(
    "meaning",
    [
        interface.pwm(full_scale_counts=65535.0),
        interface.attitude_rate(highest_rate=360.0),
        interface.attitude(100),
        ControlInterface(
            "winch", (0.1, 0, 0, 1 / 3), (0.1, 1, 2, 0.7), ("N", "m/s", "m/s", "m/s"), 40
        ),
    ],
)
def test_a_policy_reads_back_with_what_its_outputs_mean(meaning):
    back = from_json(to_json(dataclasses.replace(noisy(KEY, SPEC), interface=meaning))).policy
    assert back.interface == meaning
    assert hash(back.interface) == hash(meaning)


def test_extreme_float32_numbers_survive():
    made = untrained_policy(KEY, spec=PolicySpec(history=1, hidden=()))
    values = np.array(
        [np.finfo(np.float32).max, np.finfo(np.float32).tiny, -0.0, 1e-45, 1 / 3], np.float32
    )
    weight = np.zeros((4, 20), np.float32)
    weight[0, :5] = values
    made = Policy(
        (jnp.asarray(weight),),
        made.biases,
        made.observation_mean,
        made.observation_std,
        spec=made.spec,
    )
    back = np.asarray(from_json(to_json(made)).policy.weights[0])
    np.testing.assert_array_equal(back.view(np.uint32), weight.view(np.uint32))


@pytest.mark.parametrize(
    "field",
    [
        "format",
        "interface",
        "history",
        "activation",
        "observation_mean",
        "observation_std",
        "layers",
    ],
)
@pytest.mark.parametrize("wrong", [..., None, "text", [], {}, -1, 3.5, True])
def test_a_damaged_field_is_refused(field, wrong):
    with pytest.raises(InputError, match=r"^here: "):
        from_json(damaged(SMALL, field, to=wrong), "here")


@pytest.mark.parametrize("field", ["weights", "biases"])
@pytest.mark.parametrize(
    "wrong", [..., None, "text", [], {}, 1.0, [1.0, [2.0]], [[[1.0]]], [1.0, 2.0], [[1.0, 2.0]]]
)
def test_a_damaged_layer_is_refused(field, wrong):
    with pytest.raises(InputError, match=r"^here: "):
        from_json(damaged(SMALL, "layers", 0, field, to=wrong), "here")


WRONG = {
    "empty": ("", "not valid JSON"),
    "cut": (json.dumps(SMALL)[:-5], "not valid JSON"),
    "too deep": ("[" * 100_000, "not valid JSON"),
    "another file": ("[]", "not a policy, neither ours"),
    "control": (damaged(SMALL, "interface", "name", to="attitude"), "commands of attitude are in"),
    "activation": (damaged(SMALL, "activation", to="tanh"), "activation = 'tanh', expected 'relu'"),
    "rate": (
        damaged(SMALL, "interface", "rate", to=0),
        "rate = 0; expected a whole number from 1 to 1000",
    ),
    "history": (damaged(SMALL, "history", to=2), r"the normaliser has \(20,\) values, expected 40"),
    "no layers": (damaged(SMALL, "layers", to=[]), "0 layers"),
    "layer lost": (damaged(SMALL, "layers", to=SMALL["layers"][:1]), "3 outputs, expected 4"),
    "layers turned": (
        damaged(SMALL, "layers", to=SMALL["layers"][::-1]),
        r"layer 1 has weights \(4, 3\)",
    ),
    "nan weight": (
        damaged(SMALL, "layers", 0, "weights", 2, 5, to=float("nan")),
        "not a finite number",
    ),
    "infinite bias": (
        damaged(SMALL, "layers", 1, "biases", 0, to=float("inf")),
        "not a finite number",
    ),
    "nan mean": (damaged(SMALL, "observation_mean", 0, to=float("nan")), "not a finite number"),
    "zero deviation": (damaged(SMALL, "observation_std", 3, to=0.0), "deviation is not positive"),
    "negative deviation": (
        damaged(SMALL, "observation_std", 3, to=-1.0),
        "deviation is not positive",
    ),
    "more than float32 holds": (damaged(SMALL, "layers", 0, "weights", 0, 0, to=1e39), "here: "),
    "more than float64 holds": (damaged(SMALL, "layers", 0, "weights", 0, 0, to=10**400), "here: "),
    "more digits than Python reads": (
        json.dumps(SMALL).replace('"rate": 100', '"rate": 1' + "0" * 5000),
        "here: ",
    ),
    "text for a number": (damaged(SMALL, "layers", 0, "weights", 0, 0, to="0.5"), "here: "),
    "no number": (damaged(SMALL, "layers", 0, "weights", 0, 0, to=None), "here: "),
}


@pytest.mark.parametrize(
    ("text", "message"),
    WRONG.values(),
    ids=WRONG,
)
def test_a_wrong_policy_file_is_refused_with_its_cause(text, message):
    with pytest.raises(InputError, match=message) as caught:
        from_json(text, "here")
    assert str(caught.value).startswith("here: ")


def test_a_missing_policy_file_is_an_input_error(tmp_path):
    (tmp_path / "binary").write_bytes(b"\xff\xfe")
    for place, words in (
        (tmp_path / "none.json", "cannot be read as a policy: no such file"),
        (tmp_path, "a folder, not a policy"),
        (tmp_path / "binary", "cannot be read as a policy"),
    ):
        with pytest.raises(InputError, match=words):
            read_policy(place)


@pytest.mark.parametrize("wrong", [None, [], {"points": 4}, {"points": 3, "spacing": 0.05}, 4])
def test_a_damaged_look_ahead_is_refused(wrong):
    content = json.loads(
        to_json(noisy(KEY, dataclasses.replace(SPEC, look_ahead=LookAhead(4, 0.05))))
    )
    with pytest.raises(InputError, match=r"mine\.json"):
        from_json(json.dumps(content | {"look_ahead": wrong}), "mine.json")
    del content["look_ahead"]
    with pytest.raises(InputError, match=r"mine\.json"):
        from_json(json.dumps(content), "mine.json")
