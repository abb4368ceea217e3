"""Torque between two set-points of a PX4 log, of a controller whose answers are known."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import butter, sosfiltfilt

from maidenflight.flights.streams.streams import Stream
from maidenflight.integrations.logs import px4_rate_loop

NO_FILTERS = {"IMU_GYRO_CUTOFF": 0.0, "IMU_DGYRO_CUTOFF": 0.0}


def logged(noise: float) -> tuple[Stream, dict[str, dict[str, np.ndarray]], np.ndarray]:
    """Set-points at 50 Hz of a PI controller, a gyro at 250 Hz, and all torques."""
    generator = np.random.default_rng(0)
    stamps = 1_000_000 + 4000 * np.arange(2500)
    rates = generator.normal(0.0, 0.1, (2500, 3))
    turned = np.cumsum(rates, axis=0) * 4e-3
    torque = 0.02 - np.array([0.15, 0.15, 0.2]) * rates - np.array([0.2, 0.2, 0.1]) * turned
    gyro = rates + noise * generator.normal(size=rates.shape)
    topics = {
        "sensor_combined": {
            "timestamp": stamps,
            **{f"gyro_rad[{axis}]": gyro[:, axis] for axis in range(3)},
            "gyro_integral_dt": np.zeros(2500),
        },
        "vehicle_rates_setpoint": {
            "timestamp": stamps[::5],
            **{axis: np.zeros(500) for axis in ("roll", "pitch", "yaw")},
        },
    }
    rows = np.concatenate([torque, np.full((2500, 1), -0.5)], axis=1)
    return Stream(1e-6 * stamps[::5], rows[::5]), topics, rows


def test_torque_between_set_points_follows_from_the_gyro() -> None:
    setpoints, topics, rows = logged(0.0)
    gains = {f"MC_{axis}RATE_D": 0.0 for axis in ("ROLL", "PITCH")}
    faster, note = px4_rate_loop.between(setpoints, topics, NO_FILTERS | gains)
    assert "100 %" in note
    assert faster.rate == pytest.approx(250.0)
    assert_allclose(faster.values[50:-50], rows[50 : len(faster.values) - 50], atol=1e-3)


def test_vibration_that_set_points_fold_does_not_hide_slow_torque() -> None:
    """Single samples of the set-points hold vibration of which the logged gyro knows two thirds."""
    setpoints, topics, rows = logged(0.07)
    gains = {f"MC_{axis}RATE_D": 0.0 for axis in ("ROLL", "PITCH")}
    faster, note = px4_rate_loop.between(setpoints, topics, NO_FILTERS | gains)
    assert note
    low_pass = butter(2, 5.0, fs=250.0, output="sos")
    slow, right = (
        sosfiltfilt(low_pass, some[50:2450, :2], axis=0) for some in (faster.values, rows)
    )
    left = (slow - right).std(axis=0) / right.std(axis=0)
    # 0.72 is the logged gyro's own noise; averaged over 0.03 s, 1.2 is left.
    assert (left < 0.9).all()


def test_a_gyro_that_does_not_explain_them_is_passed_over() -> None:
    setpoints, topics, _ = logged(0.3)
    assert px4_rate_loop.between(setpoints, topics, NO_FILTERS) == (setpoints, "")
