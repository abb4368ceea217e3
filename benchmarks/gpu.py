"""Measures the simulator and the training of the paper's 81 policies on a GPU.

Beside crazyflow on the same card. Writes the tables of paper/notes/benchmarks.md.

Every figure is of a process of its own. All compile at once, wait, and are asked in turn.
"""

import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import chart
import click
import jax
import jax.numpy as jnp
import numpy as np
from page import write
from serving import Waiting, peak

import maidenflight as mf
from maidenflight import parameters, policy_file, run_folder
from maidenflight.parameters import crazyflie
from maidenflight.policy import Policy
from maidenflight.simulator.controllers import control
from maidenflight.simulator.randomization import relative_box
from maidenflight.studies import study
from maidenflight.training import defaults
from maidenflight.training.settings import Settings
from maidenflight.verbs.train import Train
from simulator import FOLDER, SERIES, VERSION, figure

BATCHES = [16**power for power in range(6)]
SCRIPTS = {"maidenflight": "maidenflight_speed.py", "crazyflow": "crazyflow_speed.py"}
STUDY = FOLDER.parent / "paper" / "settings" / "zero_shot.toml"
SAMPLE = 100
"""Updates by which numbers of cells in a call are compared."""
TOGETHER = (1, 9)
"""Cells in a call: one, and all of a control structure."""


@dataclass(frozen=True)
class Simulation:
    """A simulator, what it simulates and how many drones."""

    name: str
    series: str
    batch: int

    def question(self, seconds: float) -> dict[str, Any]:
        """As `serving.serve` takes it."""
        return {
            "series": self.series,
            "batch": self.batch,
            "layout": "one core",  # one device
            "seconds": seconds,
        }


def find_cells() -> dict[str, list[Train]]:
    """Returns what trains the paper's policies, by control structure, a cell each."""
    cells: dict[str, list[Train]] = {}
    for task in study.read_study(STUDY).tasks:
        if task.kind == "train":
            cells.setdefault(task.settings["control"], []).append(Train(**changes_of(task)))
    return cells


def changes_of(task: study.Task) -> dict[str, Any]:
    """Returns a task's settings by the names that `Train` has for them."""
    names = {name: attribute for name, (attribute, _) in Train.settings().items()}
    return {names[name]: value for name, value in task.settings.items()}


def train_cells(cells: Sequence[Train], settings: Settings) -> list[tuple[Policy, ...]]:
    """Trains the policies of cells of one control structure in one call.

    Args:
        cells: what trains those of each.
        settings: of the method.

    Returns:
        The policies of each cell.
    """
    first, count = cells[0], cells[0].policies
    controller = defaults.choose_controller(
        first.control, crazyflie(), paper_scales=first.paper_scales, rate=first.rate
    )
    boxes = []
    for cell in cells:
        changes = {name: np.float32(value) for name, value in cell.changes.items()}
        drone = control.in_fitting_steps(parameters.replace(crazyflie(), **changes), controller)
        boxes += [relative_box(drone, float(cell.randomize or 0.0))] * count
    keys = jnp.concatenate([jax.random.split(jax.random.key(cell.seed), count) for cell in cells])
    policies = mf.train(mf.simulator.circle(), controller, boxes, keys, settings, first.spec)
    return [policies[start : start + count] for start in range(0, len(policies), count)]


def train(structure: str, together: int, updates: int, folder: Path | None) -> None:
    """Trains the first cells of a control structure in one call whenever it is asked.

    Prints the seconds of compiling, then for each line that it reads the seconds of so many updates
    and the peak memory [bytes]. Policies go to the folder.
    """
    cells = find_cells()[structure][:together]
    own = cells[0].learner_settings

    def time_training(updates: int, evaluations: int) -> tuple[list[tuple[Policy, ...]], float]:
        start = time.perf_counter()
        changed: Any = replace(own, updates=updates, evaluations=evaluations)
        trained_policies = jax.block_until_ready(train_cells(cells, changed))
        return trained_policies, time.perf_counter() - start

    def tell(**what: Any) -> None:
        print(json.dumps(what), flush=True)

    sys.stdin.readline()
    tell(seconds=time_training(1, 1)[1])
    for _ in sys.stdin:
        trained_policies, seconds = time_training(
            updates, own.evaluations if updates == own.updates else 1
        )
        if folder is not None:
            for cell, policies in zip(cells, trained_policies, strict=True):
                place = folder / "_".join([structure, *map(str, cell.changes.values())])
                for number, policy in enumerate(policies, 1):
                    policy_file.write_policy(
                        run_folder.POLICY.path(place, number), policy, cell.make_record()
                    )
        tell(seconds=seconds, peak=peak())


def measure_simulators(processes: dict[Simulation, Waiting], rounds: int) -> dict[str, str]:
    """The table of rates and memory, and the chart of the rates."""
    memory = {one: process.answer()["peak"] for one, process in processes.items()}
    rates: dict[Simulation, list[float]] = {one: [] for one in processes}
    for _ in range(rounds):
        for one, process in processes.items():
            answer = process.ask(one.question(0.3))
            rates[one].append(answer["rate"])
            memory[one] = answer["peak"]
    middle = {one: statistics.median(values) for one, values in rates.items()}
    columns = list(dict.fromkeys((one.name, one.series) for one in processes))
    rows = [
        "| drones | " + " | ".join(f"{SERIES[series]}, {name}" for name, series in columns) + " |",
        "|---:" * (len(columns) + 1) + "|",
    ]
    for batch in BATCHES:
        cells = [figure(middle[Simulation(*column, batch)]) for column in columns]
        rows.append(f"| {batch:,} | " + " | ".join(cells) + " |")
    megabytes = [figure(memory[Simulation(*column, BATCHES[-1])] / 1e6) for column in columns]
    rows.append(f"| peak memory with {BATCHES[-1]:,} [MB] | " + " | ".join(megabytes) + " |")
    curves = {
        f"{SERIES[series]}, {name}": {
            batch: middle[Simulation(name, series, batch)] for batch in BATCHES
        }
        for name, series in columns
    }
    return {"gpu-sweep": "\n".join(rows), "chart": chart.lines(curves, "drones", "steps a second")}


def measure_training(processes: dict[tuple[str, int], Waiting]) -> str:
    """The table of the 81 policies, and what policies in one call save."""
    compiling = {question: process.answer()["seconds"] for question, process in processes.items()}
    cells = find_cells()
    count = next(iter(cells.values()))[0].policies
    rows = [
        f"| | one update of {count} policies [ms] | of {TOGETHER[1] * count} | "
        "all updates of these [s] | before, once [s] | peak memory [MB] |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    total = 0.0
    for structure, (first, *_) in cells.items():
        few = processes[structure, TOGETHER[0]].ask(None)
        all_of_them = processes[structure, TOGETHER[1]].ask(None)
        total += all_of_them["seconds"]
        rows.append(
            f"| {structure} | {1e3 * few['seconds'] / SAMPLE:.1f} | "
            f"{1e3 * all_of_them['seconds'] / (first.updates or 1):.1f} | "
            f"{all_of_them['seconds']:.0f} | {compiling[structure, TOGETHER[1]]:.0f} | "
            f"{figure(all_of_them['peak'] / 1e6)} |"
        )
        click.echo(rows[-1])
    every = sum(cell.policies for own in cells.values() for cell in own)
    rows.append(f"| {every} policies | | | {total:.0f} | | |")
    return "\n".join(rows)


def card() -> str:
    """The GPU, its driver, and JAX's version."""
    completed = subprocess.run(
        ["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    name, driver = completed.stdout.strip().split(", ")
    return f"One {name}, driver {driver}; JAX {jax.__version__}, crazyflow {VERSION}."


@click.command()
@click.option("--train", "words", nargs=3, type=str, hidden=True)
@click.argument("policies", type=click.Path(path_type=Path), required=False)
@click.option(
    "--output",
    type=click.Path(path_type=Path, exists=True),
    default=FOLDER.parent / "paper" / "notes" / "benchmarks.md",
    show_default=True,
)
@click.option("--crazyflow", default=sys.executable, help=f"A Python that has crazyflow {VERSION}.")
@click.option("--rounds", default=5, show_default=True, help="Answers a process.")
def main(
    words: tuple[str, str, str] | None,
    policies: Path | None,
    output: Path,
    crazyflow: str,
    rounds: int,
) -> None:
    """Measures all and writes the tables into the page OUTPUT; trained POLICIES go to a folder."""
    if words:
        structure, together, updates = words
        train(structure, int(together), int(updates), policies)
        return
    os.environ["XLA_PYTHON_CLIENT_PREALLOCATE"] = "false"  # many processes share the card
    start = time.perf_counter()
    pythons = {"maidenflight": sys.executable, "crazyflow": crazyflow}
    simulated = [
        Simulation(name, series, batch)
        for series in SERIES
        for name in SCRIPTS
        for batch in BATCHES
        if (series, name) != ("training", "crazyflow")
    ]
    simulators = {
        one: Waiting([pythons[one.name], FOLDER / SCRIPTS[one.name]]) for one in simulated
    }
    trainings = {
        (structure, cells): Waiting(
            [
                sys.executable,
                __file__,
                "--train",
                structure,
                cells,
                first.updates if cells == TOGETHER[1] else SAMPLE,
                *([policies] if policies and cells == TOGETHER[1] else []),
            ]
        )
        for structure, (first, *_) in find_cells().items()
        for cells in TOGETHER
    }
    for one, process in simulators.items():
        process.send(one.question(0.0))
    for process in trainings.values():
        process.send(None)
    parts = {"gpu": card()} | measure_simulators(simulators, rounds)
    output.with_name("gpu.svg").write_text(parts.pop("chart"))
    write(output, parts)
    click.echo(f"{parts['gpu-sweep']}\nafter {time.perf_counter() - start:.0f} s")
    write(output, {"gpu-training": measure_training(trainings)})


if __name__ == "__main__":
    main()
