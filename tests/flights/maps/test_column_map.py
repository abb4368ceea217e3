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
from maidenflight.flights.maps import column_map, proposal
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


def test_known_formats_and_tables_without_motors_get_no_map(tmp_path: Path) -> None:
    columns = of_ros(driven())
    lacking = {name: values for name, values in columns.items() if name[0] != "m"}
    assert formats.write_map(write(tmp_path / "a.csv", lacking)) is None
    (tmp_path / "b.csv").write_text("a;b\n1;2\n")
    assert formats.write_map(tmp_path / "b.csv") is None


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
