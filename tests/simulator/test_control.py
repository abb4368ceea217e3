"""Control structures: the policy's four actions, and the firmware's PID, which must fly as the firmware does."""

from functools import partial

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arrays import float32
from hypothesis import given

from maidenflight.parameters import crazyflie, noiseless, replace
from maidenflight.simulator import control, dynamics, environment, tasks
from maidenflight.simulator.control import PID, PIDMemory
from maidenflight.simulator.environment import Environment

PAPER = crazyflie()
QUICK = replace(noiseless(PAPER), latency=0.005, time_step=0.002)
"""The paper's drone with the short latency that the firmware's PID bears."""
GAINS = PID((2.0, 3.0, 4.0), (0.5, 1.0, 0.0), (0.1, 0.0, 0.2), (0.3, 0.2, 0.1))
pid = jax.jit(control.pid, static_argnums=(2, 3))


@partial(jax.jit, static_argnums=2)
def fly_pid(radius, parameters, seconds):
    """Positions [m] at 100 Hz of the position PID on a circle whose radius is traced; radius 0 is hovering."""
    unit = tasks.circle(diameter=2.0, height=0.0)
    task = unit._replace(reference=lambda time: radius * unit.reference(time) + jnp.array([0.0, 0.0, 1.0]))
    world = Environment(task=task, controller=control.position_pid(), steps_per_command=1, commands_per_action=5)
    start = dynamics.at_hover(jnp.array([0.0, 0.0, 1.0]), parameters)
    episode = environment.begin(world, start, jnp.float32(0.0), parameters, jax.random.key(0))
    _, (flown, _) = environment.rollout(world, lambda _: jnp.zeros(4), episode, parameters, jax.random.key(1), 100 * seconds)
    return flown.state


@given(st.tuples(*[st.floats(-3, 3, width=16)] * 4).map(float32))
def test_pwm_maps_actions_from_minus_one_to_one_onto_thrust(action):
    _, command = control.pwm().command(None, jnp.asarray(action), None, None)  # type: ignore[arg-type]
    np.testing.assert_allclose(command, (np.clip(action, -1, 1) + 1) / 2, atol=1e-6)


def test_a_pid_is_proportional_integral_and_derivative_by_hand():
    memory = PIDMemory(jnp.array([0.1, 0.1, 0.0]), jnp.array([0.5, 0.0, 1.0]))
    memory, output = pid(memory, jnp.array([1.0, -2.0, 0.5]), GAINS, 0.01)
    np.testing.assert_allclose(memory.integral, [0.11, 0.08, 0.005], atol=1e-6)
    np.testing.assert_allclose(memory.error, [1.0, -2.0, 0.5])
    np.testing.assert_allclose(output, [2 + 0.055 + 5, -6 + 0.08, 2 - 10], rtol=1e-5)


@pytest.mark.parametrize("sign", [1, -1])
def test_the_integral_stops_at_its_limit(sign):
    memory, output = PIDMemory(jnp.zeros(3), jnp.zeros(3)), jnp.zeros(3)
    for _ in range(5):
        memory, output = pid(memory, jnp.full(3, 10.0 * sign), GAINS, 0.01)
    np.testing.assert_allclose(memory.integral, sign * np.array([0.3, 0.2, 0.1]), rtol=1e-6)
    np.testing.assert_allclose(output, sign * np.array([20 + 0.15, 30 + 0.2, 40]), rtol=1e-6)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_mixer_turns_the_drone_the_way_it_was_told(axis, sign):
    wanted = np.zeros(3, np.float32)
    wanted[axis] = sign * 5000
    mixed = np.asarray(control.mix(jnp.float32(30000.0), jnp.asarray(wanted)))
    np.testing.assert_allclose(mixed.mean(), 30000)
    found = np.asarray(dynamics.torque(jnp.asarray(mixed / 60000), PAPER))
    assert sign * found[axis] > 1e-5
    np.testing.assert_allclose(np.delete(found, axis), 0, atol=1e-8)


def test_the_position_pid_holds_hover():
    flown = fly_pid(jnp.float32(0.0), QUICK, 12)
    np.testing.assert_allclose(flown.position, np.tile([0, 0, 1], (1200, 1)), atol=0.02)
    np.testing.assert_allclose(flown.position[-100:], np.tile([0, 0, 1], (100, 1)), atol=0.003)
    np.testing.assert_allclose(flown.velocity[-100:], 0, atol=0.005)


def test_the_position_pid_flies_the_circle_as_small_and_as_late_as_the_firmware():
    """Measured of the stock firmware: radius 0.237 to 0.25 m, 57 deg = 0.48 s behind (crazyflie.md, section 2)."""
    position = np.asarray(fly_pid(jnp.float32(0.25), QUICK, 12).position)[600:]
    time = 0.01 * np.arange(600, 1200)
    first_harmonic = np.mean((position[:, 0] + 1j * position[:, 1]) * np.exp(2j * np.pi * time / 3.0))
    lag = np.angle(-first_harmonic) * 3.0 / (2 * np.pi)  # The reference is r - r exp(-i w t).
    assert 0.23 < abs(first_harmonic) < 0.25
    assert 0.45 < lag < 0.51
    np.testing.assert_allclose(position.mean(axis=0), [0.25, 0, 1], atol=0.02)
    np.testing.assert_allclose(position[:, 2], 1, atol=0.03)


def test_an_action_is_added_to_the_pids_commands():
    plain, excited = (control.position_pid().command(*call)[1] for call in map(asked, (jnp.zeros(4), jnp.array([0.1, -0.1, 0.05, 0.0]))))
    np.testing.assert_allclose(excited - plain, [0.1, -0.1, 0.05, 0.0], atol=1e-6)


def asked(action):
    """Arguments of a command at hover."""
    state = dynamics.at_hover(jnp.array([0.0, 0.0, 1.0]), PAPER)
    memory = jax.tree.map(jnp.asarray, control.position_pid().init())
    return memory, action, environment.Measurement(*state[:4]), state.position
