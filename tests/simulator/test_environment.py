"""An episode: repeatable, equal alone and in a batch, and the paper's equations step by step."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from jaxtyping import Array, Float

import numpy_reference
from arrays import float32, float64
from maidenflight.errors import InputError
from maidenflight.parameters import crazyflie, noiseless, replace, x_frame
from maidenflight.simulator import environment, stepping
from maidenflight.simulator.controllers import control, interface
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics import dynamics, latency, motion, vectors
from maidenflight.simulator.physics.latency import DelayLine
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.stepping import rollout
from maidenflight.simulator.tasks import failures, tasks

WORLD = Environment()
PAPER, QUIET = crazyflie(), noiseless(crazyflie())
KEY = jax.random.key(0)
FINE = replace(QUIET, time_step=0.002, latency=0.007)
TRACES = []
"""One entry for each compilation of `fly`."""

start = jax.jit(environment.reset, static_argnums=0)
step = jax.jit(stepping.step, static_argnums=0)


@jax.jit
def fly(parameters, key):
    """Half a second of a simple policy from a random start."""
    TRACES.append(parameters)
    return rollout(WORLD, wobble, environment.reset(WORLD, parameters, key), parameters, key, 50)[1]


def wobble(observation):
    """Thrust against height error and climb, and some torque, as a function of the newest
    instant."""
    return jnp.clip(0.16 + observation[-6:-2].sum() - 0.2 * observation[27:31], -1.0, 1.0)


def same(one, other):
    return all(
        bool(jnp.array_equal(a, b))
        for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    )


NAMES = {
    "gravity": "g",
    "mass": "m",
    "inertia": "I",
    "torque_to_thrust": "k_M1",
    "torque_offset": "k_M2",
}
NAMES |= {"thrust_to_weight": "k_F", "motor_time_constant": "T_m"}


def reference_flight(integrator, delay):
    """First state, commands and one second of states of the paper's equations, transcribed without
    maidenflight."""
    c = numpy_reference.PAPER
    commands = np.clip(
        1 / c["k_F"]
        + 0.08 * np.sin(np.arange(100)[:, None] * [0.31, 0.23, 0.41, 0.29] + [0, 1, 2, 3]),
        0,
        1,
    )
    commands[40], commands[60:62] = [1.0, 0.9, 1.0, 0.95], 0.0
    speed = np.full(4, np.sqrt(1 / c["k_F"]))
    first = [
        np.array([0.1, -0.2, 1]),
        np.array([0.3, 0.1, -0.2]),
        np.array([0.8, 0.2, -0.4, 0.4]),
        np.array([1, -0.5, 0.3]),
        speed,
    ]
    speeds = numpy_reference.delayed_speeds(commands, delay, 0.005, 2, c)
    flown = numpy_reference.fly(getattr(numpy_reference, integrator.__name__), first, *speeds, c)
    assert np.abs(flown[0][-1] - first[0]).max() > 0.1, "the drone moved"
    first[2], flown[2] = first[2][[1, 2, 3, 0]], flown[2][:, [1, 2, 3, 0]]
    return (
        dynamics.State(*map(float64, first)),
        commands,
        dynamics.State(*(float64(column[1::2]) for column in flown)),
    )


def deviation(flown, expected):
    """Largest difference in shares of a quantity's largest value, or of one."""
    return max(
        np.abs(one - other).max() / max(1, np.abs(other).max())
        for one, other in zip(flown, expected, strict=True)
    )


@pytest.mark.parametrize("delay", [0.0, 0.013, 0.018])
@pytest.mark.parametrize(
    ("integrator", "tolerance"), [(dynamics.euler, 1e-12), (dynamics.rk4, 1e-8)]
)
def test_driving_in_float64_is_the_papers_equations(integrator, tolerance, delay):
    """Between the stages of RK4 a quaternion's length is not one, where two ways to turn a vector
    differ by some 1e-9; by more in the one step of a command without delay, which is twice as long.
    """
    tolerance *= 4 if delay == 0.0 and integrator is dynamics.rk4 else 1
    first, commands, expected = reference_flight(integrator, delay)
    with jax.enable_x64(True), jax.numpy_dtype_promotion("standard"):
        exact = {
            name: np.array(numpy_reference.PAPER[symbol], np.float64)
            for name, symbol in NAMES.items()
        }
        frame = x_frame(numpy_reference.PAPER["L"])
        exact |= {name: np.array(values, np.float64) for name, values in frame.items()}
        parameters = replace(jax.tree.map(float64, QUIET), **exact)
        parameters = replace(parameters, latency=np.asarray(delay), time_step=np.asarray(0.005))
        flown = jax.tree.map(np.asarray, driven(integrator, first, commands, parameters))
    assert flown.position.dtype == np.float64
    assert deviation(flown, expected) < tolerance, deviation(flown, expected)


@pytest.mark.parametrize("delay", [0.0, 0.013, 0.018])
def test_stepping_is_the_papers_equations_to_float32s_rounding(delay):
    """A rounding of 1e-7 in a rotor speed is some 1e-5 rad/s a tenth of a second later, because the
    drone is so light."""
    first, commands, expected = reference_flight(dynamics.rk4, delay)
    first, commands = jax.tree.map(jnp.float32, (first, commands))
    flown = jax.tree.map(np.asarray, stepped(first, commands, replace(QUIET, latency=delay)))
    assert deviation(flown, expected) < 2e-5, deviation(flown, expected)


@partial(jax.jit, static_argnums=0)
def driven(integrator, state, commands, parameters):
    """States after each command, through `drive` and a delay line."""

    def hold(carry, command):
        state, line = carry
        line = latency.push(line, jnp.sqrt(command))
        state = motion.drive(integrator, state, DelayLine(line), 2, parameters)
        return (state, line), state

    line = jnp.broadcast_to(jnp.sqrt(dynamics.hover_command(parameters)), (latency.slots(0.01), 4))
    return lax.scan(hold, (state, line), commands)[1]


@pytest.mark.parametrize("steps", [2, 3, 7])
def test_a_state_of_entries_is_driven_as_one_of_arrays(steps):
    """However many steps, by one program, also where the newest command has a place in a line."""
    rng, drone = np.random.default_rng(steps), replace(QUIET, latency=0.013, time_step=0.01 / steps)
    parts = [rng.normal(0, 0.3, size) for size in (3, 3, 4, 3)]
    parts[2] /= np.linalg.norm(parts[2])
    state = dynamics.State(*map(jnp.float32, (*parts, rng.uniform(0.2, 0.9, 4))))
    line = DelayLine(jnp.float32(rng.uniform(0.2, 0.9, (9, 4))), newest=2)
    expected = motion.drive(dynamics.midpoint, state, line, steps, drone)
    found = driven_entries(vectors.entries(state), line, np.int32(steps), drone)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(np.array(list(one)), other, rtol=2e-6, atol=2e-6)
    assert driven_entries._cache_size() == 1  # type: ignore[attr-defined]


@jax.jit
def driven_entries(state, line, steps, drone):
    return motion.drive_entries(dynamics.midpoint, state, line, steps, drone)


@jax.jit
def stepped(state, commands, parameters):
    """States after each command, through `step` and actions."""
    env = Environment(integrator=dynamics.rk4)
    env_state = environment.begin(env, state, jnp.float32(0), parameters, KEY)

    def hold(env_state, command):
        env_state, _ = stepping.step(env, env_state, 2 * command - 1, parameters, KEY)
        return env_state, env_state.state

    return lax.scan(hold, env_state, commands)[1]


def test_the_same_key_is_the_same_flight_and_another_key_another():
    assert same(fly(PAPER, KEY), fly(PAPER, KEY))
    assert not np.allclose(
        fly(PAPER, KEY)[0].state.position,
        fly(PAPER, jax.random.key(1))[0].state.position,
        atol=1e-3,
    )


def test_noise_differs_from_step_to_step_and_from_key_to_key():
    env_state = start(WORLD, PAPER, KEY)
    hover = env_state.action
    one, other = (step(WORLD, env_state, hover, PAPER, jax.random.key(seed))[0] for seed in (1, 2))
    for name in ("position", "velocity", "quaternion", "body_rates"):
        assert not np.array_equal(
            getattr(one.measurement, name), getattr(other.measurement, name)
        ), name
    assert not np.array_equal(one.actuators.noise, other.actuators.noise)


def test_a_batch_of_drones_flies_as_each_does_alone():
    drones = [
        replace(PAPER, mass=mass, latency=delay)
        for mass, delay in ((0.026, 0.0), (0.028, 0.013), (0.031, 0.04))
    ]
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
    for change in (
        {"time_step": 0.004},
        {"latency": 0.031},
        {"motor_time_constant": 0.05},
        {"mass": 1},
        {"drag": [0.1, 0.2, 0.3]},
    ):
        assert not np.array_equal(fly(replace(PAPER, **change), KEY)[0].state.velocity, before), (
            change
        )
    assert len(TRACES) == compiled


@pytest.mark.parametrize("time_step", [0.0045, 0.005, 0.0055])
def test_the_control_period_follows_the_time_step(time_step):
    parameters = replace(QUIET, time_step=time_step)
    env_state = start(WORLD, parameters, KEY)
    after, step_result = step(WORLD, env_state, env_state.action, parameters, KEY)
    np.testing.assert_allclose(after.elapsed, 2 * time_step, rtol=1e-5)
    np.testing.assert_allclose(after.time - env_state.time, 2 * time_step, rtol=1e-3)
    np.testing.assert_allclose(step_result.setpoint, WORLD.task.reference(after.time), atol=1e-6)
    np.testing.assert_allclose(
        after.state.position - env_state.state.position,
        2 * time_step * np.asarray(env_state.state.velocity),
        atol=1e-3,
    )


def test_time_is_up_after_five_seconds_and_that_is_no_failure():
    env = Environment(task=tasks.circle(diameter=0.0))
    env_state = environment.begin(
        env, dynamics.at_hover(jnp.array([0.0, 0.0, 1.0]), QUIET), jnp.float32(0), QUIET, KEY
    )
    hover = env_state.action
    roll = jax.jit(lambda env_state: rollout(env, lambda _: hover, env_state, QUIET, KEY, 502)[1])
    before, step_result = roll(env_state)
    assert not np.any(step_result.terminated)
    assert np.flatnonzero(step_result.truncated)[0] == 499
    np.testing.assert_allclose(
        np.diff(before.elapsed), 0.01, rtol=0.01
    )  # Without fresh episodes the finished one goes on.


@pytest.mark.parametrize(
    ("offset", "terminated", "truncated"), [(0.0, False, True), (1.0, True, False)]
)
def test_a_failure_in_the_last_step_is_a_failure_and_not_the_end_of_time(
    offset, terminated, truncated
):
    setpoint = WORLD.task.reference(jnp.float32(0.0))
    state = dynamics.at_hover(setpoint + jnp.array([0.0, 0.0, offset]), QUIET)
    env_state = jax.jit(environment.begin, static_argnums=0)(
        WORLD, state, jnp.float32(0), QUIET, KEY
    )._replace(elapsed=jnp.float32(4.99))
    _, step_result = step(WORLD, env_state, env_state.action, QUIET, KEY)
    assert (bool(step_result.terminated), bool(step_result.truncated)) == (terminated, truncated)
    assert (float(step_result.reward) < -100) is terminated


@pytest.mark.parametrize("history", [1, 2])
def test_an_observation_holds_instants_from_oldest_to_newest_each_with_its_last_action(history):
    env = Environment(spec=PolicySpec(history=history))
    env_state = start(env, PAPER, KEY)
    instants = [np.asarray(environment.observation(env, env_state))[-20:]]
    np.testing.assert_array_equal(
        environment.observation(env, env_state), np.tile(instants[0], history)
    )
    np.testing.assert_allclose(instants[0][-4:], 2 / 1.725 - 1, rtol=1e-6)
    for number, action in enumerate(
        float32([[0.1, 0.2, 0.3, 0.4], [-2.0, 2.0, 0.0, 0.5], [0.0, 0.1, 0.2, 0.3]])
    ):
        env_state, step_result = step(
            env, env_state, jnp.asarray(action), PAPER, jax.random.key(number)
        )
        seen = env_state.measurement
        instants.append(
            np.concatenate(
                [
                    seen.position,
                    seen.quaternion,
                    seen.velocity,
                    seen.body_rates,
                    step_result.setpoint - seen.position,
                    action,
                ]
            )
        )
        observation = np.asarray(environment.observation(env, env_state))
        assert observation.shape == (20 * history,)
        np.testing.assert_allclose(observation, np.concatenate(instants[-history:]), atol=1e-6)


def test_a_reward_sees_this_action_and_the_one_before():
    env_state = start(WORLD, QUIET, KEY)
    action = jnp.array([0.1, 0.2, 0.3, 0.4])
    after, step_result = step(WORLD, env_state, action, QUIET, KEY)
    expected = WORLD.task.reward(after.state, step_result.setpoint, action, env_state.action)
    np.testing.assert_allclose(step_result.reward, expected, rtol=1e-5)
    np.testing.assert_array_equal(after.action, action)


def test_the_gyros_bias_is_drawn_for_an_episode_and_walks_in_it():
    biased = replace(QUIET, gyro_turn_on_bias=0.1)
    first, other = start(WORLD, biased, KEY), start(WORLD, biased, jax.random.key(1))
    assert not np.allclose(first.gyro_bias, other.gyro_bias)
    np.testing.assert_allclose(
        first.measurement.body_rates - first.state.body_rates, first.gyro_bias, atol=1e-6
    )
    held, _ = step(WORLD, first, first.action, biased, KEY)
    np.testing.assert_allclose(held.gyro_bias, first.gyro_bias, rtol=1e-4)
    walked, _ = step(WORLD, first, first.action, replace(biased, gyro_bias_walk=1.0), KEY)
    assert not np.allclose(walked.gyro_bias, first.gyro_bias, atol=1e-3)


def test_a_late_estimator_shows_the_state_of_the_period_before():
    world, late = Environment(estimator_memory=3), replace(QUIET, estimator_delay=0.01)
    env_state = start(world, late, KEY)
    for number in range(3):
        before = env_state
        env_state, _ = step(world, env_state, env_state.action, late, jax.random.key(number))
        np.testing.assert_allclose(env_state.measurement.position, before.state.position, atol=1e-6)
        np.testing.assert_allclose(env_state.measurement.velocity, before.state.velocity, atol=1e-6)
        np.testing.assert_allclose(
            env_state.measurement.body_rates, env_state.state.body_rates, atol=1e-6
        )


GROUND = Environment(task=tasks.take_off())


def climb(observation):
    """The same thrust on all motors, against the height error and the climb."""
    return jnp.broadcast_to(0.16 + 4.0 * observation[-5] - observation[29], (4,))


@jax.jit
def lift(command):
    """Five seconds of a take-off; a constant command, or feedback where it is negative."""

    def act(observation):
        return jnp.where(
            command < 0, climb(observation), jnp.broadcast_to(2.0 * command - 1.0, (4,))
        )

    first = environment.reset(GROUND, QUIET, KEY)
    last, (before, step_result) = rollout(GROUND, act, first, QUIET, KEY, 500)
    return before.state, step_result, last.state, first.actuators.ratio


def test_a_drone_without_thrust_stands_on_the_floor_and_stays_there():
    states, _, last, ratio = lift(float32(0.3))
    np.testing.assert_array_equal(ratio, np.zeros(4))
    np.testing.assert_allclose(states.position[:, 2], 0.0125, atol=1e-7)
    np.testing.assert_array_equal(last.velocity, np.zeros(3))
    assert np.isfinite(np.asarray(last.quaternion)).all()


def test_a_drone_leaves_the_floor_when_thrust_exceeds_weight_and_follows_its_reference():
    states, step_result, last, _ = lift(float32(-1.0))
    assert not step_result.terminated.any()
    assert states.position[:, 2].min() >= np.float32(0.0125)
    assert abs(float(last.position[2]) - 1.0) < 0.05
    assert np.abs(states.position[:, 2] - step_result.setpoint[:, 2]).max() < 0.4


def test_a_floor_changes_nothing_in_the_air():
    state = dynamics.at_hover(jnp.array([0.0, 0.0, 0.5]), QUIET)._replace(
        velocity=float32([0.1, 0.2, -0.3])
    )
    assert same(motion.floor_reaction(state, 0.0125), state)


class Heard(NamedTuple):
    """Memory of a controller that only listens."""

    positions: Float[Array, "10 3"]
    rates: Float[Array, "10 3"]


def listening(action_rate, commands):
    """A controller of 500 Hz that remembers what it was told of its last commands."""

    def init():
        return Heard(jnp.zeros((commands, 3)), jnp.zeros((commands, 3)))

    def command(memory, action, measurement, setpoint):
        told = (measurement.position, measurement.body_rates)
        memory = Heard(
            *(jnp.concatenate([old[1:], new[None]]) for old, new in zip(memory, told, strict=True))
        )
        return memory, jnp.array([0.5, 0.6, 0.7, 0.6])

    meaning = interface.pwm(action_rate)
    return Controller(meaning, init, command, 500)


def test_between_two_estimates_a_controller_hears_only_the_gyro():
    env = Environment.matching(FINE, controller=listening(50, 10))
    env_state = start(env, FINE, KEY)
    before = env_state.measurement
    after, _ = step(env, env_state, jnp.zeros(4), FINE, KEY)
    positions, rates = np.asarray(after.controller.positions), np.asarray(after.controller.rates)
    np.testing.assert_array_equal(positions[:5], np.tile(before.position, (5, 1)))
    np.testing.assert_array_equal(positions[5:], np.tile(positions[5], (5, 1)))
    assert np.linalg.norm(positions[5] - positions[0]) > 1e-5, (
        "the estimate is renewed every 10 ms, not every 20"
    )
    assert len(np.unique(rates, axis=0)) == 10
    np.testing.assert_allclose(after.measurement.position, after.state.position, atol=1e-6)


def test_an_estimate_may_serve_several_actions_while_the_gyro_goes_on():
    env = Environment(estimate_rate=25)
    env_state = start(env, QUIET, KEY)
    seen = [env_state.measurement]
    for number in range(8):
        env_state, _ = step(
            env, env_state, float32([-0.1, 0.1, 0.2, 0.1]), QUIET, jax.random.key(number)
        )
        seen.append(env_state.measurement)
    positions = [tuple(np.asarray(entry.position).tolist()) for entry in seen]
    assert [positions.index(entry) for entry in positions] == [0, 0, 0, 0, 4, 4, 4, 4, 8]
    assert len({tuple(np.asarray(entry.body_rates).tolist()) for entry in seen}) == 9


def test_rates_that_do_not_divide_one_another_are_refused():
    with pytest.raises(InputError, match="100 commands, 60 estimates and 100 actions a second"):
        Environment(estimate_rate=60)


def test_an_environment_matches_the_drones_time_step_or_refuses_it():
    assert Environment.matching(PAPER).steps_per_command == 2
    assert (
        Environment.matching(
            replace(PAPER, time_step=0.001), controller=control.attitude()
        ).steps_per_command
        == 2
    )
    with pytest.raises(
        InputError,
        match=r"time_step = 5 ms does not divide the 2 ms between two commands of attitude_rate",
    ) as told:
        Environment.matching(PAPER, controller=control.attitude_rate())
    assert "replace(parameters, time_step=0.002)" in str(told.value)
    with pytest.raises(InputError, match="time_step = 3 ms does not divide the 10 ms"):
        Environment.matching(replace(PAPER, time_step=0.003))


def test_an_episode_tells_its_error_and_why_it_ends():
    state = dynamics.at_hover(jnp.array([0.0, 0.0, 1.3]), QUIET)
    begin = jax.jit(environment.begin, static_argnums=0)
    lost, step_result = step(
        WORLD, begin(WORLD, state, jnp.float32(0), QUIET, KEY), jnp.zeros(4), QUIET, KEY
    )
    np.testing.assert_allclose(
        step_result.position_error,
        np.linalg.norm(step_result.setpoint - lost.state.position),
        rtol=1e-5,
    )
    assert failures.END_REASONS[int(step_result.end_reason)] == "position error"
    on_it = begin(
        WORLD, dynamics.at_hover(jnp.array([0.0, 0.0, 1.0]), QUIET), jnp.float32(0), QUIET, KEY
    )
    flying = step(WORLD, on_it, on_it.action, QUIET, KEY)[1]
    assert int(flying.end_reason) == 0
    over = step(WORLD, on_it._replace(elapsed=jnp.float32(4.99)), on_it.action, QUIET, KEY)[1]
    assert failures.END_REASONS[int(over.end_reason)] == "time limit"


def test_an_episode_of_a_drone_whose_estimates_drift_is_judged_by_them():
    """Nothing tells such a drone where it truly is."""
    drone = replace(QUIET, position_walk=0.5, height_walk=0.2, velocity_walk=0.5)
    first = start(WORLD, drone, KEY)
    after, told = step(WORLD, first, jnp.full(4, 0.16), drone, KEY)
    drift = np.asarray(after.measurement.position - after.state.position)
    assert np.linalg.norm(drift) > 0.01
    error = float(jnp.linalg.norm(told.setpoint - after.measurement.position))
    assert float(told.position_error) == pytest.approx(error, abs=1e-6)
    truly = float(jnp.linalg.norm(told.setpoint - after.state.position))
    assert abs(float(told.reward) + error) < 0.1 * abs(error - truly)
    away = after._replace(drift=after.drift.at[0].set(0.3))
    _, told = step(WORLD, away, jnp.full(4, 0.16), drone, KEY)
    assert failures.END_REASONS[int(told.end_reason)] == "position error"


def test_an_action_that_is_not_a_number_ends_the_episode():
    _, step_result = step(WORLD, start(WORLD, QUIET, KEY), jnp.full(4, jnp.nan), QUIET, KEY)
    assert bool(step_result.terminated)
    assert failures.END_REASONS[int(step_result.end_reason)] == "not finite"


@pytest.mark.slow
@pytest.mark.parametrize("structure", ["pwm", "attitude_rate"])
def test_the_gradient_of_a_flight_with_respect_to_the_drone_is_its_slope(structure):
    """Of where a quarter of a second of a changing action leads, against central differences."""
    env = Environment.matching(FINE, controller=control.CONTROLLERS[structure]())
    rate = env.controller.interface.rate
    first = environment.begin(env, dynamics.at_hover(jnp.zeros(3), FINE), jnp.float32(0), FINE, KEY)
    wave = (
        jnp.array([0.1, 0.2, -0.2, 0.1])[None] * jnp.cos(jnp.linspace(0.0, 4.0, rate // 4))[:, None]
    )
    actions = wave + env.controller.interface.level(dynamics.hover_command(FINE))[None]

    @jax.jit
    @jax.value_and_grad
    def where(values):
        drone = replace(FINE, **values)

        def fly(env_state, action):
            return stepping.step(env, env_state, action, drone, KEY)[0], None

        return lax.scan(fly, first, actions)[0].state.position @ jnp.array([0.3, 0.5, 1.0])

    names = ("latency", "motor_time_constant", "thrust_to_weight")
    nominal = {name: jnp.float32(getattr(FINE, name)) for name in names}
    slopes = where(nominal)[1]
    for name in names:
        h = 0.05 * float(nominal[name])
        ahead, behind = (float(where({**nominal, name: nominal[name] + d})[0]) for d in (h, -h))
        assert abs(float(slopes[name] * nominal[name])) > 1e-4, "the parameter matters"
        np.testing.assert_allclose(slopes[name], (ahead - behind) / (2 * h), rtol=0.03)


@pytest.mark.night
def test_computing_a_period_once_more_changes_no_gradient(monkeypatch):
    env = Environment.matching(FINE, controller=control.attitude_rate())
    first = environment.begin(env, dynamics.at_hover(jnp.zeros(3), FINE), jnp.float32(0), FINE, KEY)
    action = env.controller.interface.level(dynamics.hover_command(FINE)) + 0.2

    def slope():
        def turning(lag):
            drone = replace(FINE, motor_time_constant=lag)
            after, _ = stepping.step(env, first, action, drone, KEY)
            return after.state.body_rates @ jnp.array([0.3, 0.5, 1.0])

        return float(jax.jit(jax.grad(turning))(jnp.float32(FINE.motor_time_constant)))

    again = slope()
    monkeypatch.setattr(jax, "checkpoint", lambda function, **_: function)
    assert abs(again) > 1e-3
    assert again == pytest.approx(slope(), rel=1e-4)


@pytest.mark.slow
def test_the_ground_lifts_a_drone_that_hovers_just_above_it():
    task = tasks.take_off()
    env = Environment(task=task)
    heights = {}
    for height in (0.04, 1.0):
        state = dynamics.at_hover(jnp.array([0.0, 0.0, height]), QUIET)
        command = jnp.sqrt(dynamics.hover_command(QUIET))
        line = DelayLine(jnp.broadcast_to(command, (latency.slots(0.01), 4)))
        heights[height] = (
            float(motion.drive(dynamics.rk4, state, line, 20, QUIET, task.floor).position[2])
            - height
        )
        assert motion.drive(dynamics.rk4, state, line, 20, QUIET).position[2] == pytest.approx(
            height, abs=1e-4
        )
    assert heights[0.04] > 0.005
    assert abs(heights[1.0]) < 1e-4
    assert env.task.floor == tasks.STANDING_HEIGHT_M


def test_a_weakly_typed_action_gives_the_types_of_any_other():
    world, drone = Environment(), crazyflie()
    env_state = jax.eval_shape(partial(environment.reset, world), drone, KEY)
    types = [
        jax.tree.map(
            lambda leaf: (leaf.dtype, leaf.weak_type),
            jax.eval_shape(partial(stepping.step, world), env_state, action, drone, KEY),
        )
        for action in (jnp.zeros(4, jnp.float32), jnp.full(4, 0.16))
    ]
    assert types[0] == types[1]
