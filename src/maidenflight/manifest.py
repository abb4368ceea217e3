"""The manifest of a run folder, `run.json`: what each verb wrote, from what, and how.

The run folder is the parent of a verb's output. All paths in the manifest are relative to it, so a
run folder may be moved.
"""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain
from pathlib import Path, PurePosixPath
from typing import Any, Literal

from maidenflight import inputs, results
from maidenflight.errors import InputError
from maidenflight.inputs import Fields, StrPath

NAME = "run.json"
FORMAT = "maidenflight run 1"
Kind = Literal[
    "logs",
    "truth",
    "drone",
    "evaluations",
    "picture",
    "validation",
    "windows",
    "ahead",
    "disturbed",
    "calibration",
    "policies",
    "training",
    "flights",
    "flight_logs",
    "prediction",
    "envelope",
    "study",
    "exported",
    "plan",
    "stages",
]
"""What a file of a run is. `flights` is the table of test flights, `flight_logs` are their logs,
`logs` are those of recorded flights, and `truth` the hidden parameters of a virtual drone."""
Files = Mapping[Kind, Sequence[StrPath]]

_LOCK_TIMEOUT = 30.0
"""Longest wait for another process that appends to the same manifest [s]."""
_DIGEST = " sha256:"
_CURE = f"Restore it, or remove it: commands write a new {NAME}, and report takes files by options."


@dataclass(frozen=True)
class Entry:
    """What one verb wrote to one output."""

    verb: str
    output: str
    """The file or folder that the verb writes to."""
    written: Mapping[str, Sequence[str]]
    """Files by `Kind`."""
    inputs: Mapping[str, Sequence[str]]
    """Files read, by `Kind`, each with its digest as in `results.record`. One from outside the run
    folder has its name only."""
    version: str
    seed: int | None
    settings: Mapping[str, Any]


@dataclass(frozen=True)
class Manifest:
    """The entries of a run folder, the latest last."""

    folder: Path
    entries: tuple[Entry, ...] = ()

    def files(self, entry: Entry, kind: Kind) -> list[Path]:
        """Lists the files of a kind that an entry wrote and that are still there."""
        paths = (self.folder / name for name in entry.written.get(kind, ()))
        return [path for path in paths if os.path.lexists(path)]

    def read_files(self, entry: Entry, kind: Kind) -> list[Path]:
        """Lists the files of a kind that an entry was made from and that are here unchanged."""
        named = (text.rpartition(_DIGEST) for text in entry.inputs.get(kind, ()))
        paths = ((self.folder / name, digest) for name, _, digest in named)
        return [path for path, it in paths if path.is_file() and results.digest(path) == it]

    @property
    def missing(self) -> list[str]:
        """The files that entries list and that are no longer there."""
        names = (name for entry in self.entries for each in entry.written.values() for name in each)
        return [name for name in names if not os.path.lexists(self.folder / name)]


def append(
    output: StrPath, verb: str, written: Files, record: Mapping[str, Any], read: Files | None = None
) -> Path:
    """Appends what a verb wrote to the manifest of its run folder, the parent of its output.

    Replaces the entry of the same verb and output, and takes over files that older entries list.
    Call it once all files are written, so that a damaged manifest costs no results.

    Args:
        output: the file or folder that the verb writes to.
        verb: the command's name.
        written: the files by kind; those outside the run folder and those that are not there are
            left out.
        record: how they were made, as `results.record` gives it.
        read: the files that they were made from by kind, in the order in which `record` has them.

    Returns:
        The manifest's path.

    Raises:
        InputError: the manifest is damaged, or another process holds it for long.
        WriteError: it cannot be written.
    """
    output = Path(output)
    folder = output if output.name in ("", "..") else output.parent
    names = {
        kind: [name for path in paths if os.path.lexists(path) and (name := _name(path, folder))]
        for kind, paths in written.items()
    }
    inputs: dict[str, list[str]] = {}
    listed = [(kind, path) for kind, paths in (read or {}).items() for path in paths]
    for (kind, path), text in zip(listed, record.get("inputs", ()), strict=False):
        name = _name(path, folder) or Path(path).name
        inputs.setdefault(kind, []).append(_DIGEST.join((name, text.rpartition(_DIGEST)[2])))
    entry = Entry(
        verb,
        _name(output, folder) or ".",
        {kind: files for kind, files in names.items() if files},
        inputs,
        str(record.get("version", "")),
        record.get("seed"),
        record.get("settings", {}),
    )
    release = results.claim(folder / NAME, _LOCK_TIMEOUT)
    try:
        entries = _replace(read_manifest(folder).entries, entry)
        content = {"format": FORMAT, "entries": [asdict(entry) for entry in entries]}
        return results.write(folder / NAME, f"{json.dumps(content, indent=1)}\n")
    except InputError as error:
        message = f"{error} The results of {verb} in {output} are whole, but not listed there."
        raise InputError(message) from error
    finally:
        release()


def read_manifest(folder: StrPath) -> Manifest:
    """Reads the manifest of a run folder; one without entries where there is none.

    Raises:
        InputError: it is damaged.
    """
    folder = Path(folder)
    path = folder / NAME
    if not os.path.lexists(path):
        return Manifest(folder)
    fields = Fields(inputs.json_file(path, _CURE), str(path), "manifest", _CURE)
    fields.choice("format", (FORMAT,))
    return Manifest(folder, tuple(map(_entry, fields.tables("entries"))))


def find_manifest(path: StrPath) -> Manifest | None:
    """Finds the manifest that a path belongs to, with the entries that it is about.

    Args:
        path: a run folder; or a file or folder that the nearest manifest above it lists.

    Returns:
        All entries of a run folder; else those that wrote `path` or something in it, of a log that
        alone. Nothing where no manifest lists it.

    Raises:
        InputError: the manifest is damaged.
    """
    path = Path(path)
    if os.path.lexists(path / NAME):
        return read_manifest(path)
    parents = Path(os.path.abspath(path)).parents
    home = next((folder for folder in parents if os.path.lexists(folder / NAME)), None)
    if home is None:
        return None
    # As the user wrote it, where that is possible, for messages.
    run_path = path.parent if Path(os.path.abspath(path.parent)) == home else home
    name = _name(path, home) or ""
    entries = []
    for entry in read_manifest(run_path).entries:
        kinds = [kind for kind, names in entry.written.items() if name in names]
        if kinds and set(kinds) <= {"logs", "flight_logs"}:
            entries.append(replace(entry, written={"logs": [name]}, inputs={}))
        elif any(
            PurePosixPath(each).is_relative_to(name)
            for each in (entry.output, *chain.from_iterable(entry.written.values()))
        ):
            entries.append(entry)
    return Manifest(run_path, tuple(entries)) if entries else None


def _replace(entries: Sequence[Entry], new: Entry) -> list[Entry]:
    """Adds an entry, without what it replaces."""
    own = {name for names in new.written.values() for name in names}
    remaining = []
    for old in entries:
        left = {
            kind: rest
            for kind, names in old.written.items()
            if (rest := [name for name in names if name not in own])
        }
        if left and (old.verb, old.output) != (new.verb, new.output):
            remaining.append(replace(old, written=left))
    return [*remaining, new]


def _name(path: StrPath, folder: StrPath) -> str | None:
    """Gives a path relative to a folder; nothing where it lies outside."""
    whole, home = Path(os.path.abspath(path)), os.path.abspath(folder)
    return whole.relative_to(home).as_posix() if whole.is_relative_to(home) else None


def _entry(fields: Fields) -> Entry:
    seed, written, read = fields.get("seed"), fields.table("written"), fields.table("inputs")
    if type(seed) not in (int, type(None)):
        raise fields.refused("seed", "a whole number")
    for table in (written, read):
        for kind, names in table.content.items():
            if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
                raise table.refused(kind, "a list of files")
            paths = map(PurePosixPath, names)
            if any(path.is_absolute() or ".." in path.parts for path in paths):
                raise table.refused(kind, "files in the run folder")
    return Entry(
        fields.text("verb"),
        fields.text("output"),
        written.content,
        read.content,
        fields.text("version"),
        seed,
        fields.table("settings").content,
    )
