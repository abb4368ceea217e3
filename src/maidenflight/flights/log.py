"""`Flight`, what a drone measured and commanded row by row, and our own file format for it."""

import itertools
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import polars
from jaxtyping import Float

from maidenflight import results
from maidenflight.errors import InputError
from maidenflight.flights import tables
from maidenflight.flights.tables import Table
from maidenflight.inputs import PATHS, StrPath
from maidenflight.names import COMMANDS, OPTIONAL_SIGNALS
from maidenflight.registry import PLOTS
from maidenflight.simulator.physics.battery import COUNTS, MOST_COUNTS

FAMILY = "# maidenflight flight"
MARK = f"{FAMILY} 3"
"""How a file in our format begins."""
ZERO_ORDER_HOLD, SUBSAMPLED = COMMANDS
"""What logged commands stand for: each acts until the next row, or is one of a faster loop."""

ACCELEROMETER_DELAY, GYRO_DELAY = 0.0075, 0.0028
"""Delay of a Crazyflie's low-pass filters, Butterworth of second order at 30 and 80 Hz [s]
(firmware, sensors_bmi088_bmp3xx.c)."""
GRAVITY = 9.81
"""Specific force at rest [m/s2]; 1 g where a log counts in g (firmware, physicalConstants.h)."""
LONGEST_DELAY = 0.1
"""Delay beyond which a log's comment is refused [s]."""

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

_ACCELERATION = ("acceleration_x", "acceleration_y", "acceleration_z")
_ROTOR_SPEED = ("rotor_speed_1", "rotor_speed_2", "rotor_speed_3", "rotor_speed_4")
OPTIONAL: dict[str, tuple[str, ...]] = dict(
    zip(OPTIONAL_SIGNALS, (_ACCELERATION, _ROTOR_SPEED), strict=True)
)
"""Columns that a log may have or not, likewise."""

TRUTH: dict[str, tuple[str, ...]] = {
    "true_position": ("true_position_x", "true_position_y", "true_position_z"),
}
"""Columns of a simulated flight that nobody but who looks at it may read, likewise."""

_COLUMNS = tuple(column for columns in GROUPS.values() for column in columns)

_DELAYS = {"accelerometer_delay": ACCELEROMETER_DELAY, "gyro_delay": GYRO_DELAY}
"""Comments of a log that tell a delay where it is not the usual one [s]."""

_LEGEND = (
    "time s; position m and velocity m/s in the world, z up; roll, pitch, yaw rad (ZYX, positive "
    "pitch nose down); body_rate rad/s, x forward, y left, z up; command = normalised thrust u "
    "from 0 of motors 1..4 (front right, back right, back left, front left), what the battery "
    "could give of it; battery V; setpoint m"
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
    """u, normalised thrust command right after the row was measured."""
    battery: Float[np.ndarray, "N"]
    """[V]; NaN where unknown."""
    setpoint: Float[np.ndarray, "N 3"]
    """[m]; NaN where unknown."""
    zero_order_hold: bool
    """Whether each command acts until the next row (a policy at the log's rate), or the log is
    subsampled from a faster loop (a PID)."""
    simulated: str = ""
    """Name of the virtual drone that flew it; empty for a real flight."""
    full_scale_counts: float = COUNTS
    """Counts of a Crazyflie's firmware, before battery compensation, that u = 1 stands for."""
    assumed: bool = False
    """Whether `zero_order_hold` is a guess, because the log does not say."""
    by_battery_law: bool = True
    """Whether a firmware's battery law made thrust of its commands, where the voltage is known;
    else they are the square of what an ESC was sent."""
    assumed_law: str | None = None
    """The battery law by which its commands were read although the log does not name it."""
    square_since: str = ""
    """What the log says for thrust as the square of the throttle; empty where it says nothing."""
    accelerometer_delay: float = ACCELEROMETER_DELAY
    """By which the low-pass filter of the accelerometer makes it late [s]."""
    gyro_delay: float = GYRO_DELAY
    """By which the low-pass filter of the gyro makes it late [s]."""
    gyro_delay_known: bool = True
    """Whether the log or its firmware says so; else it may be none, or twice as long."""
    lead: int = 0
    """Rows at the beginning that are there for their commands only, in a stretch of a longer
    flight; see `sampling`."""

    accelerometer: Float[np.ndarray, "N 3"] | None = None
    """Specific force along body x, y, z [m/s2], 9.81 along z at rest; None if not logged."""
    rotor_speed: Float[np.ndarray, "N 4"] | None = None
    """Measured speed of rotors 1 to 4 [rad/s]; None where it was not logged."""
    true_position: Float[np.ndarray, "N 3"] | None = None
    """Where a simulated drone was when the row was measured [m]; None where that is not known."""

    def __len__(self) -> int:
        return len(self.position)

    def __repr__(self) -> str:
        """Returns its name, length and origin; its numbers would fill a screen."""
        origin = f"simulated on {self.simulated}" if self.simulated else "real"
        return f"<flight {self.name}: {self.duration:.1f} s at {1 / self.period:.4g} Hz, {origin}>"

    @staticmethod
    def from_frame(
        frame: Any,
        columns: Mapping[str, Any],
        name: str = "table",
        zero_order_hold: bool | None = None,
    ) -> "Flight":
        """Makes a checked flight of a pandas or polars table.

        Args:
            frame: a row an instant.
            columns: its columns by signal, as NAME.columns.toml has them (docs/flight-log.md):
                `time`, `body_rates` and `motors`, and perhaps `position`, `velocity`, `attitude`,
                `accelerometer`, `rotor_speed` and `battery`. A name, a list of names, or a mapping
                of `columns` and `unit`.
            name: what to call it.
            zero_order_hold: whether each command acts until the next row; assumed where None.

        Raises:
            InputError: a column or signal is missing or no number; or the table contradicts
                physics, or is no single stretch of usable flight.
        """
        # Checks and maps of columns are made of flights.
        frames = import_module("maidenflight.flights.frames")
        return frames.flight_of_frame(frame, columns, name, zero_order_hold)

    def plot(self) -> Any:
        """Returns a picture of the signals over time, which a notebook shows."""
        return PLOTS["flight"](self)

    @property
    def has_state(self) -> bool:
        """Whether it is more than a log of accelerometer, gyro and commands alone."""
        return self.accelerometer is None or bool(np.isfinite(self.position).any())

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """What has a number for each row, by its group in `GROUPS`, `OPTIONAL` or `TRUTH`."""
        groups = (group for group in (*GROUPS, *OPTIONAL, *TRUTH) if group != "time")
        return {group: values for group in groups if (values := getattr(self, group)) is not None}

    def part(self, start: int, stop: int) -> "Flight":
        """Returns the rows from `start` to before `stop`."""
        arrays = {group: values[start:stop] for group, values in self.arrays.items()}
        return replace(self, lead=max(0, self.lead - start), **arrays)

    @property
    def duration(self) -> float:
        """[s]."""
        return (len(self) - self.lead) * self.period

    @property
    def mean_command(self) -> Float[np.ndarray, "N 4"]:
        """Command u between a row and the next.

        The command itself if it acts until then, else the mean of this row's and the next one's.
        """
        if self.zero_order_hold:
            return self.command
        following = np.concatenate([self.command[1:], self.command[-1:]])
        return (self.command + following) / 2

    @property
    def speed_command(self) -> Float[np.ndarray, "N 4"]:
        """Rotor speed nu that commands ask for until the next row: sqrt(u), in float64."""
        return np.sqrt(np.maximum(self.mean_command.astype(float), 0.0))


def flights_of(flights: Iterable[Flight] | StrPath) -> list[Flight]:
    """Returns flights, or the checked ones of a log or a folder of logs."""
    if isinstance(flights, PATHS):
        # Formats of logs are made of flights.
        return list(import_module("maidenflight.flights.reading").read_flights(flights))
    return list(flights)


def by_log(flights: Iterable[Flight]) -> dict[str, list[Flight]]:
    """Returns the pieces of each log by its name, in the order of the flights.

    Args:
        flights: checked pieces of flights; those of one name are of one log.
    """
    logs: dict[str, list[Flight]] = {}
    for flight in flights:
        logs.setdefault(flight.name, []).append(flight)
    return logs


def thinned(flight: Flight, every: int) -> Flight:
    """Returns every so many rows of a flight, as a slower log would hold them."""
    if every == 1:
        return flight
    arrays = {group: values[::every] for group, values in flight.arrays.items()}
    lead = -(-flight.lead // every)
    return replace(flight, period=flight.period * every, zero_order_hold=False, lead=lead, **arrays)


def averaged(flight: Flight, every: int) -> Flight:
    """Returns every so many rows of a flight, each with the mean of the commands until the next.

    Rotor speeds follow sqrt(u) linearly, so that is what is averaged.
    """
    if every == 1:
        return flight
    count = len(flight) // every
    # Averaged in the log's own precision.
    speeds = flight.speed_command[: count * every].astype(flight.command.dtype)
    command = np.square(speeds.reshape(count, every, 4).mean(axis=1)).astype(np.float32)
    few = thinned(flight.part(0, count * every), every)
    return replace(few, zero_order_hold=True, command=command)


def flight_of(name: str, period: float, **known: Any) -> Flight:
    """Returns a flight of what was logged.

    Args:
        name: where it comes from.
        period: time between two rows [s].
        known: other fields of `Flight`; arrays of any kind of number. What each row of our format
            has, and was not logged, is NaN.
    """
    rows = len(known["command"])
    for group, names in GROUPS.items():
        if group != "time" and known.get(group) is None:
            known[group] = np.full(rows if group == "battery" else (rows, len(names)), np.nan)
    with np.errstate(over="ignore"):  # what is not finite is refused by checking
        arrays = {
            field: values.astype(np.float32)
            for field, values in known.items()
            if isinstance(values, np.ndarray)
        }
    return Flight(name=name, period=period, **{**known, **arrays})


def to_csv(flight: Flight, record: Mapping[str, Any] | None = None) -> str:
    """Returns the text of a flight in our format: comments, a header line, a line a row."""
    columns: dict[str, np.ndarray] = {"time": np.arange(len(flight)) * flight.period}
    names = GROUPS | OPTIONAL | TRUTH
    for group, values in flight.arrays.items():
        columns |= zip(names[group], values.reshape(len(flight), -1).T, strict=True)
    frame = polars.DataFrame(
        {name: values.astype(np.float64) for name, values in columns.items()}
    ).fill_nan(None)
    head = [
        f"{MARK}: {_LEGEND}",
        f"# commands: {ZERO_ORDER_HOLD if flight.zero_order_hold else SUBSAMPLED}",
        f"# simulated: {flight.simulated or 'no'}",
        *(
            f"# {key}: {value:.6g}"
            for key, usual in {"full_scale_counts": COUNTS, **_DELAYS}.items()
            if (value := getattr(flight, key)) != usual
        ),
        *([] if flight.gyro_delay_known else ["# gyro_delay_known: no"]),
        *([] if flight.by_battery_law else ["# by_battery_law: no"]),
        *([f"# assumed_law: {flight.assumed_law}"] if flight.assumed_law else []),
        *([f"# square_since: {flight.square_since}"] if flight.square_since else []),
        results.record_line(record),
    ]
    return "\n".join(head) + "\n" + frame.write_csv(float_precision=7)


def write(path: StrPath, flight: Flight, record: Mapping[str, Any] | None = None) -> Path:
    """Writes a flight as CSV; see `to_csv`."""
    return results.write(path, to_csv(flight, record))


def from_csv(text: str, name: str) -> Flight:
    """Reads a flight in our format as if its rows were equally spaced; see `timed`."""
    return timed(tables.from_text(text, name))[0]


def _number_in_head(
    table: Table, key: str, usual: float, ends: tuple[float, float], meaning: str
) -> float:
    text, (low, high) = table.head.get(key, f"{usual:g}"), ends
    with suppress(ValueError):
        if low <= float(text) <= high:
            return float(text)
    raise InputError(
        f"{table.name}: {key} = {text[:20]!r}; expected {meaning}, {low:g} to {high:g}."
    )


def recognises(table: Table) -> bool:
    """Returns whether the first line says so or most of the columns are there."""
    return table.mark.startswith(FAMILY) or table.has_most_of(_COLUMNS)


def flights(table: Table) -> tuple[list[tuple[Flight, Float[np.ndarray, "N"]]], list[str]]:
    """Returns the flight in a table, unchecked, with the time of its rows [s], and no notes.

    Raises:
        InputError: see `timed`; or a CSV without our first line.
    """
    if table.first_line and not table.mark.startswith(MARK):
        raise InputError(
            f"{table.name}: line 1 is not '{MARK}' but {table.mark[:60]!r}. Put it there; see "
            "docs/flight-log.md."
        )
    return [timed(table)], []


def timed(table: Table) -> tuple[Flight, Float[np.ndarray, "N"]]:
    """Reads a flight in our format; the rows are not checked, `checking` does that.

    Returns:
        The flight, and the time of each of its rows [s].

    Raises:
        InputError: a column is missing or is not numeric, or it is not said what a command stands
            for.
    """
    if table.head.get("commands") not in (ZERO_ORDER_HOLD, SUBSAMPLED):
        lack, sign = ("line 2 is not", "# ") if table.first_line else ("its metadata lack", "")
        command_comments = f"'{sign}commands: {ZERO_ORDER_HOLD}' or '{sign}commands: {SUBSAMPLED}'"
        raise InputError(
            f"{table.name}: {lack} {command_comments}. Add it; see docs/flight-log.md."
        )
    logged = {
        group: names
        for group, names in (OPTIONAL | TRUTH).items()
        if set(names) <= set(table.frame.columns)
    }
    column = tables.numbers(table, [*_COLUMNS, *itertools.chain(*logged.values())])
    counts = "the counts that u = 1 stands for"
    delay, possible = "the delay of that sensor's filter [s]", (0.0, LONGEST_DELAY)
    simulated = table.head.get("simulated", "no")
    times = column["time"][np.isfinite(column["time"])]
    arrays: dict[str, Any] = {
        group: np.stack([column[name] for name in names], axis=-1)
        for group, names in (GROUPS | logged).items()
        if group not in ("time", "battery")
    }
    flight = flight_of(
        table.name,
        float(np.round(np.median(np.diff(times)), 6)) if len(times) > 1 else 0.01,
        zero_order_hold=table.head["commands"] == ZERO_ORDER_HOLD,
        simulated="" if simulated == "no" else simulated,
        full_scale_counts=_number_in_head(
            table, "full_scale_counts", COUNTS, (1.0, MOST_COUNTS), counts
        ),
        **{
            key: _number_in_head(table, key, usual, possible, delay)
            for key, usual in _DELAYS.items()
        },
        gyro_delay_known=table.head.get("gyro_delay_known", "yes") != "no",
        by_battery_law=table.head.get("by_battery_law", "yes") != "no",
        assumed_law=table.head.get("assumed_law"),
        square_since=table.head.get("square_since", ""),
        battery=column["battery"],
        **arrays,
    )
    return flight, column["time"]
