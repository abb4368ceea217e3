"""Reading flights from a file or a folder, whatever of the known formats they are in."""

import gzip
import os
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from maidenflight.errors import InputError
from maidenflight.flights import authors, checking, log
from maidenflight.flights.log import Flight

SUFFIXES = (".csv", ".csv.gz")


@dataclass(frozen=True)
class Flights:
    """Checked flights."""

    flights: tuple[Flight, ...]
    notes: tuple[str, ...]
    """What was dropped, and why, one line each."""
    paths: tuple[Path, ...]
    """The files read."""

    def __len__(self) -> int:
        return len(self.flights)

    def __iter__(self) -> Iterator[Flight]:
        return iter(self.flights)

    @property
    def duration(self) -> float:
        """[s], all flights together."""
        return sum(flight.duration for flight in self.flights)


def read_flights(path: str | os.PathLike[str], on_file: Callable[[int, int], None] | None = None) -> Flights:
    """Reads and checks flights.

    Args:
        path: a file, or a folder that is searched with all its folders for `.csv` and `.csv.gz`.
        on_file: called with (files read, files found), for a progress bar.

    Returns:
        Gapless pieces of flights in which the drone flies, in the order of the files' names.

    Raises:
        InputError: nothing there, an unknown format, or a file with nothing usable in the whole set.
    """
    paths = _files(Path(path))
    flights: list[Flight] = []
    notes: list[str] = []
    for number, file in enumerate(paths, 1):
        for flight in _read(file, notes):
            kept, dropped = checking.pieces(flight)
            flights += kept
            notes += dropped
        if on_file is not None:
            on_file(number, len(paths))
    if not flights:
        reasons = "; ".join(notes[:3])
        raise InputError(f"{path}: no usable flight in {len(paths)} files ({reasons}). A flight needs 0.5 s in the air.")
    return Flights(tuple(flights), tuple(notes), tuple(paths))


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise InputError(f"{path}: no such file or folder. Give a flight log (.csv, .csv.gz) or a folder of them.")
    found = sorted(file for file in path.rglob("*") if file.name.endswith(SUFFIXES) and file.is_file() and _first_line(file))
    if not found:
        raise InputError(f"{path}: no flight logs (.csv, .csv.gz) in this folder. Record some: maidenflight record -o {path}.")
    return found


def _open(path: Path) -> str:
    try:
        content = path.read_bytes()
        return (gzip.decompress(content) if content[:2] == b"\x1f\x8b" else content).decode("utf-8").replace("\r\n", "\n")
    except (OSError, EOFError, zlib.error, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as a flight log ({error}).") from error


def _first_line(path: Path) -> bool:
    """Whether a file looks like a flight log; folders may hold other tables."""
    try:
        with gzip.open(path, "rt", encoding="utf-8") if path.suffix == ".gz" else open(path, encoding="utf-8") as file:
            line = file.readline()
    except (OSError, EOFError, zlib.error, UnicodeDecodeError):
        return True  # let reading it say what is wrong
    return _ours(line.strip()) or _authors(line.strip())


def _ours(first: str) -> bool:
    return first.startswith(log.MARK)


def _authors(first: str) -> bool:
    return set(first.split(",")) == set(authors.COLUMNS)


def _read(path: Path, notes: list[str]) -> list[Flight]:
    text = _open(path)
    name = f"{path.parent.name}/{path.name}"
    first = text.split("\n", 1)[0].strip()
    if _ours(first):
        parts, cuts = checking.at_gaps(*log.timed(text, name))
        notes += cuts
        return parts
    if _authors(first):
        return authors.from_csv(text, name)
    raise InputError(
        f"{path}: unknown format; its first line is {first[:60]!r}. Known are maidenflight's own log ('{log.MARK}', see"
        " docs/flight-log.md) and the 22 columns of Gronauer et al."
    )
