from dataclasses import replace as changed
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight import compiler
from maidenflight.parameters import crazyflie, replace
from maidenflight.policy import untrained_policy
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.randomization import relative_box, stacked
from maidenflight.simulator.stepping import randomized_reset
from maidenflight.simulator.tasks import tasks
from maidenflight.training import ppo
from maidenflight.training.critic import Moments, advantages, merged, moments_of
from maidenflight.training.devices import DRONES
from maidenflight.training.evaluation import evaluate
from maidenflight.training.ppo import surrogate
from maidenflight.training.settings import PPO, recorded
from maidenflight.training.train import Progress, _init_once, train

BOX = relative_box(replace(crazyflie(), motor_time_constant=0.04, latency=0.0), 0.10)
TASK = tasks.circle()._replace(duration=0.6)
SIMULATED = Environment.matching(BOX.centre, TASK)
SMALLER = Environment.matching(BOX.centre, TASK, spec=PolicySpec(hidden=(8,)))
SMALL = PPO(
    updates=250,
    num_envs=128,
    horizon=16,
    learning_rate=4e-3,
    critic_learning_rate=3e-3,
    actor_minibatches=4,
    critic_minibatches=4,
)
TINY = changed(
    SMALL,
    updates=4,
    num_envs=8,
    horizon=4,
    critic_hidden=(8,),
    evaluations=2,
    episodes=4,
)
KEYS = jax.random.split(jax.random.key(5), 2)
BOXES = stacked([BOX, BOX])


def _learned(env: Environment, settings: PPO, *ends: int) -> Any:
    learners, first = _init_once(ppo.init, env, settings, BOXES, KEYS), 0
    for end in ends:
        learners, first = ppo.update(env, settings, BOXES, learners, KEYS, first, end), end
    return learners


_reset = jax.jit(randomized_reset, static_argnums=0, compiler_options=compiler.once())


@partial(jax.jit, compiler_options=compiler.once())
def _survival(policies: Any) -> Any:
    def one(policy: Any) -> Any:
        return evaluate(SIMULATED, policy, BOX, jax.random.key(9), 64).survival

    return jax.vmap(one)(policies)


@pytest.mark.night
def test_training_makes_policies_fly_that_did_not() -> None:
    learned = _learned(SIMULATED, SMALL, SMALL.updates)
    policies = jax.tree.map(
        lambda *leaves: jnp.concatenate(leaves),
        _learned(SIMULATED, SMALL).policy,
        learned.policy,
    )
    survival = _survival(policies)
    assert np.all(survival[:2] < 0.05), survival
    # How far 250 updates take a seed depends on the last bit of a sum, and so on the processor.
    assert np.all(survival[2:] > 0.1), survival
    assert np.max(survival[2:]) > 0.5, survival


@pytest.mark.night
def test_the_same_key_gives_the_same_policy_however_often_training_pauses() -> None:
    straight, paused = _learned(SMALLER, TINY, 4), _learned(SMALLER, TINY, 1, 4)
    for one, other in zip(jax.tree.leaves(straight), jax.tree.leaves(paused), strict=True):
        np.testing.assert_array_equal(one, other)
    weights = straight.policy.weights[0]
    assert not np.allclose(weights[0], weights[1])


@pytest.mark.slow
def test_interrupted_training_goes_on_to_the_same_policies(tmp_path: Path) -> None:
    def learn(saved: Path | None, hear: Any) -> Any:
        return train(
            *(TASK, SMALLER.controller, BOX, KEYS, TINY, SMALLER.spec),
            on_progress=hear,
            checkpoint=saved,
        )

    def interrupt(_: Progress) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        learn(tmp_path / "training.npz", interrupt)
    stories: list[list[Progress]] = [[], []]
    resumed, whole = (
        learn(tmp_path / "training.npz", stories[0].append),
        learn(None, stories[1].append),
    )
    assert [progress.update for progress in stories[0]] == [2, 4]
    for one, other in zip(
        jax.tree.leaves((resumed, stories[0])), jax.tree.leaves((whole, stories[1])), strict=True
    ):
        np.testing.assert_array_equal(one, other)


@pytest.mark.slow
def test_the_policy_normalises_by_all_observations_so_far() -> None:
    learned = _learned(SMALLER, TINY, TINY.updates)
    np.testing.assert_array_equal(
        learned.observation_moments.samples, TINY.updates * TINY.num_envs * TINY.horizon
    )
    np.testing.assert_array_equal(
        learned.policy.observation_mean, learned.observation_moments.mean[:, :40]
    )
    np.testing.assert_array_equal(
        learned.policy.observation_std, learned.observation_moments.deviation[:, :40]
    )
    shares = learned.observation_moments.mean[
        :, -10:-1
    ]  # of the centre's constants, all but the latency, which is 0
    np.testing.assert_allclose(shares, jnp.ones_like(shares), atol=0.06)


def _plain_advantages(
    rewards: Any,
    values: Any,
    after: Any,
    terminated: Any,
    truncated: Any,
    discount: float,
    gae_lambda: float,
) -> Any:
    found = np.zeros(len(rewards))
    for first in range(len(rewards)):
        weight = 1.0
        for now in range(first, len(rewards)):
            found[first] += weight * (
                rewards[now] + discount * (0.0 if terminated[now] else after[now]) - values[now]
            )
            if terminated[now] or truncated[now]:
                break
            weight *= discount * gae_lambda
    return found


def test_advantages_are_those_of_a_plain_loop() -> None:
    random = np.random.default_rng(3)
    rewards, values, after = random.normal(size=(3, 60)).astype(np.float32)
    terminated = random.random(60) < 0.1
    truncated = ~terminated & (random.random(60) < 0.1)
    assert terminated.any()
    assert truncated.any()
    found = advantages(
        *map(jnp.asarray, (rewards, values, after, terminated, truncated)),
        discount=0.9,
        gae_lambda=0.8,
    )
    plain = _plain_advantages(rewards, values, after, terminated, truncated, 0.9, 0.8)
    np.testing.assert_allclose(found, plain, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    ("terminated", "truncated", "expected"),
    [(True, False, 1.0), (False, True, 4.5), (False, False, 4.5)],
)
def test_what_comes_after_failure_is_nothing_and_after_the_time_limit_the_critics_guess(
    terminated: bool, truncated: bool, expected: float
) -> None:
    ends = jnp.array([terminated]), jnp.array([truncated])
    found = advantages(
        jnp.ones(1), jnp.zeros(1), jnp.full(1, 7.0), *ends, discount=0.5, gae_lambda=0.9
    )
    assert float(found[0]) == expected


@pytest.mark.slow
def test_the_value_at_an_end_is_of_the_drone_before_another_takes_over() -> None:
    short = tasks.circle()._replace(duration=0.05)
    # Every drone's episode is of five periods, as periods vary too.
    box = relative_box(BOX.centre, 0.05)
    simulated, settings = Environment.matching(box.centre, short), PPO(horizon=16)
    policy = untrained_policy(jax.random.key(1))
    drone = _reset(simulated, box, jax.random.key(2))
    fly = jax.jit(partial(ppo._rollout, simulated, settings), compiler_options=compiler.once())
    _, _, flown = fly(box, policy, jnp.float32(0.1), drone, jnp.zeros(()), jax.random.key(3))
    over = np.asarray(flown.truncated)
    np.testing.assert_array_equal(np.flatnonzero(over), [4, 9, 14])
    assert not np.any(flown.terminated)
    goes_on = ~over[:-1]
    np.testing.assert_array_equal(
        flown.next_critic_observation[:-1][goes_on], flown.critic_observation[1:][goes_on]
    )
    # The newest of the two instants that a drone saw last is not what the next one sees first, nor
    # is its last action.
    np.testing.assert_array_equal(flown.next_critic_observation[:, 36:40], flown.action)
    assert np.all(
        np.any(
            np.asarray(
                flown.next_critic_observation[:-1][over[:-1]]
                != flown.critic_observation[1:][over[:-1]]
            ),
            axis=1,
        )
    )
    discounted = 0.0
    for number, reward in enumerate(np.asarray(flown.reward, float)):
        discounted = settings.discount * discounted + reward
        assert float(flown.discounted[number]) == pytest.approx(discounted, rel=1e-4)
        discounted *= not over[number]


@pytest.mark.slow
def test_a_memory_is_carried_through_a_rollout_as_it_was_flown() -> None:
    """What an update computes anew, from the first memory on and over resets, is what was done."""
    short = tasks.circle()._replace(duration=0.05)
    simulated = Environment.matching(BOX.centre, short, spec=PolicySpec(memory=3, hidden=(8,)))
    settings = PPO(horizon=16)
    policy = untrained_policy(jax.random.key(1), spec=PolicySpec(memory=3, hidden=(8,)))
    drone = _reset(simulated, BOX, jax.random.key(2))
    deviation = jnp.float32(0.1)
    fly = jax.jit(partial(ppo._rollout, simulated, settings), compiler_options=compiler.once())
    drone, discounted, _ = fly(BOX, policy, deviation, drone, jnp.zeros(()), jax.random.key(3))
    assert np.abs(drone.env_state.memory).max() > 0.0
    _, _, flown = fly(BOX, policy, deviation, drone, discounted, jax.random.key(4))
    assert np.sum(flown.truncated) >= 2
    done = np.asarray(flown.action - deviation * flown.noise)
    np.testing.assert_allclose(ppo._actions(policy, flown), done, rtol=0, atol=1e-5)
    empty = flown.critic_observation.at[0, 40:43].set(0.0)
    without = flown._replace(critic_observation=empty)
    assert np.abs(np.asarray(ppo._actions(policy, without)) - done)[:3].max() > 1e-5

    def sum_of(gru: Any) -> Any:
        return jnp.sum(ppo._actions(changed(policy, gru=gru), flown))

    slope: Any = jax.grad(sum_of)(policy.gru)
    assert np.abs(slope.recurrent).max() > 0.0


@pytest.mark.parametrize(
    ("ratio", "advantage", "slope"),
    [
        (1.3, 2.0, 0.0),
        (0.7, 2.0, 2.0),
        (1.3, -2.0, -2.0),
        (0.7, -2.0, 0.0),
        (1.1, 2.0, 2.0),
        (0.9, -2.0, -2.0),
    ],
)
def test_the_objective_gains_nothing_beyond_the_clip_but_mends_what_went_astray(
    ratio: float, advantage: float, slope: float
) -> None:
    found = jax.grad(lambda ratio: surrogate(ratio, jnp.float32(advantage), 0.2))(
        jnp.float32(ratio)
    )
    assert float(found) == slope


def test_the_running_moments_are_those_of_all_samples_on_all_devices() -> None:
    devices, updates = 2, 4
    samples = (
        np.random.default_rng(1)
        .normal(loc=[5.0, -100.0], scale=[0.01, 30.0], size=(updates, devices, 50, 2))
        .astype(np.float32)
    )
    samples[0] += 1.0
    running = Moments(
        jnp.zeros(()), jnp.full(2, 7.0), jnp.full(2, 9.0)
    )  # a guess that no sample backs counts for nothing
    for batch in samples:
        across = jax.vmap(moments_of, axis_name=DRONES)(jnp.asarray(batch))
        running = merged(running, jax.tree.map(lambda leaf: leaf[0], across))
    flat = samples.reshape(-1, 2).astype(np.float64)
    assert float(running.samples) == len(flat)
    np.testing.assert_allclose(running.mean, flat.mean(0), rtol=1e-5)
    np.testing.assert_allclose(running.deviation, flat.std(0) + 1e-5, rtol=1e-3)


def test_the_papers_settings_are_the_papers() -> None:
    paper = PPO.paper()
    assert paper.num_envs * paper.horizon == 64_000
    assert recorded(paper) == {
        "updates": 500,
        "num_envs": 64,
        "horizon": 1000,
        "critic_hidden": [64, 64],
        "critic_sees_truth": False,
        "learning_rate": 3e-4,
        "critic_learning_rate": 1e-3,
        "actor_passes": 80,
        "actor_minibatches": 1,
        "critic_passes": 5,
        "critic_minibatches": 16,
        "clip": 0.2,
        "discount": 0.99,
        "gae_lambda": 0.95,
        "normalize_advantages": False,
        "reward_clip": 10.0,
        "initial_noise_std": 0.5,
        "final_noise_std": 0.01,
        "evaluations": 15,
        "episodes": 128,
    }
    assert hash(paper) != hash(PPO())


def test_only_a_critic_that_may_sees_the_truth() -> None:
    drone = _reset(SIMULATED, BOX, jax.random.key(1))
    blind, seeing = (
        ppo._critic_observation(SIMULATED, settings, BOX.centre, drone)
        for settings in (PPO.paper(), PPO())
    )
    np.testing.assert_array_equal(blind, seeing[:40])
    state = drone.env_state.state
    np.testing.assert_allclose(
        seeing[40:43], state.position - SIMULATED.task.reference(drone.env_state.time)
    )
    np.testing.assert_array_equal(seeing[53:57], state.rotor_speed)
    assert float(seeing[57]) == pytest.approx(
        float(drone.parameters.thrust_to_weight) / float(BOX.centre.thrust_to_weight)
    )
    assert seeing.shape == (67,)
