"""Policy files of a command line: their names and the task that they fly."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from maidenflight import policy_file
from maidenflight.errors import InputError
from maidenflight.foreign.policies import ForeignPolicy, foreign_policy
from maidenflight.inputs import StrPath
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
        found = sorted(path.glob("*.json")) if path.is_dir() else [path]
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
        if (task := _task_of(path)) is not None
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


def _task_of(path: Path) -> str | None:
    """The task that a policy was trained for; None also of a file that whoever flies it refuses."""
    with suppress(InputError):
        return policy_file.read(path).task
    return None
