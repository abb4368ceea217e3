"""The flight log: what a drone measured and commanded, row by row, and our own file format for it."""

import io
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars
from jaxtyping import Float

from maidenflight import results
from maidenflight.errors import InputError

MARK = "# maidenflight flight 1"
"""How a file in our format begins."""

GROUPS: dict[str, tuple[str, ...]] = {
    "time": ("time",),
    "position": ("position_x", "position_y", "position_z"),
    "velocity": ("velocity_x", "velocity_y", "velocity_z"),
    "attitude": ("roll", "pitch", "yaw"),
    "body_rates": ("body_rate_x", "body_rate_y", "body_rate_z"),
    "command": ("command_1", "command_2", "command_3", "command_4"),
    "battery": ("battery",),
    "setpoint": ("setpoint_x", "setpoint_y", "setpoint_z"),
}
"""Columns of our format, by the field of `Flight` that they fill."""

_LARGEST = float(np.finfo(np.float32).max)

_LEGEND = (
    "time s; position m and velocity m/s in the world, z up; roll, pitch, yaw rad (ZYX, positive pitch nose down); body_rate rad/s,"
    " x forward, y left, z up; command = normalised thrust u in [0, 1] of motors 1..4 (front right, back right, back left, front"
    " left), what the battery could give of it; battery V; setpoint m"
)


@dataclass(frozen=True)
class Flight:
    """A flight, or a gapless piece of one, in SI units; N rows at equal distances in time."""

    name: str
    """Where it comes from, usually a file."""
    period: float
    """Time between two rows [s]."""
    position: Float[np.ndarray, "N 3"]
    velocity: Float[np.ndarray, "N 3"]
    attitude: Float[np.ndarray, "N 3"]
    """Roll, pitch, yaw [rad]."""
    body_rates: Float[np.ndarray, "N 3"]
    command: Float[np.ndarray, "N 4"]
    """u, normalised thrust command given right after the row was measured."""
    battery: Float[np.ndarray, "N"]
    """[V]; NaN where unknown."""
    setpoint: Float[np.ndarray, "N 3"]
    """[m]; NaN where unknown."""
    held: bool
    """Whether each command held until the next row (a policy at the log's rate), or is a sample of a faster loop (a PID)."""
    simulated: str = ""
    """Name of the virtual drone that flew it; empty for a real flight."""

    def __len__(self) -> int:
        return len(self.position)

    @property
    def duration(self) -> float:
        """[s]."""
        return len(self) * self.period

    @property
    def mean_command(self) -> Float[np.ndarray, "N 4"]:
        """Command u between a row and the next: the command itself if it is held, else the mean of this row's and the next one's."""
        if self.held:
            return self.command
        following = np.concatenate([self.command[1:], self.command[-1:]])
        return (self.command + following) / 2


def to_csv(flight: Flight, record: Mapping[str, Any] | None = None) -> str:
    """The text of a flight in our format: four comment lines, a header line, one line a row."""
    columns: dict[str, np.ndarray] = {"time": np.arange(len(flight)) * flight.period}
    for group, names in GROUPS.items():
        if group != "time":
            values = getattr(flight, group).reshape(len(flight), -1)
            columns |= {name: values[:, number] for number, name in enumerate(names)}
    frame = polars.DataFrame({name: values.astype(np.float64) for name, values in columns.items()}).fill_nan(None)
    head = [
        f"{MARK}: {_LEGEND}",
        f"# commands: {'held' if flight.held else 'sampled'}",
        f"# simulated: {flight.simulated or 'no'}",
        f"# record: {json.dumps(dict(record or {}))}",
    ]
    return "\n".join(head) + "\n" + frame.write_csv(float_precision=7)


def write(path: str | os.PathLike[str], flight: Flight, record: Mapping[str, Any] | None = None) -> Path:
    """Writes a flight as CSV; see `to_csv`."""
    return results.write(path, to_csv(flight, record))


def from_csv(text: str, name: str) -> Flight:
    """Reads a flight in our format as if its rows were equally spaced; see `timed`."""
    return timed(text, name)[0]


def timed(text: str, name: str) -> tuple[Flight, Float[np.ndarray, "N"]]:
    """Reads a flight in our format; the rows are not checked, `checking` does that.

    Args:
        text: content of the file.
        name: what errors name.

    Returns:
        The flight, and the time of each of its rows [s].

    Raises:
        InputError: a column is missing or is not numeric, or there are no rows.
    """
    head = dict(line[2:].split(": ", 1) for line in text.split("\n", 4)[:4] if line.startswith("# ") and ": " in line)
    if head.get("commands") not in ("held", "sampled"):
        raise InputError(f"{name}: line 2 is not '# commands: held' or '# commands: sampled'. Add it; see docs/flight-log.md.")
    table = numbers(text, name, [column for columns in GROUPS.values() for column in columns])
    simulated = head.get("simulated", "no")
    flight = Flight(
        name=name,
        period=float(np.round(np.median(np.diff(table["time"])), 6)) if len(table["time"]) > 1 else 0.01,
        held=head["commands"] == "held",
        simulated="" if simulated == "no" else simulated,
        battery=table["battery"].astype(np.float32),
        **{
            group: np.stack([table[column] for column in GROUPS[group]], axis=-1).astype(np.float32)
            for group in ("position", "velocity", "attitude", "body_rates", "command", "setpoint")
        },
    )
    return flight, table["time"]


def numbers(text: str, name: str, columns: Sequence[str]) -> dict[str, np.ndarray]:
    """Reads named columns of a CSV as float64 arrays, empty cells as NaN.

    Raises:
        InputError: not a table, a column is missing or not numeric, or there are no rows.
    """
    try:
        frame = polars.read_csv(io.StringIO(text), comment_prefix="#", infer_schema_length=None)
    except (polars.exceptions.PolarsError, ValueError) as error:
        raise InputError(f"{name}: not a readable CSV table ({str(error).splitlines()[0]}).") from error
    missing = [column for column in columns if column not in frame.columns]
    if missing:
        raise InputError(f"{name}: missing column {', '.join(missing)}; expected {', '.join(columns)}.")
    if frame.height == 0:
        raise InputError(f"{name}: no rows. Leave the file out.")
    table = {}
    for column in columns:
        series = frame[column]
        cast = series.cast(polars.Float64, strict=False)
        odd = series.filter(cast.is_null() & series.is_not_null())
        if len(odd) > 0:
            raise InputError(f"{name}: column {column} holds something that is not a number, such as {str(odd[0])[:40]!r}.")
        values = cast.fill_null(float("nan")).to_numpy()
        table[column] = np.where(np.abs(values) > _LARGEST, np.inf, values)
    return table
