"""Binary logs of a Crazyflie's micro-SD card deck as a table of the firmware's log variables.

A file begins with 0xBC, its version and the event types with their variables; then records of these
types follow in the order in which they came, and a CRC-32 of everything before it ends the file.
Version 1 stamps records in milliseconds, version 2 in microseconds. `cflib` reads what the
variables mean: they are those that a radio link would log.

Event types are tables of their own. The one with the most records gives the rows; each record of
another type stands in the first row at or after its time, so that its numbers are seen once, when
they were known.

Until 2019 the format was another one: a byte with the number of variables, their names with types,
each behind a comma, a CRC-32; then sets of rows, each a byte with their number, the packed rows
and a CRC-32. Its ticks are microseconds, and its `stateEstimateZ.ratePitch` is positive nose down.

Source: Crazyflie firmware, src/deck/drivers/src/usddeck.c and tools/usdlog/cfusdlog.py (version 2
since 2022).
"""

import struct
import zlib
from array import array
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import polars
from jaxtyping import Float, Int

from maidenflight.errors import InputError
from maidenflight.flights.formats import PackedTable
from maidenflight.flights.tables import Table

MAGIC, HEAD = 0xBC, 5
"""First byte (usddeck.c), and bytes that tell such a log."""
CLOCK = "time"
"""The column of time that is added [s]; it starts at 0."""
_CLOCKS = {1: ("u4", 1e-3), 2: ("u8", 1e-6)}
"""By version: how a record's time is written, and its unit [s] (cfusdlog.py)."""
_LETTERS = frozenset("bBhHiIqQefd")
"""Kinds of number, as Python's `struct` and NumPy name them."""
_BACKWARDS = 1.0
"""Time that a record may lie behind the one before [s]; event types are stamped apart."""


class _Event(NamedTuple):
    """A type of record."""

    name: str
    columns: tuple[str, ...]
    record: np.dtype
    """Layout of a record behind its identifier: the time, then the variables, packed."""


def recognises(raw: bytes) -> bool:
    """Returns whether a file's first bytes are those of such a log."""
    return (
        len(raw) >= HEAD
        and raw[0] == MAGIC
        and int.from_bytes(raw[1:3], "little") in _CLOCKS
        and raw[4] < 4
    )


def table(raw: bytes, name: str) -> Table:
    """Decodes a file; what is whole of one that was cut off or damaged, with a note.

    Raises:
        InputError: the description of the records is damaged, or there are no records.
    """
    version, events, start = _described(raw, name)
    sound = len(raw) >= start + 4 and zlib.crc32(raw[:-4]) == int.from_bytes(raw[-4:], "little")
    end = len(raw) - 4 if sound else len(raw)
    unit = _CLOCKS[version][1]
    places, stop = _records(raw, events, start, end, unit)
    notes = () if sound else (_damage(name, start, stop, end),)
    if not places:
        raise InputError(f"{name}: no rows, the log holds no record. Leave it out.")
    bytes_ = np.frombuffer(raw, np.uint8)
    tables = {number: _gathered(bytes_, at, events[number]) for number, at in places.items()}
    main = max(tables, key=lambda number: len(tables[number]))
    frame = _joined(tables, events, main, unit)
    return Table(name, frame, head={"event": events[main].name}, notes=notes)


def _described(raw: bytes, name: str) -> tuple[int, dict[int, _Event], int]:
    """Version, event types by their identifier, and where the records begin."""
    version, count = struct.unpack_from("<HH", raw, 1)
    events, at = {}, 5
    try:
        for _ in range(count):
            (identifier,) = struct.unpack_from("<H", raw, at)
            title, at = _text(raw, at + 2)
            (variables,) = struct.unpack_from("<H", raw, at)
            at, columns, fields = at + 2, [], []
            for _ in range(variables):
                variable, at = _text(raw, at)
                column, bracket, letter = variable.partition("(")
                if not bracket or letter[:1] not in _LETTERS or letter[1:] != ")":
                    raise ValueError(f"variable {variable[:40]!r} has no known type")
                columns.append(column)
                fields.append((f"f{len(fields)}", f"<{letter[0]}"))
            layout = np.dtype([(CLOCK, f"<{_CLOCKS[version][0]}"), *fields])
            events[identifier] = _Event(title, tuple(columns), layout)
    except (struct.error, ValueError) as error:
        reason = f"its description of the records is damaged at byte {at}: {error}"
        raise InputError(
            f"{name}: not a readable micro-SD log ({reason}). Copy it again."
        ) from error
    return version, events, at


def _text(raw: bytes, at: int) -> tuple[str, int]:
    """The text that begins at a byte and ends with a zero, and where what follows begins."""
    end = raw.index(0, at)
    return raw[at:end].decode("ascii"), end + 1


def _records(
    raw: bytes, events: Mapping[int, _Event], start: int, end: int, unit: float
) -> "tuple[dict[int, array[int]], int]":
    """Where the records of each event type begin, and where the last whole one ends."""
    sizes = {number: event.record.itemsize for number, event in events.items()}
    width = next(iter(events.values())).record[0].itemsize if events else 8
    behind = round(_BACKWARDS / unit)
    places: dict[int, array[int]] = {}
    at, latest = start, 0
    while at + 2 <= end:
        size = sizes.get(raw[at] | raw[at + 1] << 8)
        if size is None or at + 2 + size > end:
            break
        stamp = int.from_bytes(raw[at + 2 : at + 2 + width], "little")
        if stamp < latest - behind:
            break
        latest = max(latest, stamp)
        places.setdefault(raw[at] | raw[at + 1] << 8, array("q")).append(at + 2)
        at += 2 + size
    return places, at


def _damage(name: str, start: int, stop: int, end: int) -> str:
    if end - stop <= 4 or stop == start:
        return (
            f"{name}: cut off in its last record (its checksum does not fit); the records before "
            "it are used"
        )
    share = 100 * (end - stop) / (end - start)
    return (
        f"{name}: damaged or cut off at byte {stop} (its checksum does not fit); the last "
        f"{share:.2g} % of it dropped"
    )


def _gathered(raw: np.ndarray, places: "array[int]", event: _Event) -> np.ndarray:
    """The records at some places as one structured array."""
    windows = np.lib.stride_tricks.sliding_window_view(raw, event.record.itemsize)
    return windows[np.asarray(places)].reshape(-1).view(event.record)


def _joined(
    tables: Mapping[int, np.ndarray], events: Mapping[int, _Event], main: int, unit: float
) -> polars.DataFrame:
    """One table: the main type's records as rows, the others' in the first row after their time."""
    stamps = tables[main][CLOCK].astype(np.int64)
    columns: dict[str, np.ndarray] = {CLOCK: (stamps - stamps[0]) * unit}
    for number, records in tables.items():
        rows = None if number == main else _rows(stamps, records[CLOCK].astype(np.int64))
        for index, column in enumerate(events[number].columns):
            with np.errstate(invalid="ignore"):  # a NaN of damaged bytes may signal
                values = records[f"f{index}"].astype(np.float64)
            spread = values if rows is None else _spread(values, rows, len(stamps))
            columns.setdefault(column, spread)
    return polars.DataFrame(columns)


def _rows(stamps: Int[np.ndarray, "N"], arrived: Int[np.ndarray, "M"]) -> Int[np.ndarray, "M"]:
    """The first row at or after each record's time; N for a record after the last row."""
    return np.searchsorted(np.maximum.accumulate(stamps), arrived)


def _spread(
    values: Float[np.ndarray, "M"], rows: Int[np.ndarray, "M"], count: int
) -> Float[np.ndarray, "N"]:
    """Values in their rows, the latest where several fall into one; elsewhere not a number."""
    column = np.full(count + 1, np.nan)
    column[rows] = values
    return column[:count]


TICK = "tick"
"""The column of time of 2019's format [us]."""
_WHAT_2019 = "a micro-SD log of 2019's format"
_PITCH_RATE = "stateEstimateZ.ratePitch"


def recognises_2019(raw: bytes) -> bool:
    """Returns whether a file's first bytes are those of 2019's format."""
    return raw[1:8] == b"tick(I)" and 0 < raw[0] < 128


def table_2019(raw: bytes, name: str) -> Table:
    """Decodes a file of 2019's format; what is whole of one that was cut off, with a note.

    Raises:
        InputError: its description is damaged, or there are no rows.
    """
    try:
        entries, at = [], 1
        for _ in range(raw[0]):
            end = raw.index(b",", at)
            entries.append(raw[at:end].decode("ascii").partition("("))
            at = end + 1
        if not all(bracket and kind[:1] in _LETTERS for _, bracket, kind in entries):
            raise ValueError("a variable has no known type")
    except ValueError as error:
        reason = f"not a readable micro-SD log of 2019's format ({error})"
        raise InputError(f"{name}: {reason}. Copy it again.") from error
    record = np.dtype([(f"f{index}", f"<{kind[0]}") for index, (_, _, kind) in enumerate(entries)])
    at, sets = at + 4, []
    while at < len(raw):
        end = at + 1 + raw[at] * record.itemsize
        checksum = int.from_bytes(raw[end : end + 4], "little")
        if end + 4 > len(raw) or zlib.crc32(raw[at:end]) ^ 0xFFFFFFFF != checksum:
            break
        sets.append(np.frombuffer(raw, record, raw[at], at + 1))
        at = end + 4
    if not sets:
        raise InputError(f"{name}: no rows, the log holds no whole set of them. Leave it out.")
    rows = np.concatenate(sets)
    with np.errstate(invalid="ignore"):  # a NaN of damaged bytes may signal
        columns = {
            column: rows[f"f{index}"].astype(np.float64)
            for index, (column, _, _) in enumerate(entries)
        }
    ticks = columns.pop(TICK)
    # A clock of 32 bits wraps after 72 minutes.
    steps = np.diff(ticks, prepend=ticks[0])
    time = np.cumsum(np.where(steps < -(2.0**31), steps + 2.0**32, steps)) * 1e-6
    notes = [f"{name}: {_WHAT_2019}; ratePitch is positive nose down in it"]
    if at < len(raw):
        share = 100 * (len(raw) - at) / len(raw)
        notes.append(f"{name}: damaged or cut off at byte {at}; the last {share:.2g} % dropped")
    if _PITCH_RATE in columns:
        columns[_PITCH_RATE] = -columns[_PITCH_RATE]
    frame = polars.DataFrame({CLOCK: time, **columns})
    return Table(name, frame, head={"what": _WHAT_2019}, notes=tuple(notes))


FORMAT_2019 = PackedTable("a Crazyflie's micro-SD log of 2019", recognises_2019, table_2019)
FORMAT = PackedTable("a Crazyflie's micro-SD log", recognises, table)
