"""ArduPilot logs: written by a writer of our own and read back through pymavlink."""

from pathlib import Path
from typing import Any

import made_dataflash as made
import pytest
from numpy.testing import assert_allclose

from made_flights import sensed
from maidenflight.errors import InputError
from maidenflight.flights.reading import Flights, read_flights

pytest.importorskip("pymavlink")


def read(folder: Path, messages: Any, **parameters: float) -> Flights:
    path = folder / "00000001.BIN"
    path.write_bytes(made.dataflash(messages, made.PARAMETERS | parameters))
    return read_flights(path)


@pytest.mark.parametrize("form", made.PLACES)
@pytest.mark.parametrize("rare", [1, 10])
def test_a_flight_comes_back(form: int, rare: int, tmp_path: Path) -> None:
    flight = sensed()
    (read_back,) = read(tmp_path, made.messages_of(flight, form, rare), FRAME_TYPE=form)
    assert not read_back.has_state
    assert read_back.period == pytest.approx(0.01)
    assert read_back.zero_order_hold
    for group in ("body_rates", "accelerometer", "battery"):
        wanted = getattr(flight, group)[:-1]
        assert_allclose(getattr(read_back, group), wanted, atol=1e-4, err_msg=group)
    # Of PWM in whole microseconds, 0.8 of which are the whole throttle; what holds until the next
    # row is not known of the last.
    assert_allclose(read_back.command, flight.command[:-1], atol=2e-3)
    assert_allclose(read_back.arrays["rotor_speed"], flight.arrays["rotor_speed"][:-1], atol=0.1)


def test_a_factor_of_thin_air_follows_from_the_logged_motors(tmp_path: Path) -> None:
    flight = sensed()
    logs = read(tmp_path, made.messages_of(flight, gain=1.2))
    assert_allclose(logs.flights[0].command, flight.command[:-1], atol=2e-3)
    assert any("factor of 1.2" in note for note in logs.notes)


def test_rotors_that_turn_the_other_way_are_a_note_and_yaw_is_mixed_so(tmp_path: Path) -> None:
    """H numbers as X does, and its rotors turn the other way."""
    flight = sensed()
    (rates_, *others), form = made.messages_of(flight), {"FRAME_TYPE": 3.0}
    name, fields, letters, rows = rates_
    turned = [(*row[:9], -row[9], *row[10:]) for row in rows]
    logs = read(tmp_path, [(name, fields, letters, turned), *others], **form)
    assert_allclose(logs.flights[0].command, flight.command[:-1], atol=2e-3)
    assert any("FRAME_TYPE 3" in note and "yaw" in note for note in logs.notes)


def test_channels_follow_their_functions_and_dshot_its_bounds(tmp_path: Path) -> None:
    flight = sensed()
    *others, (name, fields, letters, rows), battery, _ = made.messages_of(flight, rare=1)
    moved = [(row[0], *row[5:9], *row[1:5], *row[9:]) for row in rows]
    functions = {f"SERVO{number}_FUNCTION": 28.0 + number for number in range(5, 9)}
    bounds = {"MOT_PWM_TYPE": 5.0, "MOT_PWM_MIN": 1100.0}
    messages = [*others, (name, fields, letters, moved), battery]
    (read_back,) = read(tmp_path, messages, **functions, **bounds)
    assert_allclose(read_back.command, flight.command[:-1], atol=2e-3)


def test_outputs_that_an_io_processor_reads_back_are_those_of_before(tmp_path: Path) -> None:
    """Every 50 ms all four are read, and stay in RCOU until then."""
    flight = sensed()
    *others, (name, fields, letters, rows), battery, speeds = made.messages_of(flight, rare=1)
    read_back = [(row[0], *rows[5 * (number // 5)][1:]) for number, row in enumerate(rows)]
    kept = (name, fields, letters, read_back[3::10])
    logs = read(tmp_path, [*others, kept, battery, speeds])
    assert_allclose(logs.flights[0].command, flight.command[:-1], atol=2e-2)
    assert any("by an IO processor" in note for note in logs.notes)
    other = [(row[0], *row[2:5], row[1], *row[5:]) for row in read_back[3::10]]
    with pytest.raises(InputError, match="another mixer, frame or order"):
        read(tmp_path, [*others, (name, fields, letters, other), battery])


def test_firmware_of_before_3_5_says_its_frame_and_channels_otherwise(tmp_path: Path) -> None:
    flight = sensed()
    messages = [
        (name, fields.replace(",C", ",Ch"), letters, rows)
        if name == "RCOU"
        else (name, fields, letters, rows)
        for name, fields, letters, rows in made.messages_of(flight)
    ]
    older = {key: value for key, value in made.PARAMETERS.items() if "FRAME" not in key}
    path = tmp_path / "3.BIN"
    path.write_bytes(made.dataflash(messages, older | {"FRAME": 1.0}))
    (read_back,) = read_flights(path)
    assert_allclose(read_back.command, flight.command[:-1], atol=2e-3)


def before_3_4(messages: Any) -> Any:
    """Rates in hundredths of a degree, outputs up to 4500 and 1000, centivolts of CURR."""
    (_, fields, letters, rows), (*imu, senses), motors, (*_, volts), *_ = messages
    unit = [1, *(1, 100, 4500) * 3, 1, 1, 1000]
    rates = [tuple(value * by for value, by in zip(row, unit, strict=True)) for row in rows]
    battery = [(row[0], 500, round(100 * row[2]), 900) for row in volts]
    return [
        ("RATE", fields, letters, rates),
        (*imu, [row for row in senses if row[1] == 0][::2]),
        motors,
        ("CURR", "TimeUS,Throttle,Volt,Curr", "Qhhh", battery),
    ]


def test_rates_battery_and_pwm_of_before_3_4_have_other_units(tmp_path: Path) -> None:
    """As ArduCopter 3.3 logs them, but for motors that it logs at 10 Hz."""
    flight = sensed()
    older = {key: one for key, one in made.PARAMETERS.items() if key[:8] not in OLD_HAS_NOT}
    # 1000 us + 150 us, of which 800 of 850 us are the whole throttle.
    older |= {"FRAME": 1.0, "RC3_MIN": 1000.0, "RC3_MAX": 2000.0, "THR_MIN": 150.0}
    path = tmp_path / "3.BIN"
    messages = before_3_4(made.messages_of(flight, rare=1))
    path.write_bytes(made.dataflash(messages, older | {"MOT_THST_MAX": 800 / 850}))
    (read_back,) = read_flights(path)
    assert_allclose(read_back.body_rates, flight.body_rates[: len(read_back)], atol=1e-4)
    assert_allclose(read_back.command, flight.command[: len(read_back)], atol=2e-3)
    assert_allclose(read_back.battery, flight.battery[: len(read_back)], atol=1e-5)
    path.write_bytes(made.dataflash(before_3_4(made.messages_of(flight)), older))
    with pytest.raises(InputError, match=r"ArduCopter before 3\.4.* 10 Hz"):
        read_flights(path)


OLD_HAS_NOT = ("FRAME_CL", "FRAME_TY", "MOT_SPIN", "MOT_PWM_")


def test_a_lost_start_and_zeros_cost_a_note(tmp_path: Path, capfd: Any) -> None:
    raw = made.dataflash(made.messages_of(sensed()), made.PARAMETERS)
    path = tmp_path / "1.BIN"
    middle = len(raw) // 2
    path.write_bytes(raw[37:middle] + bytes(700) + raw[middle:])
    logs = read_flights(path)
    assert len(logs.flights[0]) > 200
    assert sum("damaged" in note for note in logs.notes) == 1
    assert capfd.readouterr().err == ""


def test_filters_delay(tmp_path: Path) -> None:
    filters = {"INS_GYRO_FILTER": 40.0, "INS_ACCEL_FILTER": 20.0}
    (read_back,) = read(tmp_path, made.messages_of(sensed()), **filters)
    # Of a Butterworth filter of second order: sqrt(2) / (2 pi cutoff).
    assert read_back.gyro_delay == pytest.approx(0.005627, rel=1e-3)
    assert read_back.accelerometer_delay == pytest.approx(0.011254, rel=1e-3)


def test_rows_on_the_ground_are_left_out(tmp_path: Path) -> None:
    flight = sensed()
    events = [(5_000_000, 10), (5_500_000, 28), (10_000_000, 18), (10_500_000, 11)]
    messages = [*made.messages_of(flight), ("EV", "TimeUS,Id", "QB", events)]
    (read_back,) = read(tmp_path, messages)
    # 1 s after 0.5 s, and 1.5 s before 5 s.
    assert len(read_back) == pytest.approx(200, abs=3)
    assert_allclose(read_back.body_rates[0], flight.body_rates[149], atol=1e-4)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"FRAME_CLASS": 2.0}, "FRAME_CLASS 2"),
        ({"FRAME_TYPE": 0.0}, "FRAME_TYPE 0"),
        ({"MOT_SPIN_MAX": 0.16}, "explain"),
        ({"MOT_SPIN_MIN": 0.15, "MOT_SPIN_MAX": 0.15}, "MOT_SPIN_MIN 0.15 is not below"),
    ],
)
def test_another_airframe_and_other_motors_are_refused(
    changed: dict[str, float], words: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=words):
        read(tmp_path, made.messages_of(sensed()), **changed)


def test_a_log_of_the_default_mask_is_refused_with_what_to_set(tmp_path: Path) -> None:
    messages = [
        (name, fields, letters, rows[::10])
        for name, fields, letters, rows in made.messages_of(sensed(), rare=1)
    ]
    with pytest.raises(InputError, match="LOG_BITMASK"):
        read(tmp_path, messages)


def test_a_damaged_log_is_refused_or_noted(tmp_path: Path) -> None:
    raw = made.dataflash(made.messages_of(sensed()), made.PARAMETERS)
    path = tmp_path / "log.bin"
    path.write_bytes(raw[:20_000] + b"\x00" * 5000 + raw[25_000:])
    assert any("damaged" in note for note in read_flights(path).notes)
    path.write_bytes(raw[:60])
    with pytest.raises(InputError, match=r"log\.bin"):
        read_flights(path)


def test_other_binary_files_of_a_folder_are_no_logs(tmp_path: Path) -> None:
    (tmp_path / "firmware.bin").write_bytes(bytes(300))
    read(tmp_path, made.messages_of(sensed()))
    logs = read_flights(tmp_path)
    assert len(logs) == 1
    assert not logs.refused
