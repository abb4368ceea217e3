"""Inertia by measured rotor speeds comes back: with noise, other torques and clocks that differ."""

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from maidenflight.flights.log import Flight, flight_of
from maidenflight.identification.signals.speed_inertia import inertia_of_speeds
from maidenflight.parameters import crazyflie, levers

PERIOD, LAG, ROWS = 0.002, 0.03, 6000
INERTIA = (2e-5, 3e-5)


def turned(*, late: int = 0, noise: float = 0.0, air: float = 4.0) -> Flight:
    """Returns 12 s of rotors that turn a drone at 500 Hz, driven by commands.

    Args:
        late: rows by which the body rates come after the speeds.
        noise: of the speeds as read [rad/s].
        air: torque of the air over the inertia [rad/s2].
    """
    random, drone = np.random.default_rng(2), crazyflie()
    wanted = np.asarray(lfilter([0.02], [1.0, -0.98], random.normal(0.0, 0.7, (ROWS, 4)), axis=0))
    command = np.clip(0.5 + wanted, 0.1, 1.0)
    kept = np.exp(-PERIOD / LAG)
    speed = 3000.0 * np.asarray(lfilter([1 - kept], [1.0, -kept], np.sqrt(command), axis=0))
    squares = speed**2
    hover = float(drone.mass * drone.gravity) / squares[500:].sum(axis=1).mean()
    torque = hover * squares @ levers(drone)[:, :2]
    turning = torque / INERTIA + random.normal(0.0, air, (ROWS, 2))
    rates = np.cumsum(PERIOD * (turning - turning.mean(axis=0)), axis=0)
    rates = np.roll(rates, late, axis=0)
    force = hover / float(drone.mass) * squares.sum(axis=1)
    return flight_of(
        "log",
        PERIOD,
        body_rates=np.column_stack([rates, np.zeros(ROWS)]),
        command=command,
        zero_order_hold=True,
        accelerometer=np.column_stack([np.zeros((ROWS, 2)), force]),
        rotor_speed=speed + random.normal(0.0, noise, speed.shape),
        accelerometer_delay=0.0,
    ).part(500, ROWS)


def inertia(*flights: Flight) -> dict[str, np.ndarray]:
    return inertia_of_speeds(flights, crazyflie(), 1000, np.random.default_rng(0))


def medians(samples: dict[str, np.ndarray]) -> list[float]:
    return [float(np.median(samples[f"inertia_{axis}"])) for axis in "xy"]


def test_inertia_comes_back_without_command_curve_or_lag() -> None:
    flight = turned()
    found = inertia(flight, dataclasses.replace(flight, rotor_speed=None))
    assert medians(found) == pytest.approx(list(INERTIA), rel=0.03)
    assert np.std(np.log(found["inertia_x"])) < 0.11
    assert inertia(dataclasses.replace(flight, rotor_speed=None)) == {}


def test_speeds_read_with_noise_do_not_make_the_drone_heavy() -> None:
    """More noise than signal, which turns nothing."""
    assert medians(inertia(turned(noise=150.0))) == pytest.approx(list(INERTIA), rel=0.07)


@pytest.mark.parametrize("late", [-2, 6])
def test_clocks_of_a_file_that_differ_do_not_matter(late: int) -> None:
    both = medians(inertia(turned(late=late), dataclasses.replace(turned(), name="other")))
    assert both == pytest.approx(list(INERTIA), rel=0.03)


def test_what_speeds_explain_exactly_has_a_narrow_interval() -> None:
    exact, real = (inertia(turned(air=air))["inertia_x"] for air in (0.0, 40.0))
    assert np.std(np.log(exact)) < 0.04 < 0.08 < np.std(np.log(real))


def test_a_hand_that_carries_the_drone_is_no_thrust() -> None:
    """Thrown and caught: a half more force than the rotors give, for 1.5 s of 11 s."""
    flight = turned()
    force = np.array(flight.accelerometer)
    force[:500] *= 1.5
    force[-250:] *= 1.5
    carried = dataclasses.replace(flight, accelerometer=force)
    assert medians(inertia(carried)) == pytest.approx(list(INERTIA), rel=0.04)


def test_a_log_with_a_state_says_the_same_without_an_accelerometer() -> None:
    flight, drone = turned(), crazyflie()
    attitude = np.zeros((len(flight), 3))
    attitude[:, 0] = 0.3 * np.sin(np.arange(len(flight)) * PERIOD)
    up = Rotation.from_euler("ZYX", attitude[:, ::-1]).as_matrix()[..., 2]
    assert flight.accelerometer is not None
    push = up * flight.accelerometer[:, 2:] - np.array([0.0, 0.0, float(drone.gravity)])
    state = dataclasses.replace(
        flight,
        position=np.zeros_like(attitude),
        velocity=PERIOD * np.cumsum(push, axis=0),
        attitude=attitude,
        accelerometer=None,
    )
    assert medians(inertia(state)) == pytest.approx(list(INERTIA), rel=0.04)
