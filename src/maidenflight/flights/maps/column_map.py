"""Which columns of a table are which signal of a drone, as a file beside it says.

`NAME.columns.toml` stands beside NAME.csv, NAME.csv.gz or NAME.parquet; docs/flight-log.md
describes it. A minus before a column turns its sign, so that axes that point the other way need no
further word.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from maidenflight import inputs
from maidenflight.errors import InputError
from maidenflight.flights import tables
from maidenflight.flights.checks.checking import FASTEST_S
from maidenflight.flights.log import GRAVITY, Flight
from maidenflight.flights.maps import signal_map
from maidenflight.flights.maps.signal_map import COUNTS, Motors
from maidenflight.flights.streams import streams
from maidenflight.flights.streams.streams import Stream
from maidenflight.flights.tables import Table
from maidenflight.inputs import Fields

TIME = "time"
NEEDED = (TIME, "body_rates", "motors")
UNITS = {
    **{"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    **{"m": 1.0, "cm": 1e-2, "mm": 1e-3, "m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
    **{"rad": 1.0, "deg": np.pi / 180, "rad/s": 1.0, "mrad/s": 1e-3, "deg/s": np.pi / 180},
    **{"m/s2": 1.0, "g": GRAVITY, "mg": 1e-3 * GRAVITY},
    **{"V": 1.0, "mV": 1e-3, "rpm": 2 * np.pi / 60},
    **{"erpm": 2 * np.pi / 60 / 6, "erpm14": 2 * np.pi / 60 / 7},
}
"""SI units in each unit that a column may have, by definition; electrical rpm are of motors with 12
magnet poles, as a Crazyflie's, or 14, as most others."""
REMEDY = "Log them at a higher rate."
_ANGLES = 3
"""Columns of an attitude in roll, pitch, yaw, by definition, instead of a quaternion."""


@dataclass(frozen=True)
class Source:
    """Where a signal is."""

    columns: tuple[str, ...]
    """Each with a minus before it where its sign is turned."""
    unit: str = ""
    """A key of `UNITS`; empty for SI."""
    clock: str = ""
    """Column of its own time, in the unit of `TIME`; empty for that one."""


@dataclass(frozen=True)
class ColumnMap:
    """Where all signals of a drone are."""

    sources: Mapping[str, Source]
    """By `TIME` and keys of `signal_map.COUNTS`."""
    motors: Motors = Motors()


def map_path(path: Path) -> Path:
    """Returns where the file lies that says what the columns of a table are."""
    stem = path.name.removesuffix(".gz").rpartition(".")[0]
    return path.with_name(f"{stem}.columns.toml")


def read(path: Path) -> ColumnMap:
    """Reads such a file.

    Raises:
        InputError: it cannot be read, or an entry is missing, unknown or of the wrong kind.
    """
    return of_entries(path, inputs.toml_file(path, "TOML", signal_map.CURE))


def of_entries(path: Path, entries: Mapping[str, Any]) -> ColumnMap:
    """Returns the map of its tables, by signal; errors as of `read`, which name the path."""
    return ColumnMap(*signal_map.read_sources(path, entries, NEEDED, _source))


def text(columns: ColumnMap) -> str:
    """Returns the content of such a file."""
    comments = {
        "time": "",
        "position": "world, z up",
        "velocity": "world, z up",
        "attitude": "body to world: quaternion x, y, z, w, or roll, pitch (nose down), yaw",
        "body_rates": "about body x forward, y left, z up",
        "accelerometer": "along body x forward, y left, z up: +1 g along z at rest",
        "motors": "front right, back right, back left, front left",
        "rotor_speed": "front right, back right, back left, front left",
        "battery": "",
    }
    lines = ["# Columns by signal; a minus before a column turns its sign. See docs/flight-log.md."]
    for signal, source in columns.sources.items():
        comment = f"  # {comments[signal]}" if comments[signal] else ""
        names = ", ".join(f'"{name}"' for name in source.columns)
        lines += ["", f"[{signal}]{comment}", f"columns = [{names}]"]
        lines += [f'unit = "{source.unit}"'] if source.unit else []
        lines += [f'clock = "{source.clock}"'] if source.clock else []
        if signal == "motors":
            low, high, square = columns.motors
            thrust = signal_map.THRUSTS[0 if square else 1]
            lines += [f"low = {low:g}", f"high = {high:g}", f'thrust = "{thrust}"']
    for signal in NEEDED:
        if signal not in columns.sources:
            lines += ["", f"# OPEN: no names of columns look like {signal}, which is needed."]
            lines += [f"# [{signal}]  # {comments[signal]}", "# columns = []"]
    return "\n".join(lines) + "\n"


def flight(table: Table, columns: ColumnMap) -> tuple[Flight, np.ndarray, list[str]]:
    """Returns flight in a table, unchecked, with the time of its rows [s], and what was assumed.

    Raises:
        InputError: a column is missing or no number, or a signal is logged too rarely.
    """
    signal_values = {signal: values(table, source) for signal, source in columns.sources.items()}
    time = signal_values.pop(TIME)[:, 0]
    unit = columns.sources[TIME].unit
    own = {
        signal: values(table, Source((source.clock,), unit))[:, 0]
        for signal, source in columns.sources.items()
        if source.clock
    }
    steps = np.diff(time[np.isfinite(time)])
    if not len(steps) or not FASTEST_S < np.median(steps) < np.inf:
        raise InputError(
            f"{table.name}: {columns.sources[TIME].columns[0]} advances by "
            f"{np.median(steps) if len(steps) else 0.0:.3g} s a row, which no drone logs. Mend the "
            "time, or its unit in the map of columns."
        )
    signals = {name: _stream(own.get(name, time), rows) for name, rows in signal_values.items()}
    angles = signals.get("attitude")
    if angles is not None and angles.values.shape[1] == _ANGLES:
        turned = Rotation.from_euler("ZYX", angles.values[:, ::-1]).as_quat()
        signals["attitude"] = Stream(angles.time, turned)
    logged, at, notes = signal_map.flight(table.name, signals, columns.motors, REMEDY)
    return replace(logged, assumed=True), at, notes


def values(table: Table, source: Source) -> np.ndarray:
    """Returns the columns of a signal, in SI units and with their signs."""
    names = [column.removeprefix("-") for column in source.columns]
    read_ = tables.numbers(table, dict.fromkeys(names))
    signs = [-1.0 if column.startswith("-") else 1.0 for column in source.columns]
    rows = np.stack([sign * read_[name] for name, sign in zip(names, signs, strict=True)], axis=1)
    return rows * UNITS.get(source.unit, 1.0)


def _stream(time: np.ndarray, rows: np.ndarray) -> Stream:
    """The samples of a signal, of rows in which it was logged."""
    sound = np.isfinite(rows).all(axis=1)
    return streams.stream(time[sound], rows[sound])


def _source(signal: str, fields: Fields) -> Source:
    counts = [1 if signal == TIME else COUNTS[signal]]
    counts += [_ANGLES] if signal == "attitude" else []
    clock = fields.text("clock") if "clock" in fields.content else ""
    return Source(fields.texts("columns", counts), fields.choice("unit", UNITS, ""), clock)
