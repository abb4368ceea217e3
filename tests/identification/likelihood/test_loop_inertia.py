import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from maidenflight.flights.log import Flight, flight_of
from maidenflight.identification.likelihood.loop_inertia import inertia_of_loop, inertia_of_speeds
from maidenflight.identification.outcome.plausible import HOVERING
from maidenflight.identification.signals.motor_response import MotorResponse
from maidenflight.parameters import crazyflie, levers, replace


def look(spread: float) -> MotorResponse:
    """Returns what logs show of motors of 50 + 5 ms, inertia a hundred times as clear about x."""
    random = np.random.default_rng(0)
    inertia = {
        name: 8e-6 * np.exp(deviation * random.standard_normal(2000))
        for name, deviation in (("inertia_x", 0.05), ("inertia_y", 5.0))
    }
    lag = 0.05 * np.exp(spread * random.standard_normal(2000))
    return MotorResponse(lag, np.full(2000, 0.005), None, (), (), {}, inertia_per_thrust=inertia)


def problem(over: tuple[str, ...] | None = None) -> Any:
    return SimpleNamespace(
        over=over,
        generator=np.random.default_rng(1),
        flights=[SimpleNamespace(command=np.full((9, 4), 0.25))],
    )


def turned(inertia: tuple[float, float], *, speeds: bool = True) -> Flight:
    """Returns 8 s of rotors that turn a drone of some inertia, with vibration, at 500 Hz."""
    random, drone, period = np.random.default_rng(2), crazyflie(), 0.002
    noise = np.cumsum(random.normal(0.0, 12.0, (4000, 4)), axis=0)
    speed = 2000.0 + 300.0 * np.tanh((noise - noise.mean(axis=0)) / 600.0)
    squares = speed**2
    hover = float(drone.mass * drone.gravity) / squares.sum(axis=1).mean()
    turning = hover * squares @ levers(drone)[:, :2] / inertia + random.normal(0, 4.0, (4000, 2))
    rates = np.cumsum(period * turning, axis=0)
    force = hover / float(drone.mass) * squares.sum(axis=1)
    return flight_of(
        "log",
        period,
        body_rates=np.column_stack([rates - rates.mean(axis=0), np.zeros(4000)]),
        command=np.full((4000, 4), 0.5),
        zero_order_hold=False,
        accelerometer=np.column_stack([np.zeros((4000, 2)), force]),
        rotor_speed=speed if speeds else None,
        accelerometer_delay=0.0,
    )


def test_measured_speeds_tell_the_inertia_without_command_or_curve() -> None:
    asked = problem()
    asked.flights = [turned((2e-5, 3e-5)), turned((2e-5, 3e-5), speeds=False)]
    told = inertia_of_speeds(asked, crazyflie())
    assert np.median(told["inertia_x"]) == pytest.approx(2e-5, rel=0.04)
    assert np.median(told["inertia_y"]) == pytest.approx(3e-5, rel=0.04)
    assert 0.08 < np.std(np.log(told["inertia_x"])) < 0.11
    asked.flights = asked.flights[1:]
    assert inertia_of_speeds(asked, crazyflie()) == {}


def test_a_hand_that_carries_the_drone_is_no_thrust() -> None:
    """Thrown and caught: a half more force than the rotors give, for 1.5 s of 8 s."""
    flight = turned((2e-5, 3e-5))
    force = np.array(flight.accelerometer)
    force[:500] *= 1.5
    force[-250:] *= 1.5
    asked = problem()
    asked.flights = [dataclasses.replace(flight, accelerometer=force)]
    told = inertia_of_speeds(asked, crazyflie())
    assert np.median(told["inertia_x"]) == pytest.approx(2e-5, rel=0.04)


def test_a_command_turns_by_the_slope_of_the_thrusts_curve() -> None:
    curved = replace(crazyflie(), thrust_linear=np.float32(0.5))
    straight, bent = (
        np.median(inertia_of_loop(problem(), look(0.1), {}, drone)["inertia_x"])
        for drone in (crazyflie(), curved)
    )
    # d(0.5 u + 0.5 sqrt(u)) / du = 1 at u = 0.25.
    assert bent == pytest.approx(straight, rel=0.02)
    known = {"thrust_linear": np.full(500, -0.4)}
    steeper = problem()
    steeper.flights[0].command[:] = 0.0625
    flat = inertia_of_loop(steeper, look(0.1), known, crazyflie())["inertia_x"]
    assert np.median(flat) == pytest.approx(0.6 * straight, rel=0.02)


def test_inertia_scales_with_the_thrust_and_unclear_ones_stay_out() -> None:
    told = inertia_of_loop(problem(), look(0.1), {HOVERING: np.full(500, 2.0)}, crazyflie())
    assert list(told) == ["inertia_x"]
    assert np.median(told["inertia_x"]) == pytest.approx(1.6e-5, rel=0.02)
    usual = inertia_of_loop(problem(), look(0.1), {}, crazyflie())
    ratio = float(crazyflie().thrust_to_weight) / 2.0
    assert np.median(usual["inertia_x"]) == pytest.approx(ratio * 1.6e-5, rel=0.02)


def test_nothing_is_told_without_a_clear_lag_or_of_chosen_parameters() -> None:
    assert inertia_of_loop(problem(), None, {}, crazyflie()) == {}
    assert inertia_of_loop(problem(), look(2.0), {}, crazyflie()) == {}
    assert inertia_of_loop(problem(("inertia_x",)), look(0.1), {}, crazyflie()) == {}
