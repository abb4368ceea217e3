"""What a training leaves in its folder, and the scores of its policies."""

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import reduce
from pathlib import Path
from typing import Any

import polars

from maidenflight import manifest, parameters, policy_file, results, run_folder, terminal
from maidenflight.errors import InputError
from maidenflight.experiments.transfer import transfer
from maidenflight.flights.log import Flight
from maidenflight.identification.drone_file import DroneFile
from maidenflight.policy import Policy
from maidenflight.simulator import control, dynamics, tasks
from maidenflight.simulator.virtual_drone import VirtualDrone
from maidenflight.training.distillation import Distillation, phase
from maidenflight.training.evaluation import Evaluation
from maidenflight.training.settings import Settings
from maidenflight.training.train import Progress as Training
from maidenflight.verb import Progress

WATCHED_DURATION_S = 10.0
"""Longest flight that is shown of a policy in training [s]."""
LEAST_SURVIVAL = 0.1
"""Survival below which a policy is reported as not flying."""


class Scores:
    """Evaluations of a training, shown as they come."""

    def __init__(self, progress: Progress, learner: Settings, resumed: bool) -> None:
        self._progress, self._learner, self._resumed = progress, learner, resumed
        self._evaluations: list[Training] = []
        self._first: Training | None = None
        self._began = time.perf_counter()
        self._fresh = 0

    def add(self, now: Training) -> None:
        """Adds an evaluation."""
        # Evaluations of a checkpoint take no time, and the first other includes compilation.
        since, first = time.perf_counter() - self._began, self._first
        speed = f", {(now.steps - first.steps) / since / 1e3:.0f} k steps/s" if first else ""
        self._fresh += now.best is not None
        # Of a checkpoint's evaluations the last one has policies.
        if first is None and self._fresh == 1 + self._resumed:
            self._first, self._began = now, time.perf_counter()
        self._evaluations.append(now)
        of = self._learner.updates
        doing = f"{phase(now.update, of)}: " if isinstance(self._learner, Distillation) else ""
        line = f"{doing}{describe(now)}{speed}"
        self._progress.move(now.update, of, line)
        self._progress.log(f"update {now.update} of {of}: {line}")

    @property
    def rows(self) -> polars.DataFrame:
        """Returns a row a policy and evaluation."""
        return polars.DataFrame(
            [
                {"update": now.update, "steps": now.steps, "policy": number + 1}
                | _plain(now.score, number)
                for now in self._evaluations
                for number in range(len(now.score.survival))
            ]
        )

    @property
    def best(self) -> list[dict[str, float]]:
        """Returns each policy's best scores, which are those of the policy that training keeps."""
        return best_scores(self._evaluations)


def best_scores(evaluations: Sequence[Training]) -> list[dict[str, float]]:
    """Returns the best scores of each policy among the evaluations of a training."""

    def best(number: int) -> Evaluation:
        scores = (one.score for one in evaluations)
        return reduce(lambda old, new: new if bool(new.beats(old)[number]) else old, scores)

    count = len(evaluations[0].score.survival)
    return [_plain(best(number), number) for number in range(count)]


def describe(now: Training) -> str:
    """Returns mean scores of policies in training, as text."""
    score = now.score
    each = (score.episode_return, score.survival, score.position_error)
    returns, survival, errors = (sum(map(float, values)) / len(values) for values in each)
    return f"return {returns:.1f}, survival {survival:.0%}, error {errors * 100:.1f} cm"


def _plain(score: Evaluation, number: int) -> dict[str, float]:
    return {name: round(float(value[number]), 6) for name, value in score._asdict().items()}


def write_policies(
    folder: Path,
    policies: Sequence[Policy],
    record: dict[str, Any],
    drone: DroneFile,
    scores: polars.DataFrame,
) -> manifest.Files:
    """Writes policies with what an export needs to know of their drone, and their scores.

    Returns:
        The files by kind.
    """
    hover = round(float(dynamics.hover_command(drone.parameters)), 6)
    rotors = {
        name: parameters.plain(getattr(drone.parameters, name)) for name in parameters.GEOMETRY
    }
    written = [
        policy_file.write(
            run_folder.POLICY.path(folder, number),
            policy,
            {**record, "hover": hover, "rotors": rotors, "number": number},
        )
        for number, policy in enumerate(policies, 1)
    ]
    table = run_folder.TRAINING.write(folder / run_folder.TRAINING.name, scores)
    _remove_older(folder, len(policies))
    return {"policies": written, "training": [table]}


def _remove_older(folder: Path, count: int) -> None:
    """Removes policies of an earlier training that had more of them."""
    for path in run_folder.POLICY.find(folder):
        number = path.stem.removeprefix("policy_")
        with suppress(InputError):
            if (
                number.isdecimal()
                and int(number) > count
                and policy_file.read(path).record.get("number") == int(number)
            ):
                path.unlink()


def how_to_start(folder: Path) -> str:
    """Returns what to do if there is no checkpoint to resume from."""
    if (folder / run_folder.TRAINING.name).exists():
        return (
            "The policies there are of a training whose state is gone. Give --overwrite instead "
            "of --resume to train others in their place."
        )
    started = folder.is_dir() and set(folder.iterdir()) > set(results.leftovers(folder))
    return (
        "Give --overwrite instead of --resume to start one."
        if started
        else "Leave out --resume to start one."
    )


def fly_watched(drone: str, task: str, policy: Policy) -> Flight:
    """Flies a policy once, on the drone at the centre of training.

    Args:
        drone: TOML file or name.
        task: name in `tasks.TASKS`.
        policy: the policy.
    """
    controller = control.controller_for(policy.interface)
    centre = control.in_fitting_steps(parameters.read(drone), controller)
    reality = VirtualDrone(parameters.name_of(drone), centre)
    flown = transfer(
        [policy],
        [reality],
        1,
        task=tasks.TASKS[task](),
        controller=controller,
        duration=WATCHED_DURATION_S,
    )
    return flown.flights[0]


def show_scores(scores: Sequence[Mapping[str, float]], output: Path) -> None:
    """Prints the scores of trained policies."""
    rows = [
        [
            f"policy_{number}",
            f"{score['episode_return']:.1f}",
            f"{score['survival']:.1%}",
            f"{score['position_error'] * 100:.1f} cm",
        ]
        for number, score in enumerate(scores, 1)
    ]
    terminal.print_table(
        "Trained policies", ["policy", "return", "survival", "position error"], rows
    )
    falling = [
        row[0]
        for row, score in zip(rows, scores, strict=True)
        if score["survival"] < LEAST_SURVIVAL
    ]
    if falling:
        print(
            f"note: of {', '.join(falling)} less than {LEAST_SURVIVAL:.0%} of the episodes reach "
            "the time limit. Train further with --resume and more --updates, or see "
            "docs/training.md."
        )
    print(f"written to {output}/")
