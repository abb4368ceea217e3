from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight.errors import InputError
from maidenflight.parameters import crazyflie, noiseless, replace
from maidenflight.policy import Policy, untrained
from maidenflight.simulator import control, environment, tasks
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.randomization import relative_box
from maidenflight.simulator.rollout import Drone
from maidenflight.training import analytic_gradient
from maidenflight.training.analytic_gradient import AnalyticGradient, Progress, train
from maidenflight.training.evaluation import evaluate

BOX = relative_box(replace(crazyflie(), motor_time_constant=0.08, latency=0.012), 0.10)
SMALL = AnalyticGradient(updates=400, drones=16, horizon=64, evaluations=4, episodes=32)
KEYS = jax.random.split(jax.random.key(5), 2)


@pytest.fixture(scope="module")
def trained() -> tuple[tuple[Policy, ...], list[Progress]]:
    heard: list[Progress] = []
    return train(tasks.circle(), control.pwm(), BOX, KEYS, SMALL, heard.append), heard


def test_training_makes_policies_fly_that_did_not(trained: Any) -> None:
    policies, heard = trained
    simulated = Environment()
    before = evaluate(simulated, untrained(jax.random.key(0)), BOX, jax.random.key(9), 32)
    after = [evaluate(simulated, policy, BOX, jax.random.key(9), 32) for policy in policies]
    assert float(before.survival) == 0.0
    assert all(float(score.survival) > 0.5 for score in after)
    assert len(heard) == 4
    assert [progress.update for progress in heard] == [100, 200, 300, 400]
    assert heard[-1].steps == 400 * 16 * 64 * 2


def test_the_best_scored_policy_is_kept_not_the_last(trained: Any) -> None:
    policies, heard = trained
    best = np.max([progress.score.episode_return for progress in heard], axis=0)
    scores = [float(evaluate(Environment(), policy, BOX, jax.random.key(0), SMALL.episodes).episode_return) for policy in policies]
    np.testing.assert_allclose(scores, best, rtol=1e-3)


def test_the_same_key_gives_the_same_policy_and_another_key_another(trained: Any) -> None:
    policies, _ = trained
    again = train(tasks.circle(), control.pwm(), BOX, KEYS, SMALL)
    for one, other in zip(jax.tree.leaves(policies), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(one, other)
    assert not np.allclose(policies[0].weights[0], policies[1].weights[0])


def test_training_leaves_the_normaliser_and_the_control_structure_alone(trained: Any) -> None:
    policy = trained[0][0]
    fresh = untrained(jax.random.key(0))
    np.testing.assert_array_equal(policy.observation_mean, fresh.observation_mean)
    assert (policy.control, policy.rate, policy.history, policy.layer_sizes) == ("pwm", 100, 2, (40, 50, 50, 4))


def test_gradient_through_the_simulator_is_the_slope_of_the_cost() -> None:
    simulated, drone = Environment(), noiseless(crazyflie())
    settings = AnalyticGradient(horizon=12)
    policy = untrained(jax.random.key(1))
    episode = environment.reset(simulated, drone, jax.random.key(2))
    direction = jax.tree.map(lambda leaf: jax.random.normal(jax.random.key(leaf.size), leaf.shape), analytic_gradient._network(policy))

    @jax.jit
    def cost(scale: jax.Array) -> jax.Array:
        moved = jax.tree.map(lambda leaf, step: leaf + scale * step, analytic_gradient._network(policy), direction)
        changed = analytic_gradient._with_network(policy, moved)
        return analytic_gradient._segment(simulated, settings, changed, Drone(episode, drone), jax.random.key(3))[0]

    slope = float(jax.jit(jax.grad(cost))(jnp.zeros(())))
    steps = (1e-3, 2e-3)
    numeric = [(float(cost(jnp.float32(h))) - float(cost(jnp.float32(-h)))) / (2 * h) for h in steps]
    assert abs(slope) > 1e-3
    assert slope == pytest.approx(np.mean(numeric), rel=0.05)


def test_a_control_structure_that_no_policy_can_carry_is_refused() -> None:
    with pytest.raises(InputError, match="position_pid cannot be trained for"):
        train(tasks.circle(), control.position_pid(), BOX, KEYS, SMALL)


def test_a_lost_drone_is_held_and_gives_no_gradient() -> None:
    simulated, drone = Environment(), noiseless(crazyflie())
    episode = environment.reset(simulated, drone, jax.random.key(2))
    lost = episode._replace(state=episode.state._replace(position=episode.state.position + 50.0))
    policy = untrained(jax.random.key(1))
    segment = jax.jit(partial(analytic_gradient._segment, simulated, AnalyticGradient(horizon=12)))
    cost, after = segment(policy, Drone(lost, drone), jax.random.key(3))
    assert float(cost) == 0.0
    np.testing.assert_array_equal(after.state.position, lost.state.position)
