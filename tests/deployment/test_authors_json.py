"""The authors' policy files are read to the last bit, and a changed one is refused."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from damaged_json import damaged
from maidenflight import policy
from maidenflight.deployment.authors_json import from_authors_json, read_authors_json, read_policy
from maidenflight.errors import InputError

GENERATOR = np.random.default_rng(0)
SIZES = (40, 6, 5, 4)
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
    "scaling_parameters": [GENERATOR.normal(size=40).tolist(), GENERATOR.uniform(0, 1, 40).tolist()],
    "activation": "relu",
    **{str(number): layer for number, layer in enumerate(LAYERS)},
}


@pytest.mark.parametrize(("control", "rate"), [("pwm", 100), ("attitude_rate", 50), ("attitude", 25)])
def test_a_policy_is_read_with_its_scaling_and_the_rate_of_its_control_structure(control, rate):
    made = from_authors_json(json.dumps(MADE), "here", control)
    assert (made.control, made.rate, made.history, made.layer_sizes) == (control, rate, 2, SIZES)
    mean, deviation = np.array(MADE["scaling_parameters"])
    seen = GENERATOR.normal(size=40)
    values = (seen - mean) / (deviation + 1e-5)
    for number, layer in enumerate(LAYERS):
        values = np.maximum(values, 0) if number else values
        values = np.array(layer["weights"]) @ values + np.array(layer["biases"])
    np.testing.assert_allclose(made(jnp.asarray(seen, jnp.float32)), values, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        pytest.param("", "not valid JSON", id="empty"),
        pytest.param("[" * 100_000, "not valid JSON", id="too deep"),
        pytest.param("[]", "not one of the authors' policies", id="another file"),
        pytest.param(damaged(MADE, "check_sum", to=...), "check_sum", id="no check sum"),
        pytest.param(damaged(MADE, "check_sum", to="nan"), "a weight was changed", id="check sum not a number"),
        pytest.param(damaged(MADE, "check_sum", to=None), "damaged policy", id="check sum none"),
        pytest.param(damaged(MADE, "activation", to="tanh"), "activation = 'tanh', expected 'relu'", id="activation"),
        pytest.param(damaged(MADE, "2", "biases", 3, to=LAYERS[2]["biases"][3] + 1e-3), "a weight was changed", id="changed bias"),
        pytest.param(damaged(MADE, "2", "weights", 0, 0, to=float("nan")), "a weight was changed", id="nan weight"),
        pytest.param(damaged(MADE, "1", "type", to="csrproduct"), "expected layers of type 'standard'", id="sparse"),
        pytest.param(damaged(MADE, "1", to=...), "damaged policy", id="layer lost"),
        pytest.param(damaged(MADE, "1", "weights", to="text"), "expected lists of numbers", id="text"),
        pytest.param(damaged(MADE, "1", "biases", to=[1.0]), "damaged policy", id="bias lost"),
        pytest.param(damaged(MADE, "0", to=LAYERS[1]), "a layer's inputs are not the outputs", id="wrong layer"),
        pytest.param(damaged(MADE, "scaling_parameters", to=[[0.0] * 40]), "damaged policy", id="no deviation"),
        pytest.param(damaged(MADE, "scaling_parameters", to=[[0.0] * 20, [1.0] * 20]), "expected", id="scaling of another size"),
    ],
)
def test_what_is_not_such_a_policy_or_was_changed_is_refused(text, message):
    with pytest.raises(InputError, match=message) as caught:
        from_authors_json(text, "here", "pwm")
    assert str(caught.value).startswith("here: ")


def test_every_weight_that_counts_in_the_check_sum_is_guarded():
    """A unit that is silent for ones hides the weights into it and out of it; no other change of 1 % of a deviation passes."""
    passed = []
    for number, layer in enumerate(LAYERS):
        for row, column in np.ndindex(*np.shape(layer["weights"])):
            text = damaged(MADE, str(number), "weights", row, column, to=layer["weights"][row][column] + 0.01)
            wrong = json.loads(text)
            differs = abs(float(check_sum([wrong[str(place)] for place in range(3)])) - float(MADE["check_sum"])) > 1e-3
            if differs:
                with pytest.raises(InputError, match="a weight was changed"):
                    from_authors_json(text, "here", "pwm")
            passed.append(not differs)
    assert np.mean(passed) < 0.7


def test_an_unknown_control_structure_or_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="control = 'position_pid', expected one of pwm, attitude_rate, attitude"):
        from_authors_json(json.dumps(MADE), "here", "position_pid")
    with pytest.raises(InputError, match="cannot be read as a policy"):
        read_authors_json(tmp_path / "none.json", "pwm")


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
def test_a_name_a_folder_or_the_caller_says_what_an_authors_policy_commands(tmp_path, name, given, control):
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(MADE))
    assert read_policy(path, given).control == control


def test_our_policies_are_told_from_the_authors_by_content(tmp_path):
    path = policy.write(tmp_path / "pwm.json", policy.untrained(jax.random.key(0), (8,)))
    assert read_policy(path, "attitude").control == "pwm"
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
    ("name", "control", "number"), [("pwm_024", "pwm", 24), ("attitude_rate_066", "attitude_rate", 66), ("attitude_021", "attitude", 21)]
)
def test_published_files_hold_the_networks_that_flew(shared_data, name, control, number):
    made = read_authors_json(shared_data / "authors/json_models" / f"{name}.json", control)
    archive = np.load(shared_data / "authors/policies.npz")
    (place,) = np.flatnonzero((archive["control"] == control) & (archive["policy"] == number))
    expected = [archive[f"{kind}{layer}"][place] for kind in "Wb" for layer in range(3)]
    expected += [archive["observation_mean"][place], archive["observation_std"][place] + np.float32(1e-5)]
    for given, wanted in zip(jax.tree.leaves(made), expected, strict=True):
        np.testing.assert_array_equal(given, wanted)
