"""Policies that fly: files and folders of ours and the authors', and policies by others."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from maidenflight import names, policy_file, run_folder
from maidenflight.errors import InputError, first_few, printable
from maidenflight.flying.foreign_policy import foreign_policy
from maidenflight.flying.pilots import ForeignPolicy
from maidenflight.inputs import StrPath
from maidenflight.policy import Policy
from maidenflight.policy_file import PolicyFile
from maidenflight.settings import is_code
from maidenflight.simulator.controllers.control import find_controller

USUAL_TASK = "circle"
"""Task of policies that were trained for several."""


@dataclass(frozen=True)
class Policies:
    """Policies that fly together."""

    paths: tuple[Path, ...]
    """Of the files, ours and the authors'."""
    files: tuple[PolicyFile, ...]
    foreign: tuple[ForeignPolicy, ...]
    """Policies by others."""
    foreign_files: tuple[Path, ...]
    """Of the policies by others that are files."""

    @property
    def own(self) -> list[Policy]:
        """Returns ours and the authors', in the order of the files."""
        return [file.policy for file in self.files]

    @property
    def every(self) -> list[Policy | ForeignPolicy]:
        """Returns all, those by others last."""
        return [*self.own, *self.foreign]

    @property
    def own_names(self) -> list[str]:
        """Returns what tables call the files."""
        return shortest_names([path.absolute().with_suffix("") for path in self.paths])

    @property
    def names(self) -> list[str]:
        """Returns what tables call all."""
        return [*self.own_names, *(policy.name for policy in self.foreign)]

    @property
    def inputs(self) -> list[Path]:
        """Returns the files that were read, for records."""
        return [*self.paths, *self.foreign_files]

    @property
    def record(self) -> dict[str, Any]:
        """Returns the policies by others, for records."""
        return {"policies": None, "foreign": [policy.name for policy in self.foreign] or None}

    def path_of(self, name: str | None) -> Path | None:
        """Returns the file that tables call so; nothing of no name."""
        return None if name is None else self.paths[self.own_names.index(name)]

    def policy_of(self, path: Path) -> Policy:
        """Returns the policy of a file."""
        return self.files[self.paths.index(path)].policy

    def choose_task(self, task: str | None) -> tuple[str, list[str]]:
        """Returns what they fly, and notes for the user.

        Args:
            task: name of a task, or a reference's file; by default, the task that all the files
                that say so were trained for.

        Returns:
            The name of a task, and a note where policies were trained for another.
        """
        own_tasks = {_usual(file.task) for file in self.files if file.task}
        alike = own_tasks or ({names.PAPER_TASK} if self.files else {USUAL_TASK})
        is_clear = len(alike) == 1 and alike <= set(names.TASKS)
        chosen = task or (alike.pop() if is_clear else USUAL_TASK)
        return chosen, self._note_others([chosen] * len(self.files))

    def choose_tasks(self, task: str | None) -> tuple[list[str], list[str]]:
        """Returns what each of the files flies by itself, and notes for the user.

        Args:
            task: name of a task for all; by default each flies the one that it was trained for, as
                far as a real drone flies it, and the authors' the circle of the paper.
        """
        real = {*names.REAL_TASKS, names.PAPER_TASK}
        trained = [file.task or names.PAPER_TASK for file in self.files]
        chosen = [task or (own if own in real else USUAL_TASK) for own in trained]
        return chosen, self._note_others(chosen)

    def _note_others(self, tasks: Sequence[str]) -> list[str]:
        """A note where files fly another task than they say that they were trained for."""
        others = [
            f"{name} flies {task}, trained for {file.task}"
            for name, file, task in zip(self.own_names, self.files, tasks, strict=True)
            if file.task not in (None, names.TRACKING, task)
        ]
        if not others:
            return []
        own = any(is_code(file.task or "") for file in self.files)
        named = " Code of your own runs where --task names it alone." if own else ""
        return [f"another task than that of the training: {first_few(others, '; ')}.{named}"]


def _usual(task: str) -> str:
    """The task that policies trained for a task fly by default: of any reference, the circle."""
    return USUAL_TASK if task == names.TRACKING else task


def find_policies(places: Sequence[StrPath]) -> list[Path]:
    """Returns the policy files among files and folders, each once.

    Raises:
        InputError: a folder holds no policy.
    """
    files: list[Path] = []
    for path in map(Path, places):
        inside = run_folder.find_policies(path) if path.is_dir() else [path]
        if not inside:
            raise InputError(
                f"{path}: no policies (.json) in this folder. Train some: maidenflight train -o "
                f"{path}."
            )
        files += inside
    return list(dict.fromkeys(files))


def read_policies(places: Sequence[StrPath], control: str | None = None) -> Policies:
    """Reads policies.

    Args:
        places: files and folders of policies, and policies by others, see `foreign_policy`.
        control: what the authors' policies command; what their files' names say by default. Or
            `MODULE:NAME`, a control structure of your own that policies command.

    Raises:
        InputError: one is no policy, or commands something else; or one by others needs a package
            that is not installed, or its file is wrong.
    """
    if control is not None and is_code(control):
        find_controller(control)
        control = None
    foreign = {path: foreign_policy(Path(path)) for path in places}
    paths = find_policies([path for path, policy in foreign.items() if policy is None])
    others = {path: policy for path, policy in foreign.items() if policy is not None}
    return Policies(
        tuple(paths),
        tuple(policy_file.read_policy(path, control) for path in paths),
        tuple(others.values()),
        tuple(Path(path) for path in others if Path(path).is_file()),
    )


def shortest_names(paths: Sequence[Path]) -> list[str]:
    """Returns the last parts of paths, as many as tell all of them apart."""
    for depth in range(1, max((len(path.parts) for path in paths), default=0)):
        short = [printable("/".join(path.parts[-depth:])) for path in paths]
        if len(set(short)) == len(short):
            return short
    return [printable(str(path)) for path in paths]
