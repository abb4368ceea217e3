"""What people see in a terminal: progress bars on standard error, tables on standard output."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from polars import DataFrame

    from maidenflight.demo import Demo
    from maidenflight.experiments.transfer import Transfer
    from maidenflight.identification.estimates import Identification
    from maidenflight.training.train import Progress


@contextmanager
def progress(title: str, total: int | None) -> Iterator[Callable[[int, int | None, str], None]]:
    """A progress bar on standard error; call it with (done, total, remark), where no total means that none is known."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    console = Console(stderr=True)
    share = TaskProgressColumn("{task.percentage:>3.0f} %", text_format_no_percentage="     ")
    columns = ("[bold]{task.description:<9}", BarColumn(24), share, TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, TextColumn("{task.fields[remark]}"), console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(title, total=total, remark="")

        def move(done: int, of: int | None, remark: str) -> None:
            if of is None and bar.tasks[0].total is not None:
                bar.reset(task, total=None)
            bar.update(task, completed=done, total=of, remark=remark)

        yield move


def table(title: str, columns: list[str], rows: list[list[str]], numbers_from: int = 1) -> None:
    """Prints a table; columns from `numbers_from` on are aligned right."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    grid = Table(title=title, box=SIMPLE_HEAD, title_justify="left", title_style="bold")
    for number, column in enumerate(columns):
        grid.add_column(column, justify="right" if number >= numbers_from else "left", no_wrap=True)
    for row in rows:
        grid.add_row(*row)
    console = Console()
    # Into a file or a pipe a table is as wide as it needs to be; on a terminal it must fit.
    (console if console.is_terminal else Console(width=200)).print(grid)


def estimates(found: "Identification", truth: dict[str, str] | None = None) -> None:
    """Prints identified parameters, beside the truth where it is known."""
    from maidenflight.parameters import COMPONENTS, QUANTITIES

    replayed = found.kind == "replay"
    rows = []
    for name, estimate in found.estimates.items():
        unit = QUANTITIES[COMPONENTS[name][0]].unit
        scale, shown = (1e3, "ms") if unit == "s" else (1.0, "" if unit == "-" else unit)

        def told(number: float, scale: float = scale) -> str:
            return f"{number * scale:.4g}"

        row = [
            name,
            f"{told(estimate.value)} {shown}".strip(),
            f"{told(estimate.interval[0])} .. {told(estimate.interval[1])}",
            f"{estimate.spread * scale:.2g}",
        ]
        if replayed:
            row.append("" if estimate.valley is None else f"{told(estimate.valley[0])} .. {told(estimate.valley[1])}")
        row.append(truth.get(name, "") if truth is not None else f"{estimate.trial_deviation * scale:.2g}")
        rows.append(row)
    last = "truth" if truth is not None else "between trials"
    heads = ["parameter", "value", "95 % interval", "between stretches", *(["1 % valley"] if replayed else []), last]
    table("Identified parameters", heads, rows)


def bought(found: "Identification") -> None:
    """Prints what each group of parameters bought, where the flights chose them."""
    if not found.bought:
        return
    rows = [[step.group, f"{step.gain:+.4f} +- {step.error:.4f}", "kept" if step.kept else "not kept"] for step in found.bought]
    table("What adding parameters bought on flights held out", ["parameters", "log likelihood a row [nats]", ""], rows)


def predictions(errors: "DataFrame", simulated: bool) -> None:
    """Prints prediction errors, a block of rows for each horizon; `*` marks what is worse than predicting that nothing changes."""
    from maidenflight.identification.prediction import NOTHING_CHANGES

    shown = {"position": (100.0, "cm"), "velocity": (1.0, "m/s"), "attitude": (57.29578, "deg"), "body_rates": (1.0, "rad/s")}
    simplest = {row["horizon"]: row for row in errors.iter_rows(named=True) if row["model"] == NOTHING_CHANGES}
    rows: list[list[str]] = []
    for row in errors.iter_rows(named=True):
        worse = {name: not row[name] <= simplest[row["horizon"]][name] for name in shown}
        cells = [f"{'* ' if worse[name] else ''}{row[name] * scale:#.3g}" for name, (scale, _) in shown.items()]
        first = row["model"] == errors["model"][0]
        rows.append([f"{row['horizon']:g} s" if first else "", row["model"], *(cell.removesuffix(".") for cell in cells)])
    heads = [f"{name.replace('_', ' ')}\n{unit}" for name, (_, unit) in shown.items()]
    title = f"Open-loop prediction errors on {'simulated' if simulated else 'real'} flight, root mean squares"
    table(title, ["ahead", "model", *heads], rows, numbers_from=2)
    if any(cell.startswith("*") for row in rows for cell in row[2:]):
        print(f"* worse than predicting that {NOTHING_CHANGES}")


def scores(progress: "Progress", rate: float | None = None) -> str:
    """The mean scores of policies in training and the steps that they fly a second, for the end of a progress bar."""
    returns, survival, errors = (sum(map(float, values)) / len(values) for values in progress.score)
    speed = "" if rate is None else f", {rate / 1e3:.0f} k steps/s"
    return f"return {returns:.1f}, survival {survival:.0%}, error {errors * 100:.1f} cm{speed}"


def flights(flown: "Transfer") -> None:
    """Prints a line for each zero-shot flight."""
    rows = [
        [str(row["flight"]), row["policy"], row["reality"], str(row["trial"]), f"{row['duration']:.2f} s", row["end_reason"],
         f"{row['position_error'] * 100:.1f} cm"]
        for row in flown.table.iter_rows(named=True)
    ]  # fmt: skip
    columns = ["flight", "policy", "reality", "trial", "duration", "ended by", "error"]
    table("Zero-shot flights, simulated; error: mean distance from the set-point", columns, rows, numbers_from=3)


def flight_times(flown: "DataFrame") -> None:
    """Prints predicted flight times, a line a policy."""
    from maidenflight.experiments.flight_times import summary

    rows = []
    for row, part in zip(summary(flown).iter_rows(named=True), flown.partition_by("policy", maintain_order=True), strict=True):
        ends = part["end_reason"].to_list()
        usual = max(dict.fromkeys(ends), key=ends.count)
        times = [f"{row[name]:.2f} s" for name in ("mean", "quantile_10", "quantile_50", "quantile_90")]
        rows.append([row["policy"], row["control"], *times, f"{usual} ({ends.count(usual)} of {len(ends)})"])
    columns = ["policy", "control", "mean", "10 %", "50 %", "90 %", "most frequent end"]
    table("Predicted flight times, simulated", columns, rows, numbers_from=2)


def cells(flown: "DataFrame") -> None:
    """Prints flight times of a matrix: a line a reality, control structure and latency, a column a motor lag."""
    lags = flown["motor_time_constant"].unique().sort().to_list()
    rows = []
    parts = flown.partition_by("reality", maintain_order=True)
    lines = [line for part in parts for line in part.group_by("reality", "control", "latency", maintain_order=True)]
    for (reality, control, latency), part in lines:
        found = {row["motor_time_constant"]: f"{row['mean']:.1f} s  {row['share']:4.0%}" for row in part.iter_rows(named=True)}
        rows.append([str(reality), str(control), f"{1e3 * float(latency):g} ms", *(found[lag] for lag in lags)])
    title = "Mean flight time and share of flights that last the longest, by what was trained for; simulated"
    table(title, ["reality", "control", "latency", *(f"T_m {1e3 * lag:g} ms" for lag in lags)], rows, numbers_from=2)


def truth(result: "Demo") -> dict[str, str]:
    """What the demo's virtual drone really has, in words: the model has one delay where the drone has two."""
    from maidenflight.parameters import component

    hidden = result.truth
    latency, late = float(hidden.latency) * 1e3, float(hidden.estimator_delay + hidden.gyro_lag) * 1e3
    plain = {name: f"{float(component(hidden, name)):.4g}" for name in result.identification.estimates}
    if "motor_time_constant" in plain:
        plain["motor_time_constant"] = f"{float(hidden.motor_time_constant) * 1e3:.4g}"
    if "latency" in plain:
        plain["latency"] = f"{latency:.2g} + {late:.2g} sensors"
    return plain


def summary(result: "Demo") -> None:
    """Prints what the demo found and where it wrote it."""
    from maidenflight.demo import reached

    table = result.transfer.table
    estimates(result.identification, truth(result))
    flights(result.transfer)
    durations, errors = table["duration"], table["position_error"]
    print(f"{reached(table)} of {table.height} flights reached the time limit; median {durations.median():.1f} s,", end=" ")
    print(f"mean position error {float(errors.to_numpy().mean()) * 100:.1f} cm. Flights and drone are simulated.")
    print("wall time: " + ", ".join(f"{name} {seconds:.0f} s" for name, seconds in result.seconds.items()))
    folder = result.folder
    print(f"\n  drone      {folder / 'drone.toml'}\n  policies   {folder / 'policies'}/\n  flights    {folder / 'transfer'}/")
    print(f"  C code     {folder / 'firmware'}/\n  report     {result.page}    <- open this in a browser")
