"""The formats that flights are read from, and how a file is known to be in one.

Tables are known by their columns, recordings of several signals by their first bytes. Which formats
there are `registry.LOG_FORMATS` says.
"""

import itertools
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from maidenflight import inputs, results
from maidenflight.errors import InputError, printable
from maidenflight.flights import compensation, flight_csv, tables
from maidenflight.flights.log import Flight
from maidenflight.flights.maps import column_map, proposal
from maidenflight.flights.tables import Table
from maidenflight.registry import LOG_FORMATS

_NEEDED = {
    "motors": re.compile(r"mot|pwm|esc|thrott|command|cmd|act", re.IGNORECASE),
    "body rates": re.compile(r"gyro|rate|omega|ang|wx|\bp\b", re.IGNORECASE),
}
"""How columns of signals that every log needs are called, more or less."""
TABLES = (".csv", ".csv.gz", ".parquet")
"""Endings of files with tables."""
HEAD = 128
"""Bytes of a file's beginning by which it is known."""
LoggedFlights = tuple[list[tuple[Flight, np.ndarray]], list[str]]
"""Flights as they were logged, each with the time of its rows [s], and notes."""


class TableFormat(NamedTuple):
    """A way of writing flights down in a table; a battery law reads `compensated` PWM as thrust."""

    description: str
    recognises: Callable[[Table], bool]
    flights: Callable[[Table], LoggedFlights]
    compensated: bool = False


class PackedTable(NamedTuple):
    """A binary way of writing a table with columns of a `TableFormat`; files have no ending."""

    description: str
    recognises: Callable[[bytes], bool]
    """By its first `HEAD` bytes, or more."""
    table: Callable[[bytes, str], Table]
    """Of a file's bytes, and the name that errors call it by."""


class Recording(NamedTuple):
    """A binary way of writing flights down, with signals that have rates of their own."""

    description: str
    suffixes: tuple[str, ...]
    """Endings of its files, in lower case."""
    begins: bytes
    """First bytes of its files."""
    flights: Callable[[Path, str], LoggedFlights]
    """Of a file, and the name that errors call it by."""
    shared: tuple[str, ...] = ()
    """Further endings, which others' files have too, so that their first bytes tell."""
    named: bool = False
    """Whether others begin as they do, so that its ending must fit too."""
    within: bytes = b""
    """What the beginning of files with its further endings holds if the first bytes are lost."""
    setting: str = ""
    """What makes its recorder log what identification needs, for people; "" if nothing is known."""


LogFormat = TableFormat | PackedTable | Recording
Kind = TypeVar("Kind", TableFormat, PackedTable, Recording)
OWN = TableFormat(
    f"maidenflight's own log ('{flight_csv.MARK}', see docs/flight-log.md)",
    flight_csv.recognises,
    flight_csv.flights,
)


class Logged(NamedTuple):
    """What a log, or a part of a long one, holds, unchecked."""

    name: str
    """What errors and notes call the file."""
    flights: list[tuple[Flight, np.ndarray]]
    """With the time of their rows [s]."""
    notes: list[str]


def suffixes() -> tuple[str, ...]:
    """Returns the endings of files that are searched for in folders."""
    endings = (kind.suffixes + kind.shared for kind in _formats(Recording))
    return (*TABLES, *itertools.chain.from_iterable(endings))


def is_log(file: Path) -> bool:
    """Tests whether a file may be a log, by its ending or its first bytes."""
    name = file.name.lower()
    if file.name.endswith(TABLES):
        return True
    if "." not in name:
        head = _beginning(file)
        return any(kind.recognises(head) for kind in _formats(PackedTable))
    recordings = list(_formats(Recording))
    if any(name.endswith(kind.shared) for kind in recordings):
        own = _recording(file)
        return own is not None and name.endswith(own.shared)
    return any(name.endswith(kind.suffixes) for kind in recordings)


def logged(
    file: Path, battery_law: str | None = None, law_of_drone: str | None = None
) -> Iterator[Logged] | Table:
    """Returns the flights in a file as they were logged; of a table in no known format, the table.

    A long table is read in parts, one after another, so that memory is bounded.

    Args:
        file: to be read.
        battery_law: a key of `compensation.LAWS`, whatever the log says.
        law_of_drone: one that is taken where the log does not decide.

    Raises:
        InputError: the file is damaged, or its commands are read by no battery law.
    """
    name, ours = _name(file), LOG_FORMATS.own
    recording, parts, table, kind = _recording(file, ours), iter(()), None, None
    if recording is None:
        with suppress(InputError):
            parts = _tables(file, name, ours)
            table = next(parts)
            kind = _format_of(table, ours)
    if recording is None and kind is None:
        # Installed packages are tried only with what is in no format of ours.
        recording = _recording(file)
    if recording is not None:
        if battery_law:
            raise InputError(_no_law(name))
        with np.errstate(over="ignore", invalid="ignore"):
            # Rows with what is not finite are dropped by `checking`.
            logs, notes = recording.flights(file, name)
        return iter([Logged(name, logs, notes)])
    if table is None:
        parts = _tables(file, name)
        table = next(parts)
    map_file = column_map.map_path(file)
    kind = _by_map(map_file) if map_file.exists() else kind or _format_of(table)
    if kind is None:
        return table
    if battery_law and not kind.compensated:
        raise InputError(_no_law(name))
    keys = compensation.LAW_OF_THE_HEAD, compensation.LAW_OF_THE_DRONE
    laws = zip(keys, (battery_law, law_of_drone), strict=True)
    head = {key: law for key, law in laws if law}
    return (
        Logged(name, *_with_notes(part, kind.flights(replace(part, head=part.head | head))))
        for part in itertools.chain([table], parts)
    )


def _by_map(map_file: Path) -> TableFormat:
    """The format of a table whose columns a file beside it describes."""
    columns = column_map.read(map_file)

    def flights(table: Table) -> LoggedFlights:
        with np.errstate(over="ignore", invalid="ignore"):
            flight, time, notes = column_map.flight(table, columns)
        return [(flight, time)], notes

    return TableFormat(f"a table with {map_file.name}", lambda _: True, flights)


def _with_notes(part: Table, logs: LoggedFlights) -> LoggedFlights:
    return logs[0], [*part.notes, *logs[1]]


def settings(files: Iterable[Path]) -> list[str]:
    """Returns what to set on the recorders of files, each once, where it is known."""
    kinds = [kind for file in files if (kind := _recording(file)) is not None]
    return list(dict.fromkeys(kind.setting for kind in kinds if kind.setting))


def unknown(table: Table) -> str:
    """Returns what is wrong with a table in no known format."""
    columns = ",".join(table.frame.columns)
    lacking = [signal for signal, words in _NEEDED.items() if not words.search(columns)]
    lack = f" It seems to hold no {' and no '.join(lacking)}, without which" if lacking else ""
    lack += " no drone can be identified." if lacking else ""
    names = [kind.description for kind in map(_imported, LOG_FORMATS) if not isinstance(kind, str)]
    return (
        f"{table.name}: unknown format; its columns are {columns[:60]!r}.{lack} Known are "
        f"{'; '.join(names)}.{_unusable()} {_help(table)}"
    )


def _help(table: Table) -> str:
    """What makes a table of unknown columns be read."""
    if proposal.propose(table) is not None:
        return "maidenflight log --map-columns writes and reads a map of its columns beside it."
    return (
        "Say in NAME.columns.toml beside it which columns hold time, body rates and motors; see "
        "docs/flight-log.md."
    )


def write_map(file: Path) -> Path | None:
    """Writes a map of the columns of a table in no known format beside it.

    Returns:
        The map; none where there is one, the format is known, names show too little or the file is
        damaged.
    """
    map_file, table = column_map.map_path(file), None
    if map_file.exists() or not file.name.endswith(TABLES):
        return None
    with suppress(InputError):
        table = logged(file)
    columns = proposal.propose(table) if isinstance(table, Table) else None
    if columns is None:
        return None
    return results.write(map_file, column_map.text(columns))


def _no_law(name: str) -> str:
    return (
        f"{name}: its commands are not read by a battery law. Leave it out, or give only logs of "
        "a Crazyflie's PWM."
    )


def _name(file: Path) -> str:
    return printable("/".join(filter(None, (file.parent.name, file.name))))


def _beginning(file: Path) -> bytes:
    """The first bytes of a file; none of one that cannot be read."""
    try:
        return inputs.beginning(file, HEAD)
    except OSError:
        return b""


def _recording(file: Path, names: Iterable[str] = LOG_FORMATS) -> Recording | None:
    head, ending = _beginning(file), file.name.lower()
    for kind in _formats(Recording, names):
        if head.startswith(kind.begins) and (not kind.named or ending.endswith(kind.suffixes)):
            return kind
        if kind.within and kind.within in head and ending.endswith(kind.shared):
            return kind
    return None


def _format_of(table: Table, names: Iterable[str] = LOG_FORMATS) -> TableFormat | None:
    return next((kind for kind in _formats(TableFormat, names) if kind.recognises(table)), None)


def _tables(file: Path, name: str, names: Iterable[str] = LOG_FORMATS) -> Iterator[Table]:
    """The table in a file, of a long one in parts."""
    if file.name.endswith(TABLES) and tables.is_long(file):
        return tables.parts(file, name)
    return iter([_table(file, name, names)])


def _table(file: Path, name: str, names: Iterable[str]) -> Table:
    raw = tables.content(file)
    packed = next((kind for kind in _formats(PackedTable, names) if kind.recognises(raw)), None)
    if packed is not None:
        return packed.table(raw, name)
    recordings = list(_formats(Recording, names))
    recording = next((kind for kind in recordings if raw.startswith(kind.begins)), None)
    if recording is not None and not recording.named:
        raise InputError(f"{name}: a {recording.description}, compressed. Decompress it.")
    promised = next((kind for kind in recordings if file.suffix.lower() in kind.suffixes), None)
    if promised is not None:
        raise InputError(
            f"{name}: not a {promised.description} (it begins with {raw[:4]!r}). Copy it again, or "
            "give it the ending of what it is."
        )
    try:
        return tables.parsed(raw, file, name)
    except InputError as error:
        raise InputError(f"{error}{_unusable(names)}") from error


def _formats(kind: type[Kind], names: Iterable[str] = LOG_FORMATS) -> Iterator[Kind]:
    """The formats of a kind that can be used, ours before those of installed packages."""
    return (log_format for log_format in map(_imported, names) if isinstance(log_format, kind))


def _imported(name: str) -> LogFormat | str:
    """A format by name; of an installed package that is damaged, what is wrong."""
    try:
        log_format = LOG_FORMATS[name]
    except InputError as error:
        return str(error)
    if not isinstance(log_format, LogFormat):
        wrong = f"a {type(log_format).__name__}; expected a flights.formats.LogFormat."
        return f"log format {name!r}: {wrong}"
    return log_format


def _unusable(names: Iterable[str] = LOG_FORMATS) -> str:
    """Sentences on formats of installed packages that cannot be used."""
    logs = [problem for problem in map(_imported, names) if isinstance(problem, str)]
    return "".join(f" {problem}" for problem in logs)
