"""Logs by the firmware's variables: every spelling means the same flight, and what is missing is
named."""

import numpy as np
import polars
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from made_flights import driven
from maidenflight.errors import InputError
from maidenflight.flights import compensation, tables
from maidenflight.flights.reading import read_flights
from maidenflight.integrations.logs import cflib
from maidenflight.simulator.physics.battery import LARGEST_COMMAND

ROWS = 600
DEGREE = np.pi / 180


def columns(law=compensation.PLUS, rows=ROWS):
    """Every variable that is known of one flight, from the firmware's definition."""
    flight = driven(rows)
    volts = np.linspace(4.0, 3.9, rows)
    ratios = np.linspace(0.1, 1.0, 4000)
    middle = np.full(4000, 3.95)
    commands = compensation.thrust_command((65535 * ratios)[:, None], middle, law)[:, 0]
    ratio = np.stack([np.interp(command, commands, ratios) for command in flight.command.T], axis=1)
    ratio = ratio if law == compensation.NONE else ratio * 3.95 / volts[:, None]
    quaternion = Rotation.from_euler("ZYX", flight.attitude[:, ::-1]).as_quat()
    motors, degrees = np.round(65535 * ratio), flight.attitude * [1, -1, 1] / DEGREE
    angles, short = ("roll", "pitch", "yaw"), ("rateRoll", "ratePitch", "rateYaw")
    target, milli = np.tile([0.0, 0.0, 1.0], (rows, 1)), 1000 * np.array([1, -1, 1])
    groups = (
        ("stateEstimate.{}", "xyz", flight.position),
        ("stateEstimate.v{}", "xyz", flight.velocity),
        ("stateEstimateZ.{}", "xyz", np.round(1000 * flight.position)),
        ("stateEstimateZ.v{}", "xyz", np.round(1000 * flight.velocity)),
        ("stateEstimate.{}", angles, degrees),
        ("stabilizer.{}", angles, degrees),
        ("stateEstimate.q{}", "xyzw", quaternion),
        ("gyro.{}", "xyz", flight.body_rates / DEGREE),
        ("stateEstimateZ.{}", short, milli * flight.body_rates),
        ("motor.m{}", "1234", motors),
        ("pwm.m{}_pwm", "1234", motors),
        ("ctrltarget.{}", "xyz", target),
    )
    return {
        "timestamp": 5000 + 10 * np.arange(rows),
        **{
            pattern.format(name): column
            for pattern, names, values in groups
            for name, column in zip(names, values.T, strict=True)
        },
        "stateEstimateZ.quat": np.array([compress(value) for value in quaternion]),
        "pm.vbat": volts,
        "pm.vbatMV": np.round(1000 * volts),
        "controller.cmd_thrust": 65535 * flight.command.mean(axis=1),
    }


def compress(quaternion):
    """The firmware's quatcompress: two bits for the largest component, sign and nine bits for each
    other."""
    largest = int(np.abs(quaternion).argmax())
    negative = quaternion[largest] < 0
    code = largest
    for number, value in enumerate(quaternion):
        if number != largest:
            code = (
                (code << 10)
                | (int((value < 0) ^ negative) << 9)
                | int(511 * abs(value) / np.sqrt(0.5) + 0.5)
            )
    return code


COMMON = ("timestamp", "pm.vbat", *(f"motor.m{motor}" for motor in (1, 2, 3, 4)))
STATE = tuple(f"stateEstimate.{name}" for name in ("x", "y", "z", "vx", "vy", "vz"))
GYRO = ("gyro.x", "gyro.y", "gyro.z")
EULER = tuple(f"stateEstimate.{name}" for name in ("roll", "pitch", "yaw"))
SHORT = tuple(
    f"stateEstimateZ.{name}"
    for name in ("x", "y", "z", "vx", "vy", "vz", "quat", "rateRoll", "ratePitch", "rateYaw")
)
SETS = {
    "degrees": (*COMMON, *STATE, *EULER, *GYRO),
    "quaternion": (*COMMON, *STATE, *(f"stateEstimate.q{axis}" for axis in "xyzw"), *GYRO),
    "stabilizer": (*COMMON, *STATE, "stabilizer.roll", "stabilizer.pitch", "stabilizer.yaw", *GYRO),
    "compressed": (*COMMON, *SHORT),
    "millivolts": (
        *COMMON[:1],
        "pm.vbatMV",
        *(f"pwm.m{motor}_pwm" for motor in (1, 2, 3, 4)),
        *STATE,
        *EULER,
        *GYRO,
    ),
}


FRAME = polars.DataFrame(columns()).select(SETS["degrees"])


def one(frame):
    table = tables.from_text(frame.write_csv(), "made")
    assert cflib.recognises(table)
    ((flight, time),), notes = cflib.flights(table)
    return flight, time, notes


@pytest.mark.parametrize("name", SETS)
def test_every_spelling_is_the_same_flight(name):
    flight, time, notes = one(polars.DataFrame(columns()).select(SETS[name]))
    made = driven(ROWS)
    np.testing.assert_allclose(time, 0.01 * np.arange(ROWS), atol=1e-9)
    tolerances = {
        "position": 6e-4,
        "velocity": 6e-4,
        "attitude": 4e-3,
        "body_rates": 1e-5,
        "command": 2e-3,
    }
    for group, tolerance in tolerances.items():
        np.testing.assert_allclose(
            getattr(flight, group), getattr(made, group), atol=tolerance, err_msg=group
        )
    assert (flight.period, flight.zero_order_hold, flight.simulated) == (0.01, False, "")
    assert np.isnan(flight.setpoint).all()
    assert "assumed" in notes[0]


@pytest.mark.parametrize("law", [compensation.PLUS, "legacy propellers", compensation.NONE])
def test_the_logged_thrust_tells_the_compensation(law):
    wanted = [
        *SETS["degrees"],
        "controller.cmd_thrust",
        "ctrltarget.x",
        "ctrltarget.y",
        "ctrltarget.z",
    ]
    flight, _, notes = one(polars.DataFrame(columns(law)).select(wanted))
    assert notes == [f"made: battery compensation of the {law} ({compensation.BY_THRUST})"]
    np.testing.assert_allclose(flight.command, driven(ROWS).command, atol=3e-3)
    np.testing.assert_array_equal(flight.setpoint[0], [0, 0, 1])


def test_time_may_be_in_seconds_and_called_otherwise():
    for name in ("Timestamp", "t", "time"):
        renamed = FRAME.with_columns(polars.col("timestamp") / 1000).rename({"timestamp": name})
        flight, time, _ = one(renamed)
        assert flight.period == 0.01
        assert time[-1] == pytest.approx(0.01 * (ROWS - 1))


def test_stamps_that_jitter_by_a_millisecond_are_steady(tmp_path):
    jitter = np.random.default_rng(0).integers(-1, 2, ROWS)
    FRAME.with_columns(timestamp=polars.col("timestamp") + jitter).write_csv(tmp_path / "log.csv")
    read = read_flights(tmp_path)
    assert [(len(flight), flight.period) for flight in read] == [(ROWS, 0.01)]


def test_blocks_stamped_alike_are_laid_together_and_a_rare_battery_is_held():
    estimate = FRAME.select("timestamp", *STATE, *EULER)
    motors = FRAME.select("timestamp", *GYRO, *COMMON[2:])
    power = FRAME.select("timestamp", "pm.vbat")[::50]
    apart = polars.concat([estimate, motors, power], how="diagonal").sort(
        "timestamp", maintain_order=True
    )
    flight = one(apart)[0]
    whole = one(FRAME)[0]
    assert len(flight) == ROWS
    np.testing.assert_allclose(flight.body_rates, whole.body_rates, atol=1e-6)
    np.testing.assert_allclose(flight.position, whole.position, atol=1e-6)
    np.testing.assert_allclose(flight.battery, whole.battery, atol=0.01)


def test_blocks_stamped_apart_are_refused():
    estimate, rest = (
        FRAME.select("timestamp", *STATE, *EULER),
        FRAME.select("timestamp", *GYRO, *COMMON[1:]),
    )
    apart = polars.concat(
        [estimate, rest.with_columns(polars.col("timestamp") + 3)], how="diagonal"
    ).sort("timestamp")
    with pytest.raises(InputError, match=r"only 0 of 1200 rows hold all signals.*by their time"):
        one(apart)


@pytest.mark.parametrize(
    ("gone", "words"),
    [
        ("timestamp", "missing the column of time; expected timestamp, time, t"),
        ("gyro.y", r"missing body_rates \(gyro.x, gyro.y, gyro.z or stateEstimateZ.rateRoll"),
        ("motor.m3", r"missing PWM \(motor.m1"),
        ("pm.vbat", r"missing battery \(pm.vbat or pm.vbatMV\)"),
        ("stateEstimate.vz", r"missing velocity \(stateEstimate.vx"),
        (
            "stateEstimate.yaw",
            r"missing attitude \(stateEstimate.qx.*stateEstimateZ.quat.*stabilizer.roll",
        ),
    ],
)
def test_what_is_missing_is_named_with_what_would_do(gone, words):
    with pytest.raises(InputError, match=words):
        one(FRAME.drop(gone))


def test_the_legacy_pitch_is_not_forgotten(tmp_path):
    """A log whose owner has turned the pitch already contradicts the gyro."""
    FRAME.with_columns(-polars.col("stateEstimate.pitch")).write_csv(tmp_path / "turned.csv")
    with pytest.raises(InputError, match="y with the opposite sign"):
        read_flights(tmp_path / "turned.csv")
    FRAME.write_csv(tmp_path / "as_logged.csv")
    assert len(read_flights(tmp_path / "as_logged.csv")) == 1


@given(arrays(float, 4, elements=st.floats(-1, 1)).filter(lambda q: np.linalg.norm(q) > 0.1))
def test_a_compressed_quaternion_is_read_to_a_sixth_of_a_degree(quaternion):
    quaternion = quaternion / np.linalg.norm(quaternion)
    attitude = cflib._compressed(np.array([[float(compress(quaternion))]]))[0]
    again = Rotation.from_euler("ZYX", attitude[::-1])
    assert (again.inv() * Rotation.from_quat(quaternion)).magnitude() < 0.006


@pytest.mark.parametrize("law", compensation.LAWS)
def test_the_command_rises_with_the_pwm_from_nothing(law):
    pwm = np.linspace(0, 65535, 200)[:, None]
    command = compensation.thrust_command(pwm, np.full(200, 3.9), law)[:, 0]
    assert command[0] == 0
    assert (np.diff(command) >= 0).all()
    assert 0.5 < command[-1] < LARGEST_COMMAND


def test_a_battery_law_in_a_comment_is_known_or_refused(tmp_path):
    for law in ("legacy propellers", "legacy propeler"):
        (tmp_path / f"{law}.csv").write_text(f"# battery law: {law}\n{FRAME.write_csv()}")
    assert "legacy propellers" in read_flights(tmp_path / "legacy propellers.csv").notes[0]
    with pytest.raises(InputError, match=r"legacy propeler\.csv: .*'legacy propeler'"):
        read_flights(tmp_path / "legacy propeler.csv")


def test_what_a_command_stands_for_is_a_guess_that_is_told_or_what_one_is_told(tmp_path):
    FRAME.write_csv(tmp_path / "one.csv")
    guessed, told = read_flights(tmp_path), read_flights(tmp_path, commands="zero-order-hold")
    assert [(flight.zero_order_hold, flight.assumed) for flight in guessed] == [(False, True)]
    assert any(
        "commands taken as subsampled from the firmware's PID" in note for note in guessed.notes
    )
    assert [(flight.zero_order_hold, flight.assumed) for flight in told] == [(True, False)]
    assert not any("taken as samples" in note for note in told.notes)
    assert guessed.flights[0].full_scale_counts == 65535.0
    with pytest.raises(InputError, match="commands 'kept'; expected zero-order-hold or subsampled"):
        read_flights(tmp_path, commands="kept")


def test_rates_in_the_wrong_unit_are_named(tmp_path):
    table = columns()
    wrong = table | {f"gyro.{axis}": table[f"gyro.{axis}"] * DEGREE for axis in "xyz"}
    polars.DataFrame(wrong).select(SETS["degrees"]).write_csv(tmp_path / "one.csv")
    with pytest.raises(InputError, match="looks like rad where the format has deg"):
        read_flights(tmp_path / "one.csv")
