"""Signals of a flight: turned into the body, and commands that come late."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import planted
from maidenflight.identification.signals.flight_signals import (
    body_velocity,
    delayed,
    lagged,
)

COMMAND = np.random.default_rng(0).uniform(0.3, 0.9, (40, 4))


def test_velocity_is_turned_into_the_body() -> None:
    flight = planted.logs(planted.drone(1.9, 0.06, 0.012), 1)[0]
    attitude = np.tile(np.array([0.3, -0.2, 1.0], np.float32), (len(flight), 1))
    velocity = Rotation.from_euler("ZYX", [1.0, -0.2, 0.3]).apply(np.array([1.0, 2.0, 3.0]))
    turned = replace(flight, attitude=attitude, velocity=np.tile(velocity, (len(flight), 1)))
    np.testing.assert_allclose(body_velocity(turned)[0], [1.0, 2.0, 3.0], rtol=1e-5)


@pytest.mark.parametrize("rows", [0.0, 2.0, 2.3])
def test_late_commands_are_means_over_rows_of_the_commands_that_arrive(rows: float) -> None:
    fine = np.repeat(COMMAND, 10, axis=0)
    late = np.concatenate([np.repeat(fine[:1], round(10 * rows), axis=0), fine])[: len(fine)]
    np.testing.assert_allclose(delayed(COMMAND, rows), late.reshape(-1, 10, 4).mean(axis=1))


def test_rotors_lag_exactly_behind_commands_that_are_held() -> None:
    speeds = lagged(COMMAND, 0.01, 0.05, 0.0)
    fine = lagged(np.repeat(COMMAND, 10, axis=0), 0.001, 0.05, 0.0)
    np.testing.assert_allclose(speeds, fine[::10], rtol=1e-9)
    np.testing.assert_array_equal(speeds[0], COMMAND[0])
