"""Rows of intervals: a name at the left, marks on an axis, numbers at the right."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from maidenflight.reporting.figures import charts
from maidenflight.reporting.figures.charts import Spec

ROW, TALL_ROW = 24, 40
"""Height of a row [px], and of one whose numbers stand below its name."""
_MARKS: dict[str, Spec] = {
    "bar": {"type": "rule", "strokeWidth": 3},
    "whisker": {"type": "rule", "strokeWidth": 1.6},
    "dot": {"type": "point", "filled": True, "size": 40},
    "end": {"type": "tick", "thickness": 1.6, "size": 9},
    "value": {"type": "tick", "thickness": 3, "size": 12},
    "line": {"type": "tick", "thickness": 2, "size": 18},
    "left": {"type": "point", "shape": "triangle-left", "filled": True, "size": 70},
    "right": {"type": "point", "shape": "triangle-right", "filled": True, "size": 70},
}
"""How marks look, by their kind, in the order in which they are drawn."""


def plausible_axis() -> Spec:
    """Returns the channel of shares of the range that is plausible before the flights."""
    ticks = {"values": [0, 0.25, 0.5, 0.75, 1], "format": ".0%"}
    title = charts.by_width(
        "share of the range that is plausible before the flights", "share of the plausible range"
    )
    return charts.number("x", title, axis=ticks)


def levels(count: int) -> np.ndarray:
    """Returns shifts of so many intervals from the middle of their row [rows]."""
    return (np.arange(count) - (count - 1) / 2) / (count + 0.5)


def rows(
    names: Sequence[tuple[str, ...]],
    marks: Sequence[Spec],
    x: Spec,
    tooltip: Spec | None = None,
    *,
    title: str = "",
    across: Sequence[tuple[float, Spec]] = (),
) -> Spec:
    """Returns a panel of rows.

    Args:
        names: of each row, what stands at its left and at its right, and what follows there. On a
            phone the second stands below the first, and what follows is left out.
        marks: of each `row` (its number), `kind` (a name of `_MARKS`), `colour`, and `x`, for rules
            from `x` to `x2`; `series` where the legend hides it; `shift` from the middle of the
            row, of `levels`.
        x: the channel of the axis.
        tooltip: labels of what the pointer tells of a mark, by column.
        title: above the panel.
        across: places on the axis with marks over all rows.
    """
    keys = ["\t".join((str(number), *parts)) for number, parts in enumerate(names)]
    data = [{**mark, "key": keys[mark["row"]]} for mark in marks]
    y: dict[str, Any] = {"field": "key", "type": "nominal", "title": None, "sort": keys}
    y["scale"] = {"domain": keys}
    axis = {"ticks": False, "domain": False, "labelLimit": 400, "labelPadding": 8}
    axis["minExtent"] = 0
    parts = "split(datum.label, '\\t')"
    left_label = charts.by_width(f"{parts}[1]", f"slice({parts}, 1, 3)")
    left = {**axis, "labelExpr": left_label, "labelLineHeight": 15, "grid": True}
    right = {**axis, "labelExpr": f"join(slice({parts}, 2), '')", "orient": "right", "grid": False}
    right = charts.by_width(right, None)
    # Each side of the panel is a layer of its own, without marks.
    layers: list[Spec] = [
        {"data": {"values": []}, "mark": "tick", "encoding": {"x": x, "y": {**y, "axis": side}}}
        for side in (left, right)
    ]
    layers += [
        {"data": {"values": [{"x": value}]}, "mark": mark, "encoding": {"x": x}}
        for value, mark in across
    ]
    offset = charts.number("shift", scale={"domain": [-0.5, 0.5]})
    shifted = {"yOffset": offset} if any("shift" in mark for mark in marks) else {}
    colour = {"field": "colour", "type": "nominal", "scale": None}
    for kind, mark in _MARKS.items():
        if any(row["kind"] == kind for row in data):
            encoding = {"x": x, "y": {**y, "axis": None}, "color": colour}
            encoding |= shifted
            encoding |= {"x2": {"field": "x2"}} if mark["type"] == "rule" else {}
            encoding |= {"tooltip": charts.tooltip(tooltip)} if tooltip else {}
            layers.append(charts.layer(kind, {**mark, "opacity": 1, "clip": True}, **encoding))
    panel = charts.panel(charts.rows(data), layers, zooms=())
    # Ticks of neighbouring rows keep apart.
    least = (2 * len({mark.get("shift") for mark in marks}) + 1) * ROW // 3
    wide, narrow = (max(least, height) * len(names) + 8 for height in (ROW, TALL_ROW))
    panel["height"] = charts.by_width(wide, narrow)
    # Titles begin where the frames do, however long the names beside them are.
    head = {"title": {"text": title, "frame": "group"}} if title else {}
    return {**panel, **head, "resolve": {"axis": {"y": "independent"}}}
