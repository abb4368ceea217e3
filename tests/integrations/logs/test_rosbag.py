"""Recordings of ROS 2: written by rosbags' own writer and read back."""

import contextlib
import dataclasses
import sqlite3
import sys
import tracemalloc
from importlib import import_module
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose

import maidenflight as mf
from made_flights import sensed
from maidenflight import budget
from maidenflight.errors import InputError
from maidenflight.flights import compensation
from maidenflight.flights.log import Flight
from maidenflight.flights.reading import read_flights
from maidenflight.identification.identify import identify
from maidenflight.identification.methods import Likelihood
from maidenflight.integrations.logs import ros_topics
from maidenflight.parameters import component, crazyflie, replace

pytest.importorskip("rosbags")
import made_bags as made  # needs rosbags itself

SUFFIXES = (".mcap", ".db3")
STATE = ("position", "velocity", "attitude")
FLIGHT = sensed(400)


def same(found: Flight, flight: Flight, speed: float = 1e-5, state: bool = True) -> None:
    rows = len(found)
    assert rows >= len(flight) - 1
    for group in ("body_rates", "accelerometer", *(STATE if state else ())):
        logged, true = found.arrays[group], flight.arrays[group]
        # Stamps since 1970 have steps of 0.2 us.
        assert_allclose(logged, true[-rows:] if rows < len(true) else true, atol=2e-4)
    command = flight.command[-rows:]
    assert_allclose(np.sqrt(found.command), np.sqrt(command), atol=speed)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("state", [True, False])
def test_a_flight_of_px4_comes_back(suffix: str, state: bool, tmp_path: Path) -> None:
    made.bag(tmp_path / "bag", made.px4_messages(FLIGHT, state=state), suffix)
    (found,) = read_flights(tmp_path)
    assert found.has_state is state
    same(found, FLIGHT, state=state)
    assert_allclose(found.battery, 3.7, atol=1e-5)


def test_two_drones_of_a_recording_are_two_flights(tmp_path: Path) -> None:
    one, other = FLIGHT, sensed(300, seed=2)
    messages = [*made.px4_messages(one, "/a"), *made.px4_messages(other, "/b")]
    flights = read_flights(made.bag(tmp_path / "bag", messages))
    assert [len(flight) for flight in flights] == [400, 300]
    same(flights.flights[1], other)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_flight_of_mavros_comes_back(suffix: str, tmp_path: Path) -> None:
    path = made.bag(tmp_path / "bag", made.mavros_messages(FLIGHT, "/uav1"), suffix)
    (found,) = read_flights(path)
    assert found.has_state
    same(found, FLIGHT, speed=0.51e-3)


def test_motors_in_another_order_are_named(tmp_path: Path) -> None:
    messages = made.mavros_messages(sensed(900), order=(0, 1, 2, 3))
    with pytest.raises(InputError, match="look permuted"):
        read_flights(made.bag(tmp_path / "bag", messages))


def test_messages_that_were_compressed_one_by_one_are_read(tmp_path: Path) -> None:
    zstd = import_module("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd")
    path = made.bag(tmp_path / "bag", made.px4_messages(FLIGHT), ".db3")
    with contextlib.closing(sqlite3.connect(path)) as base, base:
        rows = base.execute("SELECT id, data FROM messages").fetchall()
        packed = [(zstd.compress(data), number) for number, data in rows]
        base.executemany("UPDATE messages SET data = ? WHERE id = ?", packed)
    (found,) = read_flights(path)
    same(found, FLIGHT)


def test_a_recording_without_definitions_says_so(tmp_path: Path) -> None:
    path = made.bag(tmp_path / "bag", made.px4_messages(FLIGHT), ".db3")
    with contextlib.closing(sqlite3.connect(path)) as base, base:
        base.execute("DELETE FROM message_definitions")
    with pytest.raises(InputError, match="holds no definition of px4_msgs/msg/"):
        read_flights(path)


def test_motors_that_were_commanded_from_outside_are_read(tmp_path: Path) -> None:
    messages = (
        (time, topic.replace("/fmu/out/actuator_motors", "/fmu/in/actuator_motors"), message)
        for time, topic, message in made.px4_messages(FLIGHT)
    )
    (found,) = read_flights(made.bag(tmp_path / "bag", messages))
    same(found, FLIGHT)


def mine(flight: Flight) -> Any:
    """A recording with topics of one's own; the gyro in degrees."""
    for row in range(len(flight)):
        time = made.START + row * flight.period
        still = made.quaternion(0.0, 0.0, 0.0)
        degrees = np.degrees(flight.body_rates[row])
        yield time, "/imu", made.imu(time, degrees, flight.arrays["accelerometer"][row], still)
        share = made.message(
            "mine/msg/Motors", share=np.sqrt(flight.command[row].astype(float)) * 65535
        )
        yield time, "/motors", share


TOPICS = """
[body_rates]
topic = "/imu"
fields = ["angular_velocity.x", "angular_velocity.y", "angular_velocity.z"]
scale = 0.017453292519943295

[accelerometer]
topic = "/imu"
fields = ["linear_acceleration.x", "linear_acceleration.y", "linear_acceleration.z"]

[motors]
topic = "/motors"
fields = ["share[0]", "share[1]", "share[2]", "share[3]"]
high = 65535
"""


def test_topics_of_ones_own_are_named_in_a_file(tmp_path: Path) -> None:
    path = made.bag(tmp_path / "bag", mine(FLIGHT))
    with pytest.raises(InputError, match=r"/motors.*mine/msg/Motors"):
        read_flights(path)
    ros_topics.map_path(path).write_text(f'clock = "received"\n{TOPICS}')
    (found,) = read_flights(tmp_path)
    assert not found.has_state
    same(found, FLIGHT, state=False)
    ros_topics.map_path(path).write_text(f"{TOPICS}thrust = 'linear'\n")
    (linear,) = read_flights(path)
    assert_allclose(linear.command[-300:], np.sqrt(found.command[-300:]), atol=1e-4)


@pytest.mark.parametrize(
    "text",
    [
        "[",
        "",
        'clock = "mine"\n' + TOPICS,
        TOPICS + "[other]\n",
        TOPICS.replace("share[3]", "share[9]"),
        TOPICS.replace('"/motors"', '"/other"'),
        TOPICS.replace('"share[3]"', "3"),
        TOPICS.replace("high = 65535", "high = -1"),
        TOPICS.replace("high = 65535", 'thrust = "cubic"'),
        TOPICS + "scale = nan\n",
        '[variables]\n"/imu" = 3\n',
        '[variables]\n"/other" = ["gyro.x"]\n',
        '[variables]\n"/imu" = ["gyro.x"]\n',
    ],
)
def test_a_wrong_file_of_topics_is_refused(text: str, tmp_path: Path) -> None:
    path = made.bag(tmp_path / "bag", mine(sensed(150)))
    ros_topics.map_path(path).write_text(text)
    with pytest.raises(InputError):
        read_flights(path)


def test_log_blocks_of_crazyswarm_are_read_by_their_names(tmp_path: Path) -> None:
    blocks = {
        "/cf1/sensors": [*(f"gyro.{axis}" for axis in "xyz"), *(f"acc.{axis}" for axis in "xyz")],
        "/cf1/motors": [*(f"motor.m{motor}" for motor in "1234"), "pm.vbat"],
    }
    motors = 65535 * np.sqrt(FLIGHT.command)
    rows = {
        "/cf1/sensors": np.concatenate(
            [np.degrees(FLIGHT.body_rates), FLIGHT.arrays["accelerometer"] / 9.81], axis=1
        ),
        "/cf1/motors": np.concatenate([motors, FLIGHT.battery[:, None]], axis=1),
    }
    kind = "crazyflie_interfaces/msg/LogDataGeneric"
    messages = [
        (
            made.START + row * 0.01,
            topic,
            made.message(
                kind,
                time=made.START + row * 0.01,
                timestamp=1000 + 10 * row,
                values=values[row].astype(np.float32),
            ),
        )
        for topic, values in rows.items()
        for row in range(len(FLIGHT))
    ]
    path = made.bag(tmp_path / "bag", messages)
    lines = [f'"{topic}" = {names}' for topic, names in blocks.items()]
    ros_topics.map_path(path).write_text("[variables]\n" + "\n".join(lines).replace("'", '"'))
    flights = read_flights(path)
    (found,) = flights
    assert_allclose(found.body_rates, FLIGHT.body_rates, atol=1e-4)
    expected = compensation.thrust_command(motors, FLIGHT.battery)
    assert_allclose(found.command, expected, atol=1e-4)
    assert any(compensation.PLUS in note for note in flights.notes)


def test_signals_that_are_too_rare_are_refused(tmp_path: Path) -> None:
    messages = [
        entry
        for number, entry in enumerate(made.mavros_messages(FLIGHT))
        if "rc/out" not in entry[1] or number % 10 == 1
    ]
    slow = [entry for entry in messages if "rc/out" in entry[1]]
    assert slow
    with pytest.raises(InputError, match="SERVO_OUTPUT_RAW"):
        read_flights(made.bag(tmp_path / "bag", messages))


@pytest.mark.slow
def test_a_large_recording_is_not_held_in_memory(tmp_path: Path) -> None:
    """Pictures of 60 MB lie between the messages of a flight."""
    flight = sensed(200)
    picture = made.message(
        "sensor_msgs/msg/CompressedImage",
        time=1.0,
        format="jpeg",
        data=np.zeros(600_000, np.uint8),
    )
    pictures = [(made.START + 10.0 + 0.02 * row, "/camera", picture) for row in range(100)]
    path = made.bag(tmp_path / "bag", [*made.px4_messages(flight), *pictures])
    assert path.stat().st_size > 50e6
    tracemalloc.start()
    (found,) = read_flights(path)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(found) >= 199
    assert most < 20e6


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_damaged_recordings_are_refused_or_named(suffix: str, tmp_path: Path) -> None:
    path = made.bag(tmp_path / "bag", made.px4_messages(FLIGHT), suffix)
    raw = path.read_bytes()
    for content in (raw[:8], raw[: len(raw) // 2], b"", b"text", raw[:16] + bytes(1000)):
        path.write_bytes(content)
        try:
            flights = read_flights(path)
        except InputError:
            continue
        assert flights.notes


def test_a_recording_whose_chunks_grow_more_than_logs_do_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = made.bag(tmp_path / "bag", made.px4_messages(sensed(60)))
    monkeypatch.setattr(budget, "LOG", dataclasses.replace(budget.LOG, free=1000, growth=0.1))
    with pytest.raises(InputError, match=r"bag\.mcap: .* unpack to .* as no log does"):
        read_flights(path)


@pytest.mark.night
def test_a_planted_drone_comes_back_through_mcap(tmp_path: Path) -> None:
    drone = mf.virtual_drone(1)
    flown = mf.record(drone, jax.random.key(1), flights=2, duration=12.0, excitation=0.05)
    for number, flight in enumerate(flown):
        made.bag(tmp_path / f"bag_{number}", made.px4_messages(flight, state=False))
    flights = read_flights(tmp_path)
    assert len(flights) == 2
    start = replace(crazyflie(), mass=drone.parameters.mass)
    found = identify(list(flights), Likelihood(trials=1), start=start).parameters
    # The simulated gyro is low-pass filtered as a Crazyflie's; that of `sensor_combined` is not.
    # Of ten virtual drones so flown the error of inertia is 7 % (root mean square).
    for name, error in {"thrust_to_weight": 0.04, "inertia_x": 0.15, "inertia_y": 0.15}.items():
        value = float(component(drone.parameters, name))
        assert float(component(found, name)) == pytest.approx(value, rel=error), name
