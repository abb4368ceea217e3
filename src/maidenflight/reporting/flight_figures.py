"""Box plots of flight times: a row a policy or cell of a matrix, a panel a reality.

```python
from maidenflight.reporting.flight_figures import flight_times

rows = flown.table.select(
    polars.lit("blue").alias("colour"),
    "duration",
    "end_reason",
    row="policy",
    panel="reality",
)
Path("flights.svg").write_text(flight_times(rows))
```
"""

import numpy as np
import polars

from maidenflight.errors import InputError
from maidenflight.reporting import svg
from maidenflight.reporting.svg import Panel
from maidenflight.simulator.tasks import END_REASONS, TIME_LIMIT

COLOURS = {"pwm": "blue", "attitude_rate": "orange", "attitude": "green"}
"""Of control structures, in all pictures."""
MOST = 90
"""Rows that a picture shows; the rest is in the table."""
BOXED = 5
"""Flights from which on a row has a box; fewer stand for themselves."""
DOTTED = 60
"""Flights up to which each of a row is a dot; of more, those beyond the whiskers are."""
REACHED = END_REASONS[TIME_LIMIT]
"""Reason of the end of a flight that lasted as long as it might."""


def flight_times(
    rows: polars.DataFrame,
    width: float = 720,
    title: str = "Flight times",
    labels: dict[str, str] | None = None,
) -> str:
    """Box plots: a box holds the middle half of the flights, its thick line is the median.

    Args:
        rows: a row a flight: `row`, `colour` (a name in `colours.css`), `panel`, `duration` [s] and
            `end_reason`. Where it has `group`, rows of a group stand together under its name. Of a
            row's name only what follows a tab is shown.
        width: of the picture [px].
        title: of the picture.
        labels: what colours stand for, by colour; no legend of colours unless given.

    Raises:
        InputError: no flights, or a column is missing.
    """
    missing = [
        name
        for name in ("row", "colour", "panel", "duration", "end_reason")
        if name not in rows.columns
    ]
    rows = rows if missing else rows.filter(polars.col("duration").is_finite())
    if missing or rows.height == 0:
        raise InputError(
            f"no flight times to draw: {f'no column {missing[0]}' if missing else 'no flights'}."
        )
    lines, panels = _lines(rows), rows["panel"].unique(maintain_order=True).to_list()
    legend, tall = svg.legend(svg.TITLE, width, _legend(rows, labels or {}))
    beside = min(max(len(_shown(name)) for _, name in lines) * svg.LETTER + 18, 0.34 * width)
    columns = min(len(panels), max(int((width - beside) // 230), 1))
    step, above = 22.0 if len(lines) <= 45 else 15.0, 34 if len(panels) > 1 else 8
    side, high, top = (width - beside) / columns, step * len(lines) + 8, svg.TITLE + tall + above
    x = (0.0, max(1.04 * float(rows["duration"].to_numpy().max()), 0.01))
    parts = [legend]
    for number, name in enumerate(panels):
        panel = Panel(
            beside + number % columns * side,
            top + number // columns * (high + 84),
            side - 14,
            high,
            x,
            (0.0, high),
        )
        parts += _panel(
            panel,
            rows.filter(polars.col("panel") == name),
            lines,
            step,
            str(name) if len(panels) > 1 else "",
        )
        parts += _names(lines, panel.top, step, beside) if number % columns == 0 else []
    return svg.picture(width, top - 36 + -(-len(panels) // columns) * (high + 84), title, parts)


def _panel(
    panel: Panel, flights: polars.DataFrame, lines: list[tuple[str, str]], step: float, name: str
) -> list[str]:
    """Axis, frame and boxes of a panel, and its name above it."""
    places, _ = svg.ticks(*panel.x, 5)
    grid = (
        '<path class="grid" '
        f'd="{"".join(f"M{place:.1f} 0V{panel.height:.1f}" for place in panel.across(places))}"/>'
    )
    own = {str(row): part for (row,), part in flights.group_by("row")}
    rows = [
        _row(panel, own[each], place, step)
        for place, (kind, each) in enumerate(lines)
        if kind == "row" and each in own
    ]
    outside, _ = svg.axes(panel, "flight time [s]", "", few=5, left=False)
    above = [svg.text(panel.left, panel.top - 9, name, "strong")] if name else []
    return [outside, *above, svg.framed(panel, [grid, *rows], name or "flights")]


def _lines(rows: polars.DataFrame) -> list[tuple[str, str]]:
    """What stands below each other: `group` and its name, `row` and its name."""
    if "group" not in rows.columns:
        return [("row", name) for name in rows["row"].unique(maintain_order=True).to_list()[:MOST]]
    lines: list[tuple[str, str]] = []
    for (group,), part in rows.group_by("group", maintain_order=True):
        lines += [
            ("group", str(group)),
            *(("row", name) for name in part["row"].unique(maintain_order=True)),
        ]
    return lines[:MOST]


def _names(lines: list[tuple[str, str]], top: float, step: float, room: float) -> list[str]:
    parts = []
    for place, (kind, name) in enumerate(lines):
        most = int((room - 12) / svg.LETTER)
        whole = _shown(name)
        short = whole if len(whole) <= most else f"{whole[: most - 1]}…"
        words = short if short == whole else svg.titled(short, whole)
        down = top + 4 + (place + 0.5) * step + 4.5
        parts.append(
            svg.text(0, down, words, "strong")
            if kind == "group"
            else svg.text(room - 10, down, words, "", "end")
        )
    return parts


def _shown(name: str) -> str:
    """What is shown of a row's name: what follows a tab; rows of equal names differ before it."""
    return name.rpartition("\t")[2]


def _row(panel: Panel, flights: polars.DataFrame, place: int, step: float) -> str:
    """The box of a row, its whiskers and its flights."""
    colour, times = flights["colour"][0], flights["duration"].to_numpy()
    low, middle, high = np.quantile(times, [0.25, 0.5, 0.75])
    near = times[(times >= low - 1.5 * (high - low)) & (times <= high + 1.5 * (high - low))]
    down, half = 4 + (place + 0.5) * step, 0.32 * step
    left, centre, right, first, last = (
        float(value) for value in panel.across([low, middle, high, near.min(), near.max()])
    )
    drawn = ""
    if len(times) >= BOXED:
        drawn += svg.fill(
            f"M{left:.1f} "
            f"{down - half:.1f}H{max(right, left + 1):.1f}V{down + half:.1f}H{left:.1f}Z",
            "faint",
            colour,
        )
        drawn += svg.stroke(
            f"M{first:.1f} {down:.1f}H{left:.1f}M{right:.1f} {down:.1f}H{last:.1f}", "thin", colour
        )
    dotted = (
        np.full(len(times), True)
        if len(times) <= DOTTED
        else (times < near.min()) | (times > near.max())
    )
    reached = (flights["end_reason"] == REACHED).to_numpy()
    # Spread by their place among the flights, so that equal times do not hide each other.
    levels = down + half * 0.8 * (np.linspace(-1, 1, len(times)) if len(times) > 1 else np.zeros(1))
    spots = zip(panel.across(times)[dotted], levels[dotted], reached[dotted], strict=True)
    dots, crosses = "", ""
    for across, level, done in spots:
        dots += f"M{across:.1f} {level:.1f}h0" if done else ""
        crosses += "" if done else f"M{across - 2:.1f} {level - 2:.1f}l4 4m0 -4l-4 4"
    drawn += svg.stroke(dots, "dots faded", colour) + svg.stroke(crosses, "thin faded", colour)
    median = svg.stroke(
        f"M{centre:.1f} {down - half - 1:.1f}V{down + half + 1:.1f}", "heavy", colour
    )
    return drawn + (median if len(times) >= BOXED else "")


def _legend(rows: polars.DataFrame, labels: dict[str, str]) -> list[tuple[str, str]]:
    used = rows["colour"].unique(maintain_order=True).to_list()
    boxed = int(rows.group_by("row", "panel").len()["len"].max() or 0) >= BOXED  # type: ignore[arg-type]
    entries = [
        (
            svg.fill("M2 0H22V12H2Z", "faint", colour) + svg.stroke("M12 0V12", "heavy", colour)
            if boxed
            else svg.stroke("M12 6h0", "spots", colour),
            labels[colour],
        )
        for colour in used
        if colour in labels
    ]
    reasons = (rows["end_reason"] == REACHED).to_numpy()
    entries += (
        [(svg.stroke("M12 6h0", "spots", "soft"), "flight to the time limit")]
        if reasons.any()
        else []
    )
    entries += (
        [(svg.stroke("M9 3l6 6m0 -6l-6 6", "thin", "soft"), "flight ended by a guard")]
        if not reasons.all()
        else []
    )
    return entries
