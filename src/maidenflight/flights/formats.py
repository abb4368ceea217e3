"""The formats that flights are read from, and how a file is known to be in one.

Tables are known by their columns, recordings of several signals by their first bytes.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from maidenflight import inputs
from maidenflight.errors import InputError
from maidenflight.flights import compensation, log, tables
from maidenflight.flights.log import Flight
from maidenflight.flights.tables import Table
from maidenflight.integrations.logs import (
    authors,
    blackbox,
    cflib,
    nanobench,
    rosbag,
    ulog,
    usddeck,
)

TABLES = (".csv", ".csv.gz", ".parquet")
"""Endings of files with tables."""
HEAD = 64
"""Bytes of a file's beginning by which recordings are known."""
Found = tuple[list[tuple[Flight, np.ndarray]], list[str]]
"""Flights as they were logged, each with the time of its rows [s], and notes."""


class Format(NamedTuple):
    """A way of writing flights down in a table.

    `compensated` says whether its commands are PWM that a battery law reads as thrust.
    """

    what: str
    recognises: Callable[[Table], bool]
    flights: Callable[[Table], Found]
    compensated: bool = False


class Recording(NamedTuple):
    """A binary way of writing flights down, with signals that have rates of their own."""

    what: str
    suffixes: tuple[str, ...]
    """Endings of its files, in lower case."""
    recognises: Callable[[bytes], bool]
    """By its first `HEAD` bytes."""
    flights: Callable[[Path, str], Found]
    """Of a file, and the name that errors call it by."""
    may_be_text: bool = False
    """Whether files of it may end in .txt."""
    named: bool = False
    """Whether others begin as they do, so that its ending must fit too."""


FORMATS = (
    Format(
        f"maidenflight's own log ('{log.MARK}', see docs/flight-log.md)",
        log.recognises,
        log.flights,
    ),
    Format("the 22 columns of Gronauer et al.", authors.recognises, authors.flights),
    Format("NanoBench's 51 columns", nanobench.recognises, nanobench.flights, True),
    Format(
        "log variables of a Crazyflie ('stateEstimate.x', 'gyro.x', ...)",
        cflib.recognises,
        cflib.flights,
        True,
    ),
)
RECORDINGS = (
    Recording("PX4 ULog", (".ulg",), ulog.recognises, ulog.flights),
    Recording(
        "Betaflight blackbox log", (".bbl", ".bfl"), blackbox.recognises, blackbox.flights, True
    ),
    Recording("MCAP recording", (".mcap",), rosbag.recognises_mcap, rosbag.flights),
    Recording("rosbag2 in SQLite", (".db3",), rosbag.recognises_sqlite, rosbag.flights, named=True),
)
SUFFIXES = (*TABLES, *(suffix for kind in RECORDINGS for suffix in kind.suffixes))
"""Endings of files that are searched for in folders."""


class Logged(NamedTuple):
    """What a log holds, unchecked."""

    name: str
    """What errors and notes call the file."""
    flights: list[tuple[Flight, np.ndarray]]
    """With the time of their rows [s]."""
    notes: list[str]


def is_log(file: Path) -> bool:
    """Whether a file may be a log, by its ending or, where that does not tell, its first bytes."""
    name = file.name.lower()
    if file.name.endswith(TABLES) or name.endswith(SUFFIXES[len(TABLES) :]):
        return True
    if name.endswith(".txt"):
        kind = _recording(file)
        return kind is not None and kind.may_be_text
    return "." not in name and usddeck.recognises(_beginning(file))


def logged(file: Path, battery_law: str | None = None) -> Logged | Table:
    """The flights in a file as they were logged; of a table in no known format, the table.

    Args:
        file: to be read.
        battery_law: a key of `compensation.LAWS`, whatever the log says.

    Raises:
        InputError: the file is damaged, or its commands are read by no battery law.
    """
    name = _name(file)
    recording = _recording(file)
    if recording is not None:
        if battery_law:
            raise InputError(_no_law(name))
        with np.errstate(over="ignore", invalid="ignore"):
            # Rows with what is not finite are dropped by `checking`.
            found, notes = recording.flights(file, name)
        return Logged(name, found, notes)
    table = _table(file, name)
    kind = next((kind for kind in FORMATS if kind.recognises(table)), None)
    if kind is None:
        return table
    if battery_law:
        if not kind.compensated:
            raise InputError(_no_law(name))
        table = replace(table, head={**table.head, compensation.SAID_IN_HEAD: battery_law})
    found, notes = kind.flights(table)
    return Logged(name, found, [*table.notes, *notes])


def unknown(table: Table) -> str:
    """What is wrong with a table in no known format."""
    columns = ",".join(table.frame.columns)
    known = [*(kind.what for kind in FORMATS), *(kind.what for kind in RECORDINGS)]
    return (
        f"{table.name}: unknown format; its columns are {columns[:60]!r}. Known are "
        f"{'; '.join(known)}."
    )


def _no_law(name: str) -> str:
    return (
        f"{name}: its commands are not read by a battery law. Leave it out, or give only logs of "
        "a Crazyflie's PWM."
    )


def _name(file: Path) -> str:
    return "/".join(filter(None, (file.parent.name, file.name)))


def _beginning(file: Path) -> bytes:
    """The first bytes of a file; none of one that cannot be read."""
    try:
        return inputs.beginning(file, HEAD)
    except OSError:
        return b""


def _recording(file: Path) -> Recording | None:
    head = _beginning(file)
    return next(
        (
            kind
            for kind in RECORDINGS
            if kind.recognises(head)
            and (not kind.named or file.name.lower().endswith(kind.suffixes))
        ),
        None,
    )


def _table(file: Path, name: str) -> Table:
    """The table in a file.

    Raises:
        InputError: the file is damaged, or by its ending a recording and none by its beginning.
    """
    raw = tables.content(file)
    if usddeck.recognises(raw):
        return usddeck.table(raw, name)
    packed = next((kind for kind in RECORDINGS if kind.recognises(raw[:HEAD])), None)
    if packed is not None and not packed.named:
        raise InputError(f"{name}: a {packed.what}, compressed. Decompress it.")
    promised = next((kind for kind in RECORDINGS if file.suffix.lower() in kind.suffixes), None)
    if promised is not None:
        raise InputError(
            f"{name}: not a {promised.what} (it begins with {raw[:4]!r}). Copy it again, or give "
            "it the ending of what it is."
        )
    return tables.parsed(raw, file, name)
