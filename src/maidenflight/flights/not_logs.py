"""Files that may hold flights but are not read: what they are, and what to do with them."""

import os
from collections import Counter
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from maidenflight import inputs, run_folder

_CSV = "Write its rows as CSV in the format of docs/flight-log.md"
_SHEET = "Save its sheet as CSV, with commas and decimal points"


class Foreign(NamedTuple):
    """A kind of file."""

    begins: bytes
    """Its first bytes."""
    single: str
    several: str
    remedy: str = _CSV
    """What to do, a sentence without its full stop."""
    suffix: str = ""
    """Ending of its name, where the first bytes do not tell."""


KINDS = (
    Foreign(b"SQLite format 3", "an SQLite database", "SQLite databases"),
    Foreign(b"#ROSBAG", "a ROS 1 bag", "ROS 1 bags"),
    Foreign(b"PK\x03\x04", "an Excel workbook", "Excel workbooks", _SHEET, ".xlsx"),
    Foreign(b"\xd0\xcf\x11\xe0", "an Excel workbook", "Excel workbooks", _SHEET, ".xls"),
    Foreign(b"PK\x03\x04", "an archive of NumPy arrays", "archives of NumPy arrays", suffix=".npz"),
    Foreign(
        b"PK\x03\x04",
        "a zip archive or an Excel workbook",
        "zip archives",
        "Unpack it, or save its sheet as CSV",
    ),
    Foreign(b"\x89HDF", "an HDF5 file", "HDF5 files"),
    Foreign(b"MATLAB ", "a MATLAB file", "MATLAB files"),
    Foreign(
        b"",
        "MAVLink telemetry of a ground station",
        "files of MAVLink telemetry",
        "It holds a few messages a second: give the log of the autopilot's card, .BIN or .ulg",
        ".tlog",
    ),
    Foreign(b"\x93NUMPY", "a NumPy array", "NumPy arrays"),
)
"""Kinds of files that are recognised; of one beginning, the first whose suffix fits."""
_HEAD = max(len(kind.begins) for kind in KINDS)
READ = ".db3"
"""Ending of an SQLite database that is read, a rosbag2."""
_MAX_FILES = 1000
"""Files of a folder whose beginning is read."""


def kind_of(head: bytes, name: str) -> Foreign | None:
    """Returns the kind of a file by its first bytes and its name, if it is of one."""
    fitting = (kind for kind in KINDS if name.lower().endswith(kind.suffix))
    return next((kind for kind in fitting if head.startswith(kind.begins)), None)


def below(folder: Path) -> tuple[Counter[Foreign], int]:
    """Returns how many files of each kind a folder and all its folders hold, and of no kind."""
    names = (
        Path(parent, name)
        for parent, _, names in os.walk(folder)
        for name in sorted(names)
        if name != run_folder.CHECKPOINT
        and not name.lower().endswith(READ)
        and Path(parent, name).is_file()
    )
    kinds: Counter[Foreign] = Counter()
    others = 0
    for path in islice(names, _MAX_FILES):
        try:
            kind = kind_of(inputs.beginning(path, _HEAD), path.name)
        except OSError:
            kind = None
        if kind is None:
            others += 1
        else:
            kinds[kind] += 1
    return kinds, others


def describe(kinds: Counter[Foreign]) -> str:
    """Returns what files are, such as "2 MATLAB files", and what to do with them."""
    counts = [kind.single if n == 1 else f"{n} {kind.several}" for kind, n in kinds.items()]
    verb = "is" if kinds.total() == 1 else "are"
    remedies = ". ".join(dict.fromkeys(kind.remedy for kind in kinds))
    return f"{' and '.join(counts)}, which {verb} not read. {remedies}."
