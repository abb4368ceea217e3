"""Box plots of flight times: a row a policy, a panel a reality."""

import numpy as np
import polars

from maidenflight.errors import InputError
from maidenflight.reporting.figures import charts
from maidenflight.reporting.figures.charts import Entry, Figure, Spec
from maidenflight.simulator.tasks.failures import REACHED

COLOURS = {"pwm": "blue", "attitude_rate": "orange", "attitude": "green"}
"""Of control structures, in all pictures."""
MAX_FLIGHTS = 90
"""Rows that a picture shows; the rest is in the table."""
BOXED = 5
"""Flights from which on a row has a box; fewer stand for themselves."""
DOTTED = 60
"""Flights up to which each of a row is a dot; of more, those beyond the whiskers are."""


def flight_times(
    rows: polars.DataFrame, title: str = "Flight times", labels: dict[str, str] | None = None
) -> Figure:
    """Draws box plots: a box holds the middle half of the flights, a thick line the median.

    Args:
        rows: a row a flight: `row`, `colour` (a name in `colours.css`), `panel`, `duration` [s] and
            `end_reason`. Where it has `group`, rows of a group stand together. Of a row's name only
            what follows a tab is displayed.
        title: of the picture.
        labels: what colours stand for, by colour; no legend of colours by default.

    Raises:
        InputError: no flights, or a column is missing.
    """
    columns = ("row", "colour", "panel", "duration", "end_reason")
    missing = [name for name in columns if name not in rows.columns]
    rows = rows if missing else rows.filter(polars.col("duration").is_finite())
    if missing or rows.height == 0:
        raise InputError(
            f"no flight times to draw: {f'no column {missing[0]}' if missing else 'no flights'}."
        )
    if "group" in rows.columns:
        order = rows["group"].unique(maintain_order=True).to_list()
        rank = polars.col("group").replace_strict(order, range(len(order)))
        rows = rows.sort(rank, maintain_order=True)
    names = rows["row"].unique(maintain_order=True).to_list()[:MAX_FLIGHTS]
    rows = rows.filter(polars.col("row").is_in(names))
    panels = rows["panel"].unique(maintain_order=True).to_list()
    last = max(1.04 * float(rows["duration"].to_numpy().max()), 0.01)
    titles = {name: str(name) if len(panels) > 1 else "" for name in panels}
    drawn = [
        _panel(rows.filter(panel=name), names, last, panel_title)
        for name, panel_title in titles.items()
    ]
    return Figure(title, drawn, _legend(rows, labels or {}), least=360)


def _panel(flights: polars.DataFrame, names: list[str], last: float, title: str) -> Spec:
    parts = {str(row): part for (row,), part in flights.group_by("row")}
    marks = [mark for name in names if name in parts for mark in _marks(name, parts[name])]
    step = 22 if len(names) <= 45 else 15
    label = {"labelExpr": "slice(datum.label, indexof(datum.label, '\\t') + 1)", "labelLimit": 150}
    y = {
        "field": "row",
        "type": "nominal",
        "sort": names,
        "title": None,
        "scale": {"domain": names},
        "axis": {"ticks": False, "domain": False, "grid": False, **label},
    }
    x = charts.number("x", "flight time [s]", **charts.within(0.0, last))
    tooltip = charts.tooltip({"name": "", "x": "time [s]", "end": "ended by"})
    boxed = charts.tooltip(
        {"name": "", "median": "median [s]", "x": "a quarter below [s]", "x2": "above [s]"}
    )
    shared = {"x": x, "y": y, "color": {"field": "colour", "type": "nominal", "scale": None}}
    end, level = {"field": "x2"}, charts.number("level", scale={"domain": [-1.6, 1.6]})
    box = {"type": "bar", "opacity": 0.22, "size": 0.64 * step}
    median = {"type": "tick", "thickness": 3, "size": 0.7 * step}
    dot = {"type": "point", "size": 22, "strokeWidth": 1.4}
    shape = {"field": "shape", "type": "nominal", "scale": None}
    layers: list[Spec] = [
        charts.layer("box", box, **shared, x2=end, tooltip=boxed),
        charts.layer("whisker", {"type": "rule"}, **shared, x2=end),
        charts.layer("median", median, **shared),
        charts.layer("flight", dot, **shared, tooltip=tooltip, yOffset=level, shape=shape),
    ]
    return charts.panel(
        charts.rows(marks), layers, title=title, height=step * len(names) + 8, zooms=("x",)
    )


def _marks(name: str, flights: polars.DataFrame) -> list[Spec]:
    """The box of a row, its whiskers and its flights."""
    times, colour = flights["duration"].to_numpy(), flights["colour"][0]
    low, middle, high = np.quantile(times, [0.25, 0.5, 0.75])
    near = times[(times >= low - 1.5 * (high - low)) & (times <= high + 1.5 * (high - low))]
    title = name.rpartition("\t")[2]
    common = {"row": name, "name": title, "colour": charts.paint(colour), "series": colour}
    marks: list[Spec] = []
    if len(times) >= BOXED:
        marks.append({**common, "kind": "box", "x": low, "x2": high, "median": middle})
        marks += [
            {**common, "kind": "whisker", "x": first, "x2": last}
            for first, last in ((near.min(), low), (high, near.max()))
        ]
        marks.append({**common, "kind": "median", "x": middle})
    every = len(times) <= DOTTED
    # Spread by their place among the flights, so that equal times do not hide each other.
    levels = np.linspace(-1, 1, len(times)) if len(times) > 1 else np.zeros(1)
    for time, level, end in zip(times, levels, flights["end_reason"], strict=True):
        if every or time < near.min() or time > near.max():
            shape = "circle" if end == REACHED else charts.CROSS
            marks.append(
                {**common, "kind": "flight", "x": time, "level": level, "end": end, "shape": shape}
            )
    return marks


def _legend(rows: polars.DataFrame, labels: dict[str, str]) -> list[Entry]:
    colours = rows["colour"].unique(maintain_order=True).to_list()
    counts = rows.group_by("row", "panel").len()["len"].to_list()
    kind = "box" if max(counts, default=0) >= BOXED else "dot"
    entries = [
        Entry(labels[colour], colour, kind, colour) for colour in colours if colour in labels
    ]
    reached = (rows["end_reason"] == REACHED).to_numpy()
    entries += [Entry("flight to the time limit", "soft", "dot")] if reached.any() else []
    entries += [Entry("flight ended by a guard", "soft", "cross")] if not reached.all() else []
    return entries
