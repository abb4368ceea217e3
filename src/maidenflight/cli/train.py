"""train: policies around a drone."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING

import click

from maidenflight import cores, run_folder, terminal
from maidenflight.cli import options
from maidenflight.cli.interruption import resumable
from maidenflight.training.scoreboards import BOARDS

if TYPE_CHECKING:
    from maidenflight.training.evaluation import Evaluation
    from maidenflight.training.train import Progress


@click.command()
@click.option(
    "--drone",
    "drone_",
    default=run_folder.DRONE,
    show_default=True,
    help="Drone to train for: a TOML file or a name.",
)
@options.output("Folder for the policies.", run_folder.POLICIES)
@click.option(
    "--control",
    default="pwm",
    show_default=True,
    type=click.Choice(options.CONTROLS),
    help="Control structure.",
)
@click.option(
    "--task", default="circle", show_default=True, type=click.Choice(options.TASKS), help="Task."
)
@click.option(
    "--policies",
    "count",
    default=3,
    show_default=True,
    type=click.IntRange(1, 64),
    help="How many, each from its own seed.",
)
@click.option(
    "--history",
    default=2,
    show_default=True,
    type=click.IntRange(1, 50),
    help="Instants that a policy sees: the last so many.",
)
@click.option(
    "--method",
    default="gradient",
    show_default=True,
    type=click.Choice(["gradient", "ppo"]),
    help="How policies learn.",
)
@click.option(
    "--updates",
    type=click.IntRange(1, 10**6),
    help="Gradient steps, or epochs of PPO. Unless given: 1500 for pwm and attitude_rate, 1200 "
    "for attitude; of these twice as many"
    " for hover, three times for figure_eight; 600 for PPO.",
)
@click.option(
    "--randomize",
    default="0.1",
    show_default=True,
    callback=options.randomization("posterior", "wide"),
    help="Half width of the parameters' box; posterior: the drones that the identified flights "
    "leave possible; or wide: drones unlike it"
    " too, with all the constant torques that its flights had.",
)
@click.option(
    "--heading",
    default=0.0,
    show_default=True,
    type=options.Range(0.0, 10.0),
    help="Price of a radian of heading, a control period; 0.1 keeps a drone from turning away in "
    "long flights, of which the paper's reward"
    " says nothing.",
)
@click.option(
    "--resume",
    is_flag=True,
    help="Go on with training that was interrupted in the folder, with the same result.",
)
@click.option(
    "--log",
    "boards",
    multiple=True,
    type=click.Choice(list(BOARDS)),
    help="Show scores there too, as they come: event files in OUTPUT/tensorboard, or Weights & "
    "Biases. May be repeated.",
)
@click.option(
    "--view",
    is_flag=False,
    flag_value="",
    metavar="[FILE]",
    help="Show scores and how the best policy flies while training runs: in rerun's viewer, or "
    "into an .rrd FILE for it.",
)
@options.seed
@options.as_json
@options.overwrite
def train(
    drone_: str,
    output: Path,
    control: str,
    task: str,
    count: int,
    history: int,
    method: str,
    updates: int | None,
    randomize: float | str,
    heading: float,
    resume: bool,
    boards: tuple[str, ...],
    view: str | None,
    seed: int,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Train policies around a drone.

    They learn by gradients through the simulator, or by PPO. Interrupted, by Ctrl-C or anything
    else, it loses at most what it learned since the last score: give the same command with
    --resume.
    """
    options.must_exist(drone_)
    options.must_be_new(output, overwrite, resume)
    cores.as_devices()
    from maidenflight import workflow

    settings = workflow.settings_for(control, task, method, updates)
    heard: list[Progress] = []
    began = time.perf_counter()
    with (
        _watched(view, drone_, control, task) as watch,
        terminal.progress("train", settings.updates) as move,
        resumable(output / run_folder.CHECKPOINT),
    ):

        def hear(progress: "Progress") -> None:
            nonlocal began
            # The first score comes after compiling, and those of a resumed training come at once.
            rate = (
                (progress.steps - heard[0].steps) / (time.perf_counter() - began) if heard else None
            )
            began = began if heard else time.perf_counter()
            heard.append(progress)
            terminal.scored(move, progress, settings.updates, rate)
            watch(progress)

        move(0, settings.updates, "compiling, until the first score")
        workflow.train_for(
            drone_,
            seed,
            output,
            count,
            settings,
            randomize,
            hear,
            control,
            task,
            resume,
            boards,
            history,
            heading,
        )
    scores = _scores(heard, count)
    content = {
        "policies": [str(run_folder.POLICY.path(output, number)) for number in range(1, count + 1)],
        "scores": scores,
    }

    def text() -> None:
        rows = [
            [
                f"policy_{number}",
                f"{score['episode_return']:.1f}",
                f"{score['survival']:.1%}",
                f"{score['position_error'] * 100:.1f} cm",
            ]
            for number, score in enumerate(scores, 1)
        ]
        terminal.table("Trained policies", ["policy", "return", "survival", "position error"], rows)
        if falling := [
            row[0] for row, score in zip(rows, scores, strict=True) if score["survival"] < _FLIES
        ]:
            print(
                f"note: {', '.join(falling)} hardly ever last an episode; train with more "
                "--updates, or see docs/training.md."
            )
        print(f"written to {output}/")

    options.emit(as_json, content, text)


_FLIES = 0.1
"""Survival below which a policy is said not to fly."""


def _scores(heard: list["Progress"], count: int) -> list[dict[str, float]]:
    """Each policy's at its best, which is the one that training keeps."""

    def best(number: int) -> "Evaluation":
        return reduce(
            lambda old, new: new if bool(new.beats(old)[number]) else old,
            (progress.score for progress in heard),
        )

    return [
        {name: round(float(value[number]), 6) for name, value in score._asdict().items()}
        for number, score in enumerate(map(best, range(count)))
    ]


@contextmanager
def _watched(
    view: str | None, drone_: str, control: str, task: str
) -> Iterator[Callable[["Progress"], None]]:
    """What shows each score of a training in rerun; nothing unless asked for."""
    if view is None:
        yield lambda progress: None
        return
    from maidenflight import workflow
    from maidenflight.reporting import live

    with live.training(
        workflow.watched_flight(drone_, control, task), Path(view) if view else None
    ) as watch:
        yield watch
