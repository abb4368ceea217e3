"""Several runs side by side: what was identified, and how policies flew."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
import polars
from markupsafe import Markup

from maidenflight.identification.drone_file import Estimate
from maidenflight.reporting import tables, text
from maidenflight.reporting.figures import charts, intervals
from maidenflight.reporting.figures import flight_times as flight_time_figures
from maidenflight.reporting.figures.charts import Entry, Figure, Spec
from maidenflight.reporting.figures.identification import plausible_range
from maidenflight.reporting.figures.training import compared_curves
from maidenflight.reporting.html import render
from maidenflight.reporting.run import Run
from maidenflight.reporting.sections import flights, head
from maidenflight.simulator.tasks.failures import REACHED

Runs = Mapping[str, Run]
"""By their name."""
_WIDTH = 2 * 1.96
"""Of a 95 % interval, in standard deviations."""
_LEADING = {"run": "Run", "panel": "Drone", "policies": "Policies", "flights": "Flights"}
_FLOWN = {
    "reached": tables.number("Reached the time limit [%]", 0, 100.0),
    "duration": tables.number("Median duration [s]", 2),
    "position_error": tables.number("Mean position error [cm]", 2, 100.0),
    **flights.LARGEST,
}


def summarize(runs: Runs) -> str:
    """Returns what each run is, a sentence each."""
    return " ".join(f"{name}: {head.title(run)}." for name, run in runs.items())


def key_figures(runs: Runs) -> Markup:
    """Returns the few numbers that matter, a column a run."""
    rows: dict[str, dict[str, str]] = {}
    for name, run in runs.items():
        for figure in head.key_figures(run):
            label = Markup(figure.label).striptags()
            rows.setdefault(label, {})[name] = f"{figure.value} {figure.unit}".strip()
    table = [{"figure": label} | _fill(runs, values) for label, values in rows.items()]
    columns = {"figure": "Figure", **{name: name for name in runs}}
    if len(runs) == 2:
        columns["difference"] = "Difference"
        table = [row | {"difference": _subtract(*map(row.__getitem__, runs))} for row in table]
    return _tabulate("figures", table, columns)


def _subtract(first: str, second: str) -> str:
    """Returns how much the second figure is above the first, in the digits of both."""
    (one, unit), (other, own) = (text_of.partition(" ")[::2] for text_of in (first, second))
    try:
        low, high = (float(number.replace("\N{MINUS SIGN}", "-")) for number in (one, other))
    except ValueError:
        return text.NOTHING
    if unit != own:
        return text.NOTHING
    digits = max(len(number.partition(".")[2]) for number in (one, other))
    return f"{text.signed(f'{high - low:+.{digits}f}')} {unit}".rstrip()


def trained(runs: Runs) -> Markup:
    """Returns learning curves of the runs over each other."""
    scores = {name: run.training for name, run in runs.items() if run.training is not None}
    if len(scores) < 2:
        return Markup()
    curves = compared_curves(scores, {name: _colour(runs, name) for name in scores})
    return render("comparison.html", curves=curves, table=Markup())


def parameters(runs: Runs) -> Markup:
    """Returns intervals of each parameter that two runs or more identified."""
    identified = {name: run for name, run in runs.items() if run.estimates}
    names = [
        parameter
        for parameter in dict.fromkeys(key for run in identified.values() for key in run.estimates)
        if sum(parameter in run.estimates for run in identified.values()) > 1
    ]
    if not names:
        return Markup()
    rows = []
    for parameter in names:
        estimates = {
            name: run.estimates[parameter]
            for name, run in identified.items()
            if parameter in run.estimates
        }
        ends = [end for one in estimates.values() for end in one.interval]
        scale, digits, unit = text.rounding(parameter, min(ends), max(ends))
        values = {
            name: f"{text.fixed(scale * one.value, digits)} "
            f"[{', '.join(text.fixed(scale * end, digits) for end in one.interval)}]"
            for name, one in estimates.items()
        }
        label = f"{text.label(parameter)}{f' [{unit}]' if unit else ''}"
        rows.append(
            {"parameter": label, **_fill(runs, values), "apart": _measure_difference(estimates)}
        )
    columns = {"parameter": "Parameter", **{name: name for name in identified}}
    table = _tabulate(
        "parameters", rows, {**columns, "apart": tables.number("Apart [standard errors]", 1)}
    )
    return render("comparison.html", intervals=_draw(identified, names), table=table)


def tested(runs: Runs) -> Markup:
    """Returns test flights of all runs: their durations, and a row for each run and drone."""
    return _show_flights(runs, {name: run.table for name, run in runs.items()})


def predicted(runs: Runs) -> Markup:
    """Returns predicted flights of all runs."""
    return _show_flights(runs, {name: run.prediction for name, run in runs.items()})


def _show_flights(runs: Runs, parts: Mapping[str, polars.DataFrame | None]) -> Markup:
    tables_of = [
        rows.with_columns(
            run=polars.lit(name),
            colour=polars.lit(_colour(runs, name)),
            panel=polars.col("reality") if "reality" in rows.columns else polars.lit("predicted"),
            row=polars.lit(f"{name}: ") + polars.col("policy"),
        )
        for name, rows in parts.items()
        if rows is not None
    ]
    if not tables_of:
        return Markup()
    rows = polars.concat(tables_of, how="diagonal_relaxed")
    reached = polars.col("end_reason") == REACHED
    largest = [polars.col(name).max() for name in flights.LARGEST if name in rows.columns]
    summary = rows.group_by("run", "panel", maintain_order=True).agg(
        polars.col("policy").n_unique().alias("policies"),
        polars.len().alias("flights"),
        reached.mean().alias("reached"),
        polars.col("duration").median(),
        *([polars.col("position_error").mean()] if "position_error" in rows.columns else []),
        *largest,
    )
    columns = {name: one for name, one in (_LEADING | _FLOWN).items() if name in summary.columns}
    colours = {_colour(runs, name): name for name in runs}
    times = flight_time_figures.flight_times(rows, "Flight times", colours)
    table = tables.sortable("flown", summary, columns)
    return render("comparison.html", times=times, table=table)


def _draw(runs: Runs, names: Sequence[str]) -> Figure:
    """Draws intervals of all runs as shares of what was plausible about the first run's start."""
    marks: list[Spec] = []
    shifts = np.linspace(-0.3, 0.3, len(runs))
    for row, name in enumerate(names):
        some = [run.estimates[name] for run in runs.values() if name in run.estimates]
        low, high = plausible_range(some[0])
        for shift, (run_name, run) in zip(shifts, runs.items(), strict=True):
            if name not in run.estimates:
                continue
            one = run.estimates[name]
            value, start, stop = ((end - low) / (high - low) for end in (one.value, *one.interval))
            look = {"row": row, "shift": float(shift), "series": run_name, "name": run_name}
            look["colour"] = charts.paint(_colour(runs, run_name))
            marks += [
                {**look, "kind": "bar", "x": start, "x2": stop},
                {**look, "kind": "value", "x": value},
            ]
    labels = [(text.label(name), "") for name in names]
    legend = [Entry(name, _colour(runs, name), "bar", name) for name in runs]
    panel = intervals.rows(labels, marks, intervals.plausible_axis(), {"name": "run"})
    return Figure("Parameters", [panel], legend, columns=1)


def _colour(runs: Runs, name: str) -> str:
    return charts.PALETTE[list(runs).index(name) % len(charts.PALETTE)]


def _measure_difference(estimates: Mapping[str, Estimate]) -> float:
    """Largest difference of two estimates in standard errors of the difference."""
    values = [(one.value, np.ptp(one.interval) / _WIDTH) for one in estimates.values()]
    return max(
        abs(value - other) / max(float(np.hypot(error, other_error)), 1e-30)
        for (value, error), (other, other_error) in combinations(values, 2)
    )


def _fill(runs: Runs, values: Mapping[str, str]) -> dict[str, str]:
    return {name: values.get(name, text.NOTHING) for name in runs}


def _tabulate(name: str, rows: Sequence[Mapping[str, Any]], columns: Mapping[str, Any]) -> Markup:
    if not rows:
        return Markup()
    return tables.sortable(name, polars.DataFrame(rows), columns)
