"""ROS 2 recordings, MCAP and SQLite, through `rosbags`; messages are read one after another.

Only the fields that are used stay in memory. Topics of px4_msgs are read as those of a ULog,
others by `ros_topics`.

Source: MCAP format specification; rosbag2; REP 103.
"""

import re
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars

from maidenflight import budget, inputs
from maidenflight.errors import InputError, optional
from maidenflight.flights.formats import LoggedFlights, Recording
from maidenflight.flights.log import Flight
from maidenflight.flights.maps import signal_map
from maidenflight.flights.streams import streams
from maidenflight.flights.streams.streams import Stream
from maidenflight.flights.tables import Table
from maidenflight.integrations.logs import cflib, px4, ros_topics, rosbag_guards
from maidenflight.integrations.logs.px4_topics import vector
from maidenflight.integrations.logs.ros_topics import Layout, Source, Variables

_ZSTD = b"\x28\xb5\x2f\xfd"
"""First bytes of what zstd compressed."""
MOST_FAULTS = 100
"""Messages that cannot be decoded before the rest is left."""
_PX4_TYPE = "px4_msgs/msg/"
_PX4_TOPIC = re.compile(r"(.*)/fmu/(in|out)/(\w+?)(_v\d+)?")
_PX4_FIELDS: Mapping[str, tuple[str, ...]] = {
    "vehicle_local_position": (
        *("x", "y", "z", "vx", "vy", "vz"),
        *("xy_valid", "z_valid", "v_xy_valid", "v_z_valid"),
    ),
    "vehicle_attitude": vector("q", 4),
    "vehicle_angular_velocity": vector("xyz", 3),
    "vehicle_acceleration": vector("xyz", 3),
    "sensor_combined": (
        *vector("gyro_rad", 3),
        "gyro_integral_dt",
        *vector("accelerometer_m_s2", 3),
        *("accelerometer_integral_dt", "accelerometer_timestamp_relative"),
    ),
    "actuator_motors": vector("control", 4),
    "actuator_outputs": vector("output", 16),
    "esc_status": tuple(
        f"esc[{number}].{field}"
        for number in range(4)
        for field in ("esc_rpm", "actuator_function")
    ),
    "battery_status": ("voltage_v",),
    "vehicle_land_detected": ("landed",),
    "vehicle_status": ("arming_state",),
}


_REPAIR = {
    ".mcap": "If it was not closed or was cut off, mend it by 'mcap recover', else copy it again.",
    ".db3": "If it was not closed, mend it by 'sqlite3 FILE .recover', else copy it again.",
}


class Bag(NamedTuple):
    """An open recording."""

    name: str
    types: Mapping[str, str]
    """Message types by topic."""
    messages: Callable[[list[str]], Iterator[tuple[str, int, Any]]]
    """Topic, time of recording [ns] and message, or None for one that cannot be decoded."""
    undefined: frozenset[str] = frozenset()
    """Message types without a definition."""


def flights(path: Path, name: str) -> LoggedFlights:
    """Returns the flights in a recording, unchecked, with the times of their rows [s], and notes.

    Args:
        path: of the file, one of a bag's folder.
        name: by which errors and notes call it.

    Raises:
        InputError: it is damaged, its topics are not known, or a signal is missing; or `rosbags` is
            lacking.
    """
    map_file = ros_topics.map_path(path)
    layout_notes = ros_topics.read(map_file) if map_file.exists() else None
    with _opened(path, name) as bag:
        if isinstance(layout_notes, Variables):
            return _of_variables(bag, layout_notes)
        if layout_notes is not None:
            return _together([_of_layout(bag, name, layout_notes)])
        logs = [*_of_px4(bag), *_of_mavros(bag)]
        if logs:
            return _together(logs)
        topics = ", ".join(f"{topic} ({kind})" for topic, kind in bag.types.items())
        raise InputError(
            f"{name}: none of its topics are known ({topics[:600] or 'there are none'}). Say in "
            f"{map_file.name} beside it which hold body rates, accelerometer and motors; see "
            "docs/flight-log.md."
        )


@contextmanager
def _opened(path: Path, name: str) -> Iterator[Bag]:
    with optional("rosbags", "rosbag", "reading a ROS 2 recording"):
        from rosbags.rosbag2 import Reader
        from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
    kind = ".db3" if inputs.beginning(path, 16).startswith(SQLITE.begins) else ".mcap"
    storage: Any = Reader.STORAGE_PLUGINS[kind](path)
    try:
        guard = rosbag_guards.check_database if kind == ".db3" else rosbag_guards.limit_chunks
        guard(path)
        storage.open()
        grown = sum(chunk.uncompressed_size for chunk in getattr(storage, "chunks", ()))
        budget.LOG.check_growth(path.stat().st_size, grown)
        types: dict[str, Any] = {}
        budget.DEFINITIONS.check(
            "bytes", sum(len(connection.msgdef.data) for connection in storage.connections)
        )
        for connection in storage.connections:
            text = connection.msgdef.data
            if text and connection.msgdef.format.name == "IDL":
                types |= get_types_from_idl(text)
            elif text:
                types |= get_types_from_msg(text, connection.msgtype)
        # Old recordings in SQLite do not hold their messages' definitions.
        rosbag_guards.check_names(types)
        store: Any = get_typestore(Stores.EMPTY)
        store.register({**get_typestore(Stores.LATEST).fielddefs, **types})
    except Exception as error:
        with suppress(Exception):
            storage.close()
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(
            f"{name}: not a readable ROS 2 recording ({reason}). {_REPAIR[kind]}"
        ) from error

    def messages(topics: list[str]) -> Iterator[tuple[str, int, Any]]:
        connections = [
            connection for connection in storage.connections if connection.topic in topics
        ]
        for connection, stamp, raw in storage.messages(connections) if connections else ():
            try:
                plain = rosbag_guards.unpack_message(raw) if bytes(raw[:4]) == _ZSTD else raw
                message = store.deserialize_cdr(plain, connection.msgtype)
            except Exception:
                message = None
            yield connection.topic, stamp, message

    try:
        types = {connection.topic: connection.msgtype for connection in storage.connections}
        yield Bag(name, types, messages, frozenset(set(types.values()) - set(store.fielddefs)))
    finally:
        storage.close()


def _refuse_missing(bag: Bag, name: str, topics: Iterable[str]) -> None:
    missing = [topic for topic in topics if topic not in bag.types]
    if missing:
        raise InputError(
            f"{name}: no topic {', '.join(missing)}; it has {', '.join(bag.types)[:600]}."
        )


def _refuse_undefined(bag: Bag, topics: Iterable[str]) -> None:
    """Refuses topics whose messages cannot be decoded."""
    lacking = sorted({bag.types[topic] for topic in topics} & bag.undefined)
    if lacking:
        raise InputError(
            f"{bag.name}: holds no definition of {', '.join(lacking[:4])}, as recordings before "
            "ROS 2 Iron do not. Convert it to MCAP where these messages are installed: ros2 bag "
            "convert, with storage_id: mcap."
        )


def _together(logs: list[tuple[Flight, np.ndarray, list[str]]]) -> LoggedFlights:
    notes = [note for *_, some in logs for note in some]
    return [(flight, time) for flight, time, _ in logs], notes


class _Fields:
    """Numbers of some fields of a topic's messages, as they come."""

    def __init__(self, fields: tuple[str, ...]) -> None:
        self.fields = fields
        self._steps = [_steps(field) for field in fields]
        self._rows = array("d")
        self._received = array("d")
        self.lacking: list[str] = []

    def add(self, stamp: int, message: Any) -> None:
        """Adds a message; of fields that it lacks the number is not one."""
        self._received.append(stamp * 1e-9)
        self._rows.append(_header(message))
        for field, steps in zip(self.fields, self._steps, strict=True):
            try:
                value = message
                for step in steps:
                    value = value[step] if isinstance(step, int) else getattr(value, step)
                self._rows.append(float(value))
            except (AttributeError, IndexError, TypeError, ValueError):
                if field not in self.lacking:
                    self.lacking.append(field)
                self._rows.append(np.nan)

    def table(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Times of the headers and of recording [s], and the fields, (N, fields)."""
        rows = np.array(self._rows).reshape(-1, 1 + len(self.fields))
        return rows[:, 0], np.array(self._received), rows[:, 1:]


def _header(message: Any) -> float:
    """Time of a message's header [s]; not a number where it has none or 0."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    seconds = 0.0 if stamp is None else stamp.sec + 1e-9 * stamp.nanosec
    return seconds or np.nan


def _steps(field: str) -> list[str | int]:
    """`pose.position.x` and `channels[2]` as names and numbers."""
    return [int(part) if part.isdecimal() else part for part in re.findall(r"[^.\[\]]+", field)]


def _collected(
    bag: Bag, needed: Mapping[str, tuple[str, ...]]
) -> tuple[dict[str, _Fields], list[str]]:
    """Fields of topics, and notes on what of the recording is damaged."""
    logs = {topic: _Fields(fields) for topic, fields in needed.items()}
    faults, stopped = 0, ""
    try:
        for topic, stamp, message in bag.messages(list(needed)):
            if message is None:
                faults += 1
                if faults > MOST_FAULTS:
                    stopped = "too many messages cannot be decoded"
                    break
                continue
            logs[topic].add(stamp, message)
    except Exception as error:
        stopped = " ".join(str(error).split())[:100] or type(error).__name__
    notes = [f"{bag.name}: {faults} messages cannot be decoded and are left out"] if faults else []
    if stopped:
        notes.append(f"{bag.name}: damaged ({stopped}); what was read before is used")
    return logs, notes


def _of_px4(bag: Bag) -> list[tuple[Flight, np.ndarray, list[str]]]:
    drones: dict[str, dict[str, str]] = {}
    # What the drone sends counts more than what it was sent, so it comes last.
    for topic, kind in sorted(bag.types.items()):
        parts = _PX4_TOPIC.fullmatch(topic)
        if kind.startswith(_PX4_TYPE) and parts and parts[3] in _PX4_FIELDS:
            drones.setdefault(parts[1], {})[topic] = parts[3]
    logs = []
    for mark, drone_types in drones.items():
        needed = {
            topic: ("timestamp", "timestamp_sample", *_PX4_FIELDS[kind])
            for topic, kind in drone_types.items()
        }
        _refuse_undefined(bag, needed)
        read, notes = _collected(bag, needed)
        topics = {}
        for topic, fields in read.items():
            _, _, rows = fields.table()
            columns = dict(zip(fields.fields, np.nan_to_num(rows).T, strict=True))
            for lacking in fields.lacking:
                del columns[lacking]
            if len(rows):
                topics[drone_types[topic]] = columns
        name = bag.name if len(drones) == 1 else f"{bag.name}, {mark}"
        flight, time, layout_notes = px4.flight(name, topics, {})
        logs.append((flight, time, [*notes, *layout_notes]))
    return logs


def _of_mavros(bag: Bag) -> list[tuple[Flight, np.ndarray, list[str]]]:
    layouts = ros_topics.of_mavros(list(bag.types))
    logs = []
    for mark, layout in layouts.items():
        name = bag.name if len(layouts) == 1 else f"{bag.name}, {mark}"
        flight, time, notes = _of_layout(bag, name, layout)
        low, high, _ = layout.motors
        motor_note = f"{name}: motors of rc/out between {low:g} and {high:g}, as in an X"
        logs.append((flight, time, [*notes, motor_note]))
    return logs


def _of_layout(bag: Bag, name: str, layout: Layout) -> tuple[Flight, np.ndarray, list[str]]:
    sources = layout.sources
    _refuse_missing(bag, name, [source.topic for source in sources.values()])
    needed: dict[str, tuple[str, ...]] = {}
    for source in sources.values():
        needed[source.topic] = (*needed.get(source.topic, ()), *source.fields)
    _refuse_undefined(bag, needed)
    read, notes = _collected(bag, needed)
    for topic, fields in read.items():
        if fields.lacking and topic in {source.topic for source in sources.values()}:
            raise InputError(
                f"{name}: messages of {topic} ({bag.types[topic]}) have no "
                f"{', '.join(fields.lacking[:4])}. Name fields that they have."
            )
    read_signals = {
        signal: _stream(read[source.topic], source, layout.received)
        for signal, source in sources.items()
    }
    flight, time, layout_notes = signal_map.flight(name, read_signals, layout.motors, layout.remedy)
    return flight, time, [*notes, *layout_notes]


def _stream(fields: _Fields, source: Source, received: bool) -> Stream:
    """A signal of a topic's fields; NaN in a field leaves a sample out."""
    header, recorded, rows = fields.table()
    columns = [fields.fields.index(field) for field in source.fields]
    values = rows[:, columns] * source.scale
    stamps = recorded if received or not np.isfinite(header).all() else header
    return streams.stream(np.where(np.isfinite(values).all(axis=1), stamps, np.nan), values)


def _of_variables(bag: Bag, layout_notes: Variables) -> LoggedFlights:
    """Log variables of a Crazyflie, read as those that its radio logs."""
    _refuse_missing(bag, bag.name, layout_notes.names)
    fields = {
        topic: ("timestamp", *(f"values[{index}]" for index in range(len(names))))
        for topic, names in layout_notes.names.items()
    }
    read, notes = _collected(bag, fields)
    frames = []
    for topic, names in layout_notes.names.items():
        if read[topic].lacking:
            raise InputError(
                f"{bag.name}: messages of {topic} do not hold {len(names)} values and a timestamp. "
                "Name as many variables as there are."
            )
        _, _, rows = read[topic].table()
        frames.append(polars.DataFrame(rows, schema=["timestamp", *names], orient="row"))
    frame = polars.concat(frames, how="diagonal").sort("timestamp", maintain_order=True)
    if not frame.height:
        raise InputError(
            f"{bag.name}: no messages in {', '.join(layout_notes.names)}. Leave it out."
        )
    logs, more = cflib.flights(Table(bag.name, frame))
    return logs, [*notes, *more]


MCAP = Recording("MCAP recording", (".mcap",), b"\x89MCAP", flights)
SQLITE = Recording("rosbag2 in SQLite", (".db3",), b"SQLite format 3\0", flights, named=True)
