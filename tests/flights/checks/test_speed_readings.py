"""Readings of rotor speeds that no rotor can have had are interpolated, all else stays."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from maidenflight.flights.checks.speed_readings import mend_rotor_speeds
from maidenflight.flights.log import Flight, flight_of

ROWS, PERIOD = 500, 0.01


def logged() -> Flight:
    time = PERIOD * np.arange(ROWS)
    speed = 1500.0 + 400.0 * np.sin(7 * time)[:, None] * np.array([1.0, -1.0, 0.5, 0.2])
    zeros = np.zeros((ROWS, 3))
    return flight_of(
        "log",
        PERIOD,
        body_rates=zeros,
        command=np.full((ROWS, 4), 0.5),
        zero_order_hold=False,
        accelerometer=zeros,
        rotor_speed=speed,
    )


def damaged(rows: slice, value: float) -> Flight:
    flight = logged()
    speed = np.array(flight.rotor_speed)
    speed[rows, 2] = value
    return dataclasses.replace(flight, rotor_speed=speed)


@pytest.mark.parametrize("value", [60_000.0, 0.0, np.nan, -5000.0])
def test_a_wrong_reading_is_interpolated(value: float) -> None:
    flight = damaged(slice(100, 102), value)
    mended, notes = mend_rotor_speeds(flight)
    assert mended.rotor_speed is not None
    assert_allclose(mended.rotor_speed, np.asarray(logged().rotor_speed), atol=3.0)
    assert len(notes) == 1
    assert "2 rows" in notes[0]
    assert "row 101" in notes[0]


def test_a_long_gap_stays() -> None:
    mended, _ = mend_rotor_speeds(damaged(slice(100, 150), np.nan))
    assert mended.rotor_speed is not None
    assert np.isnan(mended.rotor_speed[100:150, 2]).all()
    assert np.isfinite(np.delete(mended.rotor_speed, np.arange(100, 150), axis=0)).all()


def test_sound_readings_and_steps_are_left_alone() -> None:
    flight = logged()
    speed = np.array(flight.rotor_speed)
    speed[250:] *= 0.3
    step = dataclasses.replace(flight, rotor_speed=speed)
    mended, notes = mend_rotor_speeds(step)
    assert notes == []
    assert mended.rotor_speed is not None
    assert_array_equal(mended.rotor_speed, speed)
    bare = dataclasses.replace(flight, rotor_speed=None)
    assert mend_rotor_speeds(bare) == (bare, [])
