"""The picture of an envelope: how far each policy flies along each axis of difficulty."""

import math
from typing import Any

import polars

from maidenflight.reporting import svg
from maidenflight.reporting.svg import Panel

WIDTH = 920.0
"""Of the picture [px]."""
ROW = 24.0
"""Height of a row [px]."""
_LEFT, _RIGHT = 250.0, 190.0
"""Room for names at the left, for numbers at the right [px]."""
_SAID = {
    "circle": "top speed on a circle of 1 m [m/s]",
    "figure_eight": "top speed on a figure-eight of 2 m [m/s]",
    "gusts": "gusts of 1 s [m/s]",
    "payload": "payload, share of the drone's mass",
    "battery": "battery, volts less than at the start",
    "propeller": "lost share of one rotor's thrust",
    "latency": "added latency [ms]",
}


def envelope_picture(summary: polars.DataFrame) -> str:
    """A panel an axis, a row a policy and reality; an SVG.

    Args:
        summary: what `envelope.summary` gives.
    """
    shown = [
        (svg.stroke("M2 6H22", "heavy", "blue"), "flown by 95 % of flights, simulated"),
        (svg.stroke("M2 6H22M2 2V10M22 2V10", "line", "orange"), "95 % interval of that"),
        (svg.stroke("M12 0V12", "line", "purple"), "limit of physics"),
    ]
    legend, tall = svg.legend(svg.TITLE + 6.0, WIDTH, shown)
    parts, down = [legend], svg.TITLE + tall + 16.0
    for part in summary.partition_by("axis", maintain_order=True):
        drawn, height = _axis(part, down)
        parts.append(drawn)
        down += height
    return svg.picture(WIDTH, down, "Envelope: how hard a flight may be", parts)


def _axis(part: polars.DataFrame, top: float) -> tuple[str, float]:
    axis = str(part["axis"][0])
    scale = 1e3 if axis == "latency" else 1.0
    panel = Panel(
        _LEFT,
        top,
        WIDTH - _LEFT - _RIGHT,
        ROW * part.height + 8,
        (0.0, scale * float(part["hardest"][0])),
        (0.0, 1.0),
    )
    outside, _ = svg.axes(panel, _SAID.get(axis, axis), "", left=False)
    uprights = panel.across(svg.ticks(*panel.x, 6)[0])
    grid = "".join(f"M{place:.1f} 0V{panel.height:.1f}" for place in uprights)
    content, beside = [svg.stroke(grid, "grid", "grid")], [outside]
    for row, values in enumerate(part.iter_rows(named=True)):
        middle = 4 + (row + 0.5) * ROW
        content += _row(panel, values, middle, scale)
        down = panel.top + middle + 4.5
        name = f"{values['policy']} in {values['reality']}"
        beside.append(svg.text(panel.left - 10, down, name, "", "end"))
        beside.append(svg.text(panel.left + panel.width + 10, down, _numbers(values, scale)))
    return "".join([*beside, svg.framed(panel, content, axis)]), panel.height + 60


def _row(panel: Panel, values: dict[str, Any], down: float, scale: float) -> list[str]:
    reached, low, high, limit = (
        scale * float(values[name]) for name in ("envelope", "low", "high", "limit")
    )
    drawn = []
    if math.isfinite(reached):
        drawn.append(svg.stroke(f"M0 {down:.1f}H{panel.at(reached, 0)[0]:.1f}", "heavy", "blue"))
    if math.isfinite(low) and math.isfinite(high):
        left, right = (panel.at(end, 0)[0] for end in (low, high))
        ends = f"M{left:.1f} {down - 4:.1f}v8M{right:.1f} {down - 4:.1f}v8"
        drawn.append(svg.stroke(f"M{left:.1f} {down:.1f}H{right:.1f}{ends}", "line", "orange"))
    if math.isfinite(limit):
        place = panel.at(limit, 0)[0]
        drawn.append(svg.stroke(f"M{place:.1f} {down - 8:.1f}v16", "line", "purple"))
    return drawn


def _numbers(values: dict[str, Any], scale: float) -> str:
    reached, low, high = (scale * float(values[name]) for name in ("envelope", "low", "high"))
    if not math.isfinite(reached):
        return "does not fly"
    shown = f"{reached:.3g}"
    if math.isfinite(low):
        shown += f" [{low:.3g}, {high:.3g}]"
    limit = float(values["limit"])
    return shown + (f", {reached / limit / scale:.0%}" if math.isfinite(limit) else "")
