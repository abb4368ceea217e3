"""Output of policies: their scores in training, their flights and predicted flight times."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from maidenflight.terminal import table, without_bar

if TYPE_CHECKING:
    from pathlib import Path

    from polars import DataFrame

    from maidenflight.experiments.transfer import Transfer
    from maidenflight.training.train import Progress


def scored(
    move: Callable[[int, int | None, str], None],
    progress: "Progress",
    updates: int,
    rate: float | None = None,
    doing: str = "",
) -> None:
    """Shows the scores of policies in training, in a progress bar or as a line of a file.

    Args:
        move: moves the bar.
        progress: of the training.
        updates: in all.
        rate: steps simulated a second.
        doing: what the training does, if it has phases.
    """
    line = scores(progress, rate)
    line = f"{doing}: {line}" if doing else line
    move(progress.update, updates, line)
    without_bar(f"update {progress.update} of {updates}: {line}")


def scores(progress: "Progress", rate: float | None = None) -> str:
    """Mean scores of policies in training and the steps simulated a second, as text."""
    score = progress.score
    each = (score.episode_return, score.survival, score.position_error)
    returns, survival, errors = (sum(map(float, values)) / len(values) for values in each)
    speed = "" if rate is None else f", {rate / 1e3:.0f} k steps/s"
    return f"return {returns:.1f}, survival {survival:.0%}, error {errors * 100:.1f} cm{speed}"


FEW = 12
"""Zero-shot flights that the command line prints one by one."""


def by_policy(summary: "DataFrame") -> None:
    """Prints a line for each policy and reality, of what `workflow.transfer_summary` gives."""
    rows = [
        [
            *(row["policy"], row["reality"]),
            f"{row['time_limit']} of {row['flights']}",
            f"{row['duration']:.2f} s",
            f"{row['position_error'] * 100:.1f} cm",
            f"{row['command_change']:.3f}",
        ]
        for row in summary.iter_rows(named=True)
    ]
    columns = [
        "policy",
        "reality",
        "reached the time limit",
        "mean duration",
        "mean error",
        "change of u",
    ]
    table(
        "Zero-shot flights by policy, simulated; error: distance from the set-point; u: in 10 ms",
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
        [
            *(str(row[name]) for name in ("flight", "policy", "reality", "trial")),
            f"{row['duration']:.2f} s",
            row["end_reason"],
            f"{row['position_error'] * 100:.1f} cm",
            f"{row['command_change']:.3f}",
        ]
        for row in flown.table.iter_rows(named=True)
    ]
    columns = [
        "flight",
        "policy",
        "reality",
        "trial",
        "duration",
        "ended by",
        "error",
        "change of u",
    ]
    table(
        "Zero-shot flights, simulated; error: mean distance from the set-point; u: in 10 ms",
        columns,
        rows,
        numbers_from=3,
    )


def envelope(found: "DataFrame") -> None:
    """Prints a line for each policy, reality and axis, of what `envelope.summary` gives."""
    rows = []
    for row in found.iter_rows(named=True):
        values = {name: row[name] for name in ("envelope", "low", "high", "median")}
        shown = {name: "-" if value != value else f"{value:.3g}" for name, value in values.items()}
        limit = "" if row["limit"] != row["limit"] else f"{row['limit']:.3g}"
        rows.append(
            [
                *(row["policy"], row["reality"], row["axis"]),
                shown["envelope"],
                f"{shown['low']} to {shown['high']}",
                shown["median"],
                limit,
                row["unit"],
            ]
        )
    columns = ["policy", "reality", "along", "envelope", "95 %", "median", "physics", "unit"]
    table(
        "Flown within 10 cm by 95 % of flights, simulated; -: not even the easiest",
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
    """Prints flight times of a matrix: rows are realities, control and latency; columns lags."""
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
