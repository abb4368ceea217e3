"""The files that a report shows: those of a manifest's entries, and those that a user gives."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict, cast

from maidenflight import manifest, run_folder
from maidenflight.errors import InputError
from maidenflight.flights import foreign, reading
from maidenflight.inputs import StrPath
from maidenflight.manifest import Entry, Kind, Manifest


class FileOptions(TypedDict, total=False):
    """Files that a user gives, of any name and place, in place of a run's."""

    logs: StrPath | Sequence[StrPath]
    """Flight logs of any format that `identify` reads, and folders of them."""
    drone: StrPath
    """An identified drone; `NAME_identification.csv` beside it is shown too."""
    truth: StrPath
    """The parameters of a virtual drone."""
    policies: StrPath
    """A policy, or a folder of policies; `training.csv` beside them is shown too."""
    flights: StrPath
    """A table of test flights; logs `flight_*.csv` beside it are shown too."""
    validation: StrPath
    """Prediction errors; `NAME_windows.csv` beside them are shown too."""
    prediction: StrPath
    """Predicted flights."""
    study: StrPath
    """The table of a study."""


_GROUPS: tuple[tuple[Kind, ...], ...] = (
    ("drone", "evaluations"),
    ("validation", "windows"),
    ("policies", "training"),
    ("flights", "flight_logs"),
    ("logs", "truth"),
    ("prediction",),
    ("study",),
    ("stages",),
)
"""Kinds of files that are shown together, of one entry, the main one first."""
_USUAL = {
    *(run_folder.DRONE, run_folder.POLICIES, run_folder.TRANSFER, *run_folder.RECORDED),
    *(run_folder.VALIDATION.name, run_folder.PREDICTION.name),
}
"""Outputs that come before others of their kind."""
_TITLES: dict[Kind, str] = {
    "policies": "policies",
    "flights": "test flights",
    "prediction": "predicted flights",
    "validation": "prediction errors",
    "drone": "identified drones",
    "logs": "flight logs",
}
"""What kinds of files are called that a page may leave out."""


@dataclass(frozen=True)
class RunFiles:
    """The files of a report."""

    files: Mapping[Kind, Sequence[Path]]
    own_logs: frozenset[Path]
    """Those of `logs` that a command of maidenflight wrote."""
    missing: Sequence[str]
    """Names of files that the manifest lists and that are no longer there."""
    others: Mapping[str, list[str]]
    """Names of what else the manifest lists, by kind."""

    def first(self, kind: Kind) -> Path | None:
        """The file of a kind of which a report shows one."""
        return next(iter(self.files.get(kind, ())), None)


def find_files(source: StrPath | None, options: FileOptions) -> RunFiles:
    """Finds the files that a report shows.

    Of several entries of a kind the one with the command's usual output is shown, else the latest.

    Args:
        source: a run folder, or a file or folder that its manifest lists.
        options: files that replace those of their kind.

    Raises:
        InputError: a path does not exist, no manifest lists `source`, or a manifest is damaged.
    """
    values = cast(dict[Kind, StrPath | Sequence[StrPath]], options)
    given = {kind: _checked_paths(kind, value) for kind, value in values.items() if value}
    run = Manifest(Path()) if source is None else _manifest(Path(source), bool(given))
    files: dict[Kind, list[Path]] = {}
    logs_read: list[Path] = []
    for group in _GROUPS:
        if group[0] in given:
            files |= _with_companions(group[0], given[group[0]])
        elif (entry := _entry_to_show(run, group)) is not None:
            files |= {kind: run.files(entry, kind) for kind in group}
            logs_read += run.read_files(entry, "logs")
    files |= {kind: given[kind] for kind in ("truth",) if kind in given}
    own = frozenset() if "logs" in given else frozenset(files.get("logs", ()))
    if "logs" not in given:
        files["logs"] = list(dict.fromkeys((*files.get("logs", ()), *logs_read)))
    used = {path for paths in files.values() for path in paths}
    return RunFiles(files, own, run.missing, _others(run, used))


def nothing_here(place: Path, files: RunFiles | None = None) -> InputError:
    """The error where there is nothing for a report, with what may hold flights."""
    gone = f" It lists {', '.join(files.missing[:5])}, no longer there." if files else ""
    kinds = foreign.below(place)[0] if place.is_dir() else None
    return InputError(
        f"{place}: nothing of a run here that {manifest.NAME} lists.{gone} Expected a folder with "
        f"{manifest.NAME}, which commands write beside their output, or files by options, such as "
        f"--logs {place} if it holds flight logs, --drone FILE, --policies FOLDER, --flights TABLE."
        + (f" Found: {foreign.told(kinds)}" if kinds else "")
    )


def _manifest(source: Path, optional: bool) -> Manifest:
    found = manifest.find_manifest(source)
    if found is not None:
        return found
    if not os.path.lexists(source):
        raise _no_such(source)
    if not optional:
        raise nothing_here(source)
    return Manifest(source)


def _no_such(path: Path) -> InputError:
    return InputError(
        f"{path}: no such file or folder. Give the folder of a run, such as maidenflight demo "
        "writes, or files by options, such as --logs and --drone."
    )


def to_paths(value: StrPath | Sequence[StrPath]) -> list[Path]:
    """Converts one path or several to a list."""
    return [Path(one) for one in ([value] if isinstance(value, str | os.PathLike) else value)]


def _checked_paths(kind: str, value: StrPath | Sequence[StrPath]) -> list[Path]:
    """The paths of an option.

    Raises:
        InputError: one does not exist, or is a folder where a file is expected.
    """
    paths = to_paths(value)
    for path in paths:
        if not os.path.lexists(path):
            raise _no_such(path)
        if path.is_dir() and kind not in ("logs", "policies"):
            raise InputError(f"{path}: a folder; expected a file for {kind}. Give the file.")
    return paths


def _with_companions(kind: Kind, paths: Sequence[Path]) -> dict[Kind, list[Path]]:
    """Adds to a user's files what commands write beside such files."""
    path = paths[0]
    if kind == "logs":
        logs = [reading.log_files(each) if each.is_dir() else [each] for each in paths]
        return {"logs": [log for each in logs for log in each]}
    found: dict[Kind, list[Path]] = {kind: [path]}
    if kind == "drone":
        found["evaluations"] = [run_folder.beside(path)]
    elif kind == "validation":
        found["windows"] = [run_folder.windows_beside(path)]
    elif kind == "flights":
        found["flight_logs"] = run_folder.LOG.find(path.parent)
    elif kind == "policies":
        folder = path if path.is_dir() else path.parent
        found["policies"] = run_folder.find_policies(path) if path.is_dir() else [path]
        found["training"] = [folder / run_folder.TRAINING.name]
    return {each: [one for one in ones if os.path.lexists(one)] for each, ones in found.items()}


def _entry_to_show(run: Manifest, group: Sequence[Kind]) -> Entry | None:
    for kind in group:
        found = [entry for entry in run.entries if run.files(entry, kind)]
        usual = [entry for entry in found if entry.output in _USUAL]
        if found:
            return (usual or found)[-1]
    return None


def _others(run: Manifest, used: set[Path]) -> dict[str, list[str]]:
    """Names of folders and files of a run that a page does not show, by what they are."""
    others: dict[str, list[str]] = {}
    for kind, title in _TITLES.items():
        for entry in run.entries:
            left = [path.name for path in run.files(entry, kind) if path not in used]
            if left:
                folder = (run.folder / entry.output).is_dir()
                names = [f"{entry.output}/"] if folder else left
                others.setdefault(title, []).extend(names)
    return others
