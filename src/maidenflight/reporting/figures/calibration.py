"""Draws rank histograms of a calibration, a panel a parameter, with the band of uniform ranks."""

from collections.abc import Sequence
from typing import Any

from maidenflight.identification.calibration import BINS, uniform_band
from maidenflight.reporting import text
from maidenflight.reporting.figures import charts
from maidenflight.reporting.figures.charts import Entry, Figure


def ranks(summary: Sequence[dict[str, Any]]) -> Figure:
    """Returns how often the truth lies where among the posterior samples.

    Args:
        summary: as `calibration.summarize` gives it.
    """
    rows = [row for row in summary if row["in_model"]]
    highest = max(max(row["ranks"]) for row in rows)
    panels = []
    for row in rows:
        low, high = uniform_band(row["in_model"])
        edges = [100 * number / BINS for number in range(BINS + 1)]
        data = [
            {"kind": "bar", "x": left, "x2": right, "y": count, "zero": 0}
            for left, right, count in zip(edges[:-1], edges[1:], row["ranks"], strict=True)
        ]
        data.append({"kind": "band", "x": 0, "x2": 100, "y": high, "zero": low})
        x = charts.number("x", "rank of the truth [%]", axis={"values": [0, 50, 100]})
        y = charts.number("y", **charts.within(0, 1.05 * max(highest, high)))
        ends = {"x": x, "x2": {"field": "x2"}, "y": y, "y2": {"field": "zero"}}
        tooltip = charts.tooltip({"x": "from [%]", "x2": "to [%]", "y": "drones"})
        bar = {"type": "rect", "color": charts.paint("orange"), "opacity": 0.8}
        band = {"type": "rect", "color": charts.paint("soft"), "opacity": 0.25}
        layers = [
            charts.layer("band", band, **ends),
            charts.layer("bar", bar, **ends, tooltip=tooltip),
        ]
        name = text.label(row["parameter"])
        title = [name, f"{row['held']} of {row['in_model']} held"]
        panels.append(charts.panel(charts.rows(data), layers, title=title, height=70, zooms=()))
    legend = [Entry("drones", "orange", "area"), Entry("99 % of uniform ranks", "soft", "area")]
    return Figure("Ranks of the truth among posterior samples", panels, legend, least=150)
