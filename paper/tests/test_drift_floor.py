"""The bound on how close a drone is held whose estimates drift."""

import numpy as np
import pytest

from maidenflight.parameters import Parameters, crazyflie, replace
from scripts import script

floor = script("drift_floor")


def drone(walk: float) -> Parameters:
    return replace(crazyflie(), position_walk=walk, velocity_walk=walk)


def test_small_errors_grow_in_proportion_to_the_walk() -> None:
    """Without the noise that turns add, the regulator and the drone are linear."""
    (one, rate), (two, faster) = (
        floor.error_and_rate(drone(walk), 1e-7, 1e-3) for walk in (1e-4, 2e-4)
    )
    assert two / one == pytest.approx(2.0, rel=1e-3)
    assert faster / rate == pytest.approx(2.0, rel=1e-3)


def test_a_drift_that_turns_feed_grows_without_bound() -> None:
    assert floor.error_and_rate(drone(1.0), 1e-10, 1e-5) == (np.inf, np.inf)


def test_a_steady_tilt_pulls_the_drone_along_a_parabola() -> None:
    after, command = floor.transition(drone(0.05))
    tilted = np.array([0.0, 0.0, 0.02, 0.0, 0.0, 0.0, 0.0])
    place, speed, *rest = np.linalg.matrix_power(after, 100) @ tilted
    assert place == pytest.approx(9.81 * 0.02 / 2, rel=1e-3)
    assert speed == pytest.approx(9.81 * 0.02, rel=1e-3)
    assert rest == pytest.approx(tilted[2:])
    # A command is felt a period late, and then as that period's torque.
    assert not np.any((after @ tilted - tilted)[3:])
    assert (after @ command)[4, 0] == pytest.approx(
        1 - np.exp(-0.01 / float(drone(0).motor_time_constant))
    )
