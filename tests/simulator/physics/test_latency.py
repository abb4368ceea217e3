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
from maidenflight.simulator.physics import latency, vectors
from maidenflight.simulator.physics.latency import DelayLine

STEPS, SLOTS = 2, latency.slots(0.01)
arriving = jax.jit(latency.delayed, static_argnums=2)
delays = st.floats(0, latency.SLOWEST)
time_steps = st.floats(0.0045, 0.0055)


def drone(delay, dt):
    return replace(crazyflie(), latency=float(delay), time_step=float(dt))


@partial(jax.jit, static_argnums=2)
def delayed(commands, parameters, steps):
    """What the motors see in each physics step; the line is empty (zero) at first."""

    def hold(line, command):
        line = latency.push(line, command)
        return line, latency.delayed(DelayLine(line), parameters, steps)

    return lax.scan(hold, jnp.zeros((SLOTS, 4)), commands)[1].reshape(-1, 4)


@pytest.mark.parametrize(("period", "expected"), [(0.01, 7), (0.002, 29), (0.05, 3)])
def test_the_line_remembers_the_longest_latency(period, expected):
    assert latency.slots(period) == expected


@given(delays, time_steps)
def test_every_step_sees_shares_of_commands_that_sum_to_one(delay, dt):
    """Each slot alone shows its share; four at a time, one a motor."""
    lines = np.eye(SLOTS, 8, dtype=np.float32).reshape(SLOTS, 2, 4).transpose(1, 0, 2)
    shares = np.concatenate(
        [arriving(DelayLine(jnp.asarray(line)), drone(delay, dt), STEPS) for line in lines], axis=1
    )
    assert shares.shape == (STEPS, 8)
    assert np.all(shares >= 0)
    assert np.all(np.count_nonzero(shares, axis=1) <= 2), "a step is no longer than a command"
    np.testing.assert_allclose(shares.sum(axis=1), 1, atol=2e-5)


@given(delays, time_steps)
def test_a_step_command_arrives_shifted_by_exactly_the_latency(delay, dt):
    """First moment: what is missing of the step is the latency."""
    seen = np.asarray(delayed(jnp.ones((12, 4)), drone(delay, dt), STEPS), np.float64)
    np.testing.assert_allclose((1 - seen).sum(axis=0) * dt, delay, atol=1e-6)
    assert np.all(np.diff(seen, axis=0) >= -1e-5)


@given(delays)
def test_a_step_arrives_in_the_step_where_the_latency_ends(delay):
    seen = np.asarray(delayed(jnp.ones((12, 4)), drone(delay, 0.005), STEPS))[:, 0]
    time = 0.005 * np.arange(len(seen))
    np.testing.assert_allclose(seen, np.clip((time + 0.005 - delay) / 0.005, 0, 1), atol=1e-4)


@pytest.mark.parametrize(("delay", "by"), [(0.0, 0), (0.005, 1), (0.01, 2), (0.035, 7), (0.05, 10)])
def test_a_latency_of_whole_steps_is_a_shift(delay, by):
    commands = jax.random.uniform(jax.random.key(0), (12, 4))
    held = np.repeat(commands, STEPS, axis=0)
    seen = delayed(commands, drone(delay, 0.005), STEPS)
    np.testing.assert_allclose(
        seen, np.concatenate([np.zeros((by, 4)), held[: len(held) - by]]), atol=2e-6
    )


@pytest.mark.parametrize("delay", [0.001, 0.0124, 0.018, 0.0333, 0.049])
def test_what_the_motors_see_has_a_slope_in_the_latency_everywhere(delay):
    """An index into a buffer would be flat between steps."""

    def seen(delay):
        commands = jnp.broadcast_to(jnp.linspace(0.0, 1.0, 12)[:, None], (12, 4))
        return jnp.sum(delayed(commands, replace(crazyflie(), latency=delay), STEPS)[:, 0])

    slope = jax.grad(seen)(jnp.float32(delay))
    h = 2e-4
    difference = (seen(jnp.float32(delay + h)) - seen(jnp.float32(delay - h))) / (2 * h)
    assert abs(slope) > 1
    np.testing.assert_allclose(slope, difference, rtol=0.02)


def test_a_latency_longer_than_the_line_sees_its_oldest_command():
    line = jnp.broadcast_to(jnp.arange(1.0, SLOTS + 1)[:, None], (SLOTS, 4))
    np.testing.assert_allclose(
        arriving(DelayLine(line), drone(1.0, 0.005), STEPS), SLOTS, rtol=1e-6
    )


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
        return line, latency.delayed(DelayLine(line), parameters, steps)

    def put(ring, number):
        line = latency.put(ring, form(commands[number]), number)
        return line.commands, latency.delayed(line, parameters, steps)

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
        arriving(DelayLine(longer[:count]), slow, 1),
        arriving(DelayLine(longer), slow, 1),
        atol=1e-6,
    )
