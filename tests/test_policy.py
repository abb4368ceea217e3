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
from maidenflight.parameters import crazyflie
from maidenflight.policy import Actor, Policy, from_json, read, to_json, untrained, write
from maidenflight.simulator import dynamics, environment, interface
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.interface import ControlInterface
from maidenflight.simulator.look_ahead import NONE, LookAhead
from maidenflight.simulator.rollout import rollout
from maidenflight.simulator.sensors import Measurement

KEY = jax.random.key(0)


def noisy(key, hidden, history, look_ahead=NONE):
    """A policy in which no number is round."""
    made = untrained(key, hidden, history, look_ahead=look_ahead)
    leaves, structure = jax.tree.flatten(made)
    keys = jax.random.split(key, len(leaves))
    leaves = [
        leaf + jax.random.uniform(k, leaf.shape, minval=1e-7, maxval=1e-3)
        for leaf, k in zip(leaves, keys, strict=True)
    ]
    return jax.tree.unflatten(structure, leaves)


SMALL = json.loads(to_json(noisy(KEY, (3,), 1)))


@pytest.mark.parametrize(
    ("hidden", "history", "look_ahead"),
    [((50, 50), 2, NONE), ((3,), 1, LookAhead(4, 0.05)), ((), 3, NONE)],
)
def test_a_policy_reads_back_bit_by_bit(tmp_path, hidden, history, look_ahead):
    made = noisy(KEY, hidden, history, look_ahead)
    back = read(write(tmp_path / "policy.json", made, {"seed": 1}))
    assert jax.tree.structure(back) == jax.tree.structure(made)
    for old, new in zip(jax.tree.leaves(made), jax.tree.leaves(back), strict=True):
        assert new.dtype == np.float32
        np.testing.assert_array_equal(
            np.asarray(old).view(np.uint32), np.asarray(new).view(np.uint32)
        )
    assert back.layer_sizes == (20 * history + 3 * look_ahead.points, *hidden, 4)
    assert back.look_ahead == look_ahead
    assert ("look_ahead" in json.loads(to_json(made))) == (look_ahead.points > 0)


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
    back = from_json(to_json(dataclasses.replace(noisy(KEY, (3,), 1), interface=meaning)))
    assert back.interface == meaning
    assert hash(back.interface) == hash(meaning)


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
    assert (made.interface, made.history) == (interface.pwm(), 2)
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


@pytest.mark.parametrize(
    ("text", "message"),
    [
        pytest.param("", "not valid JSON", id="empty"),
        pytest.param(json.dumps(SMALL)[:-5], "not valid JSON", id="cut"),
        pytest.param("[" * 100_000, "not valid JSON", id="too deep"),
        pytest.param("[]", "not a maidenflight policy", id="another file"),
        pytest.param(
            damaged(SMALL, "interface", "name", to="attitude"),
            "commands of attitude are in",
            id="control",
        ),
        pytest.param(
            damaged(SMALL, "activation", to="tanh"),
            "activation = 'tanh', expected 'relu'",
            id="activation",
        ),
        pytest.param(
            damaged(SMALL, "interface", "rate", to=0),
            "rate = 0; expected a whole number from 1 to 1000",
            id="rate",
        ),
        pytest.param(
            damaged(SMALL, "history", to=2),
            r"the normaliser has \(20,\) values, expected 40",
            id="history",
        ),
        pytest.param(damaged(SMALL, "layers", to=[]), "0 layers", id="no layers"),
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


def test_a_policy_checks_itself():
    made = noisy(KEY, (3,), 1)
    made.check()
    for wrong in (
        {"history": 2},
        {"weights": made.weights[:1]},
        {"biases": (made.biases[0], jnp.array([0, 0, jnp.nan, 0]))},
        {"observation_std": jnp.zeros(20)},
    ):
        with pytest.raises(InputError, match=r"^mine\.json: "):
            dataclasses.replace(made, **wrong).check("mine.json")


@pytest.mark.parametrize("wrong", [None, [], {"points": 4}, {"points": 3, "spacing": 0.05}, 4])
def test_a_damaged_look_ahead_is_refused(wrong):
    content = json.loads(to_json(noisy(KEY, (3,), 1, LookAhead(4, 0.05))))
    with pytest.raises(InputError, match=r"mine\.json"):
        from_json(json.dumps(content | {"look_ahead": wrong}), "mine.json")
    del content["look_ahead"]
    with pytest.raises(InputError, match=r"mine\.json"):
        from_json(json.dumps(content), "mine.json")


@pytest.mark.parametrize(("history", "look_ahead"), [(1, LookAhead(2, 0.2)), (3, NONE)])
def test_an_actor_does_what_the_simulator_does_with_the_same_policy(history, look_ahead):
    """Measurements of a simulated episode, one instant at a time: the same actions, and commands
    that the simulated motors were given."""
    made, drone = untrained(KEY, (8,), history, look_ahead=look_ahead), crazyflie()
    env = Environment(history=history, look_ahead=look_ahead)
    first = environment.reset(env, drone, KEY)
    _, (states, _) = rollout(env, made, first, drone, KEY, 21)
    actor = Actor(made, 1 / float(drone.thrust_to_weight))
    for _ in range(2):
        actor.reset()
        for number in range(20):
            seen, after = (
                jax.tree.map(lambda leaf, at=at: leaf[at], states) for at in (number, number + 1)
            )
            later = [env.task.reference(seen.time + after) for after in look_ahead.times]
            ahead = {"ahead": np.stack(later)} if later else {}
            command, action = actor.act(seen.measurement, env.task.reference(seen.time), **ahead)
            np.testing.assert_allclose(action, after.action, atol=1e-5)
            np.testing.assert_allclose(command, (np.clip(action, -1, 1) + 1) / 2, atol=1e-6)


def test_an_actor_is_given_the_points_that_its_policy_looks_ahead_at_and_no_others():
    drone = dynamics.at_hover(jnp.zeros(3), crazyflie())
    seen = Measurement(drone.position, drone.velocity, drone.quaternion, drone.body_rates)
    plain = Actor(untrained(KEY, (8,)), 0.6)
    ahead = Actor(untrained(KEY, (8,), look_ahead=LookAhead(2)), 0.6)
    first = ahead.act(seen, np.zeros(3), np.zeros((2, 3)))
    wrong = [(plain, np.zeros((2, 3))), (ahead, None), (ahead, np.zeros((3, 3)))]
    for actor, points in [*wrong, (ahead, np.zeros(6)), (ahead, np.full((2, 3), np.nan))]:
        with pytest.raises(InputError, match="ahead"):
            actor.act(seen, np.zeros(3), points)
    ahead.reset()
    again = ahead.act(seen, np.zeros(3), np.zeros((2, 3)))
    np.testing.assert_array_equal(again.action, first.action)


def test_an_actor_refuses_numbers_that_are_not_finite_and_goes_on_as_before():
    drone = dynamics.at_hover(jnp.zeros(3), crazyflie())
    seen = Measurement(drone.position, drone.velocity, drone.quaternion, drone.body_rates)
    actors = [Actor(untrained(KEY, (8,)), 0.6) for _ in range(2)]
    for actor in actors:
        actor.act(seen, np.zeros(3))
    with pytest.raises(InputError, match="nan"):
        actors[0].act(seen._replace(velocity=jnp.full(3, jnp.nan)), np.zeros(3))
    again, other = (actor.act(seen, np.ones(3)) for actor in actors)
    np.testing.assert_array_equal(again.action, other.action)
    for wrong in (0.0, 1.1, float("nan")):
        with pytest.raises(InputError, match="hover"):
            Actor(untrained(KEY, (8,)), wrong)
