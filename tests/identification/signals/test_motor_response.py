"""Lag and latency from rotor speed, accelerometer and gyro: planted ones come back."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from maidenflight.flights.log import ACCELEROMETER_DELAY, Flight
from maidenflight.flights.reading import read_flights
from maidenflight.identification.signals.flight_signals import lagged
from maidenflight.identification.signals.motor_response import BETWEEN, motor_response
from maidenflight.parameters import crazyflie

USD = Path(__file__).parents[4] / "shared" / "data" / "usd"
DRONE = crazyflie()
PERIOD, LAG, LATENCY, THRUST = 0.002, 0.07, 0.006, 4.4


def made(seed: int, *, rotor_speed: bool, lag: float = LAG, name: str = "made") -> Flight:
    """A drone that is shaken at 500 Hz, with drag against climbing, noise that lasts, and the
    sensors' filters as delays.
    """
    generator = np.random.default_rng(seed)
    rows = 6000
    slow = np.asarray(lfilter([0.04], [1.0, -0.96], generator.normal(size=(rows, 4)), axis=0))
    command = np.clip(0.57 + 0.4 * slow, 0.05, 1.0).astype(np.float32)
    zeros = np.zeros((rows, 3), np.float32)
    bare = Flight(
        name=name,
        period=PERIOD,
        position=zeros,
        velocity=zeros,
        attitude=zeros,
        body_rates=zeros,
        command=command,
        battery=zeros[:, 0],
        setpoint=zeros,
        zero_order_hold=True,
    )
    speed = lagged(bare.speed_command, PERIOD, lag, LATENCY)
    thrust = THRUST * (0.5 * (speed[1:] ** 2 + speed[:-1] ** 2)).sum(axis=1)
    wind = np.asarray(lfilter([1.0], [1.0, -0.98], 0.01 * generator.normal(size=rows)))
    climb, force = 0.0, np.zeros(rows)
    velocity = np.zeros((rows, 3))
    for row in range(rows):
        velocity[row, 2] = climb
        force[row] = thrust[row] - 0.5 * climb + wind[row]
        climb = 0.999 * climb + PERIOD * (force[row] - thrust.mean())
    late = np.arange(rows) - ACCELEROMETER_DELAY / PERIOD - 0.5
    felt = np.zeros((rows, 3))
    felt[:, 2] = np.interp(late, np.arange(rows), force) + 0.02 * generator.normal(size=rows)
    measured = 2000 * speed[:-1] + generator.normal(size=(rows, 4))
    return Flight(
        name=name,
        period=PERIOD,
        position=zeros,
        velocity=velocity.astype(np.float32),
        attitude=zeros,
        body_rates=0.01 * generator.normal(size=(rows, 3)).astype(np.float32),
        command=command,
        battery=zeros[:, 0],
        setpoint=zeros,
        zero_order_hold=True,
        accelerometer=felt.astype(np.float32),
        rotor_speed=measured.astype(np.float32) if rotor_speed else None,
    )


@pytest.mark.parametrize("rotor_speed", [True, False])
def test_a_planted_lag_comes_back(rotor_speed: bool) -> None:
    found = motor_response([made(1, rotor_speed=rotor_speed)], np.random.default_rng(0), DRONE)
    assert found is not None
    low, middle, high = np.quantile(found.lag + found.latency, [0.025, 0.5, 0.975])
    assert low < LAG + LATENCY < high
    assert middle == pytest.approx(LAG + LATENCY, rel=0.12)
    assert found.looks[0].signal == ("rotor speed" if rotor_speed else "accelerometer")


@pytest.mark.slow
def test_flights_of_different_lags_widen_the_interval() -> None:
    alike = [made(seed, rotor_speed=True, name=f"flight {seed}") for seed in range(3)]
    apart = [
        made(seed, rotor_speed=True, lag=lag, name=f"flight {seed}")
        for seed, lag in enumerate((0.04, 0.07, 0.12))
    ]
    one, other = (motor_response(some, np.random.default_rng(0), DRONE) for some in (alike, apart))
    assert one is not None
    assert other is not None
    assert other.spread > one.spread + 0.01
    assert np.std(other.lag) > 2 * np.std(one.lag)


def test_one_flight_does_not_show_what_flights_differ_by() -> None:
    found = motor_response([made(1, rotor_speed=True)], np.random.default_rng(0), DRONE)
    assert found is not None
    assert found.spread == 0
    assert np.std(np.log(found.lag + found.latency)) > 0.9 * BETWEEN


def test_without_sensors_beside_the_estimate_nothing_is_seen() -> None:
    flight = made(1, rotor_speed=False)
    bare = Flight(**{**vars(flight), "accelerometer": None})
    assert motor_response([bare], np.random.default_rng(0), DRONE) is None


@pytest.mark.slow
@pytest.mark.skipif(not USD.exists(), reason="no logs of measured drones here")
def test_the_lag_of_a_real_drone_is_that_of_its_measured_speeds() -> None:
    flights = read_flights(USD / "brushed" / "jana01").flights
    measured = motor_response(flights, np.random.default_rng(0), DRONE)
    hidden = motor_response(
        [Flight(**{**vars(flight), "rotor_speed": None}) for flight in flights],
        np.random.default_rng(0),
        DRONE,
    )
    assert measured is not None
    assert hidden is not None
    truth = float(np.median(measured.lag + measured.latency))
    assert truth == pytest.approx(0.080, abs=0.008)
    low, high = np.quantile(hidden.lag + hidden.latency, [0.025, 0.975])
    assert low < truth < high
    assert np.median(hidden.lag + hidden.latency) == pytest.approx(truth, abs=0.015)
