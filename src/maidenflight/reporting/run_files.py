"""The files that a report shows: those of a manifest's entries, and those that a user gives."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict, cast

from maidenflight import manifest, run_folder
from maidenflight.errors import InputError
from maidenflight.flights import not_logs, reading
from maidenflight.inputs import StrPath
from maidenflight.manifest import Entry, Kind, Manifest


class FileOptions(TypedDict, total=False):
    """Files that a user gives in place of a run's; `maidenflight report --help` says what each is.

    The report shows what commands write beside such files too: windows beside a validation,
    `training.csv` beside policies, and logs `flight_*.csv` beside test flights.
    """

    logs: StrPath | Sequence[StrPath]
    drone: StrPath
    truth: StrPath
    policies: StrPath
    flights: StrPath
    validation: StrPath
    calibration: StrPath
    prediction: StrPath
    study: StrPath


_GROUPS: tuple[tuple[Kind, ...], ...] = (
    ("drone",),
    ("validation", "windows"),
    ("calibration",),
    ("policies", "training"),
    ("flights", "flight_logs"),
    ("logs", "truth"),
    ("prediction",),
    ("study",),
)
"""Kinds of files that stand together, of one entry, the main one first."""
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
    "calibration": "tested intervals",
    "drone": "identified drones",
    "logs": "flight logs",
}
"""What kinds of files are called that a page may leave out."""


@dataclass(frozen=True)
class RunFiles:
    """The files of a report."""

    files: Mapping[Kind, Sequence[Path]]
    required_logs: frozenset[Path]
    """Those of `logs` that a command of maidenflight wrote or a user named."""
    missing: Sequence[str]
    """Names of files that the manifest lists and that are no longer there."""
    others: Mapping[str, list[str]]
    """Names of what else the manifest lists, by kind."""

    def first(self, kind: Kind) -> Path | None:
        """Returns the file of a kind of which a report shows one."""
        return next(iter(self.files.get(kind, ())), None)


def find_files(source: StrPath | None, options: FileOptions) -> RunFiles:
    """Finds the files that a report shows.

    Of several entries of a kind the command's usual output counts, else the latest.

    Args:
        source: a run folder, or a file or folder that its manifest lists; or a drone file, or its
            folder, without a manifest.
        options: files that replace those of their kind.

    Raises:
        InputError: a path does not exist, no manifest lists `source`, which is no drone file
            either, or a manifest is damaged.
    """
    values = cast(dict[Kind, StrPath | Sequence[StrPath]], options)
    user_files = {kind: _paths_of_option(kind, value) for kind, value in values.items() if value}
    run = manifest.find_manifest(source) if source is not None else None
    if run is None and source is not None and (drone := drone_file_of(source)) is not None:
        user_files = {"drone": [drone], **user_files}
    if run is None and not user_files:
        raise nothing_here(Path(source or ""))
    run = run or Manifest(Path(source or ""))
    files: dict[Kind, list[Path]] = {}
    logs_read: list[Path] = []
    for group in _GROUPS:
        if group[0] in user_files:
            files |= _with_companions(group[0], user_files[group[0]])
        elif (entry := _entry_to_show(run, group)) is not None:
            files |= {kind: run.files(entry, kind) for kind in group}
            logs_read += run.read_files(entry, "logs")
    files["truth"] = user_files.get("truth", files.get("truth", []))
    required = frozenset(user_files.get("logs", files.get("logs", ())))
    if "logs" not in user_files:
        files["logs"] = list(dict.fromkeys((*files.get("logs", ()), *logs_read)))
    run_paths = {path for paths in files.values() for path in paths}
    return RunFiles(files, required, run.missing, _others(run, run_paths))


def drone_file_of(source: StrPath) -> Path | None:
    """Returns the drone file that a path is, or that lies in it by the usual name."""
    path = Path(source)
    file = path / run_folder.DRONE if path.is_dir() else path
    return file if file.suffix == ".toml" and file.is_file() else None


def nothing_here(path: Path, missing: Sequence[str] = ()) -> InputError:
    """Returns the error where there is nothing for a report, with what may hold flights."""
    kinds = not_logs.below(path)[0] if path.is_dir() else None
    wrong = "nothing of a run here" if os.path.lexists(path) else "no such file or folder"
    return InputError(
        f"{path}: {wrong}. "
        + (f"{manifest.NAME} lists {missing[0]}, which is no longer there. " if missing else "")
        + f"Give a folder with {manifest.NAME}, which commands write beside their output, a file "
        f"or folder that it lists, or others by options: --logs {path} for flight logs, "
        "--drone FILE, --policies FOLDER, --flights TABLE."
        + (f" Found: {not_logs.describe(kinds)}" if kinds else "")
    )


def _paths_of_option(kind: str, value: StrPath | Sequence[StrPath]) -> list[Path]:
    paths = [Path(path) for path in ([value] if isinstance(value, str | os.PathLike) else value)]
    for path in paths:
        if not path.exists() or (path.is_dir() and kind not in ("logs", "policies")):
            problem = "is a folder" if path.exists() else "no such file or folder"
            raise InputError(f"{path}: {problem}. Give the file after --{kind}.")
    return paths


def _with_companions(kind: Kind, paths: Sequence[Path]) -> dict[Kind, list[Path]]:
    """Adds to a user's files what commands write beside such files."""
    path = paths[0]
    files: dict[Kind, list[Path]] = {kind: [path]}
    if kind == "logs":
        files[kind] = []
        for each in paths:
            files[kind] += reading.log_files(each) if each.is_dir() else [each]
    elif kind == "validation":
        files["windows"] = [run_folder.windows_path(path)]
    elif kind == "flights":
        files["flight_logs"] = run_folder.LOG.find(path.parent)
    elif kind == "policies":
        folder = path if path.is_dir() else path.parent
        files["policies"] = run_folder.find_policies(path) if path.is_dir() else [path]
        files["training"] = [folder / run_folder.TRAINING.name]
    return {each: [path for path in ones if os.path.lexists(path)] for each, ones in files.items()}


def _entry_to_show(run: Manifest, group: Sequence[Kind]) -> Entry | None:
    for kind in group:
        entries = [entry for entry in run.entries if run.files(entry, kind)]
        usual = [entry for entry in entries if entry.output in _USUAL]
        if entries:
            return (usual or entries)[-1]
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
