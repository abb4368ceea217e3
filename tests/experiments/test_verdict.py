"""Verdicts name the share of drones that fly well, and the parameter that decides it."""

import numpy as np
import polars
import pytest

from maidenflight.experiments.verdict import verdicts
from maidenflight.identification.drone_file import Advice, DroneFile
from maidenflight.identification.posterior import Posterior
from maidenflight.parameters import crazyflie

LAGS = np.linspace(0.04, 0.10, 40)
FILE = DroneFile(
    crazyflie(),
    posterior=Posterior(
        {
            "motor_time_constant": LAGS,
            "latency": np.random.default_rng(0).uniform(0.0, 0.01, 40),
        }
    ),
    advice=(Advice("motor_time_constant", "log rotor speeds", None),),
)


def flights(errors: np.ndarray, policy: str = "policy_1") -> polars.DataFrame:
    """Flights of all drones of the file, which crash where the error is infinite."""
    lasts = np.isfinite(errors)
    return polars.DataFrame(
        {
            "policy": [policy] * 40,
            "control": ["pwm"] * 40,
            "drone": np.arange(1, 41),
            "duration": np.where(lasts, 20.0, 3.0),
            "end_reason": np.where(lasts, "time limit", "tilt"),
            "position_error": np.where(lasts, errors, 0.01),
        }
    )


def test_the_lag_decides_where_errors_follow_it():
    slow = flights(np.where(LAGS > 0.0935, np.inf, LAGS / 2))
    assert verdicts(slow, FILE, 20.0) == [
        "pwm: 88% of 40 drones of the posterior fly 20 s within 5 cm (policy_1); "
        "motor_time_constant decides; next: log rotor speeds"
    ]


@pytest.mark.parametrize("errors", [np.full(40, 0.1), np.random.default_rng(1).uniform(0, 1, 40)])
def test_no_parameter_decides_where_none_does(errors: np.ndarray):
    (line,) = verdicts(flights(errors), FILE, 20.0)
    assert line.endswith("no parameter decides")


def test_the_best_policy_of_a_control_structure_counts():
    both = polars.concat([flights(np.full(40, 0.2)), flights(np.full(40, 0.01), "policy_2")])
    (line,) = verdicts(both, FILE, 20.0)
    assert line == "pwm: 100% of 40 drones of the posterior fly 20 s within 5 cm (policy_2)"
