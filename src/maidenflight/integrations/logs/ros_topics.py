"""Which topics and fields of a ROS 2 recording are which signal of a drone.

Topics of MAVROS are known by their names. For others a file `NAME.topics.toml` beside the recording
says it, NAME being the recording's name without its ending; docs/flight-log.md describes it. ROS
has our axes: the world's z up, the body's x forward, y left, z up (REP 103).

Source: mavros 2.6, mavros/src/plugins (imu.cpp, local_position.cpp, rc_io.cpp, sys_status.cpp);
mavros_msgs and crazyflie_interfaces message definitions.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from maidenflight import inputs
from maidenflight.errors import InputError
from maidenflight.flights.maps import signal_map
from maidenflight.flights.maps.signal_map import COUNTS, Motors
from maidenflight.inputs import Fields

CLOCKS = ("header", "received")
"""What stamps samples: a message's header where it has one, or when it was recorded."""
NEEDED = ("body_rates", "accelerometer", "motors")


@dataclass(frozen=True)
class Source:
    """Where a signal is."""

    topic: str
    fields: tuple[str, ...]
    scale: float = 1.0
    """By which its numbers are multiplied."""


@dataclass(frozen=True)
class Layout:
    """Where all signals of a drone are."""

    sources: Mapping[str, Source]
    """By keys of `signal_map.COUNTS`."""
    motors: Motors = Motors()
    """What the numbers of the motors mean."""
    received: bool = False
    """Whether samples have the time at which they were recorded, not that of their header."""
    remedy: str = "Record its topics at a higher rate."


@dataclass(frozen=True)
class Variables:
    """Log variables of a Crazyflie in messages that do not name them."""

    names: Mapping[str, tuple[str, ...]]
    """By topic, in the order of their values."""


_XYZ = "xyz"
_IMU = ("imu/data_raw", "imu/data")
_MAVROS = {
    "body_rates": (_IMU, tuple(f"angular_velocity.{axis}" for axis in _XYZ)),
    "accelerometer": (_IMU, tuple(f"linear_acceleration.{axis}" for axis in _XYZ)),
    # Front right, back left, front left, back right, as PX4 and ArduPilot number an X.
    "motors": (("rc/out",), tuple(f"channels[{number}]" for number in (0, 3, 1, 2))),
    "position": (("local_position/pose",), tuple(f"pose.position.{axis}" for axis in _XYZ)),
    "attitude": (("local_position/pose",), tuple(f"pose.orientation.{axis}" for axis in "xyzw")),
    "velocity": (
        ("local_position/velocity_local",),
        tuple(f"twist.linear.{axis}" for axis in _XYZ),
    ),
    "battery": (("battery",), ("voltage",)),
}
_REMEDY = (
    "Raise the rates of HIGHRES_IMU and SERVO_OUTPUT_RAW (ros2 service call "
    "/mavros/set_message_interval), or read the autopilot's own log."
)


def of_mavros(topics: list[str]) -> dict[str, Layout]:
    """Layouts of drones whose MAVROS was recorded, by the beginning of their topics' names."""
    marks = sorted({topic.rpartition("mavros/")[0] for topic in topics if "mavros/" in topic})
    layouts: dict[str, Layout] = {}
    for mark in marks:
        sources = {}
        for signal, (ends, fields) in _MAVROS.items():
            there = [name for end in ends if (name := f"{mark}mavros/{end}") in topics]
            if there:
                sources[signal] = Source(there[0], fields)
        if set(NEEDED) <= set(sources):
            layouts[mark] = Layout(sources, Motors(1000.0, 2000.0), remedy=_REMEDY)
    return layouts


def map_path(path: Path) -> Path:
    """Returns where the file lies that says what the topics of a recording are."""
    return path.with_name(f"{path.stem}.topics.toml")


def read(path: Path) -> Layout | Variables:
    """Reads such a file.

    Raises:
        InputError: it cannot be read, or an entry is missing, unknown or of the wrong kind.
    """
    content = inputs.toml_file(path, "TOML", signal_map.CURE)
    if "variables" in content:
        return _variables(path, content)
    clock = content.pop("clock", CLOCKS[0])
    if clock not in CLOCKS:
        raise InputError(f"{path}: clock = {clock!r}; expected {' or '.join(map(repr, CLOCKS))}.")
    sources, motors = signal_map.read_sources(path, content, NEEDED, _source)
    return Layout(sources, motors, clock == CLOCKS[1])


def _variables(path: Path, content: dict[str, Any]) -> Variables:
    names = content["variables"]
    sound = [
        isinstance(some, list) and some and all(isinstance(name, str) for name in some)
        for some in (names.values() if isinstance(names, dict) else [None])
    ]
    if set(content) != {"variables"} or not all(sound):
        raise InputError(
            f"{path}: expected the names of each topic's values alone, such as "
            '\'[variables]\' and \'"/cf1/log1" = ["gyro.x", "gyro.y"]\'.'
        )
    return Variables({topic: tuple(some) for topic, some in names.items()})


def _source(signal: str, fields: Fields) -> Source:
    names = fields.texts("fields", [COUNTS[signal]])
    return Source(fields.text("topic"), names, fields.number("scale", usual=1.0))
