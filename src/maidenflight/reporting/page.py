"""The report of a run: one HTML file that needs nothing else, neither a network nor a server.

The page's frame, style and scripts are the files beside this module; Plotly, for the charts that stand still, is put in once.
"""

import os
from collections.abc import Callable
from html import escape
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
import plotly.offline
import polars

from maidenflight import __version__, results
from maidenflight.experiments.transfer import Transfer
from maidenflight.parameters import crazyflie
from maidenflight.reporting import figures, parts, text, training_figures
from maidenflight.reporting import identification_figures as pictures
from maidenflight.reporting import run as runs
from maidenflight.reporting.run import Run

RATE = 50.0
"""Rows a second of the flights in the page [Hz]."""


def report(source: str | os.PathLike[str] | Transfer, path: str | os.PathLike[str]) -> Path:
    """Writes what came of a run as one self-contained HTML file. The same run gives the same bytes.

    Args:
        source: the folder of a run, whatever of it there is, or test flights.
        path: the HTML file.

    Returns:
        The path.

    Raises:
        InputError: nothing known in the folder, a file in it is broken, or the page cannot be written.
    """
    run = runs.of_transfer(source) if isinstance(source, Transfer) else runs.read(Path(source))
    return results.write(path, to_html(run))


def to_html(run: Run) -> str:
    """The page."""
    drawn = _figures(run)
    sections = [
        ("parameters", "Parameters", _parameters(run)),
        ("prediction", "Prediction", _prediction(run)),
        ("training", "Training", _training(run)),
        ("flights", "Test flights", _flights(run)),
        ("reproduce", "Reproduce", parts.seconds(run) + parts.records(run)),
    ]
    sections = [section for section in sections if section[2]]
    shown = _viewed(run)
    return Template(_file("page.html")).substitute(
        title=escape(parts.title(run)),
        badge=f"<span class=badge>{parts.kind(run)}</span>" if parts.kind(run) else "",
        lead=parts.lead(run),
        figures=parts.key_figures(run),
        links="".join(f'<a href="#{name}">{title}</a>' for name, title, _ in sections),
        sections="\n".join(f'<section id="{name}"><h2>{title}</h2>{content}</section>' for name, title, content in sections),
        version=__version__,
        style=_file("colours.css") + _file("style.css"),
        content="".join(text.embed(name, content) for name, content in (("charts", drawn), ("logs", shown)) if content),
        plotly=f"<script>{plotly.offline.get_plotlyjs()}</script>" if drawn else "",
        scripts="\n".join(f"<script>{_file(name)}</script>" for name in _scripts(bool(shown))),
    )


def _file(name: str) -> str:
    return resources.files("maidenflight.reporting").joinpath(name).read_text(encoding="utf-8")


def _scripts(viewer: bool) -> list[str]:
    return ["page.js", *(["scene.js", "traces.js", "viewer.js"] if viewer else [])]


def _figures(run: Run) -> dict[str, Any]:
    drawn = figures.durations(run)
    return {} if drawn is None else {"durations": drawn}


def _chart(name: str, label: str, caption: str = "") -> str:
    below = f"<figcaption>{caption}</figcaption>" if caption else ""
    return f'<figure><div class=chart id="{name}" role=img aria-label="{label}"></div>{below}</figure>'


def _picture(name: str, draw: Callable[[float], str], caption: str) -> str:
    """A picture twice: as wide as the page, and as wide as a phone, which shows the one that fits."""
    both = "".join(f"<div class={kind}>{draw(width)}</div>" for kind, width in (("wide", pictures.WIDE), ("narrow", pictures.NARROW)))
    return f'<figure class=drawn id="{name}">{both}<figcaption>{caption}</figcaption></figure>'


def _parameters(run: Run) -> str:
    return parts.estimates(run) + _valley(run) + _corner(run) + parts.constants(run)


def _valley(run: Run) -> str:
    names = ("motor_time_constant", "latency")
    # A likelihood has no zero, so that 1 % of it means nothing; there the posterior tells what the flights leave open.
    if run.search is None or run.objective != "replay" or not set(names) <= set(run.search.columns):
        return ""
    search, truth = run.search.filter(polars.col("objective").is_finite()), runs.truth(run)
    if search.filter(polars.col("objective") > 0).height < max(search.height, 1):
        return ""
    told = (
        " The green box is the truth, which has two time constants, for motors speeding up and slowing down, and two delays, that of"
        " the commands and that with the estimator's and the gyro's added."
        if truth
        else ""
    )
    caption = (
        f"Each dot is one of {search.height} evaluations; those far from the valley lie outside the picture. Along the dashed line"
        f" the sum of both delays is constant: were only the sum visible in flight, the valley would follow it.{told}"
    )
    return _picture("valley", lambda width: pictures.valley(search, run.estimates, truth, width), caption)


def _corner(run: Run) -> str:
    if not run.posterior:
        return ""
    best = {name: estimate.value for name, estimate in run.estimates.items()}
    caption = (
        "Each dot is a drone that the flights speak for. A narrow cloud that leans is a combination that they fix, though neither"
        " parameter alone."
    )
    return _picture("corner", lambda width: pictures.corner(run.posterior, best, width), caption)


def _prediction(run: Run) -> str:
    errors, windows = run.validation, run.windows
    shown = ""
    if errors is not None:
        caption = (
            "Root mean squares over windows of flights, each predicted from its measured start and the recorded commands alone; bands:"
            " 95 % intervals over stretches of flight. A line above the dotted one does worse than predicting that nothing changes."
        )
        shown += _picture("horizons", lambda width: pictures.horizons(errors, width), caption)
    if windows is not None:
        caption = "Windows drawn at random. Every model starts from the same measured row and then sees the recorded commands alone."
        shown += _picture("windows", lambda width: pictures.windows(windows, width), caption)
    return shown


def _training(run: Run) -> str:
    if run.training is None:
        return ""
    training = run.training
    count = training["policy"].n_unique()
    spread = ""
    if count > 1:
        last = training.filter(polars.col("steps") == training["steps"].max())["episode_return"].to_numpy()
        spread = f" At the end their returns are from {text.number(last.min(), 3)} to {text.number(last.max(), 3)}."
    caption = f"{text.plural(count, 'policy')} learning in simulation, scored on the same episodes.{spread}"
    return _picture("learning", lambda width: training_figures.learning_curves({"training": training}, width=width), caption)


def _flights(run: Run) -> str:
    if run.table is None:
        return ""
    simulated = sorted({flight.simulated for flight in run.flights if flight.simulated})
    where = f"<p class=tag>Simulated, on virtual drone {escape(', '.join(simulated))}.</p>" if simulated else ""
    viewer = ""
    count = len(runs.viewable(run))
    if count:
        held = f" The viewer holds {count} of {len(run.flights)} flights." if count < len(run.flights) else ""
        viewer = Template(_file("viewer.html")).substitute(held=held)
    times = _chart("durations", "Flight time of every flight")
    return f"{where}{viewer}<h3>All flights</h3>{parts.flights_table(run)}<h3>Flight times</h3>{times}"


def _viewed(run: Run) -> dict[str, Any]:
    """What the viewer needs of the flights: columns, decimated and rounded; equal set-points are kept once."""
    if run.table is None or not runs.viewable(run):
        return {}
    references: list[Any] = []
    flights = []
    for number in runs.viewable(run):
        row, flight = run.table.row(number, named=True), run.flights[number]
        every = max(1, round(1 / (RATE * flight.period)))
        kept = runs.usable(flight)
        setpoint = _compact(flight.setpoint[kept][::every], 4)
        if setpoint not in references:
            references.append(setpoint)
        flights.append(
            {
                "row": number,
                "label": "Flight {flight}: {policy}, trial {trial}, {duration:.1f} s, {end_reason}".format(**row),
                "simulated": flight.simulated,
                "period": round(flight.period * every, 6),
                "position": _compact(flight.position[kept][::every], 4),
                "attitude": _compact(flight.attitude[kept][::every], 4),
                "command": _compact(flight.command[kept][::every], 3),
                "reference": references.index(setpoint),
            }
        )
    arm = float((run.drone or crazyflie()).arm_length)
    return {"arm": round(arm, 5), "references": references, "flights": flights}


def _compact(values: Any, decimals: int) -> list[list[float | None]]:
    """Columns of rounded numbers; a number that is none becomes null."""
    columns = np.round(np.asarray(values, np.float64), decimals).T + 0.0
    return [[value if np.isfinite(value) else None for value in column.tolist()] for column in columns]
