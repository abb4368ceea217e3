"""What measured rotor speeds show of motors that were planted."""

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter

from maidenflight.flights.log import Flight, flight_of
from maidenflight.flights.trims import rotors
from maidenflight.identification.likelihood.measured import measure
from maidenflight.identification.likelihood.speed_errors import motors_of_speeds
from maidenflight.identification.outcome.problem import Problem, generator_of
from maidenflight.identification.signals.motor_response import MotorResponse
from maidenflight.parameters import crazyflie, replace
from maidenflight.simulator.physics.dynamics import equivalent_lag

PERIOD, ROWS, FULL = 0.002, 10_000, 3000.0


def flown(
    lag: float,
    ratio: float,
    *,
    noise: float = 0.0,
    sag: float = 0.1,
    name: str = "log",
    seed: int = 0,
) -> Flight:
    """Returns 20 s of motors under lively commands at 500 Hz, of a battery that sags by a share."""
    random = np.random.default_rng(seed)
    wanted = np.asarray(lfilter([0.02], [1.0, -0.98], random.normal(0.0, 0.7, (ROWS, 4)), axis=0))
    zeros = np.zeros((ROWS, 3))
    flight = flight_of(
        name,
        PERIOD,
        body_rates=random.normal(0.0, 0.1, (ROWS, 3)),
        command=np.clip(0.5 + wanted, 0.05, 1.0),
        zero_order_hold=True,
        accelerometer=zeros + np.array([0.0, 0.0, 9.81]),
    )
    motors = {"motor_time_constant": lag, "spin_down_ratio": ratio, "latency": 0.004}
    drone = replace(crazyflie(), **{key: np.float32(value) for key, value in motors.items()})
    full = FULL * np.linspace(1.0, 1.0 - sag, ROWS)[:, None]
    # Speeds at the end of a row's period are those of the next row.
    speed = full * np.roll(rotors(flight, drone).speed, 1, axis=0)
    return dataclasses.replace(flight, rotor_speed=speed + random.normal(0.0, noise, (ROWS, 4)))


def seen(*flights: Flight) -> MotorResponse:
    found = motors_of_speeds(flights, crazyflie(), generator_of(0))
    assert found is not None
    assert found.spin_down_ratio is not None
    return found


def medians(found: MotorResponse) -> list[float]:
    parts = found.lag, found.spin_down_ratio, found.latency
    return [float(np.median(one)) for one in parts if one is not None]


@pytest.mark.parametrize(("lag", "ratio"), [(0.0125, 2.0), (0.06, 1.5)])
def test_lag_both_ways_and_latency_come_back(lag: float, ratio: float) -> None:
    found = seen(flown(lag, ratio, noise=20.0))
    seen_lag, found_ratio, latency = medians(found)
    assert [seen_lag, found_ratio] == pytest.approx([equivalent_lag(lag, ratio), ratio], rel=0.04)
    assert latency == pytest.approx(0.004, abs=4e-4)
    assert [one.signal for one in found.evidence] == ["rotor speed"]
    low, high = found.evidence[0].interval
    assert low < equivalent_lag(lag, ratio) + 0.004 < high


def test_noise_of_the_reading_widens_intervals_up_to_what_motors_are_unlike() -> None:
    found = [seen(flown(0.03, 1.0, sag=0.0, noise=noise)) for noise in (0.0, 100.0)]
    exact, noisy = (float(np.std(np.log(one.lag))) for one in found)
    assert exact < 0.04 < noisy < 0.07


def test_logs_are_told_apart_by_their_lag() -> None:
    found = seen(flown(0.03, 1.0, name="one"), flown(0.045, 1.0, name="other", seed=1))
    mean, _ = found.per_flight["one"]
    other, _ = found.per_flight["other"]
    assert np.exp(other - mean) == pytest.approx(49 / 34, rel=0.1)


def test_speeds_that_do_not_follow_commands_show_nothing() -> None:
    flight = flown(0.03, 1.0)
    assert flight.rotor_speed is not None
    broken = dataclasses.replace(flight, rotor_speed=flight.rotor_speed[::-1].copy())
    unmeasured = dataclasses.replace(flight, rotor_speed=None)
    for lost in (broken, unmeasured):
        assert motors_of_speeds([lost], crazyflie(), generator_of(0)) is None


def test_a_policy_at_the_logs_rate_is_left_to_the_likelihood() -> None:
    flight = flown(0.03, 1.0)
    state = {key: np.zeros((ROWS, 3), np.float32) for key in ("position", "velocity", "attitude")}
    problem = Problem.of([dataclasses.replace(flight, accelerometer=None, **state)])
    assert measure(problem).motors is None


def test_commands_read_by_another_law_than_the_motors_keep_the_lag_both_ways() -> None:
    flight = flown(0.03, 1.667, sag=0.0)
    # What is in proportion to sqrt(u) is read as affine in u.
    affine = np.clip((flight.command.astype(float) + 0.08) / 0.75, 0.0, 1.0) ** 2
    read = dataclasses.replace(flight, command=affine.astype(np.float32))
    lag, ratio, latency = medians(seen(read))
    assert [lag, ratio] == pytest.approx([equivalent_lag(0.03, 1.667), 1.667], rel=0.04)
    assert latency == pytest.approx(0.004, abs=6e-4)
