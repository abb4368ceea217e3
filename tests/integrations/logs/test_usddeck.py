"""Micro-SD logs: written by a writer of our own, and the real ones where they are."""

import struct
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from made_flights import driven
from maidenflight.errors import InputError
from maidenflight.flights import compensation, flight_csv, log
from maidenflight.flights.reading import read_flights
from maidenflight.integrations.logs import usddeck

USD = Path(__file__).parents[4] / "shared" / "data" / "usd"
IMU = Path(__file__).parents[4] / "shared" / "data" / "usd_imu"
STATE = [f"stateEstimate.{name}(f)" for name in ("x", "y", "z", "vx", "vy", "vz")]
ATTITUDE = [f"stateEstimate.q{name}(f)" for name in "xyzw"]
SENSORS = [f"gyro.{name}(f)" for name in "xyz"] + [f"acc.{name}(f)" for name in "xyz"]
MOTORS = [f"pwm.m{motor}_pwm(H)" for motor in "1234"] + ["pm.vbatMV(H)"]
SIGNALS = tuple(log.OPTIONAL)
SPEED = [f"rpm.m{motor}(H)" for motor in "1234"]


def written(
    events: dict[int, tuple[str, list[str]]],
    records: list[tuple[int, int, tuple[float, ...]]],
    version: int = 2,
) -> bytes:
    """A micro-SD log: event types by identifier, and records of identifier, time stamp, values."""
    raw = struct.pack("<BHH", 0xBC, version, len(events))
    for number, (name, variables) in events.items():
        raw += struct.pack("<H", number) + name.encode() + b"\0" + struct.pack("<H", len(variables))
        raw += b"".join(variable.encode() + b"\0" for variable in variables)
    clock = {1: "I", 2: "Q"}[version]
    for number, stamp, values in records:
        letters = "".join(variable[-2] for variable in events[number][1])
        numbers = [
            value if letter in "fd" else int(value)
            for letter, value in zip(letters, values, strict=True)
        ]
        raw += struct.pack("<H" + clock + letters, number, stamp, *numbers)
    return raw + struct.pack("<I", zlib.crc32(raw))


def hovering(rows: int, step: int = 2000, start: int = 5_000_000, wobble: float = 0.0) -> list:
    """Rows of a hovering drone with a little noise, `step` clock ticks apart.

    Without a state, only a roll rate that wobbles [deg/s] shows that it does not stand.
    """
    generator = np.random.default_rng(0)
    found = []
    for row in range(rows):
        noise = generator.normal(size=6) * 0.2
        state = (0.1 + 1e-5 * row, 0.2 - 1e-5 * row, 1.0, *(0.001 * noise[1:4]))
        rolls = noise[0] + wobble * np.sin(0.03 * row)
        sensors = (rolls, *noise[1:3], *(0.01 * noise[3:5]), 1.0 + 0.01 * noise[5])
        motors = tuple(40000 + 100 * generator.normal(size=4))
        values = (
            *state,
            *(0.001 * noise[:3]),
            1.0,
            *sensors,
            *motors,
            3700,
            *(19000 + motors[0] / 100,) * 4,
        )
        found.append((0xFFFF, start + row * step, values))
    return found


EVENTS = {0xFFFF: ("fixedFrequency", [*STATE, *ATTITUDE, *SENSORS, *MOTORS, *SPEED])}


@pytest.mark.parametrize("version", [1, 2])
def test_records_come_back_with_their_time_in_seconds(version: int) -> None:
    step, unit = (2, 1e-3) if version == 1 else (2000, 1e-6)
    table = usddeck.table(written(EVENTS, hovering(5, step), version), "log00")
    assert_allclose(table.frame["time"].to_numpy(), np.arange(5) * step * unit, atol=1e-12)
    assert_allclose(table.frame["stateEstimate.x"].to_numpy(), 0.1 + 1e-5 * np.arange(5), rtol=1e-6)
    assert table.frame["pm.vbatMV"].to_list() == [3700.0] * 5
    assert table.notes == ()


def test_a_nan_that_signals_is_one_without_a_warning() -> None:
    raw = written({1: ("one", ["gyro.x(f)"])}, [(1, 0, (1.0,)), (1, 2000, (2.0,))])
    raw = raw.replace(struct.pack("<f", 2.0), struct.pack("<I", 0x7FA00000))
    assert np.isnan(usddeck.table(raw, "x").frame["gyro.x"][1])


def test_an_events_values_stand_in_the_first_row_at_or_after_them() -> None:
    events = {7: ("estPose", ["locSrv.x(f)"]), 1: ("main", ["gyro.x(f)"])}
    records = [(1, 1000, (1.0,)), (7, 1500, (0.25,)), (1, 2000, (2.0,)), (1, 3000, (3.0,))]
    frame = usddeck.table(written(events, records), "log00").frame
    assert frame["gyro.x"].to_list() == [1.0, 2.0, 3.0]
    seen = frame["locSrv.x"].to_numpy()
    assert seen[1] == 0.25
    assert np.isnan(seen[[0, 2]]).all()


def test_a_log_cut_off_in_a_record_gives_those_before_it() -> None:
    raw = written(EVENTS, hovering(100))
    size = (len(raw) - 4 - len(written(EVENTS, [])) + 4) // 100
    table = usddeck.table(raw[: -4 - size // 2], "log00")
    assert table.frame.height == 99
    assert len(table.notes) == 1


def test_damage_in_the_middle_is_named_and_what_is_before_it_kept() -> None:
    raw = bytearray(written(EVENTS, hovering(100)))
    middle = len(raw) // 2
    raw[middle : middle + 200] = b"\x55" * 200
    table = usddeck.table(bytes(raw), "log00")
    assert 40 <= table.frame.height < 60
    assert len(table.notes) == 1


def test_a_wrong_checksum_alone_is_named() -> None:
    raw = written(EVENTS, hovering(10))[:-4] + b"\0\0\0\0"
    assert len(usddeck.table(raw, "log00").notes) == 1


@pytest.mark.parametrize("end", [5, 20, 60])
def test_a_damaged_description_is_refused(end: int) -> None:
    with pytest.raises(InputError):
        usddeck.table(written(EVENTS, hovering(5))[:end], "log00")


def test_a_log_without_records_is_refused() -> None:
    with pytest.raises(InputError):
        usddeck.table(written(EVENTS, []), "log00")


def test_flights_of_a_folder_have_accelerometer_and_rotor_speed(tmp_path: Path) -> None:
    (tmp_path / "log00").write_bytes(written(EVENTS, hovering(600)))
    (tmp_path / "README").write_text("not a log")
    flights = read_flights(tmp_path)
    (flight,) = flights
    assert len(flights.paths) == 1
    assert flight.period == pytest.approx(0.002)
    assert flight.zero_order_hold
    assert flight.accelerometer is not None
    assert flight.rotor_speed is not None
    assert flight.accelerometer[:, 2].mean() == pytest.approx(9.81, abs=0.02)
    assert flight.rotor_speed.mean() == pytest.approx(19400 * 2 * np.pi / 60, rel=1e-3)
    assert any(compensation.PLUS in note for note in flights.notes)


def test_lost_rows_are_filled_in_and_a_long_gap_cuts(tmp_path: Path) -> None:
    records = hovering(900)
    kept = [record for row, record in enumerate(records) if row % 50 or row == 0]
    kept = [record for record in kept if not 2000 * 400 <= record[1] - 5_000_000 < 2000 * 420]
    (tmp_path / "log00").write_bytes(written(EVENTS, kept))
    flights = read_flights(tmp_path / "log00")
    assert len(flights) == 2
    assert sum(map(len, flights)) == pytest.approx(880, abs=2)


def test_the_battery_law_can_be_said(tmp_path: Path) -> None:
    (tmp_path / "log00").write_bytes(written(EVENTS, hovering(600)))
    plain = read_flights(tmp_path).flights[0].command.mean()
    legacy = read_flights(tmp_path, battery_law="legacy propellers").flights[0].command.mean()
    assert legacy != pytest.approx(plain, rel=0.01)
    with pytest.raises(InputError):
        read_flights(tmp_path, battery_law="of a toaster")


def test_a_signal_can_be_ignored_as_if_it_had_not_been_logged(tmp_path: Path) -> None:
    (tmp_path / "log00").write_bytes(written(EVENTS, hovering(600)))
    whole, (hidden,) = read_flights(tmp_path).flights[0], read_flights(tmp_path, ignore=SIGNALS)
    assert_allclose(hidden.position, whole.position)
    for signal in SIGNALS:
        (flight,) = read_flights(tmp_path, ignore=[signal])
        kept = [other for other in SIGNALS if getattr(flight, other) is not None]
        assert kept == [other for other in SIGNALS if other != signal]
        assert getattr(hidden, signal) is None
    with pytest.raises(InputError):
        read_flights(tmp_path, ignore=["position"])


def test_a_log_of_sensors_alone_is_nothing_without_its_accelerometer(tmp_path: Path) -> None:
    sensors = {0xFFFF: ("fixedFrequency", [*SENSORS, *MOTORS])}
    records = [
        (event, time, values[-len(SENSORS) - len(MOTORS) - 4 : -4])
        for event, time, values in hovering(600, wobble=30.0)
    ]
    (tmp_path / "log00").write_bytes(written(sensors, records))
    (flight,) = read_flights(tmp_path)
    assert not flight.has_state
    with pytest.raises(InputError):
        read_flights(tmp_path, ignore=["accelerometer"])


def test_a_motor_voltage_as_low_as_a_brushless_ones_is_taken_for_one() -> None:
    volts = np.full(100, 3.7)
    low, high = np.full((100, 4), 27000.0), np.full((100, 4), 47000.0)
    assert compensation.assumed(low, volts) == compensation.BRUSHLESS
    assert compensation.assumed(high, volts) == compensation.PLUS
    assert compensation.assumed(high, np.full(100, np.nan)) == compensation.UNKNOWN


def of_2019(variables: list[str], rows: Sequence[tuple[float, ...]], each: int = 25) -> bytes:
    """A log of 2019's format, whose checksums are complements of zlib's."""
    raw = bytes([len(variables)]) + "".join(f"{one}," for one in variables).encode()
    letters = "<" + "".join(one[-2] for one in variables)
    raw += struct.pack("<I", zlib.crc32(raw) ^ 0xFFFFFFFF)
    for start in range(0, len(rows), each):
        part = rows[start : start + each]
        packed = bytes([len(part)]) + b"".join(struct.pack(letters, *row) for row in part)
        raw += packed + struct.pack("<I", zlib.crc32(packed) ^ 0xFFFFFFFF)
    return raw


def flight_of_2019(flight: log.Flight) -> bytes:
    """A flight in 2019's format."""
    motors = np.round(65535 * np.sqrt(flight.command)).astype(int)
    names = [f"stateEstimateZ.{one}(h)" for one in ("x", "y", "z", "vx", "vy", "vz")]
    names += [f"stateEstimate.{one}(f)" for one in ("roll", "pitch", "yaw")]
    names += [f"stateEstimateZ.rate{one}(h)" for one in ("Roll", "Pitch", "Yaw")]
    names += [f"pwm.m{motor}_pwm(I)" for motor in range(1, 5)]
    rows = [
        (
            10_000 * row,
            *(round(1e3 * float(value)) for value in flight.position[row]),
            *(round(1e3 * float(value)) for value in flight.velocity[row]),
            *(np.degrees(flight.attitude[row]) * [1, -1, 1]).tolist(),
            *(round(1e3 * float(value)) for value in flight.body_rates[row]),
            *motors[row].tolist(),
            3700,
        )
        for row in range(len(flight))
    ]
    return of_2019(["tick(I)", *names, "pm.vbatMV(H)"], rows)


def test_a_log_of_2019_is_read_and_one_without_motors_says_what_it_lacks(tmp_path: Path) -> None:
    flight = driven(300)
    raw = flight_of_2019(flight)
    (tmp_path / "log00").write_bytes(raw)
    (found,) = read_flights(tmp_path)
    assert found.period == pytest.approx(0.01)
    assert_allclose(found.body_rates, flight.body_rates, atol=1e-3)
    assert_allclose(found.attitude, flight.attitude, atol=1e-5)
    (tmp_path / "log00").write_bytes(raw[: len(raw) // 2])
    assert any("cut off at byte" in note for note in read_flights(tmp_path).notes)
    (tmp_path / "log00").write_bytes(of_2019(["tick(I)", "stateEstimateZ.x(h)"], [(0, 1), (9, 2)]))
    with pytest.raises(InputError, match=r"not a flight log|2019's format, missing|unknown format"):
        read_flights(tmp_path / "log00")


def test_a_log_of_sensors_alone_is_read(tmp_path: Path) -> None:
    variables = [*SENSORS, *(f"motor.m{motor}(I)" for motor in "1234")]
    records = [
        (0xFFFF, stamp, values[10:20]) for _, stamp, values in hovering(600, 1000, wobble=30.0)
    ]
    (tmp_path / "log00").write_bytes(written({0xFFFF: ("fixedFrequency", variables)}, records))
    (flight,) = read_flights(tmp_path)
    assert not flight.has_state
    assert flight.accelerometer is not None
    assert_allclose(flight.command, (40000 / 65535) ** 2, rtol=0.05)


def test_what_was_logged_beside_survives_our_own_format(tmp_path: Path) -> None:
    (tmp_path / "log00").write_bytes(written(EVENTS, hovering(600)))
    (flight,) = read_flights(tmp_path)
    assert flight.accelerometer is not None
    assert flight.rotor_speed is not None
    again = flight_csv.from_csv(flight_csv.to_csv(flight), "again")
    assert again.accelerometer is not None
    assert again.rotor_speed is not None
    assert_allclose(again.accelerometer, flight.accelerometer, atol=1e-5)
    assert_allclose(again.rotor_speed, flight.rotor_speed, rtol=1e-6)
    assert again.part(10, 20).arrays["accelerometer"].shape == (10, 3)


@pytest.mark.skipif(not USD.exists(), reason="no logs of measured drones here")
def test_the_measured_drones_logs_are_read() -> None:
    flights = read_flights(USD / "brushed" / "jana02")
    assert flights.duration == pytest.approx(7.6, abs=0.2)
    assert all(flight.rotor_speed is not None for flight in flights)
    speed = np.concatenate(
        [flight.rotor_speed for flight in flights if flight.rotor_speed is not None]
    )
    assert speed.mean() * 60 / (2 * np.pi) == pytest.approx(19860, rel=0.01)


@pytest.mark.skipif(not IMU.exists(), reason="no logs of sensors alone here")
def test_logs_of_sensors_alone_rest_at_one_g() -> None:
    flights = read_flights(IMU / "log10")
    assert flights.flights[0].period == pytest.approx(0.00099, rel=1e-3)
    assert not flights.flights[0].has_state
