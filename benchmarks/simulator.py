"""Measures the speed of the simulator beside crazyflow.

Writes the tables of paper/notes/benchmarks.md.

Both sides run in processes of their own and are asked in turn, so that what else the machine does
falls on both. Every figure is a median; the batch and the layout at which a side is best are found
first and measured anew. Both are compiled as XLA does by itself and with fused loops
(`maidenflight.compiler.FUSED`), which is a layout like others.
"""

import os
import re
import statistics
import subprocess
import sys
import time
import venv
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import chart
import click
from maidenflight_speed import LAYOUTS
from page import write
from serving import Waiting

from maidenflight.compiler import FUSED, SMALLEST, has_older_emitter
from maidenflight.errors import require_packages

FOLDER = Path(__file__).parent
VERSION = "0.4.0"
BATCHES = [4**power for power in range(9)]
SERIES = {"motor": "motors", "rate": "rate PID", "training": "training"}
THEIR_LAYOUTS = ("one core", "all cores")
COMPILERS = {"XLA's own choice": "", "fused loops": FUSED} | (
    {"the older emitter": SMALLEST} if has_older_emitter() else {}
)
"""Flags by which the memory of a process is measured; what is compiled decides it."""
IS_FUSED = ", fused loops"
"""Ending of the layouts of a process that compiles by `FUSED`."""


@dataclass(frozen=True)
class Bar:
    """A figure that has to be reached."""

    what: str
    unit: str
    least: float | None = None
    """Of ours."""
    most: float | None = None
    """Of ours."""
    ratio: float | None = None
    """Of ours over crazyflow's."""

    def describe(self) -> str:
        """The bar in words."""
        if self.ratio:
            return f"{self.ratio:g} x crazyflow"
        return f"at least {figure(self.least)}" if self.least else f"at most {figure(self.most)}"

    def reached(self, ours: float | None, theirs: float | None) -> str:
        """Whether it is reached."""
        if ours is None or (self.ratio and theirs is None):
            return "not measured"
        if self.most:
            return "yes" if ours <= self.most else "**no**"
        least = self.least or (self.ratio or 0) * (theirs or 0)
        return "yes" if ours >= least else "**no**"


BARS = {
    "motor": Bar("motor commands: motor lag, latency, rigid body", "physics steps/s", ratio=8.0),
    "rate": Bar(
        "body rates held by the firmware's PID at 500 Hz, motor lag, latency, rigid body",
        "physics steps/s",
        ratio=7.0,
    ),
    "training": Bar(
        "training: the same, noise, randomization, reward, termination, reset, 100 Hz PWM",
        "environment steps/s",
        least=1e6,
    ),
    "single": Bar("one drone through `gymnasium.make`, resets included", "steps/s", least=20e3),
    "first": Bar("start of the process to its first step", "s", most=3.0),
    "memory": Bar("peak memory of a process with 1,000 drones in training", "MB", most=350.0),
}


def figure(value: float | None) -> str:
    """Three digits that count."""
    if value is None:
        return "-"
    for least, unit, prefix in ((1e9, 1e9, "G"), (1e6, 1e6, "M"), (1e4, 1e3, "k")):
        if value >= least:
            return f"{value / unit:.3g} {prefix}"
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def in_words(values: dict[str, Any]) -> str:
    """Figures of sides, in a line."""
    return "  ".join(f"{name} {figure(value)}" for name, value in values.items())


class Side:
    """One of the two that are measured: a Python, a script and processes of it that answer."""

    def __init__(
        self, python: str, script: str, layouts: Sequence[str], series: Sequence[str]
    ) -> None:
        """Starts a process at the first question to it."""
        self.command, self.series = [python, str(FOLDER / script)], series
        self.layouts = [layout + ending for ending in ("", IS_FUSED) for layout in layouts]
        self._processes: dict[str, Waiting] = {}

    def ask(self, series: str, batch: int, layout: str, seconds: float) -> float | None:
        """Steps a second; nothing where the layout does not fit the batch."""
        layout, ending, _ = layout.partition(IS_FUSED)
        if ending not in self._processes:
            self._processes[ending] = Waiting(
                self.command,
                stderr=subprocess.DEVNULL,
                env=environment() | ({"XLA_FLAGS": FUSED} if ending else {}),
            )
        question = {"series": series, "batch": batch, "layout": layout, "seconds": seconds}
        return self._processes[ending].ask(question)["rate"]

    def once(self, what: str, flags: str = "") -> tuple[float, float]:
        """What a fresh process tells in its last line, and the seconds until then."""
        start = time.perf_counter()
        command = [*self.command, what]
        with subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env=environment() | ({"XLA_FLAGS": flags} if flags else {}),
        ) as process:
            assert process.stdout is not None
            lines = [(line, time.perf_counter() - start) for line in process.stdout]
        if process.returncode or not lines:
            raise RuntimeError(f"{command} failed; run it by hand to see why.")
        return float(lines[-1][0]), lines[-1][1]

    def close(self) -> None:
        """Ends the processes."""
        for process in self._processes.values():
            process.close()


def environment() -> dict[str, str]:
    """Environment variables of the measured processes: no compilation cache, default threads."""
    own = ("JAX_", "XLA_", "OMP_")
    others = {name: value for name, value in os.environ.items() if not name.startswith(own)}
    return others | {"JAX_ENABLE_COMPILATION_CACHE": "false", "JAX_PLATFORMS": "cpu"}


@dataclass
class Measurements:
    """What was measured; of a side by its name, nothing where it was not measured."""

    figures: dict[str, dict[str, float | None]] = field(default_factory=dict)
    """By `BARS`."""
    details: dict[str, dict[str, str]] = field(default_factory=dict)
    """At which batch, by series."""
    sweep: dict[str, dict[str, dict[int, float]]] = field(default_factory=dict)
    """Steps a second by series, side and batch."""


def medians(
    sides: dict[str, Side],
    questions_by_side: dict[str, list[tuple[str, int, str]]],
    repeats: int,
    seconds: float,
) -> dict[Any, float]:
    """Median rate of each question to each side, all asked in turn."""
    answers: dict[Any, list[float]] = {}
    for _ in range(repeats):
        for name, questions in questions_by_side.items():
            for question in questions:
                rate = sides[name].ask(*question, seconds)
                if rate is not None:
                    answers.setdefault((name, question), []).append(rate)
    return {question: statistics.median(rates) for question, rates in answers.items()}


def measure_rates(
    sides: dict[str, Side], batches: list[int], repeats: int, seconds: float
) -> Measurements:
    """Sweeps over the batches, and both sides anew at their best."""
    measurements = Measurements()
    for series in SERIES:
        taking_part = {name: side for name, side in sides.items() if series in side.series}
        rates: dict[Any, float] = {}
        for batch in batches:
            questions = {
                name: [(series, batch, layout) for layout in side.layouts]
                for name, side in taking_part.items()
            }
            own = medians(sides, questions, max(2, repeats // 2), seconds)
            rates |= own
            best = {
                name: max(rate for (who, _), rate in own.items() if who == name)
                for name in taking_part
            }
            click.echo(f"{series:9} {batch:6} {in_words(best)}")
            for name, rate in best.items():
                measurements.sweep.setdefault(series, {}).setdefault(name, {})[batch] = rate
        winners = {
            name: max((rate, one) for (who, one), rate in rates.items() if who == name)[1]
            for name in taking_part
        }
        final = medians(
            sides, {name: [question] for name, question in winners.items()}, repeats, 2 * seconds
        )
        measurements.figures[series] = {
            name: final[name, question] for name, question in winners.items()
        }
        measurements.details[series] = {
            name: f"{question[1]:,} drones, {question[2]}" for name, question in winners.items()
        }
    return measurements


def measure_processes(sides: dict[str, Side], measurements: Measurements, repeats: int) -> None:
    """What takes fresh processes."""
    for what in ("single", "first", "memory"):
        compilers = COMPILERS if what == "memory" else {"": ""}
        answers: dict[tuple[str, str], list[float]] = {}
        for _ in range(repeats):
            for (name, side), (words, flags) in product(sides.items(), compilers.items()):
                answer, seconds = side.once(what, flags)
                answers.setdefault((name, words), []).append(seconds if what == "first" else answer)
        middle = {source: statistics.median(values) for source, values in answers.items()}
        measurements.figures[what] = {
            name: min(value for (who, _), value in middle.items() if who == name) for name in sides
        }
        if compilers is COMPILERS:
            for name in sides:
                own = {words: value for (who, words), value in middle.items() if who == name}
                texts = (f"{figure(value)} MB by {words}" for words, value in own.items())
                measurements.details.setdefault(what, {})[name] = ", ".join(texts)
        click.echo(f"{what:16} {in_words(measurements.figures[what])}")


def bars_table(measurements: Measurements) -> str:
    """The bars and what was reached."""
    rows = [
        f"| what | maidenflight | crazyflow {VERSION} | ratio | bar | reached |",
        "|---|---|---|---|---|---|",
    ]
    for what, bar in BARS.items():
        ours, theirs = (
            measurements.figures.get(what, {}).get(name) for name in ("maidenflight", "crazyflow")
        )
        ratio = f"{ours / theirs:.1f}" if ours and theirs else "-"
        missing = "has none" if what == "training" else "not measured"
        cells = [figure(ours) if ours else "not measured", figure(theirs) if theirs else missing]
        rows.append(
            f"| {bar.what} [{bar.unit}] | {cells[0]} | {cells[1]} | {ratio} | {bar.describe()} | "
            f"{bar.reached(ours, theirs)} |"
        )
    return "\n".join(rows)


def sweep_table(measurements: Measurements) -> str:
    """Steps a second against the number of drones."""
    columns = [
        (series, name) for series in measurements.sweep for name in measurements.sweep[series]
    ]
    rows = [
        "| drones | " + " | ".join(f"{SERIES[series]}, {name}" for series, name in columns) + " |",
        "|---:" * (len(columns) + 1) + "|",
    ]
    for batch in sorted(
        {batch for series, name in columns for batch in measurements.sweep[series][name]}
    ):
        rows.append(
            f"| {batch:,} | "
            + " | ".join(
                figure(measurements.sweep[series][name].get(batch)) for series, name in columns
            )
            + " |"
        )
    return "\n".join(rows)


def growth(measurements: Measurements) -> str:
    """How the cost of a step of all drones grows with their number."""
    sentences = []
    for series, words in SERIES.items():
        rates = measurements.sweep[series]["maidenflight"]
        least, most = min(rates), max(rates)
        linear = [batch for batch, rate in rates.items() if rate > 0.7 * max(rates.values())]
        end = f"to {max(linear):,}" if max(linear) < most else "on"
        sentences.append(
            f"- {words}: {1e6 * least / rates[least]:.3g} us with {least:,} drone, "
            f"{1e6 * most / rates[most]:.3g} us with {most:,}; "
            f"in proportion to their number, within 30 % of the best rate, from {min(linear):,} "
            f"drones {end}."
        )
    return "\n".join(sentences)


def machine(repeats: int, processes: int) -> str:
    """What all this ran on, and how often."""
    model = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text())
    cores, load = len(os.sched_getaffinity(0)), os.getloadavg()
    return (
        f"{cores} cores of {model[1] if model else 'an unknown CPU'}; load before the run "
        f"{load[0]:.1f}. "
        f"Medians of {repeats} answers of 0.4 s, and of {processes} processes."
    )


def crazyflow_python(choice: str | None) -> str | None:
    """A Python that has crazyflow, installed into a folder beside this file unless one is given.

    Nothing where that fails.
    """
    if choice:
        return choice
    folder = FOLDER / ".crazyflow"
    python = folder / "bin" / "python"
    if not (folder / "installed").exists():
        click.echo(f"installing crazyflow {VERSION} into {folder} ...")
        venv.create(folder, with_pip=True, clear=True)
        if subprocess.run(
            [python, "-m", "pip", "install", "--quiet", f"crazyflow=={VERSION}"], check=False
        ).returncode:
            return None
        (folder / "installed").touch()
    return str(python)


def require_crazyflow(crazyflow: str | None) -> None:
    """Asks for what is measured last before minutes of measuring.

    Raises:
        ClickException: the Python of crazyflow has none.
    """
    question = "import importlib.util, sys; sys.exit(not importlib.util.find_spec('crazyflow'))"
    if crazyflow and subprocess.run([crazyflow, "-c", question], check=False).returncode:
        raise click.ClickException(f"--crazyflow {crazyflow}: this Python has no crazyflow.")


def details(measurements: Measurements) -> str:
    """At which batches both were best, and their memory by `COMPILERS`."""
    return "\n".join(
        f"- {SERIES.get(series, series)}: "
        + "; ".join(f"{name} at {where}" for name, where in sides.items())
        + "."
        for series, sides in measurements.details.items()
    )


@click.command()
@click.option(
    "--quick", is_flag=True, help="Few batches and repeats; for a look, not for the page."
)
@click.option(
    "--output",
    type=click.Path(path_type=Path, exists=True),
    default=FOLDER.parent / "paper" / "notes" / "benchmarks.md",
    show_default=True,
)
@click.option(
    "--crazyflow",
    help=f"A Python that has crazyflow {VERSION}; installed into benchmarks/.crazyflow unless "
    "given.",
)
def main(quick: bool, output: Path, crazyflow: str | None) -> None:
    """Measures both and writes the tables into the page OUTPUT and a chart beside it."""
    require_packages("gymnasium")
    require_crazyflow(crazyflow)
    repeats, processes = (3, 1) if quick else (9, 5)
    where = machine(repeats, processes)
    sides = {
        "maidenflight": Side(sys.executable, "maidenflight_speed.py", list(LAYOUTS), list(SERIES))
    }
    python = crazyflow_python(crazyflow)
    if python:
        sides["crazyflow"] = Side(python, "crazyflow_speed.py", THEIR_LAYOUTS, ["motor", "rate"])
    measurements = measure_rates(sides, [1, 256, 4096] if quick else BATCHES, repeats, seconds=0.2)
    for side in sides.values():
        side.close()
    measure_processes(sides, measurements, processes)
    curves = {
        f"{SERIES[series]}, {name}": rates
        for series, by_side in measurements.sweep.items()
        for name, rates in by_side.items()
    }
    output.with_suffix(".svg").write_text(chart.lines(curves, "drones", "steps a second"))
    parts = {
        "machine": where,
        "bars": bars_table(measurements),
        "best": details(measurements),
        "sweep": sweep_table(measurements),
        "growth": growth(measurements),
    }
    write(output, parts)
    click.echo("\n" + parts["bars"])


if __name__ == "__main__":
    main()
