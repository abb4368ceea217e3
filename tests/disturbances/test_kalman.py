"""What flights show of disturbances, as processes for simulations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from maidenflight.disturbances.kalman import Filtered, with_disturbances
from maidenflight.parameters import crazyflie, replace
from maidenflight.simulator.physics.disturbance import SIZE, draw_disturbance

DRONE = replace(
    crazyflie(),
    disturbance_torque=(3e-4, 2e-4, 1e-4),
    disturbance_torque_time=0.4,
    disturbance_force=(0.01, 0.02, 0.03),
    disturbance_force_time=0.2,
)


def flight(rows: int, key: int, error: float = 0.0, trim: float = 0.0) -> Filtered:
    """A flight whose disturbances the simulator draws, known but for a share of their variance."""

    def draw(before, normal):
        after = draw_disturbance(before, 0.01, DRONE, normal)
        return after, after

    normal = jax.random.normal(jax.random.key(key), (rows, SIZE))
    drawn = np.asarray(lax.scan(draw, jnp.zeros(SIZE), normal)[1], float)
    none, sizes = np.zeros((rows, 3)), (DRONE.disturbance_torque, DRONE.disturbance_force)
    torques, forces = (np.diag(error * np.asarray(size, float) ** 2) for size in sizes)
    known = np.sqrt(1.0 - error) * drawn
    torque, force = known[:, :3] + trim, known[:, 3:]
    return Filtered(none, none, np.zeros((rows, 4)), none, torque, force, torques, forces, 0.01)


def test_the_process_that_flights_show_is_the_one_that_was_drawn() -> None:
    """Means of flights are trims, and what a filter does not know counts too."""
    flights = [flight(20_000, 1, 0.3, 1e-3), flight(20_000, 2, 0.3, -1e-3), flight(50, 3, 0.3)]
    found = with_disturbances(crazyflie(), flights)
    for name in ("disturbance_torque", "disturbance_force"):
        np.testing.assert_allclose(getattr(found, name), getattr(DRONE, name), rtol=0.1)
    assert found.disturbance_torque_time == pytest.approx(0.4, rel=0.15)
    assert found.disturbance_force_time == pytest.approx(0.2, rel=0.15)
    assert found.mass == DRONE.mass


def test_what_never_forgets_lasts_as_long_as_its_flight() -> None:
    none = np.zeros((90, 3))
    ramp = none + np.where(np.arange(90) < 45, -1.0, 1.0)[:, None] * 1e-4
    cover = 1e-12 * np.eye(3)
    one = Filtered(none, none, np.zeros((90, 4)), none, ramp, ramp, cover, cover, 0.01)
    found = with_disturbances(crazyflie(), [one])
    np.testing.assert_allclose(found.disturbance_torque, 1e-4, rtol=1e-3)
    assert 0.1 < found.disturbance_torque_time < 0.9
