"""Ground, take-off, throttle cuts and impacts in logs of accelerometer, gyro and commands alone."""

import numpy as np
import pytest

from maidenflight.flights.checks import airborne, checking
from maidenflight.flights.log import Flight

PERIOD, SECONDS = 0.002, 12.0
ROWS = round(SECONDS / PERIOD)


def logged() -> Flight:
    """Two seconds on the ground, the second with running motors, a flight, and the ground again."""
    generator = np.random.default_rng(0)
    time = np.arange(ROWS) * PERIOD
    flying = (time >= 2.0) & (time < 10.0)
    command = 0.4 + 0.02 * generator.normal(size=(ROWS, 4))
    command[~flying] *= 0.4
    command[(time < 1.0) | (time >= 10.5)] = 0.0
    rates = 0.005 * generator.normal(size=(ROWS, 3))
    rates[flying, :2] += 0.3 * np.sin(8.0 * time[flying, None] + [0.0, 1.0])
    force = np.zeros((ROWS, 3)) + [0.0, 0.0, 9.81] + 0.05 * generator.normal(size=(ROWS, 3))
    unknown = np.full((ROWS, 3), np.nan, np.float32)
    return Flight(
        name="log",
        period=PERIOD,
        position=unknown,
        velocity=unknown,
        attitude=unknown,
        body_rates=rates.astype(np.float32),
        command=np.clip(command, 0.0, 1.0).astype(np.float32),
        battery=unknown[:, 0],
        setpoint=unknown,
        zero_order_hold=True,
        accelerometer=force.astype(np.float32),
    )


def kept(flight: Flight) -> list[tuple[float, float]]:
    """Beginning and end of each piece that is kept [s]."""
    pieces, _ = checking.pieces(flight)
    starts = [np.flatnonzero((flight.command == one.command[0]).all(axis=1))[0] for one in pieces]
    return [
        (float(start * PERIOD), float((start + len(one)) * PERIOD))
        for start, one in zip(starts, pieces, strict=True)
    ]


def test_ground_take_off_and_landing_are_left_out() -> None:
    ((start, stop),) = kept(logged())
    assert start == pytest.approx(2.0 + airborne.TAKE_OFF, abs=airborne.WINDOW)
    assert stop == pytest.approx(10.0 - airborne.LANDING, abs=airborne.WINDOW)


def test_a_short_throttle_cut_belongs_to_the_flight_and_a_long_one_does_not() -> None:
    short, long = logged(), logged()
    short.command[round(6.0 / PERIOD) : round(6.3 / PERIOD)] = 0.0
    long.command[round(6.0 / PERIOD) : round(6.8 / PERIOD)] = 0.0
    assert len(kept(short)) == 1
    (_, first), (second, _) = kept(long)
    assert first == pytest.approx(6.0 - airborne.LANDING, abs=0.01)
    assert second == pytest.approx(6.8 + airborne.TAKE_OFF, abs=0.01)


def test_an_impact_is_left_out_with_what_is_around_it() -> None:
    flight = logged()
    assert flight.accelerometer is not None
    flight.accelerometer[round(6.0 / PERIOD) : round(6.05 / PERIOD), 0] = 30.0
    (_, first), (second, _) = kept(flight)
    assert first == pytest.approx(6.0 - airborne.IMPACT_MARGIN, abs=0.015)
    assert second == pytest.approx(6.05 + airborne.IMPACT_MARGIN, abs=0.015)


def test_a_quiet_hover_is_no_standing() -> None:
    """A heavy quadrotor hovers as calmly as others stand; it commands what flying takes."""
    flight = logged()
    flight.body_rates[round(4.0 / PERIOD) : round(8.0 / PERIOD), :2] *= 0.01
    ((start, stop),) = kept(flight)
    assert stop - start == pytest.approx(7.0 - airborne.LANDING, abs=2 * airborne.WINDOW)


def test_drag_beyond_1_g_is_no_impact() -> None:
    flight = logged()
    assert flight.accelerometer is not None
    flight.accelerometer[round(5.0 / PERIOD) : round(8.0 / PERIOD), 1] += 12.0
    assert len(kept(flight)) == 1


def test_a_flight_that_begins_in_the_air_is_kept_whole() -> None:
    flight = logged().part(round(3.0 / PERIOD), round(8.0 / PERIOD))
    assert [len(piece) for piece in checking.pieces(flight)[0]] == [len(flight)]


def test_the_vibration_of_a_raw_accelerometer_is_no_impact() -> None:
    """Propellers of 200 Hz and 2 g, which come and go with the throttle."""
    flight = logged()
    assert flight.accelerometer is not None
    time = np.arange(len(flight)) * PERIOD
    comes = (np.sin(2 * np.pi * 0.2 * time) > 0.9) * 2 * 9.81
    flight.accelerometer[:, 0] += (comes * np.sin(2 * np.pi * 200 * time)).astype(np.float32)
    assert len(kept(flight)) == 1
