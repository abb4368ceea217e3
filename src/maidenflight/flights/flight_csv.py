"""A flight in our own format: CSV with comments, or a Parquet table; docs/flight-log.md."""

import itertools
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import polars
from jaxtyping import Float

from maidenflight import results
from maidenflight.errors import InputError
from maidenflight.flights import tables
from maidenflight.flights.log import (
    ACCELEROMETER_DELAY,
    GROUPS,
    GYRO_DELAY,
    LONGEST_DELAY,
    OPTIONAL,
    SUBSAMPLED,
    TRUTH,
    ZERO_ORDER_HOLD,
    Flight,
    flight_of,
)
from maidenflight.flights.tables import Table
from maidenflight.inputs import StrPath
from maidenflight.simulator.physics.battery import COUNTS, MOST_COUNTS

FAMILY = "# maidenflight flight"
MARK = f"{FAMILY} 3"
"""How a file in our format begins."""

_COLUMNS = tuple(column for columns in GROUPS.values() for column in columns)

_DELAYS = {"accelerometer_delay": ACCELEROMETER_DELAY, "gyro_delay": GYRO_DELAY}
"""Comments of a log that tell a delay where it is not the usual one [s]."""

_LEGEND = (
    "time s; position m and velocity m/s in the world, z up; roll, pitch, yaw rad (ZYX, positive "
    "pitch nose down); body_rate rad/s, x forward, y left, z up; command = normalised thrust u "
    "from 0 of motors 1..4 (front right, back right, back left, front left), what the battery "
    "could give of it; battery V; setpoint m"
)


def to_csv(flight: Flight, record: Mapping[str, Any] | None = None) -> str:
    """Returns the text of a flight in our format: comments, a header line, a line a row.

    NaN is an empty cell, and a signal that is None has no column.
    """
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
