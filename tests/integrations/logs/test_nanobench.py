"""NanoBench's columns: signals keep their meaning, the motion capture is moved onto the drone's
clock, and the real files bear it out."""

import gzip

import numpy as np
import polars
import pytest

from made_flights import driven
from maidenflight.errors import InputError
from maidenflight.flights import compensation, tables
from maidenflight.flights.reading import read_flights
from maidenflight.integrations.logs import nanobench

ROWS = 1500


def text(late=0, rows=ROWS, **changes):
    """A file whose motion capture is `late` rows behind the drone's streams, from its
    definition."""
    flight = driven(rows)
    seen = np.clip(np.arange(rows) - late, 0, rows - 1)
    volts = np.linspace(4.0, 3.8, rows)
    ratio = np.stack([np.interp(command, *_table()) for command in flight.command.T], axis=1)
    columns = {
        "t": 1.7e9 + 0.01 * np.arange(rows),
        **{name: flight.position[seen, axis] for axis, name in enumerate(("px", "py", "pz"))},
        **{name: flight.velocity[seen, axis] for axis, name in enumerate(("vx", "vy", "vz"))},
        **{name: flight.attitude[seen, axis] for axis, name in enumerate(("roll", "pitch", "yaw"))},
        **{name: flight.body_rates[:, axis] for axis, name in enumerate(nanobench.GYRO)},
        **{name: 65535 * ratio[:, motor] / volts for motor, name in enumerate(nanobench.MOTORS)},
        **dict.fromkeys(nanobench.SETPOINT, np.ones(rows)),
        "pwr_pm_vbat": volts,
        "pid_controller_cmd_thrust": 65535 * flight.command.mean(axis=1),
        "something_else": np.zeros(rows),
        **changes,
    }
    return polars.DataFrame(columns).write_csv()


def _table():
    """Commands and the motor voltages that give them."""
    volts = np.linspace(0.5, 3.3, 2000)
    return compensation.thrust_command(np.full((2000, 1), 65535.0), volts)[:, 0], volts


def one(content):
    table = tables.from_text(content, "made")
    assert nanobench.FORMAT.recognises(table)
    ((flight, time),), notes = nanobench.flights(table)
    return flight, time, notes


def test_columns_keep_their_meaning():
    flight, time, notes = one(text())
    made = driven(ROWS)
    np.testing.assert_allclose(time, 0.01 * np.arange(ROWS), atol=1e-5)
    np.testing.assert_allclose(flight.command, made.command, atol=2e-3)
    np.testing.assert_array_equal(flight.body_rates, made.body_rates)
    for group, tolerance in (("position", 0.002), ("velocity", 0.01), ("attitude", 0.005)):
        np.testing.assert_allclose(getattr(flight, group), getattr(made, group), atol=tolerance)
    assert notes == [
        f"made: battery compensation of the 2.1+ propellers ({compensation.BY_THRUST})"
    ]
    assert (flight.zero_order_hold, flight.simulated, flight.period) == (False, "", 0.01)


def test_a_law_that_is_said_comes_before_the_one_that_the_thrust_shows():
    plain, (flight, _, notes) = one(text())[0], one(f"# battery law: thrust upgrade\n{text()}")
    assert abs(flight.command.mean() - plain.command.mean()) > 0.01
    assert notes == [f"made: battery compensation of the thrust upgrade ({compensation.AS_LOGGED})"]


@pytest.mark.parametrize("late", [-7, 0, 12])
def test_a_late_motion_capture_is_moved_to_the_drones_clock(late):
    flight = one(text(late))[0]
    made, inner = driven(ROWS), slice(100, -100)
    np.testing.assert_allclose(flight.attitude[inner], made.attitude[inner], atol=0.01)
    np.testing.assert_allclose(flight.position[inner], made.position[inner], atol=0.005)


def test_a_clock_that_wanders_is_followed():
    """Noise whose one copy runs up to eight rows ahead and back."""
    rows = np.arange(3000)
    rates = np.random.default_rng(0).normal(size=(3000, 3)).cumsum(axis=0)
    rates = np.stack(
        [
            np.convolve(
                column - np.convolve(column, np.ones(80) / 80, "same"), np.ones(9) / 9, "same"
            )
            for column in rates.T
        ],
        axis=1,
    )
    attitude = 0.01 * rates.cumsum(axis=0) * 0.02
    truth = 8 * np.sin(2 * np.pi * rows / 1500)
    seen = np.stack([np.interp(rows + truth, rows, column) for column in attitude.T], axis=1)
    found = nanobench.lag(0.02 * rates, seen)
    assert np.abs(found - truth)[100:-100].max() < 2
    assert np.median(np.abs(found - truth)) < 0.6


def test_a_count_that_no_motor_has_is_not_a_command():
    pwm = np.full(ROWS, 40000.0)
    pwm[700:710] = 1e6
    flight = one(text(motor_motor_m2=pwm))[0]
    np.testing.assert_array_equal(
        np.flatnonzero(np.isnan(flight.command).any(axis=1)), np.arange(700, 710)
    )


def test_a_missing_column_is_named():
    with pytest.raises(InputError, match="missing column imu_gyro_y;"):
        nanobench.flights(tables.from_text(text().replace("imu_gyro_y", "other"), "made"))


def test_a_file_is_recognised_and_checked(tmp_path):
    (tmp_path / "flight.csv.gz").write_bytes(gzip.compress(text().encode()))
    read = read_flights(tmp_path)
    assert [len(flight) for flight in read] == [ROWS]
    assert len(read.notes) == 1


FILES = ("B2_circle_fast_rep2", "B3_figure8_slow_rep3", "B7_oval_medium_rep3", "B7_oval_slow_rep1")


@pytest.fixture(scope="module")
def real(shared_data):
    """Four of the 26: the legacy law, a late Vicon, a wandering one, and one that stays on the
    ground."""
    folder = shared_data / "nanobench"
    if not folder.is_dir():
        pytest.skip(f"NanoBench is not at {folder}")
    return {name: tables.read(folder / f"{name}.csv.gz", name) for name in FILES}


@pytest.mark.slow
def test_real_logs_tell_their_battery_compensation(real):
    notes = {name: nanobench.flights(table)[1][0] for name, table in real.items()}
    assert f"legacy propellers ({compensation.BY_THRUST})" in notes[FILES[0]]
    plus = f"{compensation.PLUS} ({compensation.BY_THRUST})"
    assert all(plus in notes[name] for name in FILES[1:3])
    assert compensation.BY_VOLTAGE in notes[FILES[3]]


def test_a_real_wandering_clock_is_followed(real):
    """The correlation of the gyro's roll rate with that of the motion capture, before and after."""
    for name, before, after in ((FILES[1], 0.80, 0.80), (FILES[2], 0.60, 0.80)):
        ((flight, _),), _ = nanobench.flights(real[name])
        column = tables.numbers(real[name], ["roll"])
        flown = flight.position[:, 2] > 0.5
        gyro = np.convolve(flight.body_rates[:, 0], np.ones(7) / 7, "same")[flown]
        moved, raw = (
            np.convolve(np.gradient(roll), np.ones(7) / 7, "same")[flown]
            for roll in (flight.attitude[:, 0], column["roll"])
        )
        assert np.corrcoef(gyro, raw)[0, 1] < before
        assert np.corrcoef(gyro, moved)[0, 1] > after


@pytest.mark.slow
def test_real_flights_are_used_from_take_off_to_landing(real, shared_data):
    for name, seconds in ((FILES[0], 30), (FILES[1], 30), (FILES[2], 30)):
        assert read_flights(shared_data / "nanobench" / f"{name}.csv.gz").duration > seconds
    with pytest.raises(InputError, match=r"B7_oval_slow_rep1.*below 0\.1 m"):
        read_flights(shared_data / "nanobench" / f"{FILES[3]}.csv.gz")
