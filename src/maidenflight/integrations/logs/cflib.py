"""Logs of a Crazyflie by its own variables: CSV of cflib or of the client, and micro-SD logs.

Columns are the firmware's log variables with their dots (`stateEstimate.x`, `gyro.z`, `motor.m1`),
and one of time; of each signal there are several spellings, and the first that is complete is
taken. Units and signs are the firmware's: degrees, millimetres in `stateEstimateZ`, a pitch that is
positive nose up, and so is `ratePitch`; the gyro is not inverted. Blocks with the same time stamps
are joined, and a battery that is logged at a lower rate is repeated.

Source: Crazyflie firmware 2025.12, src/modules/src/stabilizer.c, stabilizer_types.h,
quatcompress.h; docs on log blocks.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import polars

from maidenflight.errors import InputError
from maidenflight.flights import compensation, tables
from maidenflight.flights.formats import LoggedFlights, TableFormat
from maidenflight.flights.log import GRAVITY, flight_of
from maidenflight.flights.streams import attitudes, streams
from maidenflight.flights.tables import Table
from maidenflight.simulator.physics.battery import MOST_COUNTS

CLOCKS = ("timestamp", "time", "t")
"""Names of the column of time, in any case; ms if its steps are 1 or more, us from 1000, else s."""


class Spelling(NamedTuple):
    """One way in which a signal may be logged."""

    columns: tuple[str, ...]
    si: Callable[[np.ndarray], np.ndarray]
    """From the columns' values, (N, columns), to SI units and our signs."""


def _compressed(values: np.ndarray) -> np.ndarray:
    """Roll, pitch, yaw of a 32-bit quaternion.

    Two bits name its largest component; ten each hold sign and size of the others.
    """
    code = np.where((values >= 0) & (values < 2**32), values, 0)[:, 0].astype(np.uint64)
    largest = (code >> np.uint64(30)).astype(int)
    quaternion = np.zeros((len(code), 4))
    for component in (3, 2, 1, 0):
        other = largest != component
        size = (code & np.uint64(511)).astype(float) / 511 * np.sqrt(0.5)
        signed = np.where(code & np.uint64(512), -size, size)
        quaternion[:, component] = np.where(other, signed, 0.0)
        code = np.where(other, code >> np.uint64(10), code)
    rest = np.sqrt(np.clip(1 - (quaternion**2).sum(axis=1), 0.0, 1.0))
    quaternion[np.arange(len(code)), largest] = rest
    return np.where(np.isfinite(values), attitudes.of_quaternions(quaternion), np.nan)


def _columns(pattern: str, *names: str) -> tuple[str, ...]:
    return tuple(pattern.format(name) for name in names)


def _scaled(*factors: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda values: values * np.array(factors)


_DEGREE, _ANGLES = np.pi / 180, ("roll", "pitch", "yaw")
_XYZ, _MOTORS = ("x", "y", "z"), ("1", "2", "3", "4")
SPELLINGS: dict[str, tuple[Spelling, ...]] = {
    "position": (
        Spelling(_columns("stateEstimate.{}", *_XYZ), _scaled(1.0)),
        Spelling(_columns("stateEstimateZ.{}", *_XYZ), _scaled(1e-3)),
    ),
    "velocity": (
        Spelling(_columns("stateEstimate.v{}", *_XYZ), _scaled(1.0)),
        Spelling(_columns("stateEstimateZ.v{}", *_XYZ), _scaled(1e-3)),
    ),
    "attitude": (
        Spelling(_columns("stateEstimate.q{}", *_XYZ, "w"), attitudes.of_quaternions),
        Spelling(("stateEstimateZ.quat",), _compressed),
        Spelling(_columns("stateEstimate.{}", *_ANGLES), _scaled(_DEGREE, -_DEGREE, _DEGREE)),
        Spelling(_columns("stabilizer.{}", *_ANGLES), _scaled(_DEGREE, -_DEGREE, _DEGREE)),
    ),
    "body_rates": (
        Spelling(_columns("gyro.{}", *_XYZ), _scaled(_DEGREE)),
        Spelling(
            _columns("stateEstimateZ.rate{}", "Roll", "Pitch", "Yaw"), _scaled(1e-3, -1e-3, 1e-3)
        ),
    ),
    "PWM": (
        Spelling(_columns("motor.m{}", *_MOTORS), _scaled(1.0)),
        Spelling(_columns("pwm.m{}_pwm", *_MOTORS), _scaled(1.0)),
    ),
    "battery": (Spelling(("pm.vbat",), _scaled(1.0)), Spelling(("pm.vbatMV",), _scaled(1e-3))),
}
"""Signals that are needed, by their spellings."""
OPTIONAL: dict[str, tuple[Spelling, ...]] = {
    "setpoint": (Spelling(_columns("ctrltarget.{}", *_XYZ), _scaled(1.0)),),
    "thrust": (Spelling(("controller.cmd_thrust",), _scaled(1.0)),),
    "accelerometer": (Spelling(_columns("acc.{}", *_XYZ), _scaled(GRAVITY)),),
    "rotor speed": (
        Spelling(_columns("rpm.m{}", *_MOTORS), _scaled(2 * np.pi / 60)),
        # Firmware of 2026: electrical turns, of motors with 12 magnet poles.
        Spelling(_columns("motor.m{}_erpm", *_MOTORS), _scaled(2 * np.pi / 60 / 6)),
    ),
}
"""Signals that may be there, likewise."""
_LEAST_US = 1000.0
"""Step of the clock from which it counts microseconds: milliseconds would be rows 1 s apart."""
_LOOP = 0.0025
"""Period below which a log holds every command of the firmware's loop of 500 Hz [s]."""

_KNOWN = {
    column
    for ways in (*SPELLINGS.values(), OPTIONAL["accelerometer"])
    for way in ways
    for column in way.columns
}


def recognises(table: Table) -> bool:
    """Returns whether a clock and three or more columns are log variables of the firmware."""
    columns = set(table.frame.columns)
    return len(_KNOWN & columns) >= 3 and not {f"{key}.time" for key in ("motor", "gyro")} & columns


def flights(table: Table) -> LoggedFlights:
    """Returns flight in a table, unchecked, with the time of its rows [s], and what was assumed.

    Position, velocity and attitude may be missing together where there is an accelerometer.

    Raises:
        InputError: a signal is missing, or is never in the same row as the others; or its battery
            law is not known.
    """
    columns = table.frame.columns
    clock = next((name for known in CLOCKS for name in columns if name.lower() == known), None)
    if clock is None:
        raise InputError(
            f"{table.name}: missing the column of time; expected {', '.join(CLOCKS)}, in "
            "milliseconds or seconds."
        )
    spellings = _chosen(table)
    names = [clock, *(name for way in spellings.values() for name in way.columns)]
    read = _together(tables.numbers(table, names), clock)
    values = {
        signal: way.si(np.stack([read[column] for column in way.columns], axis=-1))
        for signal, way in spellings.items()
    }
    rows = len(read[clock])
    volts = _hold_last(values["battery"][:, 0]) if "battery" in values else np.full(rows, np.nan)
    needed = {signal: values[signal] for signal in SPELLINGS if signal in values}
    _refuse_gaps(table.name, {name: result for name, result in needed.items() if name != "battery"})
    thrust = values["thrust"][:, 0] if "thrust" in values else None
    law, law_choice = compensation.choose_law(table.head, table.name, values["PWM"], volts, thrust)
    stamps = read[clock][np.isfinite(read[clock])]
    step = np.median(np.diff(stamps)) if len(stamps) > 1 else 10.0
    unit = 1e-6 if abs(step) >= _LEAST_US else 1e-3 if abs(step) >= 1 else 1.0
    with np.errstate(invalid="ignore"):  # what is not finite is refused by checking
        time = (read[clock] - read[clock][0]) * unit
    period = streams.period(time)
    known = ("position", "velocity", "attitude", "body_rates", "setpoint", "accelerometer")
    flight = flight_of(
        table.name,
        period,
        **{signal: values.get(signal) for signal in known},
        command=compensation.thrust_command(values["PWM"], volts, law),
        battery=volts,
        zero_order_hold=period < _LOOP,
        full_scale_counts=MOST_COUNTS,
        assumed=period >= _LOOP,
        assumed_law=law if law_choice == compensation.BY_VOLTAGE else None,
        rotor_speed=values.get("rotor speed"),
    )
    notes = [compensation.note(table.name, law, law_choice)]
    if unit == 1e-6:
        notes.append(f"{table.name}: {clock} taken as microseconds, its step is {step:g}")
    return [(flight, time)], notes


def _chosen(table: Table) -> dict[str, Spelling]:
    """How each signal that a table has is spelt."""
    present = set(table.frame.columns)
    ways = SPELLINGS | OPTIONAL
    spellings = {
        signal: next(way for way in some if present >= set(way.columns))
        for signal, some in ways.items()
        if any(present >= set(way.columns) for way in some)
    }
    needed = set(SPELLINGS)
    if "accelerometer" in spellings and not {"position", "velocity", "attitude"} & set(spellings):
        needed = {"body_rates", "PWM"}
    lacking = [
        f"{signal} ({' or '.join(', '.join(way.columns) for way in SPELLINGS[signal])})"
        for signal in SPELLINGS
        if signal in needed and signal not in spellings
    ]
    if lacking:
        prefix = f"{table.head['what']}, " if "what" in table.head else ""
        raise InputError(
            f"{table.name}: {prefix}missing {'; '.join(lacking)}. Add them to the log's variables."
        )
    return spellings


def _together(read: dict[str, np.ndarray], clock: str) -> dict[str, np.ndarray]:
    """Joins rows of one time, each column by its first number: blocks come as own rows."""
    has_gaps = any(np.isnan(values).any() for values in read.values())
    if not has_gaps or not (read[clock][1:] == read[clock][:-1]).any():
        return read
    frame = polars.DataFrame(read).fill_nan(None)
    rest = [polars.col(column).drop_nulls().first() for column in read if column != clock]
    merged = frame.group_by(polars.col(clock), maintain_order=True).agg(rest)
    filled = merged.select(polars.col(*read).cast(polars.Float64).fill_null(float("nan")))
    return {column: filled[column].to_numpy() for column in read}


def _hold_last(values: np.ndarray) -> np.ndarray:
    """Each gap filled by the number before it, the first by the one after."""
    series = polars.Series(values).fill_nan(None)
    return series.forward_fill().backward_fill().fill_null(float("nan")).to_numpy()


def _refuse_gaps(name: str, values: dict[str, np.ndarray]) -> None:
    finite = {signal: np.asarray(np.isfinite(rows).all(axis=1)) for signal, rows in values.items()}
    both = np.all(list(finite.values()), axis=0).sum()
    fewest = min(finite, key=lambda signal: finite[signal].sum())
    if both < 0.5 * finite[fewest].sum():
        counts = ", ".join(f"{signal} {rows.sum()}" for signal, rows in finite.items())
        raise InputError(
            f"{name}: only {both} of {len(finite[fewest])} rows hold all signals (rows with each: "
            f"{counts}); blocks were logged apart. Lay them together by their time first."
        )


FORMAT = TableFormat(
    "log variables of a Crazyflie ('stateEstimate.x', 'gyro.x', ...)",
    recognises,
    flights,
    compensated=True,
)
