"""The page's sections as HTML, each with its pictures, captions and tables.

Empty where nothing is known.
"""

from collections.abc import Callable
from importlib import resources
from string import Template

import polars

from maidenflight import run_folder
from maidenflight.reporting import (
    flight_figures,
    flight_tables,
    identification_tables,
    lead,
    literature_figure,
    parameter_tables,
    text,
    training_figures,
    viewer,
)
from maidenflight.reporting import identification_figures as pictures
from maidenflight.reporting import run as runs
from maidenflight.reporting.run import Run
from maidenflight.reporting.valley import cloud

_DELAYS = ("motor_time_constant", "latency")


def _picture(name: str, draw: Callable[[float], str], caption: str) -> str:
    """A picture twice: as wide as the page, and as wide as a phone, which shows the one that
    fits.
    """
    both = "".join(
        f"<div class={kind}>{draw(width)}</div>"
        for kind, width in (("wide", pictures.WIDE), ("narrow", pictures.NARROW))
    )
    return f'<figure class=drawn id="{name}">{both}<figcaption>{caption}</figcaption></figure>'


def parameters(run: Run) -> str:
    """What was identified, and how sure it is."""
    return (
        identification_tables.flights(run)
        + parameter_tables.estimates(run)
        + identification_tables.bought(run)
        + _literature(run)
        + parameter_tables.others(run)
        + _valley(run)
        + _corner(run)
        + parameter_tables.constants(run)
    )


def _literature(run: Run) -> str:
    shown = {
        name: found
        for name, found in run.estimates.items()
        if literature_figure.comparable(name) and found.value > 0
    }
    if not shown:
        return ""
    truth = {name: runs.true_ends(run, name) for name in shown} if run.reality is not None else {}
    caption = (
        "Each row is a parameter, on the purple line where it equals the paper's value; the axis "
        "is logarithmic. Grey dots are"
        " what others give for a Crazyflie; the table below names them. They differ by more than "
        "any interval, with batteries,"
        " propellers, loads and methods."
    )
    return _picture(
        "literature",
        lambda width: literature_figure.beside_literature(shown, truth, width),
        caption,
    )


def _valley(run: Run) -> str:
    if run.objective == "replay":
        return _replayed_valley(run)
    if not set(_DELAYS) <= set(run.posterior) or not set(_DELAYS) <= set(run.estimates):
        return ""
    caption = (
        "What the flights leave open of the two delays: each dot is a drone that they speak for. "
        "The longer the cloud, the less they tell"
        " lag from latency; along the dashed line the sum of both is constant."
    )
    truth = runs.truth(run)
    return _picture(
        "valley",
        lambda width: cloud(run.posterior, run.estimates, truth, width),
        caption + _box_told(run),
    )


def _box_told(run: Run) -> str:
    if not runs.truth(run):
        return ""
    if "spin_down_ratio" in run.estimates:
        return (
            " The green line is the truth, which has two delays: that of the commands, and "
            "that with the estimator's and the gyro's added."
        )
    return (
        " The green box is the truth, which has two time constants, for motors speeding up and "
        "slowing down, and two delays, that of"
        " the commands and that with the estimator's and the gyro's added."
    )


def _replayed_valley(run: Run) -> str:
    if run.search is None or not set(_DELAYS) <= set(run.search.columns):
        return ""
    search, truth = run.search.filter(polars.col("objective").is_finite()), runs.truth(run)
    if search.filter(polars.col("objective") > 0).height < max(search.height, 1):
        return ""
    caption = (
        f"Each dot is one of {search.height} evaluations; those far from the valley lie outside "
        "the picture. Along the dashed line"
        " the sum of both delays is constant: were only the sum visible in flight, the valley "
        f"would follow it.{_box_told(run)}"
    )
    return _picture(
        "valley", lambda width: pictures.valley(search, run.estimates, truth, width), caption
    )


def _corner(run: Run) -> str:
    if not run.posterior:
        return ""
    best = {name: estimate.value for name, estimate in run.estimates.items()}
    caption = (
        "Each dot is a drone that the flights speak for. A narrow cloud that leans is a "
        "combination that they fix, though neither"
        " parameter alone."
    )
    return _picture("corner", lambda width: pictures.corner(run.posterior, best, width), caption)


def prediction(run: Run) -> str:
    """How well models predict flights."""
    errors, windows = run.validation, run.windows
    shown = ""
    if errors is not None:
        caption = (
            "Root mean squares over windows of flights, each predicted from its measured start "
            "and the recorded commands alone; bands:"
            " 95 % intervals over stretches of flight. A line above the dotted one, * in the "
            "table, does worse than predicting that nothing"
            " changes. With the recorded commands alone, without the feedback that kept it level, "
            "any model of a quadrotor soon tips over,"
            " while the flight stayed about level: that line is hard to beat beyond 0.1 s. "
            "Compare drones with each other, by the first"
            " rows; the likelihood of flights held out tells them apart better."
        )
        shown += (
            _held_out(run)
            + _picture("horizons", lambda width: pictures.horizons(errors, width), caption)
            + flight_tables.errors(run)
        )
    if windows is not None:
        caption = (
            "Windows drawn at random. Every model starts from the same measured row and "
            "then sees the recorded commands alone."
        )
        shown += _picture("windows", lambda width: pictures.windows(windows, width), caption)
    return shown


def _held_out(run: Run) -> str:
    """Whether the drone was identified from flights that it is to predict, going by the records.

    Nothing where they do not tell.
    """
    told = [
        run.records.get(name, {}).get("inputs", [])
        for name in (run_folder.VALIDATION.name, run_folder.DRONE)
    ]
    known = [inputs if isinstance(inputs, list) else [] for inputs in told]
    predicted, identified = (
        {str(entry).rpartition("sha256:")[2] for entry in inputs if ".toml" not in str(entry)}
        for inputs in known
    )
    if not predicted or not identified:
        return ""
    shared = len(predicted & identified)
    if shared == 0:
        return (
            f"<p>{text.plural(len(predicted), 'log')}, held out: the drone was identified from "
            "none of them.</p>"
        )
    return (
        f"<p class=tag>The drone was identified from {shared} of these {len(predicted)} logs; "
        "how well it predicts those is no test.</p>"
    )


def training(run: Run) -> str:
    """How policies learned."""
    if run.training is None:
        return ""
    rows = run.training
    count = rows["policy"].n_unique()
    spread = ""
    if count > 1:
        last = rows.filter(polars.col("steps") == rows["steps"].max())["episode_return"].to_numpy()
        spread = (
            f" At the end their returns are from {text.number(last.min(), 3)} to "
            f"{text.number(last.max(), 3)}."
        )
    caption = (
        f"{text.plural(count, 'policy')} learning in simulation, scored on the same episodes: "
        "return and survival are to rise, the position"
        f" error is to fall.{spread}"
    )
    return _picture(
        "learning",
        lambda width: training_figures.learning_curves({"training": rows}, width=width),
        caption,
    )


def predicted(run: Run) -> str:
    """How long policies would fly on the real drone."""
    if run.prediction is None:
        return ""
    rows = run.prediction.with_columns(panel=polars.lit("predicted"))
    caption = (
        "Simulated flights on the identified drone, a row a "
        f"policy.{_boxes_told(rows, ('policy',))} What a row spreads over is noise,"
        " where the flight begins and, where they were asked for, drones that the identification "
        "leaves possible."
    )
    return _times(
        "predicted-times", "Flight times by policy", rows, caption
    ) + flight_tables.predictions(run)


def flights(run: Run) -> str:
    """Test flights: in space, in a table and in box plots."""
    if run.table is None:
        return ""
    where = f"<p class=tag>Simulated, {lead.flown_on(run)}.</p>" if lead.flown_on(run) else ""
    viewed = f"<h3>In flight</h3>{_viewer(run)}" if runs.viewable(run) else ""
    rows = run.table.with_columns(panel=polars.col("reality"))
    if flight_tables.is_matrix(run):
        told = [
            f"{row['control']}\t{1e3 * row['motor_time_constant']:g} ms, {1e3 * row['latency']:g} "
            "ms"
            for row in run.table.iter_rows(named=True)
        ]
        rows = rows.with_columns(polars.Series("policy", told))
        title = "Flight times by training"
        told = _boxes_told(rows, ("policy", "reality"))
        caption = (
            "A row is what policies were trained for: motor time constant T<sub>m</sub> "
            f"and latency.{told}"
        )
    else:
        known = [run.controls.get(name, "") for name in run.table["policy"]]
        rows = rows.with_columns(polars.Series("control", known))
        title = "Flight times by policy"
        caption = f"A row is a policy.{_boxes_told(rows, ('policy', 'reality'))}"
    figure = _times("times", title, rows, caption)
    table = f"<h3>All flights</h3>{flight_tables.flights(run)}"
    return f"{where}{viewed}{figure}{flight_tables.cells(run)}{table}"


def _boxes_told(rows: polars.DataFrame, keys: tuple[str, ...]) -> str:
    most = rows.group_by(keys).len()["len"].max()
    if int(most or 0) < flight_figures.BOXED:  # type: ignore[arg-type]
        return ""
    return (
        " Boxes hold the middle half of the flights, the thick line is their median; whiskers end "
        "at most 1.5 boxes away. Where most"
        " flights last equally long, the line is all that there is of the box."
    )


def _times(name: str, title: str, rows: polars.DataFrame, caption: str) -> str:
    """Box plots; control structures, where all are known, in groups and in their colours.

    Nothing where no flight time is a number.
    """
    if not rows["duration"].is_finite().any():
        return ""
    known = bool(rows["control"].is_in(list(flight_figures.COLOURS)).all())
    shown = rows.select(
        polars.col("policy").alias("row"),
        polars.col("control").replace_strict(flight_figures.COLOURS, default="blue").alias("colour"),
        "panel", "duration", "end_reason",
        *([polars.col("control").replace_strict(flight_tables.NAMES, default="").alias("group")] if known else []),
    )  # fmt: skip
    labels = (
        {colour: flight_tables.NAMES[kind] for kind, colour in flight_figures.COLOURS.items()}
        if known
        else {}
    )
    return _picture(
        name, lambda width: flight_figures.flight_times(shown, width, title, labels), caption
    )


def recorded(run: Run) -> str:
    """The flights that were recorded, where no others are to be looked at."""
    if run.table is not None or not run.recorded:
        return ""
    return (
        f"{_viewer(run) if runs.viewable(run) else ''}<h3>All "
        f"flights</h3>{flight_tables.recorded(run)}"
    )


def _viewer(run: Run) -> str:
    count, of = len(runs.viewable(run)), len(runs.shown(run))
    frame = (
        resources.files("maidenflight.reporting")
        .joinpath("viewer.html")
        .read_text(encoding="utf-8")
    )
    return Template(frame).substitute(
        rate=f"{viewer.rate_of(count):g}",
        held=f" The viewer holds {count} of {of} flights." if count < of else "",
    )
