"""A drone that a regulator holds, and what acts on it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight.disturbances.fitting import start_processes
from maidenflight.disturbances.motion import (
    SIZE,
    Motion,
    Slow,
    advance,
    angular_acceleration,
    as_logged,
    difference,
    hover,
    linearise,
    move,
    regulator,
    rotation_vector,
)
from maidenflight.parameters import crazyflie, replace
from maidenflight.simulator.physics import dynamics, rotations

PERIOD = 0.01
DRONE = jax.tree.map(lambda one: np.asarray(one, float), crazyflie())
PROCESSES = start_processes()


@pytest.fixture(autouse=True)
def double():
    with jax.enable_x64(True):
        yield


def any_motion(seed=0):
    generator = np.random.default_rng(seed)
    quaternion = np.array([0.1, -0.2, 0.3, 0.9])
    position, velocity, rates, *slow = generator.normal(0.0, 1.0, (8, 3))
    motion = Motion(position, velocity, quaternion / np.linalg.norm(quaternion), rates, Slow(*slow))
    return jax.tree.map(jnp.asarray, motion)


def test_an_error_moves_a_motion_to_another_and_is_their_difference():
    motion, error = any_motion(), np.random.default_rng(1).normal(0.0, 0.3, SIZE)
    moved = move(motion, jnp.asarray(error))
    assert np.allclose(difference(motion, moved), error[:12], atol=1e-12)
    assert np.allclose(np.linalg.norm(moved.quaternion), 1.0)
    assert np.allclose(moved.slow.demand - motion.slow.demand, error[21:24])


@pytest.mark.parametrize("angle", [1e-9, 0.3, 3.0, -3.0])
def test_a_rotation_vector_is_as_long_as_its_angle(angle):
    quaternion = jnp.array([np.sin(angle / 2), 0.0, 0.0, np.cos(angle / 2)])
    assert np.allclose(rotation_vector(quaternion), [angle, 0.0, 0.0], atol=1e-12)


def test_a_drone_that_hovers_stays_where_it_is():
    still, speed = hover(DRONE)
    later = advance(still, speed, DRONE, PROCESSES, PERIOD)
    assert np.allclose(difference(still, later), 0.0, atol=1e-6)


def test_without_disturbances_it_moves_by_physics():
    motion = any_motion()._replace(slow=Slow(*[jnp.zeros(3)] * 5))
    speed, drone = jnp.array([0.6, 0.8, 0.7, 0.75]), replace(DRONE, time_step=np.array(PERIOD))
    expected = dynamics.midpoint(motion.with_rotors(speed), speed, drone)
    later = advance(motion, speed, drone, PROCESSES, PERIOD)
    for own, other in zip(later[:4], expected[:4], strict=True):
        assert np.allclose(own, other, atol=1e-6)


def test_slow_torques_turn_and_forces_push_and_both_decay():
    still, speed = hover(DRONE)
    slow = still.slow._replace(
        gust=jnp.array([1.0, 0, 0]), trim=jnp.array([0, 2.0, 0]), push=jnp.array([0, 0, 3.0])
    )
    later = advance(still._replace(slow=slow), speed, DRONE, PROCESSES, PERIOD)
    assert np.allclose(later.body_rates, [0.01, 0.02, 0.0], atol=1e-5)
    assert np.allclose(later.velocity[2], 0.03, atol=1e-4)
    assert np.allclose(later.slow.gust[0], np.exp(-PERIOD / 0.3))
    assert np.allclose(later.slow.push[2], 3.0 * np.exp(-PERIOD / 1.0))


def test_a_logged_velocity_is_off_in_the_bodys_axes_and_moves_nothing():
    motion, (still, speed) = any_motion(), hover(DRONE)
    larger = PROCESSES._replace(velocity_scale=np.array([1.1, 1.0, 0.9]))
    off = difference(motion, as_logged(motion, larger))
    own = rotations.to_matrix(motion.quaternion).T @ motion.velocity
    expected = motion.slow.drift + np.array([0.1, 0.0, -0.1]) * own
    assert np.allclose(off, np.concatenate([np.zeros(3), expected, np.zeros(6)]))
    drifting = still._replace(slow=still.slow._replace(drift=jnp.ones(3)))
    later = advance(drifting, speed, DRONE, PROCESSES, PERIOD)
    assert np.allclose(difference(still, later), 0.0, atol=1e-6)


def test_a_regulator_levels_and_damps():
    still, speed = hover(DRONE)
    level = regulator(still, PROCESSES)
    assert np.allclose(level, angular_acceleration(still, speed, DRONE), atol=1e-5)
    tilted = move(still, jnp.zeros(SIZE).at[6].set(0.1).at[10].set(0.2))
    roll, pitch, yaw = regulator(tilted, PROCESSES)
    assert -2.6 < roll < -2.4
    assert -1.1 < pitch < -0.9
    assert yaw == 0.0


@pytest.mark.slow
def test_errors_grow_as_the_physics_does():
    still, speed = hover(DRONE)
    growth, _ = linearise(DRONE, PROCESSES, PERIOD)
    error = jnp.zeros(SIZE).at[7].set(1e-4).at[3].set(1e-4).at[14].set(1e-3)
    moved = difference(
        advance(still, speed, DRONE, PROCESSES, PERIOD),
        advance(move(still, error), speed, DRONE, PROCESSES, PERIOD),
    )
    assert np.allclose(moved, (growth @ error)[:12], atol=1e-7)
