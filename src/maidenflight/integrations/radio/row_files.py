"""Rows on disk: every packet of a flight, and the flight log made of them afterwards.

In flight each packet is one line, handed to the operating system before it is used. A program that
is killed loses nothing received; a computer without power loses the last second. The file stays
beside the flight log.
"""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars
from jaxtyping import Float, Int

from maidenflight import inputs, results
from maidenflight.errors import InputError, WriteError
from maidenflight.flights import flight_csv, tables
from maidenflight.flights.log import GROUPS, Flight
from maidenflight.flights.tables import Table
from maidenflight.integrations.logs import cflib
from maidenflight.integrations.radio.blocks import MOTORS, PERIOD, STATE, Block

SUFFIX = ".rows"
MARK = "# maidenflight rows 1"
_LEGEND = (
    "packets of a Crazyflie's log blocks as they came, in the firmware's units; timestamp "
    "ms of the drone, received s of the program"
)
_WRAP = 1 << 24
"""A packet's time stamp has 24 bits [ms] (Crazyflie firmware, log.c)."""
_LONGEST = 900_000
"""Longest flight [ms]: more than can be set, with take-off and landing."""
_WIDEST = 15
"""Distance of two packets of a block [ms] over which the other block's instant may be
interpolated."""
_SYNC = 1.0
"""Time between two orders to put the rows onto the disk itself [s]."""


class RowFile:
    """An append-only file of rows.

    Writing never raises: what goes wrong stands in `error`, for the drone must be landed first.
    """

    def __init__(
        self, path: Path, blocks: Sequence[Block], simulated: str, record: Mapping[str, Any]
    ) -> None:
        """Makes the file.

        Args:
            path: must not exist.
            blocks: what will be written.
            simulated: name of the simulation that answers; empty for a real drone.
            record: of the making.

        Raises:
            WriteError: it cannot be made.
        """
        self.path, self.error, self.rows = path, None, 0
        self._columns = [name for block in blocks for name in block.variables]
        self._synced = -np.inf
        head = [
            f"{MARK}: {_LEGEND}",
            f"# simulated: {simulated or 'no'}",
            results.record_line(record),
        ]
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._descriptor = os.open(
                path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o644
            )
        except OSError as error:
            raise WriteError(path, error) from error
        self._write("\n".join([*head, ",".join(["timestamp", "received", *self._columns])]) + "\n")

    error: OSError | None
    """Why rows are no longer written."""
    rows: int
    """Rows written."""

    def append(self, stamp: int, received: float, values: Mapping[str, float]) -> None:
        """Writes one packet.

        Args:
            stamp: the drone's [ms].
            received: the program's [s].
            values: of its variables.
        """
        cells = (repr(values[name]) if name in values else "" for name in self._columns)
        if self._write(f"{stamp},{received:.4f},{','.join(cells)}\n"):
            self.rows += 1
            if received - self._synced > _SYNC:
                self._synced = received
                self._sync()

    def _write(self, text: str) -> bool:
        rest = text.encode()
        try:
            while rest and self.error is None:
                rest = rest[os.write(self._descriptor, rest) :]
        except OSError as error:
            self.error = error
        return self.error is None

    def close(self) -> None:
        """Puts all rows onto the disk."""
        self._sync()
        os.close(self._descriptor)

    def _sync(self) -> None:
        try:
            os.fsync(self._descriptor)
        except OSError as error:
            self.error = self.error or error


def to_flight(path: Path) -> tuple[Flight, dict[str, Any], tuple[str, ...]]:
    """Returns the flight of a file of rows: one row each 10 ms, NaN where a packet is missing.

    Each row is a packet of the state; the motors' values are those of the same instant, or
    interpolated between the two nearest packets.

    Returns:
        The flight, the record of its making, and notes.

    Raises:
        InputError: the file cannot be read, is no such file, or no instant has both packets.
    """
    table = tables.read(path, f"{path.parent.name}/{path.name}")
    if not table.mark.startswith(MARK):
        raise InputError(
            f"{table.name}: line 1 is not '{MARK}' but {table.mark[:60]!r}. Give a file that "
            "maidenflight record left."
        )
    columns = [*STATE.variables, *MOTORS.variables]
    read = {
        name: np.where(np.isfinite(values), values, np.nan)
        for name, values in tables.numbers(table, ["timestamp", *columns]).items()
    }
    odd = ~((read["timestamp"] >= 0) & (read["timestamp"] < _WRAP))
    if odd.any():
        raise InputError(
            f"{table.name}: timestamp in {table.location(int(odd.argmax()))} is none; expected "
            "milliseconds of 24 bits. Drop the line."
        )
    stamps = _unwrapped(read["timestamp"])
    if np.ptp(stamps) > _LONGEST:
        raise InputError(
            f"{table.name}: timestamps are {np.ptp(stamps) / 1000:.0f} s apart, more than a "
            "flight lasts. Drop the odd lines."
        )
    state, motors = (_packets(table, block, stamps) for block in (STATE, MOTORS))
    if len(state) < 2 or len(motors) < 2:
        raise InputError(
            f"{table.name}: {len(state)} packets of the state and {len(motors)} of the motors, "
            "too few for a flight."
        )
    at, before, weight = _match_instants(stamps[state], stamps[motors])
    values = {name: read[name][state][at] for name in STATE.variables}
    for name in MOTORS.variables:
        series = read[name][motors]
        after = series[np.minimum(before + 1, len(series) - 1)]
        between = (1 - weight) * series[before] + weight * after
        values[name] = np.where(weight > 0, between, series[before])
    if len(at) == 0:
        raise InputError(f"{table.name}: no instant at which both blocks were received.")
    frame = polars.DataFrame({"timestamp": stamps[state][at], **values})
    ((flight, time),), notes = cflib.flights(Table(table.name, frame))
    simulated = table.head.get("simulated", "no")
    flight = _on_grid(flight, time, path.stem, "" if simulated == "no" else simulated)
    record = results.parse_record(inputs.comments(path), table.name)
    return flight, record, (*table.notes, *notes)


def write_flight(path: Path, **fields: Any) -> tuple[Path, tuple[str, ...]]:
    """Makes the flight log `NAME.csv` of `NAME.rows`.

    Args:
        path: file of rows.
        fields: what the log's record says beside what the rows' record does.

    Returns:
        The log, and notes.

    Raises:
        InputError: see `to_flight`.
        WriteError: it cannot be written.
    """
    flight, record, notes = to_flight(path)
    record["settings"] = {**record.get("settings", {}), **fields}
    return flight_csv.write(path.with_suffix(".csv"), flight, record), notes


def recover(folder: Path) -> tuple[list[Path], list[str]]:
    """Makes the flight logs that are missing in a folder, as after a crash.

    Returns:
        The logs made, and why others could not be.
    """
    recovered, refused, ended = [], [], "unknown: the program ended before the flight did"
    for path in sorted(folder.glob(f"*{SUFFIX}")):
        if not path.with_suffix(".csv").exists():
            try:
                recovered.append(write_flight(path, ended=ended)[0])
            except InputError as error:
                refused.append(str(error))
    return recovered, refused


def _packets(table: Table, block: Block, stamps: Float[np.ndarray, "N"]) -> Int[np.ndarray, "M"]:
    """Rows of a block's packets by time, each once: a radio may repeat and swap them."""
    # Not a number was sent, empty was not: only floats can be the one, only integers tell the
    # other.
    whole = next(name for name, kind in block.variables.items() if kind != "FP16")
    rows = np.flatnonzero(table.frame[whole].is_not_null().to_numpy())
    return rows[np.unique(stamps[rows], return_index=True)[1]]


def _unwrapped(stamps: Float[np.ndarray, "N"]) -> Float[np.ndarray, "N"]:
    """Time stamps that go on where the drone's counter begins again [ms].

    Two packets about that instant may be swapped.
    """
    leaps = np.diff(stamps, prepend=stamps[:1])
    laps = np.cumsum((leaps < -_WRAP / 2).astype(int) - (leaps > _WRAP / 2))
    return stamps + laps * _WRAP


def _match_instants(
    state: Float[np.ndarray, "A"], motors: Float[np.ndarray, "B"]
) -> tuple[Int[np.ndarray, "N"], Int[np.ndarray, "N"], Float[np.ndarray, "N"]]:
    """Finds the instants of one block at which the other is known.

    Returns:
        Numbers of those instants; the number of the motors' packet before each, and the weight of
        the one after it.
    """
    before = np.clip(np.searchsorted(motors, state + 1e-6) - 1, 0, len(motors) - 2)
    gap = motors[before + 1] - motors[before]
    weight = np.clip((state - motors[before]) / np.maximum(gap, 1e-6), 0.0, 1.0)
    nearer = np.where(weight > 0.5, before + 1, before)
    same = np.abs(motors[nearer] - state) <= 1.0
    between = (state >= motors[before]) & (state <= motors[before + 1]) & (gap <= _WIDEST)
    at = np.flatnonzero(same | between)
    return at, np.where(same, nearer, before)[at], np.where(same, 0.0, weight)[at]


def _on_grid(flight: Flight, time: Float[np.ndarray, "N"], name: str, simulated: str) -> Flight:
    """The flight with a row each period; those that are missing are not numbers."""
    number = np.round(time / PERIOD).astype(int)
    index, first = np.unique(number, return_index=True)
    fields: dict[str, Any] = {}
    for group in GROUPS:
        if group != "time":
            values = getattr(flight, group)
            fields[group] = np.full((index[-1] + 1, *values.shape[1:]), np.nan, np.float32)
            fields[group][index] = values[first]
    return Flight(
        name=name,
        period=PERIOD,
        zero_order_hold=False,
        simulated=simulated,
        full_scale_counts=flight.full_scale_counts,
        **fields,
    )
