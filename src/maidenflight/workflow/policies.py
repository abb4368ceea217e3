"""Policy files of a command line: their names, control structure and training task."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from maidenflight import inputs, policy_file, run_folder
from maidenflight.deployment.authors_json import read_policy
from maidenflight.errors import InputError
from maidenflight.foreign.policies import ForeignPolicy, foreign_policy
from maidenflight.inputs import StrPath
from maidenflight.parameters import GEOMETRY
from maidenflight.policy import Policy
from maidenflight.simulator import tasks

USUAL = "circle"
"""Task of policies that do not say what they were trained for, as the authors' do not."""


def own_and_foreign(given: Sequence[StrPath]) -> tuple[list[StrPath], list[ForeignPolicy]]:
    """Files and folders of policies of ours and the authors', and policies by others.

    Raises:
        InputError: one by others needs a package that is not installed, or its file is wrong.
    """
    found = {path: foreign_policy(Path(path)) for path in given}
    own = [path for path, policy in found.items() if policy is None]
    return own, [policy for policy in found.values() if policy is not None]


def policy_files(given: Sequence[StrPath]) -> list[Path]:
    """The policy files among files and folders, each once.

    Raises:
        InputError: a path does not exist, or a folder holds no policy.
    """
    files: list[Path] = []
    for path in map(Path, given):
        found = run_folder.find_policies(path) if path.is_dir() else [path]
        if not found:
            raise InputError(
                f"{path}: no policies (.json) in this folder. Train some: maidenflight train -o "
                f"{path}."
            )
        files += found
    return list(dict.fromkeys(files))


def names(files: Sequence[Path]) -> list[str]:
    """Files without their ending, each with as many of its folders as tell all of them apart."""
    parts = [path.absolute().with_suffix("").parts for path in files]
    for depth in range(1, max(map(len, parts), default=0) + 1):
        called = ["/".join(part[-depth:]) for part in parts]
        if len(set(called)) == len(called):
            return called
    return [str(path) for path in files]


def read_as(path: StrPath, structure: str | None) -> Policy:
    """Reads a policy, ours or the authors'.

    Args:
        path: the file.
        structure: what an authors' policy commands; what its file's name says unless given.

    Raises:
        InputError: the file is no policy, or one of ours that says that it commands something else.
    """
    read = read_policy(path, structure)
    if structure not in (None, read.interface.name):
        raise InputError(
            f"{path}: a {read.interface.name} policy, as its file says, not {structure}. Leave out "
            "--control, which is for the authors' policies."
        )
    return read


def trained_for(path: StrPath) -> str | None:
    """Name of the task that a policy of ours was trained for.

    Nothing where its file does not say, or it is one of the authors'.
    """
    task = trained_with(path).get("task")
    return None if task is None else str(task)


def hover_of(path: StrPath) -> float | None:
    """Share of full thrust at which the drone of a policy of ours hovers, as its file says."""
    share = _record(path).get("hover")
    return share if isinstance(share, float) and 0.0 < share <= 1.0 else None


def frame_of(path: StrPath) -> dict[str, list[float]] | None:
    """Places [m] and directions of the rotors that a policy of ours was trained for.

    By field of `parameters.Parameters`; None where its file does not say.
    """
    said = _record(path).get("rotors")
    if not isinstance(said, dict) or said.keys() != set(GEOMETRY):
        return None
    rows = [said[name] for name in GEOMETRY]
    numbers = all(
        isinstance(row, list) and len(row) == 4 and all(isinstance(one, float) for one in row)
        for row in rows
    )
    return dict(zip(GEOMETRY, rows, strict=True)) if numbers else None


def trained_with(path: StrPath) -> dict[str, Any]:
    """Settings with which a policy of ours was trained.

    Empty where its file does not say, or it is one of the authors'.
    """
    settings = _record(path).get("settings")
    return settings if isinstance(settings, dict) else {}


def _record(path: StrPath) -> dict[str, Any]:
    try:
        record = inputs.from_json(policy_file.text_of(path))["record"]
    except (ValueError, LookupError, TypeError):
        return {}
    return record if isinstance(record, dict) else {}


def task_to_fly(files: Sequence[Path], asked: str | None) -> tuple[str, list[str]]:
    """What policies are to fly, and notes for the user.

    Args:
        files: policy files.
        asked: name of a task; unless given, the one that all the files that say so were trained
            for.

    Returns:
        The name of a task, and a note where policies were trained for another.
    """
    told = {
        name: task
        for name, path in zip(names(files), files, strict=True)
        if (task := trained_for(path)) is not None
    }
    trained = set(told.values())
    flown = asked or (
        trained.pop() if len(trained) == 1 and trained <= tasks.TASKS.keys() else USUAL
    )
    others = {name: task for name, task in told.items() if task != flown}
    if not others:
        return flown, []
    first = ", ".join(f"{name} for {task}" for name, task in list(others.items())[:3])
    more = f" and {len(others) - 3} more for others" if len(others) > 3 else ""
    return flown, [f"they fly the task {flown}, but were trained for another: {first}{more}."]
