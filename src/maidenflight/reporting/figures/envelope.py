"""How far each policy flies along each axis of difficulty."""

import math
from typing import Any

import polars

from maidenflight.reporting.figures import charts, intervals
from maidenflight.reporting.figures.charts import Entry, Figure, Spec

_END_WORDS = {
    "speed": "speed, times that of the task",
    "circle": "top speed on a circle of 1 m [m/s]",
    "figure_eight": "top speed on a figure-eight of 2 m [m/s]",
    "gusts": "gusts of 1 s [m/s]",
    "payload": "payload, share of the drone's mass",
    "battery": "battery, volts less than at the start",
    "propeller": "lost share of one rotor's thrust",
    "latency": "added latency [ms]",
}


def envelope(summary: polars.DataFrame) -> Figure:
    """Returns a panel an axis, a row a policy and reality.

    Args:
        summary: what `experiments.envelope.summary` gives.
    """
    legend = [
        Entry("95 % of flights succeed, simulated", "blue", "thick"),
        Entry("95 % interval of that", "orange", "interval"),
        Entry("limit of physics", "purple", "tick"),
    ]
    panels = [_panel(part) for part in summary.partition_by("axis", maintain_order=True)]
    return Figure("Envelope: how hard a flight may be", panels, legend, columns=1)


def _panel(part: polars.DataFrame) -> Spec:
    axis = str(part["axis"][0])
    scale = 1e3 if axis == "latency" else 1.0
    names, marks = [], []
    for row, values in enumerate(part.iter_rows(named=True)):
        names.append((f"{values['policy']} in {values['reality']}", _numbers(values, scale)))
        marks += _marks(row, values, scale)
    ends = charts.within(0.0, scale * float(part["hardest"][0]))
    return intervals.rows(names, marks, charts.number("x", _END_WORDS.get(axis, axis), **ends))


def _marks(row: int, values: dict[str, Any], scale: float) -> list[Spec]:
    reached, low, high, limit = (
        scale * float(values[name]) for name in ("envelope", "low", "high", "limit")
    )
    blue, orange, purple = (
        {"row": row, "colour": charts.paint(name)} for name in ("blue", "orange", "purple")
    )
    marks = []
    if math.isfinite(reached):
        marks.append({**blue, "kind": "bar", "x": 0.0, "x2": reached})
    if math.isfinite(low) and math.isfinite(high):
        marks.append({**orange, "kind": "whisker", "x": low, "x2": high})
        marks += [{**orange, "kind": "end", "x": end} for end in (low, high)]
    if math.isfinite(limit):
        marks.append({**purple, "kind": "line", "x": limit})
    return marks


def _numbers(values: dict[str, Any], scale: float) -> str:
    reached, low, high = (scale * float(values[name]) for name in ("envelope", "low", "high"))
    if not math.isfinite(reached):
        return "does not fly"
    cell_text = f"{reached:.3g}"
    if math.isfinite(low):
        cell_text += f" [{low:.3g}, {high:.3g}]"
    limit = float(values["limit"])
    return cell_text + (f", {reached / limit / scale:.0%}" if math.isfinite(limit) else "")
