"""Test flights, predicted flights and recorded flights: pictures and tables."""

from collections.abc import Mapping
from math import degrees
from typing import Any

import numpy as np
import polars
from markupsafe import Markup

from maidenflight.experiments import flight_times, recovery
from maidenflight.flights.trims import finite_mean, hover_command, trim
from maidenflight.reporting import run as runs
from maidenflight.reporting import tables, viewer
from maidenflight.reporting.figures import changes, trims
from maidenflight.reporting.figures import flight_times as flight_time_figures
from maidenflight.reporting.figures.charts import Figure
from maidenflight.reporting.figures.plots import plot_flight
from maidenflight.reporting.html import render
from maidenflight.reporting.run import Run, viewable
from maidenflight.reporting.sections.head import describe_realities
from maidenflight.reporting.tables import Cell, Column
from maidenflight.simulator.tasks.failures import ERRORS

NAMES = {"pwm": "PWM", "attitude_rate": "Attitude rate", "attitude": "Attitude"}
"""Control structures as people call them."""
MEASURED: dict[str, Column | str] = {
    "position_error": tables.number("Mean position error [cm]", 2, 100.0),
    "estimated_error": tables.number("By its estimate [cm]", 2, 100.0),
    "largest_tilt": tables.number("Largest tilt, of 30 [deg]", 1, degrees(1.0)),
    "largest_body_rate": tables.number("Largest rate, of 800 [deg/s]", 0, degrees(1.0)),
    "largest_distance": tables.number("Farthest [cm]", 1, 100.0),
}
"""Errors, and the largest values, of the guards' limits."""
_COLUMNS: dict[str, Column | str] = {
    "flight": "Flight",
    "policy": "Policy",
    "reality": "Drone",
    "trial": Column("Trial", lambda trial, _: Cell(str(trial), str(trial))),
    "duration": tables.number("Duration [s]", 2),
    "end_reason": "Ended by",
    **{name: MEASURED[name] for name in ERRORS},
    "command_change": tables.number("Change of commands in 10 ms [%]", 1, 100.0),
    "at_limits": tables.number("Commands at a limit [%]", 1, 100.0),
    **MEASURED,
}
"""Of test flights, as far as they have them."""


def tested(run: Run) -> Markup:
    """Returns test flights: in space, in a table and in box plots."""
    if run.table is None:
        return Markup()
    rows = run.table.with_columns(panel=polars.col("reality"))
    if "control" not in rows.columns:
        controls = [run.controls.get(name, "") for name in run.table["policy"]]
        rows = rows.with_columns(polars.Series("control", controls))
    columns = {name: column for name, column in _COLUMNS.items() if name in run.table.columns}
    return render(
        "flights.html",
        where=describe_realities(run),
        viewer=_viewer(run),
        times=_times(rows),
        boxed=_boxed(rows, "policy", "reality"),
        table=tables.sortable("flights", run.table.select(*columns), columns, viewable(run)),
    )


def _boxed(rows: polars.DataFrame, *keys: str) -> bool:
    """Whether any row of a picture of flight times has a box."""
    return max(rows.group_by(keys).len()["len"].to_list(), default=0) >= flight_time_figures.BOXED


def _times(rows: polars.DataFrame) -> Figure | None:
    """Box plots, in groups if all control structures are known; None without a time."""
    if not rows["duration"].is_finite().any():
        return None
    colours = flight_time_figures.COLOURS
    is_complete = bool(rows["control"].is_in(list(colours)).all())
    group = polars.col("control").replace_strict(NAMES, default="").alias("group")
    displayed = rows.select(
        polars.col("policy").alias("row"),
        polars.col("control").replace_strict(colours, default="blue").alias("colour"),
        *("panel", "duration", "end_reason"),
        *([group] if is_complete else []),
    )
    labels = {colour: NAMES[kind] for kind, colour in colours.items()} if is_complete else {}
    return flight_time_figures.flight_times(displayed, "Flight times by policy", labels)


def change(run: Run) -> Markup:
    """Returns test flights whose drone changes on the way."""
    if run.table is None or not run.flights:
        return Markup()
    recoveries = recovery.of_flights(run.table, run.flights)
    if recoveries.is_empty():
        return Markup()
    within = f"{100 * recovery.WITHIN_M:g}"
    columns: dict[str, Column | str] = {
        "reality": "Drone",
        "policy": "Policy",
        "flights": "Flights",
        "lasting": "To the end",
        "soon": f"Back within {within} cm in {recovery.SOON_S:g} s",
        "recovery": tables.number("Median time to be back [s]", 2),
    }
    return render(
        "change.html",
        changes=changes.changes(recoveries, run.flights),
        within=within,
        table=tables.sortable("recoveries", recovery.summary(recoveries), columns),
    )


def predicted(run: Run) -> Markup:
    """Returns how long policies would fly on the real drone."""
    if run.prediction is None:
        return Markup()
    rows = run.prediction.with_columns(panel=polars.lit("predicted"))
    return render(
        "predicted.html",
        times=_times(rows),
        boxed=_boxed(rows, "policy"),
        table=_predictions(run.prediction),
    )


def _predictions(test_flights: polars.DataFrame) -> Markup:
    """A row a policy whose flights are predicted."""

    def usual_end(_: None, row: Mapping[str, Any]) -> Cell:
        ends = test_flights.filter(policy=row["policy"])["end_reason"].to_list()
        usual = max(dict.fromkeys(ends), key=ends.count)
        cell = Markup("{} <small>({} of {})</small>").format(usual, ends.count(usual), len(ends))
        return Cell(cell, usual)

    columns: dict[str, Column | str] = {
        "policy": "Policy",
        "control": Column("Control", lambda name, _: Cell(NAMES.get(str(name), str(name)), name)),
        "trials": "Flights",
        "mean": tables.number("Mean [s]", 2),
        **{f"quantile_{share}": tables.number(f"{share} % [s]", 2) for share in (10, 50, 90)},
        "end": Column("Most frequent end", usual_end),
    }
    summary = flight_times.summary(test_flights)
    columns |= {name: column for name, column in MEASURED.items() if name in summary.columns}
    return tables.sortable("prediction", summary, columns)


def recorded(run: Run) -> Markup:
    """Returns the flights that were recorded; the viewer is theirs where there are no others."""
    rows, in_viewer = _trims_of(run), run.table is None
    figure = trims.trims(rows, run.estimates, chooses=in_viewer) if rows.height > 1 else None
    return render(
        "recorded.html",
        viewer=_viewer(run) if in_viewer else Markup(),
        trims=figure,
        signals=_signals(run),
        table=_recorded(run, rows) if rows.height else Markup(),
        refused=run.refused,
        with_drone=run.drone is not None,
        identified=bool(run.estimates),
    )


def _signals(run: Run) -> list[tuple[str, Figure]]:
    """Name and signals of the first flights that no viewer can show, which lack a state."""
    others = [
        flight
        for flight in run.recorded
        if runs.usable(flight).stop <= 1 and np.isfinite(flight.command).any()
    ]
    return [(flight.name, plot_flight(flight).figure) for flight in others[:12]]


def _viewer(run: Run) -> Markup:
    viewer_count, of = len(runs.viewable(run)), len(runs.flights_to_show(run))
    if not viewer_count:
        return Markup()
    rate = f"{viewer.rate_of(viewer_count):g}"
    return render("viewer.html", rate=rate, held=viewer_count, flights=of)


def _trims_of(run: Run) -> polars.DataFrame:
    """What each recorded flight says cheaply, a row a flight, in SI units; see `trims.trim`.

    Without a drone, whose mass, motors and arms torques need, it is the command that hovers.
    """
    rows = []
    for number, flight in enumerate(run.recorded, 1):
        row: dict[str, Any] = {"number": number, "flight": flight.name}
        row |= {"drone": flight.simulated or "a real drone"}
        row |= {"duration": flight.duration, "rows": len(flight)}
        if run.drone is None:
            command, error = hover_command(flight)
            row |= {"hover_command": command, "hover_command_error": error}
        else:
            balance = trim([flight], run.drone.parameters)
            row |= {"thrust_to_weight": balance.thrust_to_weight}
            row |= {"thrust_to_weight_error": balance.thrust_to_weight_error}
            torques = zip("xyz", balance.torque_bias, balance.torque_bias_error, strict=True)
            for axis, value, error in torques:
                row |= {f"torque_bias_{axis}": float(value)}
                row |= {f"torque_bias_{axis}_error": float(error)}
        rows_used = flight.part(flight.lead, len(flight))
        means = (*finite_mean(rows_used.command), *finite_mean(rows_used.battery[:, None]))
        names = (*(f"command_{motor}" for motor in range(1, 5)), "battery")
        rows.append(row | dict(zip(names, map(float, means), strict=True)))
    return polars.DataFrame(rows)


def _recorded(run: Run, rows: polars.DataFrame) -> Markup:
    """The recorded flights, for choosing what the viewer shows."""
    torque = Markup("Torque bias {} [10<sup>\N{MINUS SIGN}6</sup> N m]")
    columns: dict[str, Column | str] = {
        "flight": "Flight",
        "drone": "Drone",
        "duration": tables.number("Duration [s]", 2),
        "thrust_to_weight": tables.number("Thrust-to-weight ratio", 3),
        "hover_command": tables.number("Hover command u", 3),
        **{f"torque_bias_{axis}": tables.number(torque.format(axis), 0, 1e6) for axis in "xyz"},
        **{
            f"command_{motor}": tables.number(f"Mean u of motor {motor}", 3)
            for motor in range(1, 5)
        },
        "battery": tables.number("Battery [V]", 2),
    }
    columns = {
        name: column
        for name, column in columns.items()
        if name in rows.columns
        and (rows[name].dtype == polars.String or rows[name].is_finite().any())
    }
    if run.table is None:
        return tables.sortable("flights", rows, columns, viewable(run))
    return tables.sortable("recorded", rows, columns)
