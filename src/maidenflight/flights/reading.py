"""Reading flights from a file or a folder, whatever of the known formats they are in.

A folder with unreadable logs still gives the others; one that contradicts physics makes all of
them doubtful. Nothing is passed over without a word but the result tables that maidenflight writes.
"""

import math
import os
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple, TypedDict, Unpack

import numpy as np

from maidenflight import names, run_folder
from maidenflight.errors import InputError, first_few
from maidenflight.flights import compensation, formats, log, not_logs
from maidenflight.flights.checked_log import check_log, cut
from maidenflight.flights.checkup import one_drone
from maidenflight.flights.checkup.columns import check_battery, check_one_motor
from maidenflight.flights.checkup.result import CheckResult, LogWarning, warnings_of
from maidenflight.flights.log import ZERO_ORDER_HOLD, Flight
from maidenflight.flights.sampling import sampled
from maidenflight.flights.tables import Table
from maidenflight.flights.windows import LEAD_IN
from maidenflight.inputs import StrPath

_RESULTS = (
    {"update", "steps", "policy"},
    {"flight", "policy", "reality", "trial"},
    {"trial", "objective"},
    {"model", "horizon"},
    {"policy", "trial", "duration", "end_reason"},
)
"""Columns by which our own result tables are known."""
_DROPPED = re.compile("not used:|dropped|left out|damaged")
"""Notes that say why rows are of no use."""


@dataclass(frozen=True)
class Flights:
    """Checked flights."""

    flights: tuple[Flight, ...]
    notes: tuple[str, ...]
    """What was dropped, and why, and what was assumed, one line each."""
    paths: tuple[Path, ...]
    """The files read."""
    refused: tuple[str, ...] = ()
    """Files of the folder that could not be used, each with its reason."""
    checks: Mapping[str, tuple[CheckResult, ...]] = field(default_factory=dict)
    """The check-up of each log, by its name."""
    warnings: tuple[LogWarning, ...] = ()
    """What makes them doubtful, the surest first."""

    def __repr__(self) -> str:
        periods = sorted({flight.period for flight in self.flights}, reverse=True)
        rates = ", ".join(f"{1 / period:g} Hz" for period in periods)
        return (
            f"<{len(self)} pieces of flight, {self.duration:.1f} s at {rates}, of "
            f"{len(self.paths)} files; notes: {len(self.notes)}>"
        )

    def __len__(self) -> int:
        return len(self.flights)

    def __getitem__(self, number: int) -> Flight:
        return self.flights[number]

    def __iter__(self) -> Iterator[Flight]:
        return iter(self.flights)

    @property
    def duration(self) -> float:
        """[s], all flights together."""
        return sum(flight.duration for flight in self.flights)


COMMANDS = names.COMMANDS
"""What a logged command may stand for; see docs/flight-log.md."""


class LogSettings(TypedDict, total=False):
    """What a user says of logs, in place of what they say themselves."""

    commands: str | None
    """One of `COMMANDS`: zero-order hold if a policy at the log's rate commanded the motors. Logs
    of a Crazyflie's variables do not say, and are taken as subsampled, as of the firmware's PID, by
    default. Taken the wrong way, latency is half a row off."""
    battery_law: str | None
    """A key of `compensation.LAWS`, by which a Crazyflie's PWM is read as thrust."""
    ignore: Collection[str]
    """Signals of `log.OPTIONAL` to pass over as if they had not been logged."""
    faulty: str
    """One of `names.FAULTY_LOGS`: what is done with logs whose check-up fails. The others of a
    folder come from the same recorder, and are refused with them by default."""
    drone: str | None
    """A named drone, whose battery law is taken where a log does not decide."""


def read_flights(
    path: StrPath,
    on_file: Callable[[int, int], None] | None = None,
    most: float = math.inf,
    lead_in: int = LEAD_IN,
    on_flight: Callable[[Flight], None] | None = None,
    **settings: Unpack[LogSettings],
) -> Flights:
    """Reads and checks flights.

    Args:
        path: a file, or a folder that is searched with all its folders for files with one of
            `formats.suffixes`, and for micro-SD logs of a Crazyflie, which have no extension.
        on_file: called with (files read, files found), for a progress bar.
        most: flight to keep [s]. Of more, segments of every flight stay, one file being in
            memory beside them.
        lead_in: rows of commands that a window of a segment has before it.
        on_flight: called with each piece of a flight once it is read and checked.
        **settings: what the user says of the logs; see `LogSettings`.

    Returns:
        Gapless pieces of flights in which the drone flies, in the order of the files' names. A
        flight that two files hold is used once. Of a folder, with the files that were refused and
        why; and a note for each table that is no flight log.

    Raises:
        InputError: nothing there; a single file that is damaged or in an unknown format; a log
            whose check-up fails; nothing usable in the whole set; or an unknown argument.
    """
    options = _ReadOptions.of(settings, str(path))
    path = Path(path)
    paths, refused = _files(path)
    reading = _ReadLog([], [], _unread(path), refused, {}, {}, [])
    read = (
        _set_zero_order_hold(flight, options, reading)
        for flight in _read(paths, path.is_file(), reading, options, on_file)
    )
    if on_flight is not None:
        read = _report_each(read, on_flight)
    flights, duration = sampled(read, most, lead_in)
    if reading.faulty and options.faulty == names.FAULTY_LOGS[0]:
        raise InputError(
            f"{path}: {len(reading.faulty)} of {len(paths)} logs contradict physics, "
            "and the others most likely come from the same recorder. Mend them, or leave these out "
            f"with --faulty skip: {'; '.join(reading.faulty)}"
        )
    if not flights:
        count = len(reading.paths) + len(reading.refused)
        # Why nothing is left comes before what was assumed.
        notes = sorted(reading.notes, key=lambda note: not _DROPPED.search(note))
        reasons = [*reading.refused, *notes, *reading.others]
        raise InputError(_nothing(path, count, reasons))
    loads = {
        name: result.statistic
        for name, results in reading.checks.items()
        for result in results
        if result.name == "thrust to weight" and result.statistic is not None
    }
    if dead := check_battery(flights):
        flights = [replace(piece, battery=np.full_like(piece.battery, np.nan)) for piece in flights]
    selection = Flights(
        tuple(flights),
        (*reading.others, *reading.notes),
        tuple(reading.paths),
        tuple(reading.refused),
        reading.checks,
        (
            *warnings_of(reading.checks),
            *one_drone.compare_loads(loads),
            *check_one_motor(flights, reading.checks),
            *dead,
        ),
    )
    if duration <= most:
        return selection
    note = (
        f"{selection.duration:.0f} of {duration:.0f} s of flight used, stretches of every flight; "
        "more takes more memory and time"
    )
    return replace(selection, notes=(note, *selection.notes))


def _report_each(
    flights: Iterator[Flight], on_flight: Callable[[Flight], None]
) -> Iterator[Flight]:
    for flight in flights:
        on_flight(flight)
        yield flight


class _ReadOptions(NamedTuple):
    """What the user says of the logs; see `LogSettings`."""

    commands: str | None
    battery_law: str | None
    ignore: frozenset[str]
    faulty: str
    law_of_drone: str | None

    @classmethod
    def of(cls, settings: LogSettings, source: str) -> "_ReadOptions":
        """Checks settings; the source is what errors name."""
        faulty = settings.get("faulty", names.FAULTY_LOGS[0])
        commands, law = settings.get("commands"), settings.get("battery_law")
        ignore = settings.get("ignore", ())
        if faulty not in names.FAULTY_LOGS:
            raise InputError(f"faulty {faulty!r}; expected {' or '.join(names.FAULTY_LOGS)}.")
        if commands not in (*COMMANDS, None):
            raise InputError(f"commands {commands!r}; expected {' or '.join(COMMANDS)}.")
        if law is not None:
            compensation.logged_law({compensation.LAW_OF_THE_HEAD: law}, source)
        for signal in ignore:
            if signal not in log.OPTIONAL:
                expected = " or ".join(log.OPTIONAL)
                raise InputError(f"ignore = {signal!r}; expected {expected}, which a log may lack.")
        of_drone = compensation.OF_DRONE.get(settings.get("drone") or "")
        return cls(commands, law, frozenset(ignore), faulty, of_drone)


class _FaultError(InputError):
    """The check-up of a log fails."""


def _set_zero_order_hold(flight: Flight, options: _ReadOptions, reading: "_ReadLog") -> Flight:
    """Sets what commands stand for where the log does not say it, or notes the guess."""
    if options.commands:
        zero_order_hold = options.commands == ZERO_ORDER_HOLD
        return replace(flight, zero_order_hold=zero_order_hold, assumed=False)
    if flight.assumed:
        note = (
            f"{flight.name}: commands taken as subsampled from the firmware's PID; if each "
            f"acted until the next row, give --commands {ZERO_ORDER_HOLD}"
        )
        reading.notes.extend([] if note in reading.notes else [note])
    return flight


class _ReadLog(NamedTuple):
    """What is said of files while they are read."""

    paths: list[Path]
    notes: list[str]
    others: list[str]
    refused: list[str]
    keys: dict[str, np.ndarray]
    """What tells the rows of each file apart, by its name; see `one_drone.row_keys`."""
    checks: dict[str, tuple[CheckResult, ...]]
    """The check-up of each log, by its name."""
    faulty: list[str]
    """Reasons of those that fail it."""


def _read(
    paths: list[Path],
    alone: bool,
    reading: _ReadLog,
    options: _ReadOptions,
    on_file: Callable[[int, int], None] | None,
) -> Iterator[Flight]:
    """Pieces of flights, one file after another."""
    for number, file in enumerate(paths, 1):
        try:
            yield from _of_file(file, alone, reading, options)
        except InputError as error:
            if alone:
                raise
            reading.refused.append(str(error))
            reading.faulty.extend([str(error)] if isinstance(error, _FaultError) else [])
        if on_file is not None:
            on_file(number, len(paths))


def _of_file(file: Path, alone: bool, reading: _ReadLog, options: _ReadOptions) -> Iterator[Flight]:
    """Pieces of the flights of a file; one of several parts is read twice, to check it first."""
    logs = formats.logged(file, options.battery_law, options.law_of_drone)
    if isinstance(logs, Table):
        if alone:
            raise InputError(formats.unknown(logs))
        if not any(columns <= set(logs.frame.columns) for columns in _RESULTS):
            reading.others.append(
                f"{logs.name}: not a flight log, passed over (columns "
                f"{', '.join(logs.frame.columns[:4])[:60]} ...)"
            )
        return
    log = check_log(logs, options.ignore)
    reading.checks.update(log.checks)
    if log.faults and options.faulty != names.FAULTY_LOGS[2]:
        raise _FaultError(" ".join(map(str, log.faults)))
    first = one_drone.find_copy(log.keys, reading.keys) if len(log.keys) else None
    if first is not None:
        reading.notes.append(f"{log.name}: holds the same flight as {first}; used once")
        return
    reading.keys[log.name] = log.keys
    reading.notes.extend(log.notes)
    reading.paths.append(file)
    if log.parts == 1:
        yield from (log.without_wrong_speeds(piece) for piece in log.pieces)
        return
    again = formats.logged(file, options.battery_law, options.law_of_drone)
    for part in () if isinstance(again, Table) else again:
        for flight, time in part.flights:
            yield from map(log.without_wrong_speeds, cut(flight, time, options.ignore)[0])


def _nothing(path: Path, files: int, reasons: list[str]) -> str:
    if not reasons:
        kinds, others = not_logs.below(path)
        if kinds:
            return f"{path}: no flight logs that are read, but {not_logs.describe(kinds)}"
        example = path / "flights" if others or not path.name else path
        return (
            f"{path}: no flight logs ({', '.join(formats.suffixes())}) in this folder or below it. "
            f"Give the folder that holds yours, or record some (maidenflight record -o {example})."
        )
    return (
        f"{path}: no usable flight in {files} files ({first_few(reasons, '; ')}). A flight "
        "needs 0.5 s in the air."
    )


def _files(path: Path) -> tuple[list[Path], list[str]]:
    """The files that may be logs, and what could not be looked into."""
    if path.is_file():
        return [path], []
    if not path.is_dir():
        endings = ", ".join(formats.suffixes())
        raise InputError(
            f"{path}: no such file or folder. Give a flight log ({endings}) or a folder of them."
        )
    logs, refused = _below(path)
    astray = [file for file in logs if file.is_symlink() and not file.exists()]
    refused += [f"{file}: this link leads nowhere. Mend or remove it." for file in sorted(astray)]
    files = sorted(file for file in logs if file.is_file())
    if not files and not refused:
        raise InputError(_nothing(path, 0, []))
    return files, refused


def _unread(path: Path) -> list[str]:
    """A note on files of a folder that may hold flights but are not read."""
    kinds = Counter[not_logs.Foreign]() if path.is_file() else not_logs.below(path)[0]
    return [f"{path.name}: also holds {not_logs.describe(kinds)}"] if kinds else []


def log_files(folder: Path) -> list[Path]:
    """Lists files that may be logs in a folder and its folders, by the numbers in their names."""
    return sorted((file for file in _below(folder)[0] if file.is_file()), key=run_folder.by_number)


def whole_flights(file: Path) -> list[Flight]:
    """Returns the flights of a file to look at: as logged, unchecked, uncut, however short.

    Raises:
        InputError: the file is damaged or in no known format.
    """
    logs = formats.logged(file)
    if isinstance(logs, Table):
        raise InputError(formats.unknown(logs))
    return [flight for part in logs for flight, _ in part.flights]


def _below(path: Path) -> tuple[list[Path], list[str]]:
    """What may be logs in a folder and all its folders, and what could not be looked into."""
    refused: list[str] = []

    def unreadable(error: OSError) -> None:
        refused.append(
            f"{error.filename}: this folder cannot be read ({error.strerror}). Allow reading it."
        )

    logs = [
        file
        for folder, _, names in os.walk(path, onerror=unreadable)
        for name in names
        if formats.is_log(file := Path(folder, name))
    ]
    return logs, refused
