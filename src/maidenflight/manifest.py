"""The manifest of a run folder, `run.json`: what each verb wrote, from what, and how.

The run folder is the parent of a verb's output. All paths in the manifest are relative to it, so a
run folder may be moved.
"""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
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
_CURE = (
    f"Restore it, or remove it and give files by options, as in maidenflight report --drone FILE; "
    f"commands write a new {NAME}."
)


@dataclass(frozen=True)
class Entry:
    """What one verb wrote to one output."""

    verb: str
    output: str
    """The file or folder that the verb was given to write to."""
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
        """Lists the files of a kind that an entry was made from and that are still here."""
        named = (text.rpartition(_DIGEST) for text in entry.inputs.get(kind, ()))
        paths = ((self.folder / name, digest) for name, mark, digest in named if mark)
        return [path for path, it in paths if path.is_file() and results.digest(path) == it]

    @property
    def missing(self) -> list[str]:
        """The files that entries list and that are no longer there."""
        names = (name for entry in self.entries for each in entry.written.values() for name in each)
        return [name for name in names if not os.path.lexists(self.folder / name)]


def append(
    output: StrPath,
    verb: str,
    written: Files,
    record: Mapping[str, Any],
    read: Files | None = None,
) -> Path:
    """Appends what a verb wrote to the manifest of its run folder.

    Replaces the entry of the same verb and output. A file that an older entry lists too is from now
    on listed by this one only. Call it once all files are written, so that a damaged manifest costs
    no results.

    Args:
        output: the file or folder that the verb was given to write to; its parent is the run
            folder.
        verb: the command's name.
        written: the files by kind; those outside the run folder and those that are not there are
            left out.
        record: how they were made, as `results.record` gives it.
        read: the files that they were made from, which `record` names, by kind.

    Returns:
        The manifest's path.

    Raises:
        InputError: the manifest is damaged, or another process holds it for long.
        WriteError: it cannot be written.
    """
    output = Path(output)
    folder = output if output.name in ("", "..") else output.parent
    entry = Entry(
        verb,
        _relative(output, folder) or ".",
        {
            kind: names
            for kind, paths in written.items()
            if (names := [name for path in paths if (name := _written(path, folder))])
        },
        _with_digests(read or {}, record, folder),
        str(record.get("version", "")),
        record.get("seed"),
        record.get("settings", {}),
    )
    release = results.claim(folder / NAME, _LOCK_TIMEOUT)
    try:
        older = _without(read_manifest(folder).entries, entry)
        content = {"format": FORMAT, "entries": [asdict(one) for one in (*older, entry)]}
        return results.write(folder / NAME, f"{json.dumps(content, indent=1)}\n")
    except InputError as error:
        said = f"{error} The results of {verb} in {output} are whole, but not listed there."
        raise InputError(said) from error
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
    try:
        content = inputs.from_json(inputs.readable(path))
    except ValueError as error:
        raise InputError(f"{path}: not valid JSON ({error}). {_CURE}") from error
    fields = Fields(content, str(path), "manifest", _CURE)
    fields.choice("format", (FORMAT,))
    return Manifest(folder, tuple(map(_entry, fields.tables("entries"))))


def find_manifest(place: StrPath) -> Manifest | None:
    """Finds the manifest that a path belongs to, with the entries that it is about.

    Args:
        place: a run folder; or a file or folder that the nearest manifest above it lists.

    Returns:
        All entries of a run folder; else those that wrote `place` or something in it. Of logs, only
        those at `place` are in them. Nothing where no manifest lists it.

    Raises:
        InputError: the manifest is damaged.
    """
    place = Path(place)
    if os.path.lexists(place / NAME):
        return read_manifest(place)
    parents = Path(os.path.abspath(place)).parents
    home = next((folder for folder in parents if os.path.lexists(folder / NAME)), None)
    if home is None:
        return None
    # As the user wrote it, where that is possible, for messages.
    shown = place.parent if Path(os.path.abspath(place.parent)) == home else home
    name = _relative(place, home) or ""
    found = tuple(filter(None, (_about(entry, name) for entry in read_manifest(shown).entries)))
    return Manifest(shown, found) if found else None


def _about(entry: Entry, name: str) -> Entry | None:
    """Narrows an entry to a path; nothing where it wrote nothing there."""
    if _within(entry.output, name):
        return entry
    held = [kind for kind, names in entry.written.items() if any(_within(n, name) for n in names)]
    if not held:
        return None
    if set(held) <= {"logs", "flight_logs"}:
        logs = [one for kind in held for one in entry.written[kind] if _within(one, name)]
        return replace(entry, written={"logs": logs}, inputs={})
    return entry


def _within(name: str, folder: str) -> bool:
    return PurePosixPath(name).is_relative_to(folder)


def _without(entries: Sequence[Entry], new: Entry) -> list[Entry]:
    """Leaves out what a new entry replaces."""
    own = {name for names in new.written.values() for name in names}
    kept = []
    for old in entries:
        left = {
            kind: [name for name in names if name not in own] for kind, names in old.written.items()
        }
        left = {kind: names for kind, names in left.items() if names}
        if left and (old.verb, old.output) != (new.verb, new.output):
            kept.append(replace(old, written=left))
    return kept


def _relative(path: StrPath, folder: StrPath) -> str | None:
    """Gives a path relative to a folder; nothing where it lies outside."""
    whole, home = os.path.abspath(path), Path(os.path.abspath(folder))
    return Path(whole).relative_to(home).as_posix() if Path(whole).is_relative_to(home) else None


def _written(path: StrPath, folder: StrPath) -> str | None:
    """Gives a file's path relative to a folder; nothing where it is not there."""
    return _relative(path, folder) if os.path.lexists(path) else None


def _with_digests(read: Files, record: Mapping[str, Any], folder: Path) -> dict[str, list[str]]:
    """Names files read, with the digests that the record has of them in the same order."""
    digests: dict[str, list[str]] = {}
    for text in record.get("inputs", ()):
        name, mark, digest = text.rpartition(_DIGEST)
        digests.setdefault(name, []).append(mark + digest)
    found: dict[str, list[str]] = {}
    for kind, paths in read.items():
        for path in map(Path, paths):
            known = digests.get(path.name)
            name = _relative(path, folder) or path.name
            found.setdefault(kind, []).append(name + (known.pop(0) if known else ""))
    return found


def _entry(fields: Fields) -> Entry:
    """Reads an entry.

    Raises:
        InputError: it is damaged.
    """
    seed = fields.get("seed")
    if seed is not None and type(seed) is not int:
        raise fields.refused("seed", "a whole number")
    return Entry(
        fields.text("verb"),
        fields.text("output"),
        _lists(fields.table("written"), inside=True),
        _lists(fields.table("inputs"), inside=False),
        fields.text("version"),
        seed,
        fields.table("settings").content,
    )


def _lists(fields: Fields, inside: bool) -> dict[str, list[str]]:
    """Reads lists of files by kind.

    Raises:
        InputError: one is no list of texts, or names a file outside the run folder.
    """
    for kind, names in fields.content.items():
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise fields.refused(kind, "a list of files")
        paths = map(PurePosixPath, names if inside else ())
        if any(path.is_absolute() or ".." in path.parts for path in paths):
            raise fields.refused(kind, "files in the run folder")
    return fields.content
