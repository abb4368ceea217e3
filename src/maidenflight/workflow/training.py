"""From a drone to policies."""

import dataclasses
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import reduce
from pathlib import Path
from typing import Any

import jax
import polars

from maidenflight import manifest, parameters, policy, policy_file, results, run_folder
from maidenflight.errors import InputError
from maidenflight.experiments.transfer import transfer
from maidenflight.flights.log import Flight
from maidenflight.identification.drone_file import DroneFile
from maidenflight.inputs import StrPath
from maidenflight.policy import Policy
from maidenflight.simulator import control, dynamics, raptor_form, tasks
from maidenflight.simulator.control import Controller
from maidenflight.simulator.look_ahead import NONE, LookAhead
from maidenflight.simulator.virtual_drone import VirtualDrone
from maidenflight.training import checkpoint, loggers
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.evaluation import Evaluation
from maidenflight.training.settings import Settings, recorded
from maidenflight.training.train import Progress, train
from maidenflight.workflow.deployment import check_export
from maidenflight.workflow.drones import drone_to_fly, randomized

WATCHED_DURATION_S = 10.0
"""Longest flight that is shown of a policy in training [s]."""

HOVER_STEP = 0.05
"""Shares at which drones hover are rounded to this for the range of thrust in attitude control, so
that drones alike have one range and one compiled program."""


def controller_to_train(
    structure: str, file: DroneFile, initial: Policy | None = None, paper_scales: bool = False
) -> Controller:
    """The control structure that policies are trained for.

    The paper's range of thrust in attitude control lifts drones whose thrust-to-weight ratio is
    above 1.71, so unless asked for it is set about the share at which the drone hovers.

    Args:
        structure: name in `control.CONTROLLERS`.
        file: the drone to train for.
        initial: where training starts, if given; the range of thrust is then its own.
        paper_scales: scale all actions as the paper does.
    """
    counts = file.full_scale_counts
    papers = control.CONTROLLERS[structure](full_scale_counts=counts)
    if structure != "attitude" or paper_scales:
        return papers
    if initial is not None and initial.interface.name == structure:
        theirs = initial.interface
        return control.controller_for(
            dataclasses.replace(papers.interface, centre=theirs.centre, span=theirs.span)
        )
    share = float(dynamics.hover_command(file.parameters))
    hover = min(max(round(share / HOVER_STEP), 1) * HOVER_STEP, 1.0)
    return control.attitude(full_scale_counts=counts, hover=round(hover, 6))


def updates_so_far(folder: StrPath) -> int | None:
    """Number of updates of the training in a folder, whether it has ended or not, if there is one.

    Raises:
        InputError: its checkpoint is damaged, or of another version.
    """
    return max(checkpoint.stages(Path(folder, run_folder.CHECKPOINT)), default=None)


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
    logger_names: Sequence[str] = (),
    history: int = 2,
    yaw_penalty: float = 0.0,
    accept_bounds: bool = False,
    target: str | None = None,
    look_ahead: LookAhead = NONE,
    memory: int = 0,
    initial: StrPath | None = None,
    paper_scales: bool = False,
) -> tuple[Policy, ...]:
    """Trains policies for a drone.

    Writes one JSON per policy, `training.csv` with their scores, and the state of training, from
    which it can be extended.

    Args:
        drone: TOML file or name.
        seed: random seed.
        folder: where to write. `run_folder.CHECKPOINT` in it is the state at the last evaluation.
        count: number of policies.
        settings: of the method. With RAPTOR's form in them, history, look-ahead and memory are that
            form's.
        randomization: half width of a box about the drone; `POSTERIOR`: samples of its posterior;
            `WIDE`: a wide box about it; `ANY_DAY`: also trims, payloads and more that no log told;
            or `ANY`: drones of any make with its sensors.
        on_progress: called after each evaluation.
        structure: name of a control structure in `control.CONTROLLERS`.
        task: name in `tasks.TASKS`.
        resume: resume from the checkpoint in the folder, with the same result as without the
            interruption; or extend the training that has ended there to more updates.
        logger_names: names in `loggers.LOGGERS`.
        history: H, number of last instants in an observation.
        yaw_penalty: cost of a radian of yaw, per control period; see `tasks.with_yaw_penalty`.
        accept_bounds: see `drone_to_fly`.
        target: name in `deployment.EXPORTERS` of what the policies are to be exported to, which is
            checked before training.
        look_ahead: points of the reference ahead of time in an observation.
        memory: M, numbers that a policy remembers; 0: none.
        initial: file of the policy that training starts from, instead of random weights; layers,
            history, look-ahead and memory are then its own.
        paper_scales: see `controller_to_train`; so it is for the target `"authors"`, whose format
            holds no other scales.

    Raises:
        InputError: the drone is refused; the policies could not be exported to the target; there
            is nothing to resume, or the checkpoint is of another training; or a logger's package is
            not installed.
        WriteError: a file cannot be written, as on a full disk; the state at the last evaluation
            is kept.
    """
    saved = Path(folder, run_folder.CHECKPOINT)
    if resume and not saved.exists():
        raise InputError(f"{saved}: no training to resume. {_how_to_start(Path(folder))}")
    file = drone_to_fly(drone, accept_bounds)
    start = None if initial is None else policy_file.read(initial)
    paper_scales = paper_scales or target == "authors"
    controller = controller_to_train(structure, file, start, paper_scales)
    if start is not None:
        history, look_ahead, memory = start.history, start.look_ahead, start.memory
    form = settings.form if isinstance(settings, AnalyticGradient) else policy.INSTANTS
    if form == raptor_form.RAPTOR:
        history, look_ahead, memory = raptor_form.SEEN
    if target is not None:
        network = settings.hidden, history, file.parameters, look_ahead, memory, form
        check_export(target, controller.interface, *network)
    box = randomized(file, randomization, controller)
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
        "look_ahead": look_ahead.to_dict() if look_ahead.points else None,
        "memory": memory or None,
        "yaw_penalty": yaw_penalty or None,
        "initial": None if initial is None else Path(initial).name,
        "paper_scales": paper_scales or None,
        **recorded(settings),
    }
    keys = jax.random.split(jax.random.key(seed), count)
    with loggers.opened(
        logger_names, folder, count, {"drone": Path(drone).name, "seed": seed, **said}
    ) as show:
        for left in results.leftovers(folder):
            left.unlink(missing_ok=True)
        trained_task = (
            tasks.with_yaw_penalty(tasks.TASKS[task](), yaw_penalty)
            if yaw_penalty
            else tasks.TASKS[task]()
        )
        policies = train(
            trained_task,
            controller,
            box,
            keys,
            settings,
            on_progress=note,
            saved=saved,
            history=history,
            anew=not resume,
            look_ahead=look_ahead,
            memory=memory,
            initial=start,
        )
    stages = checkpoint.stages(saved)
    said["extended_from"] = list(stages[:-1]) or None
    from_file = Path(drone).is_file()
    inputs = [*([drone] if from_file else []), *([] if initial is None else [initial])]
    made = results.record(
        seed=seed, inputs=inputs, settings=said if from_file else {"drone": str(drone), **said}
    )
    hover = round(float(dynamics.hover_command(file.parameters)), 6)
    rotors = {
        name: parameters.plain(getattr(file.parameters, name)) for name in parameters.GEOMETRY
    }
    for number, trained in enumerate(policies, 1):
        path = run_folder.POLICY.path(folder, number)
        policy_file.write(
            path, trained, {**made, "hover": hover, "rotors": rotors, "number": number}
        )
    table = Path(folder, run_folder.TRAINING.name)
    run_folder.TRAINING.write(table, polars.DataFrame(rows))
    _remove_older(Path(folder), count)
    written = [run_folder.POLICY.path(folder, number) for number in range(1, count + 1)]
    files: manifest.Files = {"policies": written, "training": [table]}
    manifest.append(folder, "train", files, made, {"drone": inputs})
    return policies


def best_scores(heard: Sequence[Progress], count: int) -> list[dict[str, float]]:
    """Each policy's best scores, which are those of the policy that training keeps.

    Args:
        heard: all that a training of `count` policies told of its progress.
        count: number of policies.
    """

    def best(number: int) -> Evaluation:
        return reduce(
            lambda old, new: new if bool(new.beats(old)[number]) else old,
            (progress.score for progress in heard),
        )

    return [
        {name: round(float(value[number]), 6) for name, value in score._asdict().items()}
        for number, score in enumerate(map(best, range(count)))
    ]


def _remove_older(folder: Path, count: int) -> None:
    """Removes policies of an earlier training that had more of them."""
    for path in run_folder.POLICY.find(folder):
        number = path.stem.removeprefix("policy_")
        with suppress(InputError):
            if (
                number.isdecimal()
                and int(number) > count
                and policy_file.record(path).get("number") == int(number)
            ):
                path.unlink()


def _how_to_start(folder: Path) -> str:
    """What to do if there is no checkpoint to resume from."""
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


def watched_flight(drone: StrPath, task: str) -> Callable[[Policy], Flight]:
    """A function that flies a policy once, on the drone at the centre of training.

    Args:
        drone: TOML file or name.
        task: name in `tasks.TASKS`.
    """
    centre, flown = parameters.read(drone), tasks.TASKS[task]()

    def fly(one: Policy) -> Flight:
        controller = control.controller_for(one.interface)
        reality = VirtualDrone(
            parameters.name_of(drone), control.in_fitting_steps(centre, controller)
        )
        return transfer(
            [one], [reality], 1, task=flown, controller=controller, duration=WATCHED_DURATION_S
        ).flights[0]

    return fly
