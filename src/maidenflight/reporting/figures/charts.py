"""Figures, described in Vega-Lite: `charts.js` draws them in the page, `picture` in files.

A figure has panels, each a Vega-Lite specification, a legend above them and a table of numbers in
columns. Colours are CSS variables of `colours.css`, so that light, dark and print need no second
drawing. Source: Satyanarayan et al. 2017, Vega-Lite: a grammar of interactive graphics.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup

Spec = dict[str, Any]
"""A Vega-Lite specification or a part of one."""
DIGITS = 6
"""Significant digits of the numbers in a page."""
NARROW = 620
"""Width of a panel below which it is a phone's [px]."""
PALETTE = ("blue", "orange", "green", "purple")
"""Colours of things in their order; of more things some share one."""
CROSS = "M-.7-.7L.7 .7M-.7 .7L.7-.7"
"""Mark of a flight that a guard ended."""


class Entry(NamedTuple):
    """An entry of a legend."""

    name: str
    colour: str
    """A name in `colours.css`."""
    sample: str
    """What is drawn beside the name, a sample of `look.json`."""
    series: str | None = None
    """The series that the entry hides and shows; none where it only explains."""


@dataclass(frozen=True)
class Figure:
    """Panels side by side, as many as fit, below a legend that they share."""

    title: str
    panels: Sequence[Spec]
    legend: Sequence[Entry] = ()
    least: int = 260
    """Width below which a panel goes to the next line [px]."""
    columns: int | None = None
    """Panels side by side; a narrow page then scrolls."""
    chooses: bool = False
    """Whether a click on a mark shows the flight of its `place` in the viewer."""

    @property
    def json(self) -> Markup:
        """For a script element: nothing in it can end the element."""
        content = {
            "title": self.title,
            "panels": self.panels,
            "legend": [entry._asdict() for entry in self.legend],
            "least": self.least,
            "columns": self.columns,
            "chooses": self.chooses,
            "narrow": NARROW,
            "series": any(entry.series is not None for entry in self.legend),
        }
        return embedded(content)


def embedded(content: Any) -> Markup:
    """Returns content as JSON within a script element: nothing in it can end the element."""
    text = json.dumps(content, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return Markup(text.replace("<", "\\u003c"))


def paint(colour: str) -> str:
    """Returns a colour of the page by its name in `colours.css`."""
    return f"var(--{colour})"


def table(columns: Mapping[str, Any]) -> Spec:
    """Converts columns to data in few digits; numbers that are not finite become null."""
    return {
        "columns": {name: [_plain(value) for value in values] for name, values in columns.items()}
    }


def rows(entries: Sequence[Mapping[str, Any]]) -> Spec:
    """Returns the same from rows; what a row lacks is null."""
    names = dict.fromkeys(name for entry in entries for name in entry)
    return table({name: [entry.get(name) for entry in entries] for name in names})


def panel(
    data: Spec,
    layers: Sequence[Spec],
    *,
    title: str | Sequence[str] = "",
    height: int = 180,
    zooms: Sequence[str] = ("x", "y"),
) -> Spec:
    """Layers over one another that share data and axes.

    Args:
        data: see `table`; rows with a `series` are hidden by the entry of the legend that has it.
        layers: marks and encodings, the first below the others.
        title: above the panel, in one line or several.
        height: of its inside [px].
        zooms: axes that the pointer moves and zooms; each must be of numbers.
    """
    first, *others = layers
    if zooms:
        first = {**first, "params": [zoom(zooms)]}
    spec: Spec = {"data": data, "height": height, "layer": [first, *others]}
    if title:
        spec["title"] = title
    return spec


def by_width(wide: Any, narrow: Any) -> Spec:
    """Returns a part of a specification that is another one on a phone."""
    return {"wide": wide, "narrow": narrow}


def zoom(axes: Sequence[str] = ("x", "y"), name: str = "zoom") -> Spec:
    """Moves by dragging and zooms by the wheel with Ctrl; a double click resets."""
    moved = "[mousedown, window:mouseup] > window:mousemove!"
    wheel = "wheel![event.ctrlKey || event.metaKey]"
    select = {"type": "interval", "encodings": list(axes), "translate": moved, "zoom": wheel}
    return {"name": name, "select": select, "bind": "scales"}


def number(name: str, title: str | Spec = "", **more: Any) -> Spec:
    """Returns a channel of numbers."""
    return {"field": name, "type": "quantitative", "title": title or None, **more}


def within(low: float, high: float, **more: Any) -> Spec:
    """Returns the range of an axis, which then need not hold zero."""
    return {"scale": {"domain": [_plain(low), _plain(high)], "zero": False, "nice": False, **more}}


def margin(values: Any, least: float = 0.0) -> tuple[float, float]:
    """Returns a range with a little room around the finite values; never empty.

    Args:
        values: what is to be in view.
        least: span that it has at least: differences far below it mean nothing.
    """
    finite = np.asarray(values, np.float64)
    finite = finite[np.isfinite(finite)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    room = max(0.06 * (high - low), (least - (high - low)) / 2)
    # Numbers that are equal but for their last bit are equal.
    if room <= 1e-6 * max(abs(low), abs(high)):
        room = 0.05 * max(abs(low), abs(high)) or 1.0
    return low - room, high + room


def layer(condition: str, mark: Spec, **encoding: Any) -> Spec:
    """Returns a layer of a panel.

    Args:
        condition: the `kind` of its rows, or an expression that holds for them; empty for all.
        mark: how it looks.
        encoding: channels by their name.
    """
    test = f"datum.kind === '{condition}'" if condition.isidentifier() else condition
    transform = {"transform": [{"filter": test}]} if test else {}
    return {**transform, "mark": mark, "encoding": encoding}


def tooltip(fields: Mapping[str, str]) -> list[Spec]:
    """Returns the tooltip of a mark: labels by the field, numbers in four digits."""
    return [
        {"field": name, "title": label, **({"format": ".4~g"} if label.endswith("]") else {})}
        for name, label in fields.items()
    ]


def coloured(colours: Mapping[str, str], name: str = "series") -> Spec:
    """Returns a colour for each series, by its name in `colours.css`."""
    scale = {"domain": list(colours), "range": [paint(colour) for colour in colours.values()]}
    return {"field": name, "type": "nominal", "scale": scale}


def _plain(value: Any) -> Any:
    """A number that JSON has; anything else as it is."""
    if isinstance(value, np.generic):
        value = value.item()
    if not isinstance(value, float):
        return value
    if not math.isfinite(value):
        return None
    return float(f"{value:.{DIGITS}g}")
