"""Advice names what narrows an interval, and the interval to expect."""

import numpy as np
import pytest

from maidenflight.identification.drone_file import Estimate
from maidenflight.identification.outcome.narrowing import advise
from maidenflight.identification.signals.motor_response import SPEEDS, TWICE, MotorResponse

RANDOM = np.random.default_rng(0)
LOG_TOTAL = np.log(0.05) + 0.2 * RANDOM.normal(size=4000)
LATENCY = np.full(4000, 0.002)
SAMPLES = {
    "motor_time_constant": np.exp(LOG_TOTAL) - LATENCY,
    "latency": LATENCY,
    # Follows the lag, and has a tenth of its own.
    "inertia_x": 1.4e-5 * np.exp(LOG_TOTAL - np.log(0.05) + 0.1 * RANDOM.normal(size=4000)),
}
MOTORS = MotorResponse(
    lag=SAMPLES["motor_time_constant"],
    latency=LATENCY,
    usual_latency=None,
    evidence=(),
    notes=(),
    per_flight={},
    expected_deviations={TWICE: (0.15, 0.0), SPEEDS: (0.05, 0.0)},
)


def estimate(value: float, factor: float) -> Estimate:
    return Estimate(value, (value / factor, value * factor), (value,), 0.0)


def test_the_lag_and_what_follows_it_narrow_by_measured_speeds():
    estimates = {"motor_time_constant": estimate(0.048, 1.48), "inertia_x": estimate(1.4e-5, 1.55)}
    lag, inertia = advise(estimates, (), SAMPLES, MOTORS)
    assert (lag.action, inertia.action) == (SPEEDS, SPEEDS)
    assert lag.interval == pytest.approx(0.048 * np.exp([-0.102, 0.102]), rel=0.01)
    reach = 1.96 * np.hypot(0.05, 0.1)
    assert inertia.interval == pytest.approx(1.4e-5 * np.exp([-reach, reach]), rel=0.02)


def test_narrow_intervals_need_nothing_and_others_are_named_without_a_number():
    narrow = {"motor_time_constant": estimate(0.048, 1.1), "thrust_to_weight": estimate(2.0, 1.03)}
    assert advise(narrow, (), SAMPLES, MOTORS) == ()
    (one,) = advise(narrow, ("drag_x",), SAMPLES, None)
    assert (one.parameter, one.interval) == ("drag_x", None)


def test_of_thrust_another_day_is_left():
    (one,) = advise({"thrust_to_weight": estimate(2.0, 1.06)}, (), SAMPLES, MOTORS)
    assert one.interval == pytest.approx((2 - 0.0588, 2 + 0.0588))
