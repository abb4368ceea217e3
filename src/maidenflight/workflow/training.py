"""From a drone to policies."""

import dataclasses
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import jax
import polars

from maidenflight import parameters, policy, results, run_folder
from maidenflight.errors import InputError
from maidenflight.experiments.transfer import transfer
from maidenflight.flights.log import Flight
from maidenflight.inputs import StrPath
from maidenflight.policy import Policy
from maidenflight.simulator import control, tasks
from maidenflight.simulator.virtual_drone import VirtualDrone
from maidenflight.training import scoreboards
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.ppo import PPO
from maidenflight.training.train import Progress, Settings, recorded, train
from maidenflight.workflow.drones import randomized, table

WATCHED = 10.0
"""Longest flight that is shown of a policy in training [s]."""

SETTINGS: dict[str, AnalyticGradient] = {
    "pwm": AnalyticGradient(),
    "attitude_rate": AnalyticGradient(
        drones=256, horizon=32, hidden=(128, 128), failure=10.0, restart=0.5
    ),
    "attitude": AnalyticGradient(updates=1200, drones=128, horizon=32),
}
"""What works out of the box, by control structure: a policy that acts less often looks as far ahead
in fewer periods, and to tell the starts that it can save from those that it cannot takes more
drones, and at 50 Hz, where most of them depend on it, more weights."""


def settings_for(
    structure: str, task: str, method: str = "gradient", updates: int | None = None
) -> Settings:
    """What works out of the box for a control structure, a task and a method, all by name.

    With other updates if given.
    """
    settings = PPO() if method == "ppo" else _by_gradient(structure, task)
    return settings if updates is None else dataclasses.replace(settings, updates=updates)


def _by_gradient(structure: str, task: str) -> AnalyticGradient:
    settings = SETTINGS[structure]
    if task == "hover":  # which fails beyond 5.2 rad/s
        return dataclasses.replace(settings, updates=2 * settings.updates, spin_margin=4.0)
    if task == "figure_eight":  # eight times as large as the circle, and faster
        return dataclasses.replace(settings, updates=3 * settings.updates)
    return settings


def train_for(
    drone: StrPath,
    seed: int,
    folder: StrPath,
    count: int,
    settings: Settings,
    randomization: float | str,
    on_progress: Callable[[Progress], None] | None = None,
    structure: str = "pwm",
    task: str = "circle",
    resume: bool = False,
    boards: Sequence[str] = (),
    history: int = 2,
    heading: float = 0.0,
) -> tuple[Policy, ...]:
    """Trains policies around a drone.

    Writes one JSON a policy and `training.csv` with their scores.

    Args:
        drone: TOML file or name.
        seed: random seed.
        folder: where to write. Until the policies are written it holds `run_folder.CHECKPOINT`.
        count: policies.
        settings: of the method.
        randomization: half width of a box about the drone; `POSTERIOR`: the drones that its flights
            leave possible; or `WIDE`: drones unlike it too.
        on_progress: called after each score.
        structure: name of a control structure in `control.CONTROLLERS`.
        task: name in `tasks.TASKS`.
        resume: go on from the checkpoint in the folder, with the same result as if training had
            never stopped.
        boards: where scores are shown too, names in `scoreboards.BOARDS`.
        history: H, instants that a policy sees.
        heading: price of a radian of heading, a control period; see `tasks.facing`.

    Raises:
        InputError: there is nothing to resume, or it is another training; or a board's package is
            not installed.
        WriteError: a file cannot be written, as on a full disk; what was reached until the last
            score is kept.
    """
    saved = Path(folder, run_folder.CHECKPOINT)
    if resume and not saved.exists():
        raise InputError(f"{saved}: no training to resume. {_how_to_begin(Path(folder))}")
    controller = control.CONTROLLERS[structure]()
    box = randomized(drone, randomization, controller)
    rows: list[dict[str, Any]] = []

    def note(progress: Progress) -> None:
        for number in range(count):
            scores = {
                name: round(float(value[number]), 6)
                for name, value in progress.score._asdict().items()
            }
            rows.append(
                {"update": progress.update, "steps": progress.steps, "policy": number + 1, **scores}
            )
        show(progress)
        if on_progress is not None:
            on_progress(progress)

    said = {
        "task": task,
        "control": structure,
        "method": type(settings).__name__,
        "randomization": randomization,
        "policies": count,
        "history": history,
        "full": table(drone, "identification").get("full"),
        "heading": heading or None,
        **recorded(settings),
    }
    keys = jax.random.split(jax.random.key(seed), count)
    with scoreboards.opened(
        boards, folder, count, {"drone": Path(drone).name, "seed": seed, **said}
    ) as show:
        # Only now is all that was given known to make sense, and an earlier training may go.
        for left in [*([] if resume else [saved]), *results.leftovers(folder)]:
            left.unlink(missing_ok=True)
        practised = tasks.facing(tasks.TASKS[task](), heading) if heading else tasks.TASKS[task]()
        policies = train(practised, controller, box, keys, settings, note, saved, history)
    inputs = [drone] if Path(drone).is_file() else []
    made = results.record(
        seed=seed, inputs=inputs, settings=said if inputs else {"drone": str(drone), **said}
    )
    for number, trained in enumerate(policies, 1):
        file = run_folder.POLICY.path(folder, number)
        policy.write(file, trained, {**made, "number": number})
    run_folder.TRAINING.write(Path(folder, run_folder.TRAINING.name), polars.DataFrame(rows))
    _remove_older(Path(folder), count)
    saved.unlink()
    return policies


def _remove_older(folder: Path, count: int) -> None:
    """Removes what an earlier training of more policies left, that no one takes them for this
    one's.
    """
    for path in run_folder.POLICY.find(folder):
        number = path.stem.removeprefix("policy_")
        with suppress(InputError):
            if (
                number.isdecimal()
                and int(number) > count
                and policy.record(path).get("number") == int(number)
            ):
                path.unlink()


def _how_to_begin(folder: Path) -> str:
    """What to do where there is no checkpoint to go on from."""
    if (folder / run_folder.TRAINING.name).exists():
        return (
            "The policies there are of a training that has ended. Give --overwrite instead of "
            "--resume to train others in their place."
        )
    begun = folder.is_dir() and set(folder.iterdir()) > set(results.leftovers(folder))
    return (
        "Give --overwrite instead of --resume to begin one."
        if begun
        else "Leave out --resume to begin one."
    )


def watched_flight(drone: StrPath, structure: str, task: str) -> Callable[[Policy], Flight]:
    """A function that lets a policy fly once, on the very drone that policies are trained around.

    Args:
        drone: TOML file or name.
        structure: name of a control structure in `control.CONTROLLERS`.
        task: name in `tasks.TASKS`.
    """
    controller, flown = control.CONTROLLERS[structure](), tasks.TASKS[task]()
    reality = VirtualDrone(
        Path(drone).stem, control.in_fitting_steps(parameters.read(drone), controller)
    )
    return lambda one: transfer(
        [one], [reality], 1, task=flown, controller=controller, duration=WATCHED
    ).flights[0]
