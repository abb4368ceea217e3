"""Tables of others: columns by a map beside the file, and the map that is proposed."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from made_flights import driven
from maidenflight.errors import InputError
from maidenflight.flights import formats, tables
from maidenflight.flights.log import Flight
from maidenflight.flights.maps import column_map, names, proposal
from maidenflight.flights.reading import read_flights

DOWN = np.array([1.0, -1.0, -1.0])
Columns = dict[str, np.ndarray]


def named(names: str, values: np.ndarray) -> Columns:
    return dict(zip(names.split(), np.asarray(values, float).T, strict=True))


def quaternions(flight: Flight) -> np.ndarray:
    return Rotation.from_euler("ZYX", flight.attitude[:, ::-1]).as_quat()


def of_ros(flight: Flight) -> Columns:
    """Forward, left, up in SI units, w of the quaternion first."""
    return {
        "t": np.arange(len(flight)) * flight.period,
        **named("px py pz", flight.position),
        **named("vx vy vz", flight.velocity),
        **named("qw qx qy qz", quaternions(flight)[:, [3, 0, 1, 2]]),
        **named("wx wy wz", flight.body_rates),
        **named("m1 m2 m3 m4", flight.command),
        "vbat": flight.battery,
    }


def of_px4(flight: Flight) -> Columns:
    """Forward, right, down, north, east, down; motors in another order; microseconds."""
    return {
        "timestamp_us": np.arange(len(flight)) * flight.period * 1e6,
        **named("pos_x pos_y pos_z", flight.position * DOWN),
        **named("vel_x vel_y vel_z", flight.velocity * DOWN),
        **named("q[0] q[1] q[2] q[3]", quaternions(flight)[:, [3, 0, 1, 2]] * [1, 1, -1, -1]),
        **named("p q r", flight.body_rates * DOWN),
        **named("motor[0] motor[1] motor[2] motor[3]", flight.command[:, [0, 2, 3, 1]]),
    }


def of_degrees(flight: Flight) -> Columns:
    """Degrees with pitch nose up, milliseconds, PWM, millivolts, and units in the names."""
    return {
        "time_ms": np.arange(len(flight)) * flight.period * 1e3,
        **named("x_m y_m z_m", flight.position),
        **named("vx_mps vy_mps vz_mps", flight.velocity),
        **named("Roll Pitch Yaw", np.degrees(flight.attitude * [1, -1, 1])),
        **named("Gyro X [deg/s],Gyro Y [deg/s],Gyro Z [deg/s]".replace(" ", "_").replace(",", " "),
                np.degrees(flight.body_rates)),
        **named("pwm1 pwm2 pwm3 pwm4", 1000 + 1000 * flight.command),
        "battery_mV": 1000 * flight.battery,
    }  # fmt: skip


def of_imu(flight: Flight) -> Columns:
    """A gyro in degrees, an accelerometer in g and counts, all in the drone's own names."""
    turned = Rotation.from_euler("ZYX", flight.attitude[:, ::-1]).inv()
    return {
        "Time": np.arange(len(flight)) * flight.period,
        **named("imu.gyro.x imu.gyro.y imu.gyro.z", np.degrees(10 * flight.body_rates)),
        **named("imu.acc.x imu.acc.y imu.acc.z", turned.apply([0.0, 0.0, 1.0])),
        **named("cmd_m1 cmd_m2 cmd_m3 cmd_m4", 65535 * flight.command),
    }


def write(path: Path, columns: Columns, comment: str = "") -> Path:
    rows = np.column_stack(list(columns.values()))
    np.savetxt(path, rows, "%.9g", ",", header=",".join(columns), comments=comment)
    return path


@pytest.mark.parametrize("how", [of_ros, of_px4, of_degrees])
def test_a_proposed_map_reads_the_flight(how: Callable[[Flight], Columns], tmp_path: Path) -> None:
    flight = driven()
    path = write(tmp_path / "flight.csv", how(flight))
    with pytest.raises(InputError, match="--map-columns"):
        read_flights(path)
    assert formats.write_map(path) == tmp_path / "flight.columns.toml"
    (found,) = read_flights(path)
    for group in ("position", "velocity", "body_rates"):
        assert_allclose(getattr(found, group), getattr(flight, group), atol=1e-4, err_msg=group)
    assert_allclose(found.attitude[:, :2], flight.attitude[:, :2], atol=1e-4)
    assert_allclose(found.command, flight.command**2, atol=1e-4)  # by the square law
    assert not np.isfinite(found.battery).any() or how is not of_px4
    assert found.assumed


def test_units_of_an_imu_follow_from_its_numbers(tmp_path: Path) -> None:
    table = tables.read(write(tmp_path / "imu.csv", of_imu(driven())), "imu.csv")
    found = proposal.propose(table)
    assert found is not None
    assert found.sources["body_rates"].unit == "deg/s"
    assert found.sources["accelerometer"].unit == "g"
    assert found.motors.high == 65535


def test_what_is_written_is_read_as_it_was(tmp_path: Path) -> None:
    table = tables.read(write(tmp_path / "flight.csv", of_px4(driven())), "flight.csv")
    found = proposal.propose(table)
    assert found is not None
    path = tmp_path / "flight.columns.toml"
    path.write_text(column_map.text(found))
    assert column_map.read(path) == found


@pytest.mark.parametrize("ending", [".csv", ".csv.gz", ".parquet"])
def test_a_map_stands_beside_any_table(ending: str, tmp_path: Path) -> None:
    flight, path = driven(), tmp_path / f"day.1{ending}"
    if ending == ".parquet":
        polars.DataFrame(of_ros(flight)).write_parquet(path)
    else:
        write(path, of_ros(flight), "# ")  # as numpy writes a header
    assert formats.write_map(path) == tmp_path / "day.1.columns.toml"
    (found,) = read_flights(tmp_path)
    assert_allclose(found.body_rates, flight.body_rates, atol=1e-4)
    with pytest.raises(InputError, match="battery law"):
        read_flights(path, battery_law="legacy propellers")


def test_known_formats_get_no_map_and_a_lacking_part_is_open(tmp_path: Path) -> None:
    columns = of_ros(driven())
    lacking = {name: values for name, values in columns.items() if name[0] != "m"}
    written = formats.write_map(write(tmp_path / "a.csv", lacking))
    assert written is not None
    assert "# OPEN" in written.read_text()
    with pytest.raises(InputError, match="motors missing"):
        read_flights(tmp_path / "a.csv")
    (tmp_path / "b.csv").write_text("a;b\n1;2\n")
    assert formats.write_map(tmp_path / "b.csv") is None


FOREIGN = {
    "NeuroBEM": (
        "t;ang acc x;ang acc y;ang acc z;ang vel x;ang vel y;ang vel z;quat x;quat y;quat z;quat w;"
        "acc x;acc y;acc z;vel x;vel y;vel z;pos x;pos y;pos z;mot 1;mot 2;mot 3;mot 4;dmot 1;"
        "dmot 2;dmot 3;dmot 4;vbat",
        {"body_rates": "ang vel x", "attitude": "quat x", "accelerometer": "acc x"}
        | {"velocity": "vel x", "position": "pos x", "motors": "mot 1", "battery": "vbat"},
    ),
    "TII": (
        "elapsed_time;timestamp;accel_x;accel_y;accel_z;gyro_x;gyro_y;gyro_z;thrust[0];thrust[1];"
        "thrust[2];thrust[3];channels_roll;channels_pitch;channels_yaw;vbat;drone_x;drone_y;drone_z;"
        "drone_roll;drone_pitch;drone_yaw;drone_velocity_linear_x;drone_velocity_linear_y;"
        "drone_velocity_linear_z;drone_velocity_angular_x;drone_velocity_angular_y;"
        "drone_velocity_angular_z;drone_rot[0];drone_rot[1];drone_rot[2];drone_rot[3]",
        {"accelerometer": "accel_x", "body_rates": "gyro_x", "motors": "thrust[0]"}
        | {"attitude": "drone_roll", "position": "drone_x", "battery": "vbat"}
        | {"velocity": "drone_velocity_linear_x"},
    ),
    "NanoDrone": (
        "t;x;y;z;qx;qy;qz;qw;yaw;pitch;roll;vx;vy;vz;wx;wy;wz;x_mocap;y_mocap;z_mocap;m1_thrust;"
        "m2_thrust;m3_thrust;m4_thrust;m1_erpm;m2_erpm;m3_erpm;m4_erpm;thrust;ax;ay;az;x_r;y_r;z_r;"
        "qx_r;qy_r;qz_r;qw_r;vx_r;vy_r;vz_r;Vbat",
        {"position": "x", "attitude": "qx", "velocity": "vx", "body_rates": "wx", "battery": "Vbat"}
        | {"motors": "m1_thrust", "rotor_speed": "m1_erpm", "accelerometer": "ax"},
    ),
    "ulog2csv, sensors": (
        "timestamp;gyro_rad[0];gyro_rad[1];gyro_rad[2];gyro_integral_dt;accelerometer_m_s2[0];"
        "accelerometer_m_s2[1];accelerometer_m_s2[2];accelerometer_integral_dt",
        {"body_rates": "gyro_rad[0]", "accelerometer": "accelerometer_m_s2[0]"},
    ),
    "ulog2csv, motors": (
        "timestamp;timestamp_sample;reversible_flags;control[0];control[1];control[2];control[3]",
        {"motors": "control[0]"},
    ),
    "Crazyflie's client": (
        "Timestamp;stateEstimate.x;stateEstimate.y;stateEstimate.z;stabilizer.roll;stabilizer.pitch;"
        "stabilizer.yaw;gyro.x;gyro.y;gyro.z;motor.m1;motor.m2;motor.m3;motor.m4;pm.vbat",
        {"position": "stateEstimate.x", "attitude": "stabilizer.roll", "body_rates": "gyro.x"}
        | {"motors": "motor.m1", "battery": "pm.vbat"},
    ),
    "rostopic echo -p, odometry": (
        "%time;field.header.seq;field.header.stamp;field.pose.pose.position.x;"
        "field.pose.pose.position.y;field.pose.pose.position.z;field.pose.pose.orientation.x;"
        "field.pose.pose.orientation.y;field.pose.pose.orientation.z;field.pose.pose.orientation.w;"
        "field.twist.twist.linear.x;field.twist.twist.linear.y;field.twist.twist.linear.z;"
        "field.twist.twist.angular.x;field.twist.twist.angular.y;field.twist.twist.angular.z",
        {"position": "field.pose.pose.position.x", "attitude": "field.pose.pose.orientation.x"}
        | {"velocity": "field.twist.twist.linear.x", "body_rates": "field.twist.twist.angular.x"},
    ),
    "rostopic echo -p, IMU": (
        "%time;field.header.stamp;field.orientation.x;field.orientation.y;field.orientation.z;"
        "field.orientation.w;field.orientation_covariance0;field.orientation_covariance1;"
        "field.orientation_covariance2;field.orientation_covariance3;field.angular_velocity.x;"
        "field.angular_velocity.y;field.angular_velocity.z;field.linear_acceleration.x;"
        "field.linear_acceleration.y;field.linear_acceleration.z",
        {"attitude": "field.orientation.x", "body_rates": "field.angular_velocity.x"}
        | {"accelerometer": "field.linear_acceleration.x"},
    ),
}


@pytest.mark.parametrize("source", FOREIGN)
def test_names_of_known_data_sets_tell_the_signals(source: str) -> None:
    columns, expected = FOREIGN[source]
    read = names.read_names(columns.split(";"))
    assert {signal: chosen[0] for signal, chosen in read.signals.items()} == expected
    assert read.clock in ("t", "timestamp", "Timestamp", "%time")
    counts = {"battery": {1}, "motors": {4}, "rotor_speed": {4}, "attitude": {3, 4}}
    for signal, chosen in read.signals.items():
        assert len(set(chosen)) in counts.get(signal, {3})


def test_measured_speeds_are_no_commands_and_keep_their_order() -> None:
    """Speeds in rad/s, in NeuroBEM's order: front right, back left, back right, front left."""
    flight = driven()
    speeds = 1300.0 * np.sqrt(flight.command[:, [0, 2, 1, 3]] / 0.6)
    columns = {
        "t": np.arange(len(flight)) * flight.period,
        **named("ang_vel_x ang_vel_y ang_vel_z", flight.body_rates),
        **named("mot_1 mot_2 mot_3 mot_4", speeds),
    }
    table = tables.Table("speeds.csv", polars.DataFrame(columns))
    found = proposal.propose(table)
    assert found is not None
    assert "motors" not in found.sources
    speed = found.sources["rotor_speed"]
    assert (speed.columns, speed.unit) == (("mot_1", "mot_3", "mot_2", "mot_4"), "rad/s")


@pytest.mark.parametrize("power", [0.5, 1.0])
@pytest.mark.parametrize("shown_by", ["force", "force down", "velocity"])
def test_the_force_decides_the_law_of_thrust(shown_by: str, power: float) -> None:
    """Columns called thrust are the square root of it, or thrust itself; the force is late."""
    flight = driven()
    throttle = flight.command * (1 + 0.3 * np.sin(0.02 * np.arange(len(flight))))[:, None]
    late = np.interp(np.arange(len(flight)) - 6, np.arange(len(flight)), throttle.mean(axis=1))
    force = np.zeros((len(flight), 3))
    force[:, 2] = late * 9.81 / late.mean()
    climb = np.cumsum(force - [0, 0, 9.81], axis=0) * flight.period
    motion = {
        "force": named("accel_x accel_y accel_z", force),
        "force down": named("accel_x accel_y accel_z", -force),
        "velocity": named("vel_x vel_y vel_z", climb),
    }[shown_by]
    columns = {
        "timestamp": 1e6 * np.arange(len(flight)) * flight.period,
        **named("gyro_x gyro_y gyro_z", flight.body_rates),
        **motion,
        **named("thrust[0] thrust[1] thrust[2] thrust[3]", throttle**power),
    }
    found = proposal.propose(tables.Table("t.csv", polars.DataFrame(columns)))
    assert found is not None
    assert found.motors.square == (power == 0.5)
    assert found.sources["time"].unit == "us"


def test_each_signal_may_have_a_clock_of_its_own(tmp_path: Path) -> None:
    flight, late = driven(), 3
    clock = 1e9 * (1.7e9 + np.arange(len(flight)) * flight.period)
    columns = {
        "omega.time": clock,
        **named("omega.r omega.p omega.y", np.degrees(flight.body_rates)),
        "pos.time": clock,
        **named("pos.x pos.y pos.z", flight.position),
        "vel.time": clock,
        **named("vel.x vel.y vel.z", flight.velocity),
        "quat.time": clock,
        **named("quat.w quat.x quat.y quat.z", quaternions(flight)[:, [3, 0, 1, 2]]),
        # Each row has the command of three rows before, and its time.
        "motor.time": np.roll(clock, late),
        "bat.time": clock,
        "bat.voltage": flight.battery,
        **named("motor.m1 motor.m2 motor.m3 motor.m4", np.roll(65535 * flight.command, late, 0)),
    }
    rows = {name: values[late:] for name, values in columns.items()}
    path = tmp_path / "own.csv"
    polars.DataFrame(rows).with_columns(polars.col("^.*time$").cast(polars.Int64)).write_csv(path)
    assert formats.write_map(path) is not None
    (found,) = read_flights(path)
    assert_allclose(found.body_rates, flight.body_rates[late:][: len(found)], atol=1e-4)
    wanted = flight.command[late:][: len(found)] ** 2
    assert_allclose(found.command[:-late], wanted[:-late], atol=1e-3)
    assert_allclose(found.battery, flight.battery[late:][: len(found)], rtol=1e-4)


GOOD = """
[time]
columns = ["t"]
[body_rates]
columns = ["wx", "wy", "wz"]
[motors]
columns = ["m1", "m2", "m3", "m4"]
"""


@pytest.mark.parametrize(
    ("text", "named_"),
    [
        (GOOD.replace('[time]\ncolumns = ["t"]\n', ""), "time missing"),
        (GOOD.replace('"m4"', "4"), r"\[motors\]"),
        (GOOD.replace(', "wz"', ""), r"\[body_rates\]"),
        (GOOD + 'unit = "furlong"\n', "unit"),
        (GOOD + "low = 1\n", "low"),
        (GOOD + "[colour]\n", "colour"),
        (GOOD.replace('"wx"', '"absent"'), "absent"),
        ("=", "TOML"),
    ],
)
def test_a_wrong_map_is_named(text: str, named_: str, tmp_path: Path) -> None:
    path = write(tmp_path / "flight.csv", of_ros(driven()))
    column_map.map_path(path).write_text(text)
    with pytest.raises(InputError, match=named_):
        read_flights(path)
