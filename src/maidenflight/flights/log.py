"""`Flight`, what a drone measured and commanded row by row, and our own file format for it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any

import numpy as np
from jaxtyping import Float

from maidenflight.inputs import PATHS, StrPath
from maidenflight.names import COMMANDS, OPTIONAL_SIGNALS
from maidenflight.registry import PLOTS
from maidenflight.simulator.physics.battery import COUNTS

ZERO_ORDER_HOLD, SUBSAMPLED = COMMANDS
"""What logged commands stand for: each acts until the next row, or is one of a faster loop."""

ACCELEROMETER_DELAY, GYRO_DELAY = 0.0075, 0.0028
"""Delay of a Crazyflie's low-pass filters, Butterworth of second order at 30 and 80 Hz [s]
(firmware, sensors_bmi088_bmp3xx.c)."""
GRAVITY = 9.81
"""Specific force at rest [m/s2]; 1 g where a log counts in g (firmware, physicalConstants.h)."""
ROTORS = np.array([(1, -1, 0), (-1, -1, 0), (-1, 1, 0), (1, 1, 0)]) / np.sqrt(2)
"""Places of a log's rotors [arm length], (4, 3): an X, in the order of a Crazyflie's motors: front
right, back right, back left, front left. `parameters.levers` has those of a known drone."""
YAW = (-1, 1, -1, 1)
"""Sign of each rotor's reaction torque about z [-]: + turns the drone to the left, since the rotor
turns clockwise from above."""
TORQUES = np.sign(np.stack([ROTORS[:, 1], -ROTORS[:, 0], YAW])).T
"""Signs of each rotor's torque about x, y and z [-], (4, 3); Gronauer et al. 2022, eq:torque."""
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
"""Columns of a simulated flight that no estimator may read, likewise."""


@dataclass(frozen=True)
class Flight:
    """A flight, or a gapless piece of one, in SI units; N rows at equal distances in time.

    NaN is what was not logged of a signal that every flight has; the others may be None.
    """

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
        # Imported here, for checks and maps of columns import flights.
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
        # Imported here, for formats of logs import flights.
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
    with np.errstate(over="ignore"):  # checking refuses what overflowed
        arrays = {
            field: values.astype(np.float32)
            for field, values in known.items()
            if isinstance(values, np.ndarray)
        }
    return Flight(name=name, period=period, **{**known, **arrays})
