from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from maidenflight.identification.likelihood.measured import inertia_of_loop
from maidenflight.identification.outcome.plausible import HOVERING
from maidenflight.identification.signals.motor_response import MotorResponse
from maidenflight.parameters import Parameters, crazyflie, replace


def look(spread: float) -> MotorResponse:
    """Returns what logs show of motors of 50 + 5 ms, inertia a hundred times as clear about x."""
    random = np.random.default_rng(0)
    inertia = {
        name: 8e-6 * np.exp(deviation * random.standard_normal(2000))
        for name, deviation in (("inertia_x", 0.05), ("inertia_y", 5.0))
    }
    lag = 0.05 * np.exp(spread * random.standard_normal(2000))
    return MotorResponse(lag, np.full(2000, 0.005), None, (), (), {}, inertia_per_thrust=inertia)


def told(
    known: dict[str, np.ndarray],
    drone: Parameters,
    command: float = 0.25,
    spread: float = 0.1,
) -> dict[str, np.ndarray]:
    flights: Any = [SimpleNamespace(command=np.full((9, 4), command))]
    return inertia_of_loop(flights, look(spread), known, drone, np.random.default_rng(1))


def test_a_command_turns_by_the_slope_of_the_thrusts_curve() -> None:
    curved = replace(crazyflie(), thrust_linear=np.float32(0.5))
    straight, bent = (np.median(told({}, drone)["inertia_x"]) for drone in (crazyflie(), curved))
    # d(0.5 u + 0.5 sqrt(u)) / du = 1 at u = 0.25.
    assert bent == pytest.approx(straight, rel=0.02)
    known = {"thrust_linear": np.full(500, -0.4)}
    flat = told(known, crazyflie(), command=0.0625)["inertia_x"]
    assert np.median(flat) == pytest.approx(0.6 * straight, rel=0.02)


def test_inertia_scales_with_the_thrust_and_unclear_ones_stay_out() -> None:
    strong = told({HOVERING: np.full(500, 2.0)}, crazyflie())
    assert list(strong) == ["inertia_x"]
    assert np.median(strong["inertia_x"]) == pytest.approx(1.6e-5, rel=0.02)
    usual = told({}, crazyflie())
    ratio = float(crazyflie().thrust_to_weight) / 2.0
    assert np.median(usual["inertia_x"]) == pytest.approx(ratio * 1.6e-5, rel=0.02)


def test_nothing_is_told_without_a_clear_lag() -> None:
    assert told({}, crazyflie(), spread=2.0) == {}
