"""A policy is its layers, and an actor flies it as the simulator does."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight.errors import InputError
from maidenflight.parameters import crazyflie
from maidenflight.policy import Actor, untrained_policy
from maidenflight.simulator import environment
from maidenflight.simulator.controllers import interface
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.stepping import rollout
from maidenflight.simulator.tasks.look_ahead import LookAhead
from noisy_policy import noisy

KEY = jax.random.key(0)


def test_a_policy_is_affine_layers_with_relu_between_them():
    made = noisy(KEY, PolicySpec(history=1, hidden=(7, 5)))
    seen = np.asarray(jax.random.normal(KEY, (20,)))
    values = (seen - np.asarray(made.observation_mean)) / np.asarray(made.observation_std)
    for number, (weight, bias) in enumerate(zip(made.weights, made.biases, strict=True)):
        values = np.asarray(weight) @ values + np.asarray(bias)
        values = values if number == 2 else np.maximum(values, 0)
    np.testing.assert_allclose(made(jnp.asarray(seen)), values, rtol=1e-5, atol=1e-6)


def test_a_policy_prints_its_kind_and_sizes_alone():
    assert repr(untrained_policy(KEY)) == "Policy(pwm, 100 Hz, layers 40-50-50-4)"
    assert repr(untrained_policy(KEY, spec=PolicySpec(memory=16))).endswith("memory of 16)")


def test_an_untrained_policy_has_the_papers_layers_and_bounded_weights():
    made = untrained_policy(KEY)
    assert [weight.shape for weight in made.weights] == [(50, 40), (50, 50), (4, 50)]
    assert [bias.shape for bias in made.biases] == [(50,), (50,), (4,)]
    assert (made.interface, made.spec) == (interface.pwm(), PolicySpec())
    for weight, bound in zip(
        made.weights, (np.sqrt(6 / 40), np.sqrt(6 / 50), 0.1 * np.sqrt(6 / 50)), strict=True
    ):
        assert 0.9 * bound < np.abs(weight).max() <= bound * (1 + 1e-6)
    assert not any(np.any(bias) for bias in made.biases)
    np.testing.assert_array_equal(made.observation_mean[:20], made.observation_mean[20:])


def test_different_keys_make_different_policies():
    first, second = untrained_policy(KEY), untrained_policy(jax.random.key(1))
    assert not np.array_equal(first.weights[0], second.weights[0])
    np.testing.assert_array_equal(first.weights[0], untrained_policy(KEY).weights[0])


def test_a_policy_checks_itself():
    made = noisy(KEY, PolicySpec(history=1, hidden=(3,)))
    made.check()
    for wrong in (
        {"spec": PolicySpec(history=2, hidden=(3,))},
        {"spec": PolicySpec(history=1, hidden=(4,))},
        {"spec": PolicySpec(history=1, hidden=(3,), memory=4)},
        {"weights": made.weights[:1]},
        {"biases": (made.biases[0], jnp.array([0, 0, jnp.nan, 0]))},
        {"observation_std": jnp.zeros(20)},
    ):
        with pytest.raises(InputError, match=r"^mine\.json: "):
            dataclasses.replace(made, **wrong).check("mine.json")


@pytest.mark.parametrize(
    "spec",
    [
        PolicySpec(history=1, look_ahead=LookAhead(2, 0.2), hidden=(8,)),
        PolicySpec(history=3, hidden=(8,)),
    ],
)
def test_an_actor_does_what_the_simulator_does_with_the_same_policy(spec):
    """Measurements of a simulated episode, one instant at a time: the same actions, and commands
    that the simulated motors were given."""
    made, drone, env = untrained_policy(KEY, spec=spec), crazyflie(), Environment(spec=spec)
    first = environment.reset(env, drone, KEY)
    _, (states, _) = rollout(env, made, first, drone, KEY, 21)
    actor = Actor(made, 1 / float(drone.thrust_to_weight))
    for _ in range(2):
        actor.reset()
        for number in range(20):
            seen, after = (
                jax.tree.map(lambda leaf, at=at: leaf[at], states) for at in (number, number + 1)
            )
            later = [env.task.reference(seen.time + after) for after in spec.look_ahead.times]
            ahead = {"ahead": np.stack(later)} if later else {}
            command, action = actor.act(seen.measurement, env.task.reference(seen.time), **ahead)
            np.testing.assert_allclose(action, after.action, atol=1e-5)
            np.testing.assert_allclose(command, (np.clip(action, -1, 1) + 1) / 2, atol=1e-6)


def test_an_actor_is_given_the_points_that_its_policy_looks_ahead_at_and_no_others():
    drone = dynamics.at_hover(jnp.zeros(3), crazyflie())
    seen = Measurement(drone.position, drone.velocity, drone.quaternion, drone.body_rates)
    plain = Actor(untrained_policy(KEY, spec=PolicySpec(hidden=(8,))), 0.6)
    ahead = Actor(untrained_policy(KEY, spec=PolicySpec(look_ahead=LookAhead(2), hidden=(8,))), 0.6)
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
    actors = [Actor(untrained_policy(KEY, spec=PolicySpec(hidden=(8,))), 0.6) for _ in range(2)]
    for actor in actors:
        actor.act(seen, np.zeros(3))
    with pytest.raises(InputError, match="nan"):
        actors[0].act(seen._replace(velocity=jnp.full(3, jnp.nan)), np.zeros(3))
    again, other = (actor.act(seen, np.ones(3)) for actor in actors)
    np.testing.assert_array_equal(again.action, other.action)
    for wrong in (0.0, 1.1, float("nan")):
        with pytest.raises(InputError, match="hover"):
            Actor(untrained_policy(KEY, spec=PolicySpec(hidden=(8,))), wrong)
