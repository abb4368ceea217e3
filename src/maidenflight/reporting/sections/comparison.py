"""Several runs side by side: what was identified, and how policies flew."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
import polars
from markupsafe import Markup

from maidenflight.flights.checkup.result import warning_lines
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
_OF_FLIGHTS = {
    "reached": tables.number("Reached the time limit [%]", 0, 100.0),
    "duration": tables.number("Median duration [s]", 2),
    **flights.MEASURED,
}


def summarize(runs: Runs) -> str:
    """Returns what each run is, a sentence each."""
    return " ".join(
        f"{name}{f' ({_mass(run)})' if _mass(run) else ''}: {head.title(run)}."
        for name, run in runs.items()
    )


def _mass(run: Run) -> str:
    """The mass that the drone's values are in proportion to."""
    return "" if run.drone is None else f"{text.number(1e3 * float(run.drone.parameters.mass))} g"


def key_figures(runs: Runs) -> Markup:
    """Returns the few numbers that matter, a column a run, and what makes each drone doubtful."""
    masses = {name: _mass(run) for name, run in runs.items() if run.drone is not None}
    rows: dict[str, dict[str, str]] = {"mass": masses} if masses else {}
    decimals = {parameter: _decimals(runs, parameter) for parameter in head.NAMES}
    for name, run in runs.items():
        own = {parameter: each[name] for parameter, each in decimals.items() if name in each}
        for figure in head.key_figures(run, own):
            label = Markup(figure.label).striptags()
            rows.setdefault(label, {})[name] = f"{figure.value} {figure.unit}".strip()
    table = [{"figure": label} | _fill(runs, values) for label, values in rows.items()]
    columns = {"figure": "Figure", **{name: name for name in runs}}
    if len(runs) == 2:
        columns["difference"] = "Difference"
        table = [row | {"difference": _subtract(*map(row.__getitem__, runs))} for row in table]
    doubts = {
        name: warning_lines(run.drone.warnings)
        for name, run in runs.items()
        if run.drone is not None and run.drone.warnings
    }
    return render("comparison.html", doubts=doubts, table=_tabulate("figures", table, columns))


def _subtract(first: str, second: str) -> str:
    """Returns how much the second figure is above the first, in digits that both have."""
    (value, unit), (other, own) = (text_of.partition(" ")[::2] for text_of in (first, second))
    try:
        low, high = (float(number.replace("\N{MINUS SIGN}", "-")) for number in (value, other))
    except ValueError:
        return text.NOTHING
    if unit != own:
        return text.NOTHING
    digits = min(len(number.partition(".")[2]) for number in (value, other))
    return f"{text.signed(f'{high - low:+.{digits}f}')} {unit}".rstrip()


def trained(runs: Runs) -> Markup:
    """Returns learning curves of the runs over each other."""
    scores = {name: run.training for name, run in runs.items() if run.training is not None}
    if len(scores) < 2:
        return Markup()
    curves = compared_curves(scores, {name: _colour(runs, name) for name in scores})
    return render("comparison.html", curves=curves, table=Markup())


def parameters(runs: Runs) -> Markup:
    """Returns intervals of each parameter that two drones or more were identified by."""
    drones = {name: run for name, run in runs.items() if run.estimates}
    if len(drones) < 2:
        return Markup()
    sought = [[*run.estimates] for run in drones.values()]
    sought += [[*run.unidentified] for run in drones.values()]
    names = list(dict.fromkeys(name for some in sought for name in some))
    rows = []
    for parameter in names:
        ends = [end for run in drones.values() for end in _interval(run, parameter) or ()]
        factor, unit = text.scale(parameter, ends)
        decimals = _decimals(drones, parameter)
        values = {
            name: _written(run, parameter, factor, decimals.get(name, 0))
            for name, run in drones.items()
        }
        estimates = [
            drone.estimates[parameter] for drone in drones.values() if parameter in drone.estimates
        ]
        label = f"{text.label(parameter)}{f' [{unit}]' if unit else ''}"
        rows.append({"parameter": label, **values, "apart": _measure_difference(estimates)})
    columns = {"parameter": "Parameter", **{name: name for name in drones}}
    table = _tabulate(
        "parameters", rows, {**columns, "apart": tables.number("Apart [standard errors]", 1)}
    )
    return render("comparison.html", intervals=_draw(drones, names), table=table)


def _interval(run: Run, name: str) -> tuple[float, float] | None:
    """The interval of an estimate, or what is plausible of a parameter that is not identified."""
    return run.estimates[name].interval if name in run.estimates else run.unidentified.get(name)


def _decimals(runs: Runs, name: str) -> dict[str, int]:
    """Decimals of a parameter by run: one more than its interval justifies, where others have."""
    known = {run_name: _interval(run, name) for run_name, run in runs.items()}
    intervals_of = {run_name: ends for run_name, ends in known.items() if ends is not None}
    factor, _ = text.scale(name, [*intervals_of.values()] or [0.0])
    own = {
        run_name: text.places(factor * (high - low))
        for run_name, (low, high) in intervals_of.items()
    }
    return {run_name: min(decimals + 1, max(own.values())) for run_name, decimals in own.items()}


def _written(run: Run, name: str, factor: float, digits: int) -> str:
    """What a run says about a parameter."""
    ends = _interval(run, name)
    if ends is None:
        return text.NOTHING
    interval = f"[{', '.join(text.fixed(factor * end, digits) for end in ends)}]"
    if name not in run.estimates:
        return f"not identified, plausible {interval}"
    return f"{text.fixed(factor * run.estimates[name].value, digits)} {interval}"


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
    summary = rows.group_by("run", "panel", maintain_order=True).agg(
        polars.col("policy").n_unique().alias("policies"),
        polars.len().alias("flights"),
        reached.mean().alias("reached"),
        polars.col("duration").median(),
        polars.col("^(position|estimated)_error$").mean(),
        polars.col("^largest_.*$").max(),
    )
    columns = {
        name: column for name, column in (_LEADING | _OF_FLIGHTS).items() if name in summary.columns
    }
    colours = {_colour(runs, name): name for name in runs}
    times = flight_time_figures.flight_times(rows, "Flight times", colours)
    table = tables.sortable("flown", summary, columns)
    return render("comparison.html", times=times, table=table)


def _draw(runs: Runs, names: Sequence[str]) -> Figure:
    """Draws intervals of all runs as shares of what was plausible about the start of any run."""
    marks: list[Spec] = []
    shifts = intervals.levels(len(runs))
    for row, name in enumerate(names):
        ranges = [
            plausible_range(run.estimates[name]) for run in runs.values() if name in run.estimates
        ]
        ranges += [run.unidentified[name] for run in runs.values() if name in run.unidentified]
        low, high = min(low for low, _ in ranges), max(high for _, high in ranges)
        for shift, (run_name, run) in zip(shifts, runs.items(), strict=True):
            ends = _interval(run, name)
            if ends is None:
                continue
            start, stop = ((end - low) / (high - low) for end in ends)
            look = {"row": row, "shift": float(shift), "series": run_name, "name": run_name}
            look["colour"] = charts.paint(_colour(runs, run_name))
            kind = "bar" if name in run.estimates else "whisker"
            marks.append({**look, "kind": kind, "x": start, "x2": stop})
            if name in run.estimates:
                value = (run.estimates[name].value - low) / (high - low)
                marks.append({**look, "kind": "value", "x": value})
    labels = [(text.label(name), "") for name in names]
    legend = [Entry(name, _colour(runs, name), "bar", name) for name in runs]
    panel = intervals.rows(labels, marks, intervals.plausible_axis(), {"name": "run"})
    return Figure("Parameters", [panel], legend, columns=1)


def _colour(runs: Runs, name: str) -> str:
    return charts.PALETTE[list(runs).index(name) % len(charts.PALETTE)]


def _measure_difference(estimates: Sequence[Estimate]) -> float:
    """Largest difference of two estimates in standard errors of it; NaN of fewer than two."""
    values = [(estimate.value, np.ptp(estimate.interval) / _WIDTH) for estimate in estimates]
    return max(
        (
            abs(value - other) / max(float(np.hypot(error, other_error)), 1e-30)
            for (value, error), (other, other_error) in combinations(values, 2)
        ),
        default=float("nan"),
    )


def _fill(runs: Runs, values: Mapping[str, str]) -> dict[str, str]:
    return {name: values.get(name, text.NOTHING) for name in runs}


def _tabulate(name: str, rows: Sequence[Mapping[str, Any]], columns: Mapping[str, Any]) -> Markup:
    if not rows:
        return Markup()
    return tables.sortable(name, polars.DataFrame(rows), columns)
