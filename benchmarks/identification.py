"""Measures the time of identification with as much flight as the paper had.

Writes a part of paper/notes/benchmarks.md.

The flights are simulated, so that anybody can run it; the authors' real ones are read too where
they are given.
"""

import os
import re
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import jax
import numpy as np
from page import write

from maidenflight.flights.reading import read_flights
from maidenflight.flights.windows import Windows, windows
from maidenflight.flying import recording
from maidenflight.identification.identify import identify
from maidenflight.identification.methods import Likelihood, Replay
from maidenflight.identification.replay.objective import Objective
from maidenflight.identification.search import bayesian, gradient
from maidenflight.identification.search.gauss_newton import NormalEquations, in_unit_cube
from maidenflight.identification.unknowns import PAPER_BOUNDS, Box
from maidenflight.parameters import Parameters, crazyflie, replace
from maidenflight.simulator.realities.virtual_drone import VirtualDrone

PAGE = Path(__file__).parent.parent / "paper" / "notes" / "benchmarks.md"
WINDOWS = 37_673
"""Windows of 50 rows that the paper had (sec. Simulation Optimization)."""
FLIGHTS, DURATION, SEED = 121, 32.0, 0
"""Flights recorded and how long each is [s]: about an hour, which is enough for as many windows."""
TRUTH = {"thrust_to_weight": 1.72, "motor_time_constant": 0.09, "latency": 0.015}
"""xi of the simulated drone, as a Crazyflie's."""
AUTHORS = 570.0
"""Seconds that one evaluation takes the authors' code on one core: measured on fewer windows and
scaled to 37,673 of 50 rows."""
BARS = {"evaluation": 0.5, "bayesian": 240.0, "identify": 60.0}
"""Most seconds: an evaluation on windows of 50 rows; 250 evaluations of Bayesian optimisation;
`identify` from the files on."""
BOX = Box(tuple(PAPER_BOUNDS), *(tuple(ends) for ends in zip(*PAPER_BOUNDS.values(), strict=True)))


@dataclass(frozen=True)
class Search:
    """An optimiser's work."""

    seconds: float
    inside: float
    """Of these inside the objective [s]."""
    evaluations: int
    """On all windows, with derivatives or without."""
    cost: float
    """In evaluations without derivatives."""
    lowest: float
    """Objective reached."""


def drone(unit: np.ndarray) -> Parameters:
    values = BOX.values(unit)
    return replace(
        crazyflie(),
        **{name: np.float32(value) for name, value in zip(BOX.names, values, strict=True)},
    )


def cached_windows(folder: Path, length: int, flights: int) -> Windows:
    """Windows of flights of the simulated drone, recorded once and kept in a folder."""
    path = folder / f"windows-{flights}-{length}.npz"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        reality = VirtualDrone("planted", replace(crazyflie(), time_step=0.001, **TRUTH))
        recordings = recording.record(reality, jax.random.key(SEED), flights, DURATION, rate=100)
        cut = windows(recordings, length)
        np.savez(path, **{name: array[:WINDOWS] for name, array in cut._asdict().items()})
    with np.load(path) as arrays:
        return Windows(**{name: arrays[name] for name in Windows._fields})


def time_computations(
    computations: Sequence[Callable[[np.ndarray], object]], repeats: int
) -> np.ndarray:
    """Seconds of computations, a row for each of some points, after one that compiles.

    In turn, so that what else runs falls on all.
    """
    generator = np.random.default_rng(SEED)
    durations = np.empty((repeats + 1, len(computations)))
    for row, point in zip(durations, generator.random((repeats + 1, 3)), strict=True):
        for place, compute in enumerate(computations):
            began = time.perf_counter()
            compute(point)
            row[place] = time.perf_counter() - began
    return durations[1:]


class Clock:
    """Counts and times the calls of an objective."""

    def __init__(self, objective: Objective) -> None:
        self.objective, self.inside, self.plain, self.with_derivatives = objective, 0.0, 0, 0.0

    def loss(self, unit: np.ndarray) -> float:
        """Of all windows."""
        began = time.perf_counter()
        loss = self.objective(drone(unit))
        self.inside += time.perf_counter() - began
        self.plain += 1
        return loss

    def equations(self, unit: np.ndarray, every: int) -> NormalEquations:
        """The same with derivatives, of each so manieth window."""
        began = time.perf_counter()
        system = self.objective.normal_equations(drone(unit), BOX.names, every)
        self.inside += time.perf_counter() - began
        self.with_derivatives += 1 / every
        return in_unit_cube(system, BOX, unit)


def bayesian_search(objective: Objective, evaluations: int, seed: int) -> Search:
    clock, began = Clock(objective), time.perf_counter()
    _, losses = bayesian.minimise(clock.loss, 3, evaluations, np.random.default_rng(seed))
    return Search(
        time.perf_counter() - began, clock.inside, len(losses), len(losses), float(losses.min())
    )


def gradient_search(objective: Objective, seed: int, derivatives: float) -> Search:
    """One start; `derivatives` is what derivatives on all windows cost, in evaluations."""
    clock, began = Clock(objective), time.perf_counter()
    kinks = gradient.kinks(BOX, objective.period)
    _, losses = gradient.minimise(
        clock.loss, clock.equations, objective.size, kinks, 60, np.random.default_rng(seed)
    )
    cost = clock.plain + derivatives * clock.with_derivatives
    return Search(time.perf_counter() - began, clock.inside, len(losses), cost, float(losses.min()))


def verdict(seconds: float, bar: str) -> str:
    return f"at most {BARS[bar]:g} s | {'yes' if seconds <= BARS[bar] else '**no**'}"


def measure_evaluations(
    objectives: dict[int, Objective], repeats: int
) -> tuple[list[str], float, float]:
    """Rows of the table, evaluation time on the longest windows [s], and the cost of derivatives.

    The last is a multiple of an evaluation.
    """
    rows, plain, ratio = [], 0.0, 0.0
    for length, objective in objectives.items():

        def loss(unit: np.ndarray, objective: Objective = objective) -> float:
            return objective(drone(unit))

        def slopes(unit: np.ndarray, objective: Objective = objective) -> object:
            return objective.normal_equations(drone(unit), BOX.names)

        durations = time_computations([loss, slopes], repeats)
        plain, ratio = (
            float(np.median(durations[:, 0])),
            float(np.median(durations[:, 1] / durations[:, 0])),
        )
        bar = verdict(plain, "evaluation") if length == max(objectives) else "- | -"
        what = f"{objective.size:,} windows of {length} rows"
        rows.append(
            f"| one evaluation, {what} | {plain:.3f} s (fastest {durations[:, 0].min():.3f} s) | "
            f"{bar} |"
        )
        rows.append(
            "| the same with derivatives for three parameters | "
            f"{np.median(durations[:, 1]):.2f} s, {ratio:.1f} evaluations | - | - |"
        )
    return rows, plain, ratio


def measure_searches(
    objective: Objective, evaluations: int, starts: int, ratio: float
) -> tuple[list[str], str]:
    """Rows of the table for both optimisers, and a sentence that compares them."""
    theirs = bayesian_search(objective, evaluations, SEED)
    ours = [gradient_search(objective, seed, ratio) for seed in range(starts)]
    seconds, cost = (
        statistics.median(getattr(search, what) for search in ours) for what in ("seconds", "cost")
    )
    above = max(search.lowest for search in ours) / theirs.lowest - 1
    bar = verdict(theirs.seconds, "bayesian") if evaluations == 250 else "- | -"
    own = (
        f"{theirs.seconds:.0f} s, of these {theirs.seconds - theirs.inside:.1f} s the "
        "optimiser's own"
    )
    rows = [
        f"| {evaluations} evaluations of Bayesian optimisation | {own} | {bar} |",
        f"| gradients, median of {starts} starts | {seconds:.1f} s, {cost:.1f} evaluations' worth "
        "| - | - |",
    ]
    worst = max(search.cost for search in ours)
    remark = f"{100 * abs(above):.4f} % {'above' if above > 0 else 'below'}"
    sentences = (
        f"The gradient method's {starts} random starts cost at most {worst:.1f} evaluations each, "
        "derivatives counted at their measured"
        f" cost. The worst of them ends at an objective {remark} the one that {evaluations} "
        "Bayesian evaluations reach."
    )
    return rows, sentences


def measure_authors(folder: Path | None) -> list[str]:
    """Rows of the table: `identify` from real files, by default and by the paper's objective."""
    rows = []
    for settings, remark in ((Likelihood(), "as it is"), (Replay(), "by replay")):
        what = (
            f"`identify` {remark}, on the authors' 108 PWM flights, reading and intervals included"
        )
        if folder is None or not folder.is_dir():
            rows.append(f"| {what} | not measured: give their folder with --authors | - | - |")
            continue
        began = time.perf_counter()
        result = identify(read_flights(folder), settings)
        seconds = time.perf_counter() - began
        values = ", ".join(f"{result.estimates[name].value:.4g}" for name in PAPER_BOUNDS)
        rows.append(
            f"| {what} | {seconds:.1f} s ({result.windows:,} windows; {values}) | "
            f"{verdict(seconds, 'identify')} |"
        )
    return rows


def measure_real_searches(folder: Path | None, evaluations: int, starts: int) -> list[str]:
    """Rows of a table: both optimisers on the authors' real flights of each control structure."""
    rows = [
        "| flights | derivatives cost | gradients: evaluations' worth | their objective over the "
        "Bayesian one, less 1 |",
        "|---|---|---|---|",
    ]
    for structure in ("pwm", "attitude_rate", "attitude"):
        if folder is None or not (folder / structure).is_dir():
            rows.append(
                f"| {structure} | not measured: give the folder of all with --structures | - | - |"
            )
            continue
        objective = Objective(windows(read_flights(folder / structure), 50), 0.01)
        _, _, ratio = measure_evaluations({50: objective}, 5)
        theirs = bayesian_search(objective, evaluations, SEED)
        ours = [gradient_search(objective, seed, ratio) for seed in range(starts)]
        costs = ", ".join(f"{search.cost:.1f}" for search in ours)
        above = ", ".join(f"{search.lowest / theirs.lowest - 1:+.1e}" for search in ours)
        rows.append(
            f"| {structure}, {objective.size:,} windows of 50 rows | {ratio:.1f} | {costs} | "
            f"{above} |"
        )
    return rows


def machine() -> str:
    model = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text())
    return (
        f"{os.cpu_count()} cores of {model[1] if model else 'an unknown CPU'}; load before the "
        f"run {os.getloadavg()[0]:.1f}."
    )


@click.command()
@click.option(
    "--quick", is_flag=True, help="Little flight and few evaluations; for a look, not for the page."
)
@click.option(
    "--authors", type=click.Path(path_type=Path), help="Folder of the authors' real PWM flights."
)
@click.option(
    "--structures",
    type=click.Path(path_type=Path),
    help="Folder of pwm/, attitude_rate/, attitude/: measures only searches there.",
)
@click.option(
    "--cache",
    type=click.Path(path_type=Path),
    default=Path(tempfile.gettempdir()) / "maidenflight-benchmark",
    show_default=True,
)
@click.option(
    "--output", type=click.Path(path_type=Path, exists=True), default=PAGE, show_default=True
)
def main(
    quick: bool, authors: Path | None, structures: Path | None, cache: Path, output: Path
) -> None:
    """Measures identification and writes its tables into the page OUTPUT.

    With --structures, prints a table instead.
    """
    if structures is not None:
        click.echo(
            "\n".join(measure_real_searches(structures, 20 if quick else 250, 2 if quick else 5))
        )
        return
    where, repeats, flights = machine(), 3 if quick else 9, 4 if quick else FLIGHTS
    lengths = (10, 30, 50)
    objectives = {
        length: Objective(cached_windows(cache, length, flights), 0.01) for length in lengths
    }
    rows, seconds, ratio = measure_evaluations(objectives, repeats)
    click.echo("\n".join(rows))
    searches, sentences = measure_searches(
        objectives[max(lengths)], 20 if quick else 250, 2 if quick else 5, ratio
    )
    click.echo("\n".join(searches))
    table = [
        "| what | time | bar | reached |",
        "|---|---|---|---|",
        *rows,
        *searches,
        *measure_authors(authors),
    ]
    compared = (
        f"One evaluation takes the authors' code about {AUTHORS:.0f} s on one core, by PyBullet, "
        "measured on fewer windows and scaled to"
        f" {WINDOWS:,} of 50 rows: {AUTHORS / seconds:,.0f} times as long as here on all cores."
    )
    if quick:
        click.echo("\n".join([*table, "", sentences]))
        return
    write(
        output,
        {
            "identification-machine": where,
            "identification": "\n".join(table),
            "identification-compared": f"{sentences}\n{compared}",
        },
    )
    click.echo("\n".join([*table, "", sentences, compared]))


if __name__ == "__main__":
    main()
