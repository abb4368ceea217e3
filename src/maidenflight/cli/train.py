"""The command train."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from maidenflight import compiler, run_folder, terminal
from maidenflight.cli import options
from maidenflight.cli.interruption import resumable
from maidenflight.deployment import EXPORTERS
from maidenflight.terminal import flight_output
from maidenflight.training.loggers import LOGGERS

if TYPE_CHECKING:
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
    help="Number of policies, each with its own seed.",
)
@click.option(
    "--history",
    default=2,
    show_default=True,
    type=click.IntRange(1, 50),
    help="Number of last instants in a policy's observation.",
)
@click.option(
    "--look-ahead",
    "points",
    default=0,
    show_default=True,
    type=click.IntRange(0, 50),
    help="Number of points of the reference, ahead of time, in a policy's observation.",
)
@click.option(
    "--look-ahead-spacing",
    "spacing",
    default=0.1,
    show_default=True,
    type=options.Range(0.001, 10.0),
    help="Time between two of these points [s].",
)
@click.option(
    "--memory",
    default=0,
    show_default=True,
    type=click.IntRange(0, 256),
    help="Numbers that a policy remembers of its flight, by a gated recurrent unit (GRU), such as "
    "32; with it, it adapts to trims, lag and payload that no log told.",
)
@click.option(
    "--form",
    default="instants",
    show_default=True,
    type=click.Choice(["instants", "raptor"]),
    help="Form of the policies. raptor: shape, observation and actions of RAPTOR's network, for "
    "export --to raptor; it has its own control structure, history, look-ahead, memory and "
    "layers.",
)
@click.option(
    "--hidden",
    callback=options.layers,
    metavar="SIZES",
    help="Sizes of a policy's hidden layers, such as 50,50; that unless given, and 75,75 for "
    "attitude_rate by gradients.",
)
@click.option(
    "--from",
    "initial",
    metavar="POLICY",
    type=click.Path(path_type=Path),
    help="Start from a policy's file instead of random weights, as to fit it to today's drone in "
    "seconds: 200 updates unless given. Its control structure, form, layers, history, look-ahead "
    "and memory stay.",
)
@click.option(
    "--for",
    "target",
    type=click.Choice(list(EXPORTERS)),
    help="Check before training that the policies can be exported to this; authors implies "
    "--paper-scales.",
)
@click.option(
    "--paper-scales",
    is_flag=True,
    help="In attitude control, scale thrust as the paper does, from 7/12 to 11/12 of full thrust, "
    "instead of about hovering.",
)
@click.option(
    "--method",
    type=click.Choice(["gradient", "distillation", "ppo"]),
    help="Training method. Unless given: for policies with a --memory distillation, from a teacher "
    "that is told what it flies, and gradient for others and for RAPTOR's form.",
)
@click.option(
    "--updates",
    type=click.IntRange(1, 10**6),
    help="Gradient steps, or epochs of PPO. Unless given: 1500 for pwm and attitude_rate, 800 "
    "for attitude (1200 with a --memory); of these twice as many for hover, three times for "
    "figure_eight; by distillation three times as many; 600 for PPO.",
)
@click.option(
    "--randomize",
    callback=options.randomization("posterior", "wide", "any-day", "any"),
    help="wide: a wide box about the drone, with the constant torques of all its flights; "
    "posterior: samples of the identified posterior; any-day: as wide, with trims, payload, a weak "
    "rotor and latency that no log told; any: quadrotors of any make, 20 g to 2.5 kg; both "
    "suit --memory; or the half width of a box, 0.1 in the paper. Unless given: wide, any-day for "
    "attitude_rate, and 0.1 for fast_circle and fast_figure_eight.",
)
@click.option(
    "--yaw-penalty",
    default=0.0,
    show_default=True,
    type=options.Range(0.0, 10.0),
    help="Cost of a radian of yaw, per control period; 0.1 keeps the yaw near 0 in long flights. "
    "The paper's reward does not depend on yaw.",
)
@click.option(
    "--resume",
    is_flag=True,
    help="Resume training that was interrupted in the folder, with the same result; or, with more "
    "--updates, extend the one that has ended there.",
)
@click.option(
    "--log",
    "logger_names",
    multiple=True,
    type=click.Choice(list(LOGGERS)),
    help="Log evaluations while training runs: event files in OUTPUT/tensorboard, or Weights & "
    "Biases. May be repeated.",
)
@click.option(
    "--view",
    is_flag=False,
    flag_value="",
    metavar="[FILE]",
    help="Show evaluations and flights of the best policy while training runs: in rerun's viewer, "
    "or in an .rrd FILE for it.",
)
@options.accept_bounds
@options.seed
@options.as_json
@options.overwrite
@click.pass_context
def train(
    context: click.Context,
    drone_: str,
    output: Path,
    control: str,
    task: str,
    count: int,
    history: int,
    points: int,
    spacing: float,
    memory: int,
    form: str,
    hidden: tuple[int, ...] | None,
    initial: Path | None,
    target: str | None,
    paper_scales: bool,
    method: str | None,
    updates: int | None,
    randomize: float | str | None,
    yaw_penalty: float,
    resume: bool,
    logger_names: tuple[str, ...],
    view: str | None,
    accept_bounds: bool,
    seed: int,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Train policies for a drone.

    By gradients through the simulator, by distillation, or by PPO. Interrupted training loses at
    most the updates since the last evaluation: give the same command with --resume.
    """
    options.must_exist(drone_)
    options.must_be_new(output, overwrite, resume)
    compiler.prepare_jax(fused=True)
    from maidenflight import policy_file, workflow
    from maidenflight.simulator.look_ahead import LookAhead
    from maidenflight.simulator.policy_spec import INSTANTS
    from maidenflight.training.distillation import Distillation, phase

    if resume and updates is None:
        updates = workflow.updates_so_far(output)
    start = None
    if initial is not None:
        _refuse(context, _OF_A_POLICY, "the policy of --from")
        start = policy_file.read(initial).policy
        control = start.interface.name
    if form != INSTANTS:
        _refuse(context, _OF_RAPTOR, "--form raptor")
    ahead = LookAhead(points, spacing)
    policy = {"history": history, "look_ahead": ahead, "memory": memory, "form": form}
    settings, spec = workflow.settings_for(
        control, task, method, updates, start, hidden=hidden, **policy
    )
    distilled = isinstance(settings, Distillation)
    heard: list[Progress] = []
    first: Progress | None = None
    new = 0
    began = time.perf_counter()
    with (
        _watched(view, drone_, task) as watch,
        terminal.progress("train", settings.updates) as move,
        resumable(output / run_folder.CHECKPOINT),
    ):

        def hear(progress: "Progress") -> None:
            nonlocal first, began, new
            # Evaluations of a checkpoint take no time, and the first other includes compilation.
            since = time.perf_counter() - began
            rate = (progress.steps - first.steps) / since if first else None
            new += progress.best is not None
            if first is None and new == 1 + resume:  # of a checkpoint's the last one has policies
                first, began = progress, time.perf_counter()
            heard.append(progress)
            doing = phase(progress.update, settings.updates) if distilled else ""
            flight_output.scored(move, progress, settings.updates, rate, doing)
            watch(progress)

        move(0, settings.updates, "compiling, until the first score")
        workflow.train_for(
            drone_,
            seed,
            output,
            count,
            settings,
            workflow.usual_training_box(task, control) if randomize is None else randomize,
            hear,
            control,
            task,
            resume,
            logger_names,
            spec,
            yaw_penalty,
            accept_bounds,
            target,
            initial,
            paper_scales,
        )
    scores = workflow.best_scores(heard, count)
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
            row[0]
            for row, score in zip(rows, scores, strict=True)
            if score["survival"] < _MIN_SURVIVAL
        ]:
            print(
                f"note: of {', '.join(falling)} less than {_MIN_SURVIVAL:.0%} of the episodes "
                "reach the time limit. Train further with --resume and more --updates, or see "
                "docs/training.md."
            )
        print(f"written to {output}/")

    options.emit(as_json, content, text, ("transfer", output, "--drone", drone_))


_OF_RAPTOR = ("control", "history", "points", "spacing", "memory", "hidden")
"""Parameters of the command that RAPTOR's form settles."""
_OF_A_POLICY = (*_OF_RAPTOR, "paper_scales", "form")
"""Those that a policy settles from which training starts."""


def _refuse(context: click.Context, settled: tuple[str, ...], settler: str) -> None:
    """Refuses options that something else settles.

    Raises:
        click.UsageError: one is given.
    """
    for name, option in options.given(context).items():
        if name in settled:
            raise click.UsageError(f"{option}: {settler} has its own. Leave it out.")


_MIN_SURVIVAL = 0.1
"""Survival below which a policy is reported as not flying."""


@contextmanager
def _watched(view: str | None, drone_: str, task: str) -> Iterator[Callable[["Progress"], None]]:
    """A function that shows each evaluation in rerun; without --view it does nothing."""
    if view is None:
        yield lambda progress: None
        return
    from maidenflight import workflow
    from maidenflight.reporting import live

    with live.training(
        workflow.watched_flight(drone_, task), Path(view) if view else None
    ) as watch:
        yield watch
