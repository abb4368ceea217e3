"""The delay line shifts commands by exactly the latency, and smoothly."""

from functools import partial
from typing import Any

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from jax import lax

from maidenflight.parameters import crazyflie, replace
from maidenflight.simulator.physics import latency, motion, vectors
from maidenflight.simulator.physics.latency import DelayLine

STEPS, SLOTS = 2, latency.slots(0.01)
delays = st.floats(0, latency.SLOWEST)
time_steps = st.floats(0.0045, 0.0055)


def drone(delay, dt):
    return replace(crazyflie(), latency=float(delay), time_step=float(dt))


@partial(jax.jit, static_argnums=2)
def arriving(line, parameters, steps):
    """Commands of all steps of a period, and how long these are."""
    return latency.in_step(line, parameters, steps, jnp.arange(steps))


@partial(jax.jit, static_argnums=2)
def delayed(commands, parameters, steps):
    """What the motors see in each physics step, and its length; the line is empty at first."""

    def hold(line, command):
        line = latency.push(line, command)
        return line, latency.in_step(DelayLine(line), parameters, steps, jnp.arange(steps))

    seen, length = lax.scan(hold, jnp.zeros((latency.slots(0.0045), 4)), commands)[1]
    return seen.reshape(-1, 4), length.reshape(-1)


@pytest.mark.parametrize(("period", "expected"), [(0.01, 7), (0.002, 29), (0.05, 3)])
def test_the_line_remembers_the_longest_latency(period, expected):
    assert latency.slots(period) == expected


@pytest.mark.parametrize("steps", [1, 2, 3, 8])
@given(delays, time_steps)
def test_the_steps_of_a_period_are_as_long_as_it(steps, delay, dt):
    _, length = arriving(DelayLine(jnp.zeros((SLOTS, 4))), drone(delay, dt), steps)
    assert np.all(np.asarray(length) >= 0)
    np.testing.assert_allclose(length.sum(), steps * dt, rtol=1e-5)


@pytest.mark.parametrize("steps", [2, 3, 8])
@given(delay=delays, dt=time_steps)
def test_what_acts_was_commanded_a_latency_ago(steps, delay, dt):
    """Each command is its own number; in the middle of a step that has a length."""
    numbers = jnp.broadcast_to(jnp.arange(1.0, 13.0)[:, None], (12, 4))
    seen, length = (
        np.asarray(part, np.float64) for part in delayed(numbers, drone(delay, dt), steps)
    )
    middle = np.cumsum(length) - length / 2
    given_ago = np.floor((middle - delay) / (steps * dt)) + 1
    sure = length > 1e-5
    np.testing.assert_array_equal(seen[sure, 0], np.maximum(given_ago, 0)[sure])


@pytest.mark.parametrize("steps", [1, 2, 3, 8])
@given(delay=delays, dt=time_steps)
def test_a_step_command_arrives_shifted_by_exactly_the_latency(steps, delay, dt):
    """First moment: what is missing of the step is the latency."""
    commands = jnp.ones((2 + int(0.05 / (steps * 0.0045)), 4))
    seen, length = (
        np.asarray(part, np.float64) for part in delayed(commands, drone(delay, dt), steps)
    )
    np.testing.assert_allclose((1 - seen[:, 0]) @ length, delay, atol=1e-6)
    assert np.all(np.diff(seen, axis=0) >= -1e-5)


@pytest.mark.parametrize(("delay", "by"), [(0.005, 1), (0.015, 3), (0.035, 7)])
def test_a_command_that_arrives_halfway_leaves_all_steps_alike(delay, by):
    commands = jax.random.uniform(jax.random.key(0), (12, 4))
    held = np.repeat(commands, STEPS, axis=0)
    seen, length = delayed(commands, drone(delay, 0.005), STEPS)
    np.testing.assert_array_equal(seen, np.concatenate([np.zeros((by, 4)), held[:-by]]))
    np.testing.assert_allclose(length, 0.005, rtol=1e-5)


@pytest.mark.parametrize("steps", [1, 2])
@pytest.mark.parametrize("delay", [0.001, 0.0124, 0.018, 0.0333, 0.049])
def test_what_the_motors_see_has_a_slope_in_the_latency_everywhere(delay, steps):
    """An index into a buffer would be flat between steps."""

    def seen(delay):
        commands = jnp.broadcast_to(jnp.linspace(0.0, 1.0, 12)[:, None], (12, 4))
        parameters = replace(crazyflie(), latency=delay, time_step=jnp.float32(0.01 / steps))
        command, length = delayed(commands, parameters, steps)
        return jnp.sum(command[:, 0] * length) / 0.01

    slope = jax.grad(seen)(jnp.float32(delay))
    h = 2e-4
    difference = (seen(jnp.float32(delay + h)) - seen(jnp.float32(delay - h))) / (2 * h)
    assert abs(slope) > 1
    np.testing.assert_allclose(slope, difference, rtol=0.02)


@given(delay=delays, ratio=st.floats(0.25, 4.0))
def test_motors_that_slow_down_otherwise_need_no_more_steps(delay, ratio):
    """Of chattering commands; as one mean in each step they were a tenth of a command off."""
    commands = jnp.float32(np.random.default_rng(0).uniform(0.2, 1, (30, 4)))

    def ends(steps):
        asked = replace(drone(delay, 0.01 / steps), spin_down_ratio=ratio)
        return spun(commands, asked, np.int32(steps))

    np.testing.assert_allclose(ends(4), ends(200), atol=1e-3)


@jax.jit
def spun(commands, parameters, steps):
    """Rotor speeds after each command."""

    def hold(speed, place):
        after = motion.spin(speed, DelayLine(commands[::-1], place), steps, parameters)
        return after, after

    return lax.scan(hold, commands[0], jnp.arange(len(commands))[::-1])[1]


def test_a_latency_longer_than_the_line_sees_its_oldest_command():
    line = jnp.broadcast_to(jnp.arange(1.0, SLOTS + 1)[:, None], (SLOTS, 4))
    seen, _ = arriving(DelayLine(line), drone(1.0, 0.005), STEPS)
    np.testing.assert_array_equal(seen, SLOTS)


def test_push_puts_the_newest_in_front_and_forgets_the_oldest():
    line = jnp.arange(12.0).reshape(3, 4)
    np.testing.assert_array_equal(
        latency.push(line, jnp.full(4, 9.0)), [[9, 9, 9, 9], [0, 1, 2, 3], [4, 5, 6, 7]]
    )


@partial(jax.jit, static_argnums=(0, 1, 2))
def pushed_and_put(form, count, steps, parameters):
    """Line and ring, and what the motors see of each, of commands that go round three times."""
    commands = jax.random.uniform(jax.random.key(0), (3 * count, 4))
    old = jax.random.uniform(jax.random.key(1), (count, 4))

    def push(line, command):
        line = latency.push(line, command)
        return line, latency.in_step(DelayLine(line), parameters, steps, jnp.arange(steps))[0]

    def put(ring, number):
        line = latency.put(ring, form(commands[number]), number)
        return line.commands, latency.in_step(line, parameters, steps, jnp.arange(steps))[0]

    begun: Any = form(old.T) if form is vectors.Entries else old
    ring, seen = lax.scan(put, begun, jnp.arange(len(commands)))
    ends = latency.in_front(ring, len(commands))
    if form is vectors.Entries:
        ends, seen = (jnp.stack(list(one), axis=-1) for one in (ends, seen))
    return lax.scan(push, old, commands), (ends, seen)


@pytest.mark.parametrize("form", [jnp.asarray, vectors.Entries])
@pytest.mark.parametrize(("period", "steps"), [(0.01, 2), (0.002, 1)])
@given(delay=delays, share=st.floats(0.9, 1.1))
def test_a_ring_is_the_line_to_which_commands_are_pushed(form, period, steps, delay, share):
    """However many commands go round, also where periods are shorter than expected."""
    parameters = drone(delay, share * period / steps)
    (line, expected), (ends, found) = pushed_and_put(form, latency.slots(period), steps, parameters)
    np.testing.assert_array_equal(ends, line)
    np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize("period", [0.01, 0.002])
def test_a_line_holds_all_that_the_longest_latency_can_reach(period):
    """A longer line tells no more, also of periods that are a tenth shorter."""
    count, slow = latency.slots(period), drone(latency.SLOWEST, 0.9 * period)
    longer = jax.random.uniform(jax.random.key(0), (count + 5, 4))
    np.testing.assert_allclose(
        arriving(DelayLine(longer[:count]), slow, 1)[0],
        arriving(DelayLine(longer), slow, 1)[0],
        atol=1e-6,
    )
