"""Advice names what narrows an interval, and the interval to expect."""

from dataclasses import replace

import numpy as np
import pytest

from made_flights import calm
from maidenflight.identification.drone_file import Estimate
from maidenflight.identification.outcome.narrowing import (
    advise,
    inseparable_from_thrust,
    note_inseparable,
)
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


def tied(throttle_spread: float, linear_spread: float) -> tuple[str, ...]:
    """What cannot be told apart where hover alone ties thrust's ratio to its curve."""
    linear = 0.2 + linear_spread * RANDOM.normal(size=4000)
    own = 1 + 0.02 * RANDOM.normal(size=4000)
    # Thrust at u = 0.25 is the weight: ratio (linear sqrt(u) + (1 - linear) u) = 1.
    samples = {"thrust_to_weight": own / (0.5 * linear + 0.25 * (1 - linear))}
    samples |= {"thrust_linear": linear}
    ends = np.quantile(samples["thrust_to_weight"], [0.025, 0.975])
    estimates = {
        "thrust_to_weight": Estimate(3.3, (float(ends[0]), float(ends[1])), (3.3,), 0.0),
        "thrust_linear": estimate(0.2, 2.0),
    }
    time = np.linspace(0, 60, 600)
    command = np.tile(0.25 + throttle_spread * np.sin(time), (4, 1)).T.astype(np.float32)
    flights = [replace(calm(600), command=command)]
    names = inseparable_from_thrust(estimates, samples, flights)
    advice = {one.parameter: one for one in advise(estimates, (), samples, None, names)}
    assert ("hover" in advice["thrust_to_weight"].action) != bool(names)
    if names:
        assert advice["thrust_linear"].action == advice["thrust_to_weight"].action
        (note,) = note_inseparable(names, flights)
        assert "u = 0.25" in note
    return names


def test_a_calm_hover_ties_thrust_to_its_curve_and_varied_throttle_is_advised():
    both = ("thrust_to_weight", "thrust_linear")
    assert tied(throttle_spread=0.02, linear_spread=0.3) == both
    assert tied(throttle_spread=0.02, linear_spread=0.01) == ()
    assert tied(throttle_spread=0.2, linear_spread=0.3) == ()
    assert note_inseparable((), ()) == []


def test_what_shows_as_a_share_of_another_needs_that_one():
    alone = advise({}, ("torque_bias_z",), {}, None)
    trim, ratio = advise({}, ("torque_bias_z", "torque_to_thrust"), {}, None)
    assert trim.action == ratio.action != alone[0].action
