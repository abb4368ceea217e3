"""The page's sections: the pictures and tables of each, filled into its template.

A section is empty where nothing is known of it.
"""

import polars
from markupsafe import Markup

from maidenflight.experiments import recovery
from maidenflight.flights.windows import SEGMENT_SECONDS
from maidenflight.reporting import (
    change_figure,
    corner_figure,
    delay_figures,
    flight_figures,
    flight_tables,
    identification_tables,
    lead,
    literature,
    literature_figure,
    parameter_tables,
    prediction_figures,
    records,
    study_tables,
    text,
    training_figures,
    trim_figure,
    viewer,
)
from maidenflight.reporting import run as runs
from maidenflight.reporting.charts import Figure
from maidenflight.reporting.html import render
from maidenflight.reporting.run import Run

_NAMED = 20
"""Files of a kind that are not on the page and are named there."""


def parameters(run: Run) -> Markup:
    """What was identified, and how sure it is."""
    best = {name: estimate.value for name, estimate in run.estimates.items()}
    draws = {name: one for name, one in run.posterior.items() if name in best}
    landscape, contours = _loss_landscape(run) or (None, "")
    return render(
        "parameters.html",
        source=identification_tables.flights(run),
        estimates=parameter_tables.estimates(run),
        segment_seconds=f"{SEGMENT_SECONDS:g}",
        untold=parameter_tables.untold(run),
        missed=identification_tables.missed(run),
        paper=literature.PAPER,
        gains=identification_tables.gains(run),
        literature=_literature(run),
        others=parameter_tables.others(run),
        sources=parameter_tables.sources(run),
        landscape=landscape,
        contours=contours,
        evaluations=_evaluations(run).height,
        posterior_of_delays=_delay_posterior(run),
        truth=_shape_of_truth(run),
        corner=corner_figure.corner(draws, best) if draws else None,
        constants=parameter_tables.constants(run),
        count=len(parameter_tables.QUANTITIES),
    )


def _literature(run: Run) -> Figure | None:
    shown = {
        name: found
        for name, found in run.estimates.items()
        if literature_figure.comparable(name) and found.value > 0
    }
    truth = {name: runs.true_ends(run, name) for name in shown} if run.reality is not None else {}
    if not shown:
        return None
    return literature_figure.beside_literature(shown, truth)


def _shape_of_truth(run: Run) -> str:
    """How the truth is drawn in the picture of the delays: a `line`, a `box`, or not at all."""
    if not runs.truth(run):
        return ""
    return "line" if "spin_down_ratio" in run.estimates else "box"


def _delay_posterior(run: Run) -> Figure | None:
    delays = set(delay_figures.DELAYS)
    known = delays <= set(run.posterior) and delays <= set(run.estimates)
    if run.objective == "replay" or not known:
        return None
    return delay_figures.delay_posterior(run.posterior, run.estimates, runs.truth(run))


def _evaluations(run: Run) -> polars.DataFrame:
    search = polars.DataFrame() if run.search is None else run.search
    return search.filter(polars.col("objective").is_finite()) if search.width else search


def _loss_landscape(run: Run) -> tuple[Figure, str] | None:
    search = _evaluations(run)
    if run.objective != "replay" or not set(delay_figures.DELAYS) <= set(search.columns):
        return None
    if search.is_empty() or not (search["objective"] > 0).all():
        return None
    return delay_figures.loss_landscape(search, run.estimates, runs.truth(run))


def prediction(run: Run) -> Markup:
    """How well models predict flights."""
    errors, windows = run.validation, run.windows
    logs, held_out = _held_out(run)
    return render(
        "prediction.html",
        logs=logs,
        held_out=held_out,
        errors=flight_tables.errors(run),
        horizons=None if errors is None else prediction_figures.horizons(errors),
        windows=None if windows is None else prediction_figures.windows(windows),
    )


def _held_out(run: Run) -> tuple[str, int | None]:
    """How many logs were predicted, and of how many of these the drone was identified.

    Going by the records; `None` where they do not say.
    """
    logs = text.plural(len(run.judged), "log")
    return logs, len(run.judged & run.used) if run.judged and run.used else None


def training(run: Run) -> Markup:
    """How policies learned."""
    rows = run.training
    if rows is None:
        return Markup()
    policies = rows["policy"].n_unique()
    last = rows.filter(polars.col("steps") == rows["steps"].max())["episode_return"].to_numpy()
    return render(
        "training.html",
        curves=training_figures.learning_curves(rows),
        policies=text.plural(policies, "policy"),
        range=[text.number(end, 3) for end in (last.min(), last.max())] if policies > 1 else [],
    )


def predicted(run: Run) -> Markup:
    """How long policies would fly on the real drone."""
    if run.prediction is None:
        return Markup()
    rows = run.prediction.with_columns(panel=polars.lit("predicted"))
    return render(
        "predicted.html",
        times=_times("Flight times by policy", rows),
        boxed=_boxed(rows, "policy"),
        table=flight_tables.predictions(run),
    )


def flights(run: Run) -> Markup:
    """Test flights: in space, in a table and in box plots."""
    if run.table is None:
        return Markup()
    rows = run.table.with_columns(panel=polars.col("reality"))
    if "control" not in rows.columns:
        controls = [run.controls.get(name, "") for name in run.table["policy"]]
        rows = rows.with_columns(polars.Series("control", controls))
    return render(
        "flights.html",
        where=lead.flown_on(run),
        viewer=_viewer(run),
        times=_times("Flight times by policy", rows),
        boxed=_boxed(rows, "policy", "reality"),
        table=flight_tables.flights(run),
    )


def change(run: Run) -> Markup:
    """Test flights whose drone changes on the way."""
    if run.table is None or not run.flights:
        return Markup()
    found = recovery.of_flights(run.table, run.flights)
    if found.is_empty():
        return Markup()
    return render(
        "change.html",
        changes=change_figure.changes(found, run.flights),
        within=f"{100 * recovery.WITHIN_M:g}",
        table=flight_tables.recoveries(found),
    )


def _boxed(rows: polars.DataFrame, *keys: str) -> bool:
    """Whether any row of a picture of flight times has a box."""
    return max(rows.group_by(keys).len()["len"].to_list(), default=0) >= flight_figures.BOXED


def _times(title: str, rows: polars.DataFrame) -> Figure | None:
    """Box plots; control structures, where all are known, in groups and in their colours.

    Nothing where no flight time is a number.
    """
    if not rows["duration"].is_finite().any():
        return None
    colours, names = flight_figures.COLOURS, flight_tables.NAMES
    known = bool(rows["control"].is_in(list(colours)).all())
    group = polars.col("control").replace_strict(names, default="").alias("group")
    shown = rows.select(
        polars.col("policy").alias("row"),
        polars.col("control").replace_strict(colours, default="blue").alias("colour"),
        *("panel", "duration", "end_reason"),
        *([group] if known else []),
    )
    labels = {colour: names[kind] for kind, colour in colours.items()} if known else {}
    return flight_figures.flight_times(shown, title, labels)


def study(run: Run) -> Markup:
    """What the tasks of a study found."""
    return Markup("\n").join(study_tables.entries(run))


def recorded(run: Run) -> Markup:
    """The flights that were recorded, where no others are to be looked at."""
    if run.table is not None:
        return Markup()
    return render(
        "recorded.html",
        viewer=_viewer(run),
        trims=_trims(run),
        table=flight_tables.recorded(run),
        refused=run.refused,
    )


def _trims(run: Run) -> Figure | None:
    """Nothing where there are not several flights, or they say nothing."""
    found = flight_tables.trims(run)
    return trim_figure.trims(found, run.estimates) if found.height > 1 else None


def _viewer(run: Run) -> Markup:
    held, of = len(runs.viewable(run)), len(runs.shown(run))
    if not held:
        return Markup()
    return render("viewer.html", rate=f"{viewer.rate_of(held):g}", held=held, flights=of)


def reproduce(run: Run) -> Markup:
    """How long it took, how each file was made, and what else is in the folder."""
    return render(
        "reproduce.html",
        stages=run.seconds,
        longest=max(run.seconds.values(), default=0.0) or 1.0,
        records=records.records(run),
        others=run.other_files,
        missing=run.missing_files,
        most=_NAMED,
    )
