"""Pictures of how well models predict flights: errors by horizon, and windows of flight."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import polars

from maidenflight.identification.replay.prediction import LOGGED
from maidenflight.names import PERSISTENCE
from maidenflight.reporting.figures import charts
from maidenflight.reporting.figures.charts import Entry, Figure, Spec
from maidenflight.reporting.text import ERRORS, DisplayFormat


class _Look(NamedTuple):
    colour: str
    sample: str
    dash: list[int]


_LINE_STYLES = (
    _Look("orange", "line", [1, 0]),
    _Look("purple", "dashed", [7, 4]),
    _Look("blue", "line", [1, 0]),
    _Look("green", "dashed", [7, 4]),
)
"""How models are drawn, in their order: the identified drone and the paper's in the colours that
they have in the pictures of the delays."""
_SIGNALS = {
    "roll": DisplayFormat("roll", 180 / np.pi, "°"),
    "pitch": DisplayFormat("pitch", 180 / np.pi, "°"),
    "body_rate_x": DisplayFormat("roll rate", 1.0, "rad/s"),
    "body_rate_y": DisplayFormat("pitch rate", 1.0, "rad/s"),
    "position_z": DisplayFormat("height gained", 100.0, "cm"),
}
"""What is drawn of windows; heights count from a window's start."""


def horizons(errors: polars.DataFrame) -> Figure:
    """Returns how the errors of open-loop predictions grow, a line a model with its 95 % interval.

    Args:
        errors: as `prediction_error` gives them.
    """
    styles = _line_styles(errors["model"].unique(maintain_order=True).to_list())
    panels = []
    for column, format in ERRORS.items():
        rows = []
        for model in styles:
            part = errors.filter(polars.col("model") == model).sort("horizon")
            rows.append({"series": model, "x": 0.0, "y": 0.0, "low": 0.0, "high": 0.0})
            for row in part.iter_rows(named=True):
                ends = [format.scale * row[f"{column}{end}"] for end in ("", "_low", "_high")]
                numbers = dict(zip(("y", "low", "high"), ends, strict=True))
                rows.append({"series": model, "x": row["horizon"], **numbers})
        label = f"{format.name} [{format.unit}]"
        x, y = charts.number("x", "time ahead [s]"), charts.number("y")
        in_tooltip = {"series": "", "x": "ahead [s]", "y": label}
        in_tooltip |= {"low": "95 % from [ ]", "high": "to [ ]"}
        colour, low = _colours(styles), charts.number("low")
        band = {"type": "area", "opacity": 0.18}
        dot = {"type": "point", "filled": True, "size": 40, "opacity": 1}
        tooltip = charts.tooltip(in_tooltip)
        layers = [
            charts.layer("", band, x=x, y=low, y2={"field": "high"}, color=colour),
            _line("", x, y, styles),
            charts.layer("datum.x > 0", dot, x=x, y=y, color=colour, tooltip=tooltip),
        ]
        panels.append(charts.panel(charts.rows(rows), layers, title=label, height=200))
    return Figure("Errors over the time predicted", panels, _legend(styles), least=220)


def windows(rows: polars.DataFrame) -> Figure:
    """Draws logged flight and predictions from its commands alone, a column a window.

    Args:
        rows: as `predicted_windows` gives them.
    """
    windows = rows["window"].unique(maintain_order=True).to_list()
    names = [name for name in rows["model"].unique(maintain_order=True).to_list() if name != LOGGED]
    styles = _line_styles(names)
    rose = polars.col("position_z").first().over("window", "model")
    chart_rows = rows.with_columns(position_z=polars.col("position_z") - rose)
    last = 1.02 * float(chart_rows["time"].to_numpy().max())
    panels = []
    for line, (column, signal) in enumerate(_SIGNALS.items()):
        label = f"{signal.name} [{signal.unit}]"
        ends = charts.margin(signal.scale * chart_rows[column].to_numpy())
        below = "time [s]" if line == len(_SIGNALS) - 1 else ""
        x = charts.number("x", below, **charts.within(0.0, last), axis={"tickCount": 3})
        y = charts.number("y", **charts.within(*ends))
        tooltip = charts.tooltip({"series": "", "x": "time [s]", "y": label})
        for number, window in enumerate(windows):
            part = chart_rows.filter(polars.col("window") == window)
            data = {"series": part["model"], "x": part["time"], "y": signal.scale * part[column]}
            ink = {"type": "point", "filled": True, "size": 9, "opacity": 1}
            ink["color"] = charts.paint("ink")
            near = {"type": "point", "size": 60, "opacity": 0}
            layers = [
                charts.layer(f"datum.series === '{LOGGED}'", ink, x=x, y=y, tooltip=tooltip),
                _line(f"datum.series !== '{LOGGED}'", x, y, styles),
                charts.layer("", near, x=x, y=y, tooltip=tooltip),
            ]
            title = label if number == 0 else " "
            panels.append(charts.panel(charts.table(data), layers, title=title, height=100))
    legend = [Entry(LOGGED, "ink", "dots", LOGGED), *_legend(styles)]
    return Figure("Predicted windows", panels, legend, least=150, columns=len(windows))


def _line_styles(names: Sequence[str]) -> dict[str, _Look]:
    models = [name for name in names if name != PERSISTENCE]
    styles = {name: _LINE_STYLES[number % len(_LINE_STYLES)] for number, name in enumerate(models)}
    return styles | ({PERSISTENCE: _Look("soft", "dotted", [2, 4])} if PERSISTENCE in names else {})


def _colours(styles: dict[str, _Look]) -> Spec:
    return charts.coloured({name: look.colour for name, look in styles.items()})


def _line(condition: str, x: Spec, y: Spec, styles: dict[str, _Look]) -> Spec:
    dashes = {"domain": list(styles), "range": [look.dash for look in styles.values()]}
    dash = {"field": "series", "type": "nominal", "scale": dashes}
    mark = {"type": "line", "strokeWidth": 2}
    return charts.layer(condition, mark, x=x, y=y, color=_colours(styles), strokeDash=dash)


def _legend(styles: dict[str, _Look]) -> list[Entry]:
    return [Entry(name, look.colour, look.sample, name) for name, look in styles.items()]
