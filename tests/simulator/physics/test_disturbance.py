"""Torques and forces that change slowly, against what their processes and bodies must do."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from maidenflight.parameters import crazyflie, noiseless, replace
from maidenflight.simulator import environment, stepping
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.physics.disturbance import (
    SIZE,
    draw_disturbance,
    is_disturbed,
    kick,
)

SIZES = {"disturbance_torque": (3e-4, 2e-4, 1e-4), "disturbance_force": (0.01, 0.02, 0.03)}
TIMES = {"disturbance_torque_time": 0.2, "disturbance_force_time": 0.7}
STILL = noiseless(crazyflie())
SHAKEN = replace(STILL, **SIZES, **TIMES)
CHAINS = 5000


@partial(jax.jit, static_argnums=2)
def chains(period: Any, key: Any, steps: int) -> Any:
    """Independent disturbances from their stationary distribution on."""

    def draw(before: Any, elapsed: Any, key: Any) -> Any:
        normal = jax.random.normal(key, (CHAINS, SIZE))
        return jax.vmap(lambda one, by: draw_disturbance(one, elapsed, SHAKEN, by))(before, normal)

    def one(before: Any, key: Any) -> Any:
        after = draw(before, period, key)
        return after, after

    first = draw(jnp.zeros((CHAINS, SIZE)), jnp.inf, key)
    return first, lax.scan(one, first, jax.random.split(key, steps))[1]


@pytest.mark.parametrize("period", [0.002, 0.02])
def test_a_disturbance_is_as_large_and_as_slow_however_often_it_is_drawn(period: float) -> None:
    first, later = map(
        np.asarray, chains(np.float32(period), jax.random.key(0), round(0.1 / period))
    )
    sizes = np.concatenate(list(SIZES.values()))
    for some in (first, later[-1]):
        np.testing.assert_allclose(some.std(axis=0), sizes, rtol=0.05)
        assert (np.abs(some.mean(axis=0)) < 4 * sizes / np.sqrt(CHAINS)).all()
        np.testing.assert_allclose(np.corrcoef(some.T), np.eye(SIZE), atol=0.06)
    correlation = [np.corrcoef(first[:, one], later[-1][:, one])[0, 1] for one in range(SIZE)]
    np.testing.assert_allclose(
        correlation, np.exp(-0.1 / np.repeat(list(TIMES.values()), 3)), atol=0.03
    )


def test_a_kick_changes_momentum_by_force_and_torque_times_time() -> None:
    """Force along the body's axes: a drone on its side is pushed along the world's."""
    side = jnp.array([0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)])  # z along the world's x
    state = dynamics.at_hover(jnp.zeros(3), STILL)._replace(quaternion=side)
    disturbance = jnp.array([1e-4, 2e-4, 3e-4, 0.0, 0.01, 0.02])
    after = kick(state, disturbance, jnp.float32(0.01), STILL)
    momentum = (after.velocity - state.velocity) * STILL.mass
    np.testing.assert_allclose(momentum, [2e-4, 1e-4, 0.0], atol=1e-9)
    spin = np.asarray(after.body_rates) * STILL.inertia
    np.testing.assert_allclose(spin, [1e-6, 2e-6, 3e-6], rtol=1e-5)
    for name in ("position", "quaternion", "rotor_speed"):
        np.testing.assert_array_equal(getattr(after, name), getattr(state, name))


def test_a_constant_push_moves_a_drone_as_its_weight_would() -> None:
    """Half before and half after each step, so that the way is that of Newton, a t^2 / 2."""
    env = Environment.matching(SHAKEN)
    drone = replace(
        STILL, gravity=1e-9, disturbance_force=(1e-9, 1e-9, 1e-9), disturbance_force_time=1e3
    )
    state = dynamics.at_hover(jnp.zeros(3), STILL)._replace(rotor_speed=jnp.zeros(4))
    start = environment.begin(env, state, jnp.zeros(()), drone, jax.random.key(0))
    start = start._replace(
        disturbance=jnp.zeros(SIZE).at[3].set(0.028), delay_line=jnp.zeros_like(start.delay_line)
    )
    after = start
    for _ in range(10):
        after, _ = stepping.step(env, after, jnp.full(4, -1.0), drone, jax.random.key(0))
    elapsed = float(after.elapsed)
    np.testing.assert_allclose(after.state.velocity[0], elapsed, rtol=2e-3)
    np.testing.assert_allclose(after.state.position[0], 0.5 * elapsed**2, rtol=2e-3)


def test_where_nothing_disturbs_there_is_nothing_to_draw() -> None:
    calm, shaken = Environment.matching(STILL), Environment.matching(SHAKEN)
    assert (calm.disturbance_size, shaken.disturbance_size) == (0, SIZE)
    assert not is_disturbed(noiseless(SHAKEN))
    begun = environment.reset(calm, STILL, jax.random.key(0))
    assert begun.disturbance.shape == (0,)
    assert stepping.draw(calm, jax.random.key(0)).disturbance.shape == (1, 0)
    assert stepping.draw(shaken, jax.random.key(0)).disturbance.shape == (1, SIZE)


def test_sizes_and_times_are_traced() -> None:
    env, count = Environment.matching(SHAKEN), 0

    @jax.jit
    def last(drone: Any) -> Any:
        nonlocal count
        count += 1
        begun = environment.reset(env, drone, jax.random.key(0))
        return stepping.step(env, begun, jnp.zeros(4), drone, jax.random.key(1))[0].disturbance

    quick = replace(SHAKEN, disturbance_torque=(1e-5, 1e-5, 1e-5), disturbance_force_time=0.01)
    assert not np.array_equal(last(SHAKEN), last(quick))
    assert count == 1
