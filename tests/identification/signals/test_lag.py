"""Looks at the lag are compared in one quantity."""

import numpy as np
import pytest

from maidenflight.identification.signals import lag
from maidenflight.identification.signals.motor_response import MotorResponse
from maidenflight.identification.uncertainty import Evidence
from maidenflight.parameters import crazyflie, replace
from maidenflight.simulator.physics.dynamics import equivalent_lag

SPEEDING_UP = np.full(200, 0.060)
DRAWS = {"motor_time_constant": SPEEDING_UP, "latency": np.full(200, 0.005)}


def taken(**more: np.ndarray) -> Evidence:
    drone = replace(crazyflie(), spin_down_ratio=1.4)
    return lag.delay_evidence(None, {**DRAWS, **more}, (), drone)[-1]


def test_what_is_taken_is_the_equivalent_of_speeding_up_and_slowing_down_as_signals_show():
    assert taken().value == pytest.approx(equivalent_lag(0.060, 1.4) + 0.005)
    twice = taken(spin_down_ratio=np.full(200, 2.0)).value
    assert twice == pytest.approx(equivalent_lag(0.060, 2.0) + 0.005)


@pytest.mark.parametrize("ratio", [0.7, 1.0, 2.4])
def test_the_equivalent_lag_stays_along_the_slope_by_the_ratio(ratio):
    drone = replace(crazyflie(), motor_time_constant=0.05, spin_down_ratio=ratio)
    step = 1e-4
    up = 0.05 + step * lag.slope_by_ratio(drone)
    assert equivalent_lag(up, ratio + step) == pytest.approx(equivalent_lag(0.05, ratio), rel=1e-7)
    assert lag.speeding_up(equivalent_lag(0.05, ratio), ratio) == pytest.approx(0.05)


def test_without_delays_there_is_nothing_to_compare():
    assert lag.delay_evidence(None, {"latency": np.full(9, 0.005)}, (), crazyflie()) == ()


def test_looks_whose_intervals_do_not_touch_disagree():
    one, other = (
        Evidence("accelerometer", 0.08, (0.07, 0.09)),
        Evidence("gyro x", 0.05, (0.04, 0.06)),
    )
    motors = MotorResponse(SPEEDING_UP, SPEEDING_UP, None, (one, other), (), {})
    assert len(lag.notes((one, other), motors)) == 1
    assert lag.notes((one, Evidence("taken", 0.08, (0.06, 0.1))), motors) == []
