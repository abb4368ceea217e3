"""An episode: repeatable, equal alone and in a batch, and the paper's equations step by step."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import numpy_reference
import pytest
from jax import lax

from maidenflight.parameters import crazyflie, noiseless, replace
from maidenflight.simulator import dynamics, environment, latency, rotations, tasks
from maidenflight.simulator.environment import Environment

WORLD = Environment()
PAPER, QUIET = crazyflie(), noiseless(crazyflie())
KEY = jax.random.key(0)
TRACES = []
"""One entry for each compilation of `fly`."""

start = jax.jit(environment.reset, static_argnums=0)
step = jax.jit(environment.step, static_argnums=0)


@jax.jit
def fly(parameters, key):
    """Half a second of a simple policy from a random start."""
    TRACES.append(parameters)
    return environment.rollout(WORLD, wobble, environment.reset(WORLD, parameters, key), parameters, key, 50)[1]


def wobble(observation):
    """Thrust against height error and climb, and some torque, as a function of the newest instant."""
    return jnp.clip(0.16 + observation[-6:-2].sum() - 0.2 * observation[27:31], -1.0, 1.0)


def same(one, other):
    return all(bool(jnp.array_equal(a, b)) for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True))


@pytest.mark.parametrize("integrator", [dynamics.euler, dynamics.rk4])
@pytest.mark.parametrize("delay", [0.0, 0.013, 0.018])
@pytest.mark.parametrize("through", ["drive", "step"])
def test_the_simulator_is_the_papers_equations(integrator, delay, through):
    """One second of varying commands against an independent float64 transcription."""
    commands = np.clip(1 / 1.725 + 0.08 * np.sin(np.arange(100)[:, None] * [0.31, 0.23, 0.41, 0.29] + [0, 1, 2, 3]), 0, 1)
    commands[40], commands[60:62] = [1.0, 0.9, 1.0, 0.95], 0.0
    attitude = rotations.from_attitude(jnp.array([0.1, -0.2, 0.7]))
    hover = np.float32(np.sqrt(1 / 1.725))
    first = dynamics.State(*map(jnp.asarray, np.split(np.float32([0.1, -0.2, 1, 0.3, 0.1, -0.2, *attitude, 1, -0.5, 0.3, *[hover] * 4]), [3, 6, 10, 13])))
    flown = jax.tree.map(np.asarray, flown_by(through)(integrator, first, jnp.asarray(commands, jnp.float32), replace(QUIET, latency=delay)))
    x, y, z, w = np.float64(first.quaternion)
    begin = [np.float64(first.position), np.float64(first.velocity), np.array([w, x, y, z]), np.float64(first.body_rates), np.full(4, np.sqrt(1 / 1.725))]
    expected = numpy_reference.fly(getattr(numpy_reference, integrator.__name__), begin, commands, delay, 0.005, 2, numpy_reference.PAPER)
    worst = 0.0
    for name, column in zip(flown._fields, map(np.array, zip(*expected, strict=True)), strict=True):
        column = column[:, [1, 2, 3, 0]] if name == "quaternion" else column
        np.testing.assert_allclose(getattr(flown, name), column, rtol=1e-5, atol=1e-5, err_msg=name)
        worst = max(worst, np.abs(getattr(flown, name) - column).max())
    assert np.abs(expected[-1][0] - begin[0]).max() > 0.1, "the drone moved"
    print(f"deviation {through} {integrator.__name__} {delay}: {worst:.2e}")


@partial(jax.jit, static_argnums=0)
def driven(integrator, state, commands, parameters):
    """States after each command, through `drive` and a delay line."""

    def hold(carry, command):
        state, line = carry
        line = latency.push(line, jnp.sqrt(command))
        state = environment.drive(integrator, state, line, 2, parameters)
        return (state, line), state

    line = jnp.broadcast_to(jnp.sqrt(dynamics.hover_command(parameters)), (latency.slots(0.01), 4))
    return lax.scan(hold, (state, line), commands)[1]


@partial(jax.jit, static_argnums=0)
def stepped(integrator, state, commands, parameters):
    """States after each command, through `step` and actions."""
    world = Environment(integrator=integrator)
    episode = environment.begin(world, state, jnp.float32(0), parameters, KEY)

    def hold(episode, command):
        episode, _ = environment.step(world, episode, 2 * command - 1, parameters, KEY)
        return episode, episode.state

    return lax.scan(hold, episode, commands)[1]


def flown_by(through):
    return {"drive": driven, "step": stepped}[through]


def test_the_same_key_is_the_same_flight_and_another_key_another():
    assert same(fly(PAPER, KEY), fly(PAPER, KEY))
    assert not np.allclose(fly(PAPER, KEY)[0].state.position, fly(PAPER, jax.random.key(1))[0].state.position, atol=1e-3)


def test_noise_differs_from_step_to_step_and_from_key_to_key():
    episode = start(WORLD, PAPER, KEY)
    hover = episode.action
    one, other = (step(WORLD, episode, hover, PAPER, jax.random.key(seed))[0] for seed in (1, 2))
    for name in ("position", "velocity", "quaternion", "body_rates"):
        assert not np.array_equal(getattr(one.measurement, name), getattr(other.measurement, name)), name
    assert not np.array_equal(one.actuators.noise, other.actuators.noise)


def test_a_batch_of_drones_flies_as_each_does_alone():
    drones = [replace(PAPER, mass=mass, latency=delay) for mass, delay in ((0.026, 0.0), (0.028, 0.013), (0.031, 0.04))]
    keys = jax.random.split(KEY, 3)
    batch = jax.tree.map(lambda *leaves: np.stack(leaves), *drones)
    together, _ = jax.jit(jax.vmap(fly))(batch, keys)
    for number, drone in enumerate(drones):
        alone, _ = fly(drone, keys[number])
        for one, other in zip(alone.state, together.state, strict=True):
            np.testing.assert_allclose(other[number], one, rtol=1e-3, atol=1e-3)


def test_one_compilation_serves_every_drone():
    fly(PAPER, KEY)
    compiled, before = len(TRACES), fly(PAPER, KEY)[0].state.position
    for change in ({"time_step": 0.004}, {"latency": 0.031}, {"motor_time_constant": 0.05}, {"mass": 1}, {"drag": [0.1, 0.2, 0.3]}):
        assert not np.array_equal(fly(replace(PAPER, **change), KEY)[0].state.velocity, before), change
    assert len(TRACES) == compiled


@pytest.mark.parametrize("time_step", [0.0045, 0.005, 0.0055])
def test_the_control_period_follows_the_time_step(time_step):
    parameters = replace(QUIET, time_step=time_step)
    episode = start(WORLD, parameters, KEY)
    after, outcome = step(WORLD, episode, episode.action, parameters, KEY)
    np.testing.assert_allclose(after.elapsed, 2 * time_step, rtol=1e-5)
    np.testing.assert_allclose(after.time - episode.time, 2 * time_step, rtol=1e-3)
    np.testing.assert_allclose(outcome.setpoint, WORLD.task.reference(after.time), atol=1e-6)
    np.testing.assert_allclose(after.state.position - episode.state.position, 2 * time_step * np.asarray(episode.state.velocity), atol=1e-3)


def test_time_is_up_after_five_seconds_and_that_is_no_failure():
    world = Environment(task=tasks.circle(diameter=0.0))
    episode = environment.begin(world, dynamics.at_hover(jnp.array([0.0, 0.0, 1.0]), QUIET), jnp.float32(0), QUIET, KEY)
    hover = episode.action
    roll = jax.jit(lambda episode: environment.rollout(world, lambda _: hover, episode, QUIET, KEY, 502)[1][1])
    outcome = roll(episode)
    assert not np.any(outcome.terminated)
    assert np.flatnonzero(outcome.truncated)[0] == 499


@pytest.mark.parametrize(("offset", "terminated", "truncated"), [(0.0, False, True), (1.0, True, False)])
def test_a_failure_in_the_last_step_is_a_failure_and_not_the_end_of_time(offset, terminated, truncated):
    setpoint = WORLD.task.reference(jnp.float32(0.0))
    state = dynamics.at_hover(setpoint + jnp.array([0.0, 0.0, offset]), QUIET)
    episode = jax.jit(environment.begin, static_argnums=0)(WORLD, state, jnp.float32(0), QUIET, KEY)._replace(elapsed=jnp.float32(4.99))
    _, outcome = step(WORLD, episode, episode.action, QUIET, KEY)
    assert (bool(outcome.terminated), bool(outcome.truncated)) == (terminated, truncated)
    assert (float(outcome.reward) < -100) is terminated


@pytest.mark.parametrize("history", [1, 2])
def test_an_observation_holds_instants_from_oldest_to_newest_each_with_its_last_action(history):
    world = Environment(history=history)
    episode = start(world, PAPER, KEY)
    instants = [np.asarray(environment.observation(episode))[-20:]]
    np.testing.assert_array_equal(environment.observation(episode), np.tile(instants[0], history))
    np.testing.assert_allclose(instants[0][-4:], 2 / 1.725 - 1, rtol=1e-6)
    for number, action in enumerate(np.float32([[0.1, 0.2, 0.3, 0.4], [-2.0, 2.0, 0.0, 0.5], [0.0, 0.1, 0.2, 0.3]])):
        episode, outcome = step(world, episode, jnp.asarray(action), PAPER, jax.random.key(number))
        seen = episode.measurement
        instants.append(np.concatenate([seen.position, seen.quaternion, seen.velocity, seen.body_rates, outcome.setpoint - seen.position, action]))
        observation = np.asarray(environment.observation(episode))
        assert observation.shape == (20 * history,)
        np.testing.assert_allclose(observation, np.concatenate(instants[-history:]), atol=1e-6)


def test_a_reward_sees_this_action_and_the_one_before():
    episode = start(WORLD, QUIET, KEY)
    action = jnp.array([0.1, 0.2, 0.3, 0.4])
    after, outcome = step(WORLD, episode, action, QUIET, KEY)
    expected = WORLD.task.reward(after.state, outcome.setpoint, action, episode.action)
    np.testing.assert_allclose(outcome.reward, expected, rtol=1e-5)
    np.testing.assert_array_equal(after.action, action)


def test_the_gyros_bias_is_drawn_for_an_episode_and_walks_in_it():
    biased = replace(QUIET, gyro_turn_on_bias=0.1)
    first, other = start(WORLD, biased, KEY), start(WORLD, biased, jax.random.key(1))
    assert not np.allclose(first.gyro_bias, other.gyro_bias)
    np.testing.assert_allclose(first.measurement.body_rates - first.state.body_rates, first.gyro_bias, atol=1e-6)
    held, _ = step(WORLD, first, first.action, biased, KEY)
    np.testing.assert_allclose(held.gyro_bias, first.gyro_bias, rtol=1e-4)
    walked, _ = step(WORLD, first, first.action, replace(biased, gyro_bias_walk=1.0), KEY)
    assert not np.allclose(walked.gyro_bias, first.gyro_bias, atol=1e-3)


def test_a_late_estimator_shows_the_state_of_the_period_before():
    world, late = Environment(estimator_memory=3), replace(QUIET, estimator_delay=0.01)
    episode = start(world, late, KEY)
    for number in range(3):
        before = episode
        episode, _ = step(world, episode, episode.action, late, jax.random.key(number))
        np.testing.assert_allclose(episode.measurement.position, before.state.position, atol=1e-6)
        np.testing.assert_allclose(episode.measurement.velocity, before.state.velocity, atol=1e-6)
        np.testing.assert_allclose(episode.measurement.body_rates, episode.state.body_rates, atol=1e-6)


def test_a_rollout_goes_on_after_the_end_unless_it_is_given_fresh_episodes():
    def outcomes(fresh):
        episode = environment.reset(WORLD, PAPER, KEY)._replace(elapsed=jnp.float32(4.9))
        falling = lambda _: jnp.full(4, -1.0)  # noqa: E731
        return environment.rollout(WORLD, falling, episode, PAPER, KEY, 60, fresh)[1]

    before, outcome = jax.jit(partial(outcomes, None))()
    np.testing.assert_allclose(np.diff(before.elapsed), 0.01, rtol=1e-3)
    before, outcome = jax.jit(partial(outcomes, lambda key: environment.reset(WORLD, PAPER, key)))()
    over = np.flatnonzero(outcome.terminated | outcome.truncated)
    assert len(over) >= 2
    over = over[over < 59]
    np.testing.assert_array_equal(before.elapsed[over + 1], 0)
    starts = np.asarray(before.state.position[over + 1])
    assert len(np.unique(starts, axis=0)) == len(starts), "each fresh episode starts elsewhere"
