"""The full pipeline on a virtual drone: record, identify, train, fly zero-shot, export, report."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Thread
from typing import Any

import jax
import polars

from maidenflight import manifest, results, run_folder, workflow
from maidenflight.experiments.transfer import Transfer
from maidenflight.identification.estimates import Identification
from maidenflight.identification.identify import AUTO
from maidenflight.identification.likelihood import Likelihood
from maidenflight.identification.progress import Progress as IdentificationProgress
from maidenflight.parameters import Parameters
from maidenflight.reporting.page import report
from maidenflight.simulator import control, tasks
from maidenflight.simulator.virtual_drone import virtual_drone
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.train import Progress, train

RANDOMIZATION = 0.10
"""Half width of the box that policies are trained over, as the paper's."""
DRONE = "crazyflie"
"""Named drone that training is compiled with."""


@dataclass(frozen=True)
class Plan:
    """How much the demo does."""

    flights: int = 4
    """Flights recorded."""
    duration: float = 30.0
    """Of each of them [s]."""
    over: str | Sequence[str] = AUTO
    """Parameters to identify; `AUTO`: the flights choose them."""
    identification: Likelihood = Likelihood(trials=1)
    """Settings of identification."""
    policies: int = 3
    """Policies trained."""
    learner: AnalyticGradient = AnalyticGradient(updates=600, evaluations=6)
    """Settings of training."""
    flight_trials: int = 3
    """Zero-shot flights of each policy."""
    longest: float = 20.0
    """Longest of them [s]."""


@dataclass(frozen=True)
class Demo:
    """What the demo found."""

    truth: Parameters
    identification: Identification
    transfer: Transfer
    seconds: dict[str, float]
    """Wall time of each stage."""
    folder: Path
    page: Path
    best: Path
    """The policy that was exported."""


@dataclass(frozen=True)
class Listener:
    """Functions that are called as the demo goes on."""

    stage: Callable[[str], None]
    identification: Callable[[IdentificationProgress], None]
    training: Callable[[Progress], None]


def demo(folder: Path, seed: int, plan: Plan, listener: Listener) -> Demo:
    """Runs every stage on the virtual drone of a seed and writes all results into a folder.

    Identification and training see only the recorded flights; the truth is read again only for the
    summary.
    """
    seconds: dict[str, float] = {}
    drone = virtual_drone(seed)
    Thread(target=_compile_training, args=(plan,), daemon=True).start()

    def run(name: str, stage: Callable[[], Any]) -> Any:
        listener.stage(name)
        began = time.perf_counter()
        made = stage()
        seconds[name] = round(time.perf_counter() - began, 2)
        return made

    recorded = folder / run_folder.RECORDED[0]
    run(
        "record",
        lambda: workflow.record(
            drone, seed, recorded, folder / run_folder.REALITY, plan.flights, plan.duration, 0.06
        ),
    )
    _, found = run(
        "identify",
        lambda: workflow.identify_from(
            recorded,
            seed,
            folder / run_folder.DRONE,
            plan.identification,
            over=plan.over,
            on_progress=listener.identification,
        ),
    )
    policies = folder / run_folder.POLICIES
    run(
        "train",
        lambda: workflow.train_for(
            folder / run_folder.DRONE,
            seed,
            policies,
            plan.policies,
            plan.learner,
            RANDOMIZATION,
            listener.training,
            accept_bounds=True,
        ),
    )
    flown = run(
        "transfer",
        lambda: workflow.transfer_to(
            [policies],
            [drone],
            seed,
            folder / run_folder.TRANSFER,
            plan.flight_trials,
            plan.longest,
        ),
    )
    best = workflow.best_policy(flown, workflow.policy_files([policies]))
    run("export", lambda: workflow.export(best, folder / run_folder.FIRMWARE, seed))
    stages = run_folder.write_stages(folder, seed, seconds)
    made = results.record(seed=seed, inputs=[], settings={"drone": drone.name})
    manifest.append(stages, "demo", {"stages": [stages]}, made)
    page = run("report", lambda: report(folder, folder / run_folder.REPORT))
    return Demo(drone.parameters, found, flown, seconds, folder, page, best)


def _compile_training(plan: Plan) -> None:
    """Compiles training while flights are recorded and identified, by one update of it.

    The compiled program is that of any drone: its parameters are arguments.
    """
    controller = control.pwm()
    train(
        tasks.circle(),
        controller,
        workflow.randomized(DRONE, RANDOMIZATION, controller),
        jax.random.split(jax.random.key(0), plan.policies),
        replace(plan.learner, updates=1, evaluations=1),
    )


def reached(table: polars.DataFrame) -> int:
    """Number of flights that reached the time limit."""
    return table.filter(polars.col("end_reason") == "time limit").height
