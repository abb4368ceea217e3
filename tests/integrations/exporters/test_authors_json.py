"""The authors' policy files are read and written to the last bit, and a changed one is refused."""

import dataclasses
import importlib.util
import json
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_c import COMPILERS, SimulatedFlight

from damaged_json import damaged
from maidenflight import policy, policy_file
from maidenflight.deployment.c import export_c
from maidenflight.errors import InputError
from maidenflight.flights import tables
from maidenflight.integrations.exporters.authors_json import export_authors_json, to_authors_json
from maidenflight.integrations.exporters.onnx import to_onnx
from maidenflight.integrations.logs import authors
from maidenflight.integrations.policies.authors_policy import EPSILON, RATES, interface_of
from maidenflight.policy_file import from_json, read_policy
from maidenflight.simulator.controllers import interface
from maidenflight.simulator.physics import rotations
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.tasks.look_ahead import LookAhead

GENERATOR = np.random.default_rng(0)
SIZES = (40, 6, 5, 4)
QUATERNIONS = jax.jit(jax.vmap(rotations.from_attitude))
LAYERS = [
    {
        "type": "standard",
        "weights": GENERATOR.normal(size=(outputs, inputs)).astype(np.float32).tolist(),
        "biases": GENERATOR.normal(size=outputs).astype(np.float32).tolist(),
    }
    for inputs, outputs in zip(SIZES[:-1], SIZES[1:], strict=True)
]


def check_sum(layers):
    """The sum of the outputs for ones that are not scaled."""
    values = np.ones(40)
    for number, layer in enumerate(layers):
        values = np.maximum(values, 0) if number else values
        values = np.array(layer["weights"]) @ values + np.array(layer["biases"])
    return str(np.float32(values.sum()))


MADE = {
    "check_sum": check_sum(LAYERS),
    "scaling_parameters": [
        GENERATOR.normal(size=40).tolist(),
        GENERATOR.uniform(0, 1, 40).tolist(),
    ],
    "activation": "relu",
    **{str(number): layer for number, layer in enumerate(LAYERS)},
}


def made(hidden=(8,), control="pwm", history=2):
    """A policy of random numbers that act at the rate of the authors' drone."""
    sizes = (20 * history, *hidden, 4)
    random = np.random.default_rng(len(sizes))
    return policy.Policy(
        weights=tuple(
            jnp.asarray(random.normal(size=(after, before)), jnp.float32)
            for before, after in zip(sizes[:-1], sizes[1:], strict=True)
        ),
        biases=tuple(jnp.asarray(random.normal(size=size), jnp.float32) for size in sizes[1:]),
        observation_mean=jnp.asarray(random.normal(size=sizes[0]), jnp.float32),
        observation_std=jnp.asarray(random.uniform(0.01, 2.0, sizes[0]), jnp.float32),
        interface=interface_of(control),
        spec=PolicySpec(history=history, hidden=hidden),
    )


def onnx_actions(given, observations):
    """What the exported ONNX model gives; what Python gives where it is not installed."""
    if importlib.util.find_spec("onnxruntime") is None:
        return np.asarray(jax.vmap(given)(jnp.asarray(observations)))
    session = importlib.import_module("onnxruntime").InferenceSession(to_onnx(given))
    return session.run(["action"], {"observation": observations})[0]


def acting(given, meaning):
    """The same network with another meaning of its outputs."""
    return dataclasses.replace(given, interface=meaning)


def same(one, other):
    """Whether two policies are the same, to the last bit."""
    return jax.tree.structure(one) == jax.tree.structure(other) and all(
        np.array_equal(first, second)
        for first, second in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    )


@pytest.mark.parametrize(
    ("control", "rate"), [("pwm", 100), ("attitude_rate", 50), ("attitude", 25)]
)
def test_a_policy_is_read_with_its_scaling_and_the_rate_of_its_control_structure(control, rate):
    made = from_json(json.dumps(MADE), "here", control).policy
    assert (made.interface.name, made.interface.rate, made.spec.history, made.layer_sizes) == (
        control,
        rate,
        2,
        SIZES,
    )
    mean, deviation = np.array(MADE["scaling_parameters"])
    seen = GENERATOR.normal(size=40)
    values = (seen - mean) / (deviation + 1e-5)
    for number, layer in enumerate(LAYERS):
        values = np.maximum(values, 0) if number else values
        values = np.array(layer["weights"]) @ values + np.array(layer["biases"])
    np.testing.assert_allclose(made(jnp.asarray(seen, jnp.float32)), values, rtol=1e-3, atol=1e-3)


WRONG = {
    "empty": ("", "not valid JSON"),
    "too deep": ("[" * 100_000, "not valid JSON"),
    "another file": ("[]", "neither ours .* nor the authors'"),
    "no check sum": (damaged(MADE, "check_sum", to=...), "no check_sum"),
    "check sum not a number": (damaged(MADE, "check_sum", to="nan"), "a weight was changed"),
    "check sum none": (damaged(MADE, "check_sum", to=None), "damaged policy"),
    "activation": (damaged(MADE, "activation", to="tanh"), "activation = 'tanh', expected 'relu'"),
    "changed bias": (
        damaged(MADE, "2", "biases", 3, to=LAYERS[2]["biases"][3] + 1e-3),
        "a weight was changed",
    ),
    "nan weight": (damaged(MADE, "2", "weights", 0, 0, to=float("nan")), "a weight was changed"),
    "sparse": (damaged(MADE, "1", "type", to="csrproduct"), "expected layers of type 'standard'"),
    "layer lost": (damaged(MADE, "1", to=...), "damaged policy"),
    "text": (damaged(MADE, "1", "weights", to="text"), "expected lists of numbers"),
    "bias lost": (damaged(MADE, "1", "biases", to=[1.0]), "damaged policy"),
    "wrong layer": (damaged(MADE, "0", to=LAYERS[1]), "a layer's inputs are not the outputs"),
    "no deviation": (damaged(MADE, "scaling_parameters", to=[[0.0] * 40]), "damaged policy"),
    "scaling of another size": (
        damaged(MADE, "scaling_parameters", to=[[0.0] * 20, [1.0] * 20]),
        "expected",
    ),
}


@pytest.mark.parametrize(
    ("text", "message"),
    WRONG.values(),
    ids=WRONG,
)
def test_what_is_not_such_a_policy_or_was_changed_is_refused(text, message):
    with pytest.raises(InputError, match=message) as caught:
        from_json(text, "here", "pwm")
    assert str(caught.value).startswith("here: ")


def test_every_weight_that_counts_in_the_check_sum_is_guarded():
    """A unit that is silent for ones hides the weights into it and out of it; no other change of 1
    % of a deviation passes."""
    passed = []
    for number, layer in enumerate(LAYERS):
        for row, column in np.ndindex(*np.shape(layer["weights"])):
            text = damaged(
                MADE, str(number), "weights", row, column, to=layer["weights"][row][column] + 0.01
            )
            wrong = json.loads(text)
            differs = (
                abs(
                    float(check_sum([wrong[str(place)] for place in range(3)]))
                    - float(MADE["check_sum"])
                )
                > 1e-3
            )
            if differs:
                with pytest.raises(InputError, match="a weight was changed"):
                    from_json(text, "here", "pwm")
            passed.append(not differs)
    assert np.mean(passed) < 0.7


def test_an_unknown_control_structure_or_file_is_refused(tmp_path):
    with pytest.raises(
        InputError, match="control = 'position_pid', expected one of pwm, attitude_rate, attitude"
    ):
        from_json(json.dumps(MADE), "here", "position_pid")
    with pytest.raises(InputError, match="cannot be read as a policy"):
        read_policy(tmp_path / "none.json", "pwm")


@pytest.mark.parametrize(
    ("name", "given", "control"),
    [
        ("pwm_024.json", None, "pwm"),
        ("attitude_rate_066.json", None, "attitude_rate"),
        ("Attitude_21.json", None, "attitude"),
        ("attitude/model.json", None, "attitude"),
        ("model.json", "attitude_rate", "attitude_rate"),
        ("pwm_024.json", "attitude", "attitude"),
    ],
)
def test_a_name_a_folder_or_the_caller_says_what_an_authors_policy_commands(
    tmp_path, name, given, control
):
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(MADE))
    assert read_policy(path, given).interface.name == control


def test_our_policies_are_told_from_the_authors_by_content(tmp_path):
    path = policy_file.write_policy(
        tmp_path / "pwm.json",
        policy.untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(8,))),
    )
    assert read_policy(path).interface.name == read_policy(path, "pwm").interface.name == "pwm"
    with pytest.raises(InputError, match="a pwm policy, as its file says, not attitude"):
        read_policy(path, "attitude")
    for text, message in (
        (json.dumps(MADE), "model.json: one of the authors' policies, which do not say"),
        ("{}", "model.json: not a policy, neither ours"),
        ("[1]", "model.json: not a policy, neither ours"),
        ("text", "model.json: not a policy, ours or the authors': not valid JSON"),
        (damaged(MADE, "1", to=...), "model.json: one of the authors'"),
    ):
        (tmp_path / "model.json").write_text(text)
        with pytest.raises(InputError, match=message):
            read_policy(tmp_path / "model.json")


@pytest.mark.parametrize(
    ("name", "control", "number"),
    [
        ("pwm_024", "pwm", 24),
        ("attitude_rate_066", "attitude_rate", 66),
        ("attitude_021", "attitude", 21),
    ],
)
def test_published_files_hold_the_networks_that_flew(shared_data, name, control, number):
    made = read_policy(shared_data / "authors/json_models" / f"{name}.json", control).policy
    archive = np.load(shared_data / "authors/policies.npz")
    (place,) = np.flatnonzero((archive["control"] == control) & (archive["policy"] == number))
    expected = [archive[f"{kind}{layer}"][place] for kind in "Wb" for layer in range(3)]
    expected += [
        archive["observation_mean"][place],
        archive["observation_std"][place] + np.float32(1e-5),
    ]
    for given, wanted in zip(jax.tree.leaves(made), expected, strict=True):
        np.testing.assert_array_equal(given, wanted)


def test_our_policies_read_back_from_the_authors_json_as_they_were():
    for hidden in ((50, 50), (), (3, 4, 5, 6, 7, 8)):
        for control in RATES:
            given = made(hidden, control)
            assert same(from_json(to_authors_json(given), "here", control).policy, given)


def test_deviations_read_back_to_the_last_bit_or_to_one_rounding_where_there_is_none():
    drawn = (
        np.exp(GENERATOR.uniform(np.log(1.001e-5), np.log(1e6), 4000))
        .astype(np.float32)
        .reshape(100, 40)
    )
    drawn[0, :3] = np.float32(1e-5), np.float32(9e-5), np.nextafter(np.float32(9e-5), np.float32(1))
    given = made(())
    read = np.array(
        [
            from_json(
                to_authors_json(dataclasses.replace(given, observation_std=jnp.asarray(row))),
                "here",
                "pwm",
            ).policy.observation_std
            for row in drawn
        ]
    )
    narrow = (drawn > 6.1e-5) & (drawn < 1.2208e-4)
    np.testing.assert_array_equal(read[~narrow], drawn[~narrow])
    assert np.all(np.abs(read - drawn)[narrow] <= np.spacing(drawn[narrow]))


def test_what_the_authors_json_holds_is_written_as_they_write_it():
    given = from_json(json.dumps(MADE), "here", "pwm").policy
    content = json.loads(to_authors_json(given))
    assert list(content) == list(MADE)
    assert [content[name] for name in ("activation", "0", "1", "2")] == [
        MADE[name] for name in ("activation", "0", "1", "2")
    ]
    assert isinstance(content["check_sum"], str)
    assert float(content["check_sum"]) == pytest.approx(float(MADE["check_sum"]), rel=1e-6)
    np.testing.assert_array_equal(
        content["scaling_parameters"][0], np.float32(MADE["scaling_parameters"][0])
    )
    np.testing.assert_allclose(
        content["scaling_parameters"][1], MADE["scaling_parameters"][1], atol=1e-7
    )


def test_one_changed_number_of_what_we_wrote_is_refused():
    given = made()
    content = json.loads(to_authors_json(given))
    awake = int(np.argmax(given.weights[0].sum(axis=1) + given.biases[0]))
    for place in (
        ("0", "weights", awake, 7),
        ("0", "biases", awake),
        ("1", "weights", 3, awake),
        ("1", "biases", 2),
    ):
        with pytest.raises(InputError, match="a weight was changed"):
            from_json(damaged(content, *place, to=2.5), "here", "pwm")


def test_what_the_authors_json_cannot_hold_is_refused(tmp_path):
    fine = made()
    for wrong, message in (
        (
            acting(fine, interface.pwm(50)),
            "rate = 50, but the authors' drone runs pwm policies with 100",
        ),
        (acting(fine, interface.attitude(100)), "rate = 100, but .* attitude policies with 25"),
        (acting(fine, interface.attitude_rate(highest_rate=360.0)), "span = "),
        (acting(fine, interface.pwm(full_scale_counts=65535.0)), "full_scale_counts = 65535"),
        (made(history=3), "history = 3, but the authors' policies see 2 instants"),
        (
            policy.untrained_policy(
                jax.random.key(0), spec=PolicySpec(look_ahead=LookAhead(3), hidden=(8,))
            ),
            "look_ahead = .*3.*, but the authors' policies",
        ),
        (made((4,) * 7), "8 layers, but the authors' firmware takes at most 7"),
        (
            dataclasses.replace(fine, observation_std=jnp.full(40, 9e-6)),
            "deviation is 9e-06, but the authors' files hold none below",
        ),
        (
            dataclasses.replace(
                fine, weights=tuple(jnp.full(weight.shape, 3e38) for weight in fine.weights)
            ),
            "check sum overflows",
        ),
        (
            dataclasses.replace(fine, biases=(jnp.full(8, jnp.nan), *fine.biases[1:])),
            "not a finite number",
        ),
        (
            acting(fine, dataclasses.replace(interface.pwm(), name="motor")),
            "control = 'motor'; the authors' drone knows",
        ),
    ):
        with pytest.raises(InputError, match=message):
            export_authors_json(wrong, tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "control", "expected"),
    [
        ("policy_1", "pwm", "pwm_policy_1"),
        ("attitude_rate_066", "attitude_rate", "attitude_rate_066"),
        ("attitude_rate_066", "attitude", "attitude_attitude_rate_066"),
        ("pwm", "pwm", "pwm"),
    ],
)
def test_the_name_of_what_we_write_says_what_it_commands(tmp_path, name, control, expected):
    given = made(control=control)
    (path,) = export_authors_json(given, tmp_path, name=name)
    assert path.name == f"{expected}.json"
    if not expected.startswith("attitude_attitude"):
        assert same(read_policy(path).policy, given)


PUBLISHED = ["pwm_024", "attitude_rate_066", "attitude_021"]


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_files_are_written_byte_for_byte_and_guarded(shared_data, name):
    """But for the last digit of the check sum, which they computed in float32."""
    path = shared_data / "authors/json_models" / f"{name}.json"
    published, given = json.loads(path.read_text()), read_policy(path).policy
    written = json.loads(to_authors_json(given))
    assert damaged(written, "check_sum", to=published["check_sum"]) == path.read_text()
    assert float(written["check_sum"]) == pytest.approx(float(published["check_sum"]), abs=1e-5)
    assert same(from_json(json.dumps(written), "here", given.interface.name).policy, given)
    for content in (published, written):
        changed = damaged(content, "2", "weights", 3, 49, to=content["2"]["weights"][3][49] + 1e-3)
        with pytest.raises(InputError, match="a weight was changed"):
            from_json(changed, "here", given.interface.name)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "most"),
    [
        ("pwm_021", 0.005),
        ("pwm_024", 0.035),
        ("attitude_rate_066", 0.012),
        ("attitude_007", 0.01),
        ("attitude_021", 0.065),
    ],
)
def test_published_policies_exported_give_what_their_drones_logged(
    shared_data, tmp_path, name, most
):
    """In C step by step, in ONNX all at once; measured are medians of flights.

    What is left is float16, of the logs and of the drone's sums. Two of the published files are
    odd: the outputs of pwm_024 were logged 0.03 off in all flights, those of attitude_021 0.05, and
    one flight of that was not flown by it.
    """
    path = shared_data / "authors/json_models" / f"{name}.json"
    given = read_policy(path if path.exists() else written_anew(shared_data, tmp_path, name)).policy
    rows = 100 // given.interface.rate
    drone = (
        SimulatedFlight(export_c(given, tmp_path)[0].parent, given.spec.history)
        if COMPILERS
        else None
    )
    assert drone is None or drone.self_test()
    number = name.rpartition("_")[2]
    errors, rounded = [], []
    for path in sorted(
        (shared_data / "authors/flights" / given.interface.name / f"policy_{number}").glob(
            "*.csv.gz"
        )
    ):
        table = tables.read(path, path.name)
        flight = authors.flights(table)[0][0][0]
        column = tables.numbers(table, authors.COLUMNS)
        logged = np.stack([column[f"n{output}"] for output in range(4)], axis=1).astype(np.float32)
        taken = np.roll(logged, rows, axis=0)
        quaternion = np.asarray(QUATERNIONS(jnp.asarray(np.resize(flight.attitude, (2200, 3)))))[
            : len(logged)
        ]
        seen: list[Any] = [flight.position, flight.velocity, quaternion, flight.body_rates]
        parts = (
            flight.position,
            quaternion,
            flight.velocity,
            flight.body_rates,
            flight.setpoint - flight.position,
            taken,
        )
        instants = np.concatenate(parts, axis=1).astype(np.float32)
        anew = np.flatnonzero(np.any(np.diff(logged, axis=0) != 0, axis=1)) + 1
        assert np.all(np.diff(anew) == rows)
        anew = anew[anew >= 2 * rows]
        observations = np.concatenate([instants[anew - rows], instants[anew]], axis=1)
        actions = onnx_actions(given, observations)
        errors.append(np.median(np.abs(actions - logged[anew])))
        rounded.append(np.median(np.abs(in_float16(given, observations) - logged[anew])))
        if drone is not None:
            drone.reset(np.zeros(4))
            stepped = []
            for row in (anew[0] - rows, *anew):
                drone.state.action[:] = taken[row].tolist()
                assert drone.step(Measurement(*(part[row] for part in seen)), flight.setpoint[row])[
                    0
                ]
                stepped.append(drone.action)
            np.testing.assert_allclose(stepped[1:], actions, rtol=1e-5, atol=1e-5)
    assert len(errors) == 3
    assert np.median(errors) < most
    assert name in ("pwm_024", "attitude_021") or np.median(rounded) < 0.8 * np.median(errors)


def in_float16(given, observations):
    """A network as the authors' firmware computes it: scaling without the 1e-5, and every sum,
    rounded to float16."""
    mean, deviation = (
        np.asarray(array) for array in (given.observation_mean, given.observation_std - EPSILON)
    )
    values = (observations.astype(np.float16) - mean.astype(np.float16)) / deviation.astype(
        np.float16
    )
    for number, (weight, bias) in enumerate(
        zip(*(map(np.asarray, arrays) for arrays in given.network[:2]), strict=True)
    ):
        values = np.maximum(values, 0) if number else values
        total = np.zeros((len(values), len(bias)), np.float16)
        for column, weights in enumerate(weight.T.astype(np.float16)):
            total += values[:, column, None] * weights
        values = total + bias.astype(np.float16)
    return values.astype(np.float32)


def written_anew(shared_data, folder, name):
    """A file that we write of one of the published networks."""
    control, _, number = name.rpartition("_")
    archive = np.load(shared_data / "authors/policies.npz")
    (place,) = np.flatnonzero((archive["control"] == control) & (archive["policy"] == int(number)))
    network = policy.Policy(
        weights=tuple(jnp.asarray(archive[f"W{layer}"][place]) for layer in range(3)),
        biases=tuple(jnp.asarray(archive[f"b{layer}"][place]) for layer in range(3)),
        observation_mean=jnp.asarray(archive["observation_mean"][place]),
        observation_std=jnp.asarray(archive["observation_std"][place] + np.float32(1e-5)),
        interface=interface_of(control),
    )
    return export_authors_json(network, folder, name=name)[0]
