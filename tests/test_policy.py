"""A policy file holds a network to the last bit, and a damaged one does not fly."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from damaged_json import damaged
from maidenflight import policy
from maidenflight.errors import InputError
from maidenflight.policy import Policy, from_json, read, to_json, untrained, write

KEY = jax.random.key(0)


def noisy(key, hidden, history):
    """A policy in which no number is round."""
    made = untrained(key, hidden, history)
    leaves, structure = jax.tree.flatten(made)
    keys = jax.random.split(key, len(leaves))
    leaves = [
        leaf + jax.random.uniform(k, leaf.shape, minval=1e-7, maxval=1e-3)
        for leaf, k in zip(leaves, keys, strict=True)
    ]
    return jax.tree.unflatten(structure, leaves)


SMALL = json.loads(to_json(noisy(KEY, (3,), 1)))


@pytest.mark.parametrize(("hidden", "history"), [((50, 50), 2), ((3,), 1), ((), 3)])
def test_a_policy_reads_back_bit_by_bit(tmp_path, hidden, history):
    made = noisy(KEY, hidden, history)
    back = read(write(tmp_path / "policy.json", made, {"seed": 1}))
    assert jax.tree.structure(back) == jax.tree.structure(made)
    for old, new in zip(jax.tree.leaves(made), jax.tree.leaves(back), strict=True):
        assert new.dtype == np.float32
        np.testing.assert_array_equal(
            np.asarray(old).view(np.uint32), np.asarray(new).view(np.uint32)
        )
    assert back.layer_sizes == (20 * history, *hidden, 4)


@pytest.mark.parametrize(
    ("control", "rate"), [("pwm", 100), ("attitude_rate", 50), ("attitude", 25), ("attitude", 100)]
)
def test_a_policy_reads_back_with_its_control_structure_and_rate(control, rate):
    back = from_json(to_json(dataclasses.replace(noisy(KEY, (3,), 1), control=control, rate=rate)))
    assert (back.control, back.rate) == (control, rate)


def test_extreme_float32_numbers_survive():
    made = untrained(KEY, (), 1)
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
        history=1,
    )
    back = np.asarray(from_json(to_json(made)).weights[0])
    np.testing.assert_array_equal(back.view(np.uint32), weight.view(np.uint32))


def test_a_policy_is_affine_layers_with_relu_between_them():
    made = noisy(KEY, (7, 5), 1)
    seen = np.asarray(jax.random.normal(KEY, (20,)))
    values = (seen - np.asarray(made.observation_mean)) / np.asarray(made.observation_std)
    for number, (weight, bias) in enumerate(zip(made.weights, made.biases, strict=True)):
        values = np.asarray(weight) @ values + np.asarray(bias)
        values = values if number == 2 else np.maximum(values, 0)
    np.testing.assert_allclose(made(jnp.asarray(seen)), values, rtol=1e-5, atol=1e-6)


def test_an_untrained_policy_has_the_papers_layers_and_bounded_weights():
    made = untrained(KEY)
    assert [weight.shape for weight in made.weights] == [(50, 40), (50, 50), (4, 50)]
    assert [bias.shape for bias in made.biases] == [(50,), (50,), (4,)]
    assert (made.control, made.rate, made.history) == ("pwm", 100, 2)
    for weight, bound in zip(
        made.weights, (np.sqrt(6 / 40), np.sqrt(6 / 50), 0.1 * np.sqrt(6 / 50)), strict=True
    ):
        assert 0.9 * bound < np.abs(weight).max() <= bound * (1 + 1e-6)
    assert not any(np.any(bias) for bias in made.biases)
    np.testing.assert_array_equal(made.observation_mean[:20], made.observation_mean[20:])


def test_different_keys_make_different_policies():
    first, second = untrained(KEY), untrained(jax.random.key(1))
    assert not np.array_equal(first.weights[0], second.weights[0])
    np.testing.assert_array_equal(first.weights[0], untrained(KEY).weights[0])


@pytest.mark.parametrize(
    "field",
    [
        "format",
        "control",
        "rate",
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


@pytest.mark.parametrize(
    ("text", "message"),
    [
        pytest.param("", "not valid JSON", id="empty"),
        pytest.param(json.dumps(SMALL)[:-5], "not valid JSON", id="cut"),
        pytest.param("[" * 100_000, "not valid JSON", id="too deep"),
        pytest.param("[]", "not a maidenflight policy", id="another file"),
        pytest.param(
            damaged(SMALL, "control", to="position_pid"),
            "control = 'position_pid', expected one of pwm, attitude_rate, attitude",
            id="control",
        ),
        pytest.param(
            json.dumps(SMALL | {"control": "attitude", "rate": 30}),
            "rate = 30, expected one that divides the 500 Hz",
            id="PID rate",
        ),
        pytest.param(
            damaged(SMALL, "activation", to="tanh"),
            "activation = 'tanh', expected 'relu'",
            id="activation",
        ),
        pytest.param(
            damaged(SMALL, "rate", to=0),
            "rate = 0, expected a whole number from 1 to 1000",
            id="rate",
        ),
        pytest.param(
            damaged(SMALL, "history", to=2),
            r"the normaliser has \(20,\) values, expected 40",
            id="history",
        ),
        pytest.param(damaged(SMALL, "layers", to=[]), "no layers", id="no layers"),
        pytest.param(
            damaged(SMALL, "layers", to=SMALL["layers"][:1]),
            "3 outputs, expected 4",
            id="layer lost",
        ),
        pytest.param(
            damaged(SMALL, "layers", to=SMALL["layers"][::-1]),
            r"layer 1 has weights \(4, 3\)",
            id="layers turned",
        ),
        pytest.param(
            damaged(SMALL, "layers", 0, "weights", 2, 5, to=float("nan")),
            "not a finite number",
            id="nan weight",
        ),
        pytest.param(
            damaged(SMALL, "layers", 1, "biases", 0, to=float("inf")),
            "not a finite number",
            id="infinite bias",
        ),
        pytest.param(
            damaged(SMALL, "observation_mean", 0, to=float("nan")),
            "not a finite number",
            id="nan mean",
        ),
        pytest.param(
            damaged(SMALL, "observation_std", 3, to=0.0),
            "deviation is not positive",
            id="zero deviation",
        ),
        pytest.param(
            damaged(SMALL, "observation_std", 3, to=-1.0),
            "deviation is not positive",
            id="negative deviation",
        ),
        pytest.param(
            damaged(SMALL, "layers", 0, "weights", 0, 0, to=1e39),
            "here: ",
            id="more than float32 holds",
        ),
        pytest.param(
            damaged(SMALL, "layers", 0, "weights", 0, 0, to=10**400),
            "here: ",
            id="more than float64 holds",
        ),
        pytest.param(
            json.dumps(SMALL).replace('"rate": 100', '"rate": 1' + "0" * 5000),
            "here: ",
            id="more digits than Python reads",
        ),
        pytest.param(
            damaged(SMALL, "layers", 0, "weights", 0, 0, to="0.5"),
            "here: ",
            id="text for a number",
        ),
        pytest.param(
            damaged(SMALL, "layers", 0, "weights", 0, 0, to=None), "here: ", id="no number"
        ),
    ],
)
def test_a_wrong_policy_file_is_refused_with_its_cause(text, message):
    with pytest.raises(InputError, match=message) as caught:
        from_json(text, "here")
    assert str(caught.value).startswith("here: ")


def test_a_missing_policy_file_is_an_input_error(tmp_path):
    (tmp_path / "binary").write_bytes(b"\xff\xfe")
    for place in (tmp_path / "none.json", tmp_path, tmp_path / "binary"):
        with pytest.raises(InputError, match="cannot be read as a policy"):
            policy.read(place)
