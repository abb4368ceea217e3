"""What people see in a terminal: progress bars on standard error, tables on standard output."""

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from textwrap import fill
from typing import TYPE_CHECKING

_WIDE = 110
"""Columns of a terminal from which a bar may be long."""

if TYPE_CHECKING:
    from pathlib import Path

    from polars import DataFrame

    from maidenflight.demo import Demo
    from maidenflight.experiments.transfer import Transfer
    from maidenflight.identification.estimates import Identification
    from maidenflight.training.train import Progress


@contextmanager
def progress(title: str, total: int | None) -> Iterator[Callable[[int, int | None, str], None]]:
    """A progress bar on standard error.

    Call it with (done, total, remark), where no total means that none is known.
    """
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.table import Column

    console = Console(stderr=True)
    width = 24 if console.width >= _WIDE else 5
    share = TaskProgressColumn("{task.percentage:>3.0f} %", text_format_no_percentage="     ")
    # A bar must not give way to the remark: it would jump with each.
    line = BarColumn(width, table_column=Column(min_width=width, no_wrap=True))
    remark = TextColumn(
        "{task.fields[remark]}", table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1)
    )
    columns = (
        "[bold]{task.description:<9}",
        line,
        share,
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        remark,
    )
    with Progress(*columns, console=console, disable=not console.is_terminal, expand=True) as bar:
        task = bar.add_task(title, total=total, remark="")

        def move(done: int, of: int | None, remark: str) -> None:
            if of is None and bar.tasks[0].total is not None:
                bar.reset(task, total=None)
            bar.update(task, completed=done, total=of, remark=remark)

        yield move


def without_bar(line: str) -> None:
    """Prints a line on standard error where no terminal is, and so no bar: whoever reads a file
    sees that work goes on.
    """
    if not sys.stderr.isatty():
        print(line, file=sys.stderr, flush=True)


def notes(said: Sequence[str], most: int = 6) -> None:
    """Prints notes on files, each different one once: of those that say the same the number of
    files instead of their names.
    """
    same: dict[str, list[str]] = {}
    for note in said:
        same.setdefault(note.partition(": ")[2] or note, []).append(note)
    grouped = [
        f"{len(every)} files: {text}" if len(every) > 1 else every[0]
        for text, every in same.items()
    ]
    for line in grouped[:most]:
        print(f"  {line}")
    if len(grouped) > most:
        print(f"  and {len(grouped) - most} more; --json lists them all")


def table(title: str, columns: list[str], rows: list[list[str]], numbers_from: int = 1) -> None:
    """Prints a table; columns from `numbers_from` on are aligned right."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    grid = Table(title=title, box=SIMPLE_HEAD, title_justify="left", title_style="bold")
    for number, column in enumerate(columns):
        # On a terminal that is too narrow cells are folded: no number is cut.
        grid.add_column(
            column,
            justify="right" if number >= numbers_from else "left",
            no_wrap=number == 0,
            overflow="fold",
        )
    for row in rows:
        grid.add_row(*row)
    console = Console()
    # Into a file or a pipe a table is as wide as it needs to be; on a terminal it must fit.
    (console if console.is_terminal else Console(width=200)).print(grid)


_IN_MS = ("motor_time_constant", "latency")
"""Parameters whose truth `truth` tells in milliseconds, in words."""


def estimates(found: "Identification", truth: dict[str, str] | None = None) -> None:
    """Prints identified parameters, beside the truth where it is known."""
    replayed = found.kind == "replay"
    rows: list[list[str]] = []
    for name, estimate in found.estimates.items():
        scale, unit = _scale(name, estimate.value)

        def told(number: float, scale: float = scale) -> str:
            return f"{number * scale:.4g}"

        row = [
            name,
            told(estimate.value),
            f"{told(estimate.interval[0])} .. {told(estimate.interval[1])}",
            f"{float(f'{estimate.spread * scale:.2g}'):g}",
        ]
        if replayed:
            row.append(
                ""
                if estimate.valley is None
                else f"{told(estimate.valley[0])} .. {told(estimate.valley[1])}"
            )
            row.append(
                f"{float(f'{estimate.trial_deviation * scale:.2g}'):g}"
                if len(estimate.trials) > 1
                else ""
            )
        if truth is not None:
            row.append(truth.get(name, "") if name in _IN_MS else told(float(truth[name])))
        rows.append([*row, unit])
    further = [
        *(["1 % valley", "between\ntrials"] if replayed else []),
        *(["truth"] if truth is not None else []),
    ]
    table(
        "Identified parameters",
        ["parameter", "value", "95 % interval", "between\nstretches", *further, "unit"],
        rows,
    )
    print("between stretches: standard deviation; the next flight may be as far off")
    if replayed:
        print("between trials: standard deviation; it tells of the optimiser only")


def _scale(name: str, value: float) -> tuple[float, str]:
    """A factor that makes an SI value one to read, and the unit that it then has."""
    from maidenflight.parameters import COMPONENTS, QUANTITIES

    unit = QUANTITIES[COMPONENTS[name][0]].unit
    unit = "" if unit == "-" else unit
    if unit == "s":
        return 1e3, "ms"
    return (1e6, f"1e-6 {unit}".strip()) if 0.0 < abs(value) < 1e-3 else (1.0, unit)


def kept(found: "Identification", start: str) -> None:
    """Prints what identified parameters rest on, and the noise found."""
    from maidenflight.parameters import QUANTITIES

    mass, arm = float(found.parameters.mass), float(found.parameters.arm_length)
    if not {"mass", "arm_length"} & set(found.estimates):
        print(
            f"kept from {start}: mass {mass * 1e3:.4g} g and arm length {arm * 1e3:.4g} mm, on "
            "which inertias and torques depend;"
        )
        print("if yours differ, give your drone with --start.")
    if found.noise:
        told = (
            f"{name} {value:.3g} {QUANTITIES[name].unit}".removesuffix(" -")
            for name, value in found.noise.items()
            if value
        )
        print(fill(f"noise found: {', '.join(told)}", 118))


def reached_objective(found: "Identification", start: str) -> None:
    """Prints how well the identified drone fits, beside the one that was begun with."""
    if found.kind == "replay":
        fit = (
            f"mean error of a replayed window {found.objective:.4g} "
            f"({found.start_objective:.4g} for {start})"
        )
    else:
        fit = (
            f"log likelihood {-found.objective:.4g} nats a row ({-found.start_objective:.4g} "
            f"for {start}; more is better)"
        )
    print(f"{fit}, after {found.evaluations} evaluations of it in {found.seconds:.1f} s")


def bought(found: "Identification") -> None:
    """Prints what each group of parameters bought, where the flights chose them."""
    if not found.bought:
        return
    # One stretch has no spread, and its error comes out as zero, or as a rounding.
    unsure = [step.error <= 1e-9 * abs(step.gain) for step in found.bought]
    rows = [
        [
            step.group,
            f"{step.gain:+.4f} +- {'?' * 6 if unknown else f'{step.error:.4f}'}",
            "kept" if step.kept else "not kept",
        ]
        for step, unknown in zip(found.bought, unsure, strict=True)
    ]
    table(
        "What adding parameters bought on flights held out",
        ["parameters", "log likelihood a row (nats)", ""],
        rows,
    )
    if any(unsure):
        print(
            "?: how sure a gain is cannot be told from one stretch of flight held out; give more "
            "flights."
        )


def predictions(errors: "DataFrame", simulated: bool) -> None:
    """Prints prediction errors, a block of rows for each horizon.

    `*` marks what is worse than predicting that nothing changes.
    """
    from maidenflight.identification.prediction import NOTHING_CHANGES

    shown = {
        "position": (100.0, "cm"),
        "velocity": (1.0, "m/s"),
        "attitude": (57.29578, "deg"),
        "body_rates": (1.0, "rad/s"),
    }
    simplest = {
        row["horizon"]: row
        for row in errors.iter_rows(named=True)
        if row["model"] == NOTHING_CHANGES
    }
    rows: list[list[str]] = []
    for row in errors.iter_rows(named=True):
        worse = {name: not row[name] <= simplest[row["horizon"]][name] for name in shown}
        cells = [
            f"{'* ' if worse[name] else ''}{row[name] * scale:#.3g}"
            for name, (scale, _) in shown.items()
        ]
        first = row["model"] == errors["model"][0]
        rows.append(
            [
                f"{row['horizon']:g} s" if first else "",
                row["model"],
                *(cell.removesuffix(".") for cell in cells),
            ]
        )
    heads = [f"{name.replace('_', ' ')}\n{unit}" for name, (_, unit) in shown.items()]
    title = (
        f"Open-loop prediction errors on {'simulated' if simulated else 'real'} flight, root "
        "mean squares"
    )
    table(title, ["ahead", "model", *heads], rows, numbers_from=2)
    if any(cell.startswith("*") for row in rows for cell in row[2:]):
        print(f"* worse than predicting that {NOTHING_CHANGES}")


def scored(
    move: Callable[[int, int | None, str], None],
    progress: "Progress",
    updates: int,
    rate: float | None = None,
) -> None:
    """Shows the scores of policies in training, in a progress bar or as a line of a file."""
    told = scores(progress, rate)
    move(progress.update, updates, told)
    without_bar(f"update {progress.update} of {updates}: {told}")


def scores(progress: "Progress", rate: float | None = None) -> str:
    """The mean scores of policies in training and the steps that they fly a second, for the end of
    a progress bar.
    """
    score = progress.score
    told = (score.episode_return, score.survival, score.position_error)
    returns, survival, errors = (sum(map(float, values)) / len(values) for values in told)
    speed = "" if rate is None else f", {rate / 1e3:.0f} k steps/s"
    return f"return {returns:.1f}, survival {survival:.0%}, error {errors * 100:.1f} cm{speed}"


FEW = 12
"""Zero-shot flights that the command line prints one by one."""


def by_policy(summary: "DataFrame") -> None:
    """Prints a line for each policy and reality, of what `workflow.transfer_summary` gives."""
    rows = [
        [row["policy"], row["reality"], f"{row['time_limit']} of {row['flights']}", f"{row['duration']:.2f} s",
         f"{row['position_error'] * 100:.1f} cm"]
        for row in summary.iter_rows(named=True)
    ]  # fmt: skip
    columns = ["policy", "reality", "reached the time limit", "mean duration", "mean error"]
    table(
        "Zero-shot flights by policy, simulated; error: distance from the set-point",
        columns,
        rows,
        numbers_from=2,
    )


def best(files: Sequence["Path"], how: str) -> None:
    """Prints which policy is best, or which are."""
    print(f"best: {', '.join(map(str, files))} ({how})")


def flights(flown: "Transfer") -> None:
    """Prints a line for each zero-shot flight."""
    rows = [
        [str(row["flight"]), row["policy"], row["reality"], str(row["trial"]), f"{row['duration']:.2f} s", row["end_reason"],
         f"{row['position_error'] * 100:.1f} cm"]
        for row in flown.table.iter_rows(named=True)
    ]  # fmt: skip
    columns = ["flight", "policy", "reality", "trial", "duration", "ended by", "error"]
    table(
        "Zero-shot flights, simulated; error: mean distance from the set-point",
        columns,
        rows,
        numbers_from=3,
    )


def flight_times(flown: "DataFrame") -> None:
    """Prints predicted flight times, a line a policy."""
    from maidenflight.experiments.flight_times import summary

    rows = []
    for row, part in zip(
        summary(flown).iter_rows(named=True),
        flown.partition_by("policy", maintain_order=True),
        strict=True,
    ):
        ends = part["end_reason"].to_list()
        usual = max(dict.fromkeys(ends), key=ends.count)
        times = [
            f"{row[name]:.2f} s" for name in ("mean", "quantile_10", "quantile_50", "quantile_90")
        ]
        rows.append(
            [row["policy"], row["control"], *times, f"{usual} ({ends.count(usual)} of {len(ends)})"]
        )
    columns = ["policy", "control", "mean", "10 %", "50 %", "90 %", "most frequent end"]
    table("Predicted flight times, simulated", columns, rows, numbers_from=2)


def cells(flown: "DataFrame") -> None:
    """Prints flight times of a matrix: a line a reality, control structure and latency, a column a
    motor lag.
    """
    lags = flown["motor_time_constant"].unique().sort().to_list()
    rows = []
    parts = flown.partition_by("reality", maintain_order=True)
    lines = [
        line
        for part in parts
        for line in part.group_by("reality", "control", "latency", maintain_order=True)
    ]
    for (reality, control, latency), part in lines:
        found = {
            row["motor_time_constant"]: f"{row['mean']:.1f} s  {row['share']:4.0%}"
            for row in part.iter_rows(named=True)
        }
        rows.append(
            [
                str(reality),
                str(control),
                f"{1e3 * float(latency):g} ms",
                *(found[lag] for lag in lags),
            ]
        )
    title = (
        "Mean flight time and share of flights that last the longest, by what was trained "
        "for; simulated"
    )
    table(
        title,
        ["reality", "control", "latency", *(f"T_m {1e3 * lag:g} ms" for lag in lags)],
        rows,
        numbers_from=2,
    )


def truth(result: "Demo") -> dict[str, str]:
    """What the demo's virtual drone really has, in words: the model has one delay where the drone
    has two.
    """
    from maidenflight.parameters import component

    hidden = result.truth
    latency, late = (
        float(hidden.latency) * 1e3,
        float(hidden.estimator_delay + hidden.gyro_time_constant) * 1e3,
    )
    plain = {
        name: f"{float(component(hidden, name)):.4g}" for name in result.identification.estimates
    }
    if "motor_time_constant" in plain:
        plain["motor_time_constant"] = f"{float(hidden.motor_time_constant) * 1e3:.4g}"
    if "latency" in plain:
        plain["latency"] = f"{latency:.2g} + {late:.2g} sensors"
    return plain


def _both_lags(result: "Demo", told: dict[str, str]) -> dict[str, str]:
    """The truth with the lag while slowing down too, where one lag was identified."""
    lag = float(result.truth.motor_time_constant * result.truth.spin_down_ratio) * 1e3
    if "motor_time_constant" not in told or "spin_down_ratio" in told:
        return told
    return told | {"motor_time_constant": f"{told['motor_time_constant']}, slowing {lag:.4g}"}


def summary(result: "Demo") -> None:
    """Prints what the demo found and where it wrote it."""
    from maidenflight.demo import reached

    table = result.transfer.table
    estimates(result.identification, _both_lags(result, truth(result)))
    print(
        "Intervals tell how much values depend on these flights, not on the model: the truth may "
        "lie outside where this drone has"
    )
    print("what the model lacks, such as late sensors and a battery that sags.")
    flights(result.transfer)
    durations, errors = table["duration"], table["position_error"]
    print(
        f"{reached(table)} of {table.height} flights reached the time limit; median "
        f"{durations.median():.1f} s,",
        end=" ",
    )
    print(
        f"mean position error {float(errors.to_numpy().mean()) * 100:.1f} cm. Flights and drone "
        "are simulated."
    )
    print(
        "wall time: "
        + ", ".join(f"{name} {seconds:.0f} s" for name, seconds in result.seconds.items())
    )
    folder = result.folder
    print(
        f"\n  drone      {folder / 'drone.toml'}\n  policies   {folder / 'policies'}/\n  flights  "
        f"  {folder / 'transfer'}/"
    )
    print(f"  C code     {folder / 'firmware'}/    <- of the best policy, {result.best.stem}")
    print(f"  report     {result.page}    <- open this in a browser")
