"""Verdicts count what is wrong with flights, and name the parameter that decides it."""

import numpy as np
import polars
import pytest

from maidenflight.experiments.verdict import judge

LAGS = np.linspace(0.04, 0.10, 40)
SAMPLES = {
    "motor_time_constant": LAGS,
    "latency": np.random.default_rng(0).uniform(0.0, 0.01, 40),
    "mass": np.full(40, 0.03),
}
ACTIONS = {"motor_time_constant": "log rotor speeds"}


def flights(errors: np.ndarray, drift: float = 0.0) -> polars.DataFrame:
    """Flights of all drones of the file, which crash where the error is infinite."""
    policy = "policy_1"
    lasts = np.isfinite(errors)
    return polars.DataFrame(
        {
            "policy": [policy] * 40,
            "control": ["pwm"] * 40,
            "drone": np.arange(1, 41),
            "duration": np.where(lasts, 20.0, 3.0),
            "end_reason": np.where(lasts, "time limit", "tilt"),
            "position_error": np.where(lasts, errors + drift, 0.01),
            "estimated_error": np.where(lasts, errors, 0.01),
        }
    )


def test_the_lag_decides_where_errors_follow_it():
    slow = judge(flights(np.where(LAGS > 0.0935, np.inf, LAGS / 1.6)), SAMPLES, 20.0, ACTIONS)
    assert not slow.is_good
    assert slow.parameter == "motor_time_constant"
    assert slow.sentence == (
        "Do not fly: of policy_1, 5 of 40 end by tilt (3.0 s in the mean); 9 of 40 stay farther "
        "than 5 cm from the set-point; motor_time_constant decides which; log rotor speeds."
    )


@pytest.mark.parametrize("errors", [np.full(40, 0.1), np.random.default_rng(1).uniform(0, 1, 40)])
def test_no_parameter_decides_where_none_does(errors: np.ndarray):
    verdict = judge(flights(errors), SAMPLES, 20.0, ACTIONS)
    assert not verdict.is_good
    assert verdict.parameter is None


def test_one_flight_farther_away_is_not_good():
    errors = np.full(40, 0.01)
    errors[3] = 0.06
    assert "1 of 40 stay farther" in judge(flights(errors), {}, 20.0, {}).sentence


def test_flights_that_last_and_stay_near_are_good():
    verdict = judge(flights(np.full(40, 0.049)), SAMPLES, 20.0, ACTIONS)
    assert verdict.is_good
    assert verdict.sentence.startswith("Fly: 40 of 40 flights of policy_1 last 20 s within 5 cm")
    assert "drifts" not in verdict.sentence


def test_how_far_flights_are_in_truth_is_said_where_estimates_drift():
    verdict = judge(flights(np.full(40, 0.02), drift=0.15), SAMPLES, 20.0, ACTIONS)
    assert verdict.is_good
    assert "up to 17 cm in truth" in verdict.sentence
