"""The picture of flights whose drone changes: distance from the set-point over time."""

from collections.abc import Sequence
from itertools import cycle

import numpy as np
import polars

from maidenflight.experiments.recovery import WITHIN_M, distance
from maidenflight.flights.log import Flight
from maidenflight.reporting.figures import charts
from maidenflight.reporting.figures.charts import Entry, Figure, Spec

MAX_PANELS = 40
"""Flights that a panel shows; the rest is in the table."""
_RATE, _POINTS = 25.0, 20_000
"""Points a second of a line at most [Hz], and points of the picture at most."""


def changes(recoveries: polars.DataFrame, flights: Sequence[Flight]) -> Figure:
    """Returns a panel a reality, a thin line a flight, the colour that of its policy.

    Args:
        recoveries: a row a flight, as `recovery.of_flights` gives them; at least one.
        flights: the logs at the `place` of the rows.
    """
    policies = recoveries["policy"].unique(maintain_order=True).to_list()
    colours = dict(zip(policies, cycle(charts.PALETTE), strict=False))
    parts = [
        part.head(MAX_PANELS) for _, part in recoveries.group_by("reality", maintain_order=True)
    ]
    rows = [flights[index] for part in parts for index in part["place"]]
    step = max(1 / _RATE, sum(flight.duration for flight in rows) / _POINTS)
    legend = [Entry(name, colour, "thin", name) for name, colour in colours.items()]
    legend += [Entry("change of the drone", "ink", "line")]
    legend += [Entry(f"{100 * WITHIN_M:g} cm", "soft", "dashed")]
    if not all(part["lasts"].all() for part in parts):
        legend.append(Entry("flight ended by a guard", "soft", "cross"))
    last = max(*(flight.duration for flight in rows), *recoveries["at"])
    panels = [_panel(part, flights, step, last, colours) for part in parts]
    return Figure("Distance from the set-point", panels, legend, least=360, chooses=True)


def _panel(
    part: polars.DataFrame,
    flights: Sequence[Flight],
    step: float,
    last: float,
    colours: dict[str, str],
) -> Spec:
    rows: list[Spec] = [{"kind": "jump", "x": part["at"][0]}]
    rows.append({"kind": "within", "y": 100 * WITHIN_M})
    for row in part.iter_rows(named=True):
        flight = flights[row["place"]]
        every = max(1, round(step / flight.period))
        errors = 100 * distance(flight)
        common = {"series": row["policy"], "place": row["place"], "flight": row["place"] + 1}
        common["back"] = f"{row['recovery']:.2f} s" if np.isfinite(row["recovery"]) else "never"
        points = sorted({*range(0, len(flight), every), len(flight) - 1})
        rows += [
            {**common, "kind": "flight", "x": flight.period * n, "y": errors[n]} for n in points
        ]
        if not row["lasts"]:
            rows.append({**common, "kind": "end", "x": flight.duration, "y": errors[-1]})
    x = charts.number("x", "time [s]", **charts.within(0.0, last))
    y = charts.number("y", "distance [cm]")
    tooltip = charts.tooltip({"series": "policy", "flight": "flight", "back": "back after"})
    shared = {"color": charts.coloured(colours), "detail": {"field": "place"}, "tooltip": tooltip}
    line = {"type": "line", "strokeWidth": 1.1, "opacity": 0.8}
    cross = {"type": "point", "shape": charts.CROSS, "size": 40, "strokeWidth": 1.6}
    dashes = {"type": "rule", "strokeDash": [7, 4], "strokeWidth": 1.3}
    ink = {"type": "rule", "color": charts.paint("ink"), "strokeWidth": 1.3}
    layers: list[Spec] = [
        charts.layer("flight", line, x=x, y=y, **shared),
        charts.layer("end", cross, x=x, y=y, **shared),
        charts.layer("within", dashes, y=y),
        charts.layer("jump", ink, x=x),
    ]
    return charts.panel(charts.rows(rows), layers, title=str(part["reality"][0]), height=220)
