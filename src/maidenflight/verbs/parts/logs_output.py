"""Flight logs of a command: what was read, and what is written."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from maidenflight import results
from maidenflight.flights import flight_csv, formats
from maidenflight.flights.log import Flight
from maidenflight.flights.reading import Flights, log_files
from maidenflight.parameters import COMPONENTS, QUANTITIES
from maidenflight.terminal import Progress

_OTHER_THRUST = 1.35
"""Ratio of full thrust to weight of logs, by that of a start, beyond which a note is made."""
_FEW_NOTES, _FEW_REFUSED = 10, 3
"""Lines on files for people."""


def count_files(progress: Progress) -> Callable[[int, int], None]:
    """Returns a function that shows how many files are read."""
    return lambda done, of: progress.move(done, of, "reading flights")


def note_thrust(flights: Flights, start: str, thrust_to_weight: float) -> list[str]:
    """Returns a note where calm flight takes far more or less of full thrust than a start's would.

    Physics cannot tell a wrong scale of commands from another drone; who flew it can.
    """
    counts = [
        result.statistic
        for results in flights.checks.values()
        for result in results
        if result.name == "thrust to weight" and result.statistic is not None
    ]
    if not counts:
        return []
    logged = sorted(counts)[len(counts) // 2]
    if 1 / _OTHER_THRUST < logged / thrust_to_weight < _OTHER_THRUST:
        return []
    reason = "PWM limits, percent, another full throttle, sqrt(u) or u squared for u"
    squares = [flight.square_since for flight in flights if flight.square_since]
    if squares and logged > thrust_to_weight:
        reason = f"{squares[0]}, so u is the square of the throttle: thrust may follow it itself"
    return [
        f"full thrust is {logged:.2f} times the weight in these logs, and {thrust_to_weight:.2f} "
        f"times of {start}: if that is your drone, the scale of the commands is wrong ({reason}), "
        "or the battery or load is another one"
    ]


def write_logs(folder: Path, flights: Mapping[str, Flight], record: dict[str, Any]) -> list[Path]:
    """Writes logs by their names, in place of those that an earlier run wrote there."""
    written = [
        flight_csv.write(folder / f"{name}.csv", flight, record) for name, flight in flights.items()
    ]
    results.remove_older(written, record)
    return written


def write_maps(logs: Path) -> list[Path]:
    """Writes maps of columns beside tables in no known format, and returns them."""
    files = [logs] if logs.is_file() else log_files(logs)
    return [path for file in files if (path := formats.write_map(file)) is not None]


def to_content(flights: Flights) -> dict[str, Any]:
    """Returns what was read, for JSON."""
    return {
        "files": len(flights.paths),
        "pieces": len(flights),
        "seconds": round(flights.duration, 2),
        "dropped": flights.notes,
        "refused": flights.refused,
        "warnings": [asdict(warning) for warning in flights.warnings],
    }


def describe_flights(flights: Flights, further: str = "", but: Sequence[str] = ()) -> list[str]:
    """Returns lines on what was read, dropped and refused, without notes that `but` repeats."""
    whole = (
        f"{_count(len(flights.paths), 'file')}, {_count(len(flights), 'usable piece')} of flight, "
        f"{flights.duration:.0f} s{further}"
    )
    notes = [
        note
        for note in flights.notes
        if not any((note.partition(": ")[2] or note) in line for line in but)
    ]
    dropped, refused = _group(notes), _group(flights.refused)
    head = [f"{_count(len(flights.refused), 'file')} refused:"] if refused else []
    return [whole, *head, *_first(refused, _FEW_REFUSED), *_first(dropped, _FEW_NOTES)]


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'s' * (number != 1)}"


def _group(notes: Sequence[str]) -> list[str]:
    """Returns equal notes on files once, with the number of files instead of their names."""
    alike: dict[str, list[str]] = {}
    for note in notes:
        alike.setdefault(note.partition(": ")[2] or note, []).append(note)
    return [
        f"{len(every)} files: {text}" if len(every) > 1 else every[0]
        for text, every in alike.items()
    ]


def _first(lines: Sequence[str], count: int) -> list[str]:
    more = len(lines) - count
    rest = [f"  and {more} more; --json lists them all"] if more > 0 else []
    return [f"  {line}" for line in lines[:count]] + rest


def scale_of(name: str, value: float) -> tuple[float, str]:
    """Returns the displayed value per SI value of a parameter, and its unit."""
    unit = QUANTITIES[COMPONENTS[name][0]].unit
    unit = "" if unit == "-" else unit
    if unit == "s":
        return 1e3, "ms"
    return (1e6, f"1e-6 {unit}".strip()) if 0.0 < abs(value) < 1e-3 else (1.0, unit)
