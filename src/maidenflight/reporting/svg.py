"""Pictures as SVG text, drawn for a width in pixels, so that letters have one size everywhere.

Colours are CSS variables of `colours.css`, which each picture carries in light and in dark, so that
it stands alone as a file too. Paths of numbers are put together here, where a template would bring
nothing; all text goes through `text`, which escapes what is no `Markup`.
"""

import math
import re
from collections.abc import Iterable, Sequence
from importlib import resources
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup, escape

from maidenflight.reporting import text as names

LETTER = 6.9
"""About the width of a letter of the pictures' 13 px [px]."""
TITLE = 30
"""Height of a picture's title [px]."""
ENTRY = 22
"""Height of a line of a legend [px]."""


class Panel(NamedTuple):
    """A rectangle of a picture [px] and the ranges of values that it shows."""

    left: float
    top: float
    width: float
    height: float
    x: tuple[float, float]
    y: tuple[float, float]

    def across(self, values: Any) -> np.ndarray:
        """Distances from the panel's left edge [px]."""
        return (np.asarray(values, np.float64) - self.x[0]) / (self.x[1] - self.x[0]) * self.width

    def down(self, values: Any) -> np.ndarray:
        """Distances from the panel's upper edge [px]."""
        return (self.y[1] - np.asarray(values, np.float64)) / (self.y[1] - self.y[0]) * self.height

    def at(self, x: float, y: float) -> tuple[float, float]:
        """A point's distances from the panel's left and upper edges [px]."""
        return float(self.across(x)), float(self.down(y))


def picture(width: float, height: float, title: str, parts: Iterable[str]) -> str:
    """A whole picture; the title is text, and the name that screen readers say."""
    style = "".join(
        resources.files("maidenflight.reporting").joinpath(name).read_text("utf-8")
        for name in ("colours.css", "picture.css")
    )
    size = f'width="{width:g}" height="{height:g}" viewBox="0 0 {width:g} {height:g}"'
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" class="picture" role="img" '
        f'aria-label="{escape(title)}" {size}><style>{style}</style>'
        '<rect class="paper" width="100%" '
        f'height="100%"/>{text(0, 18, title, "title")}{"".join(parts)}</svg>\n'
    )


def framed(panel: Panel, content: Iterable[str], name: str = "") -> str:
    """A panel's frame and what is drawn in it, cut off at its edges.

    `name` is kept in the file, for who looks for the panel there.
    """
    left, top, width, height = (_number(side) for side in panel[:4])
    named = f' data-panel="{escape(name)}"' if name else ""
    edge = (
        '<path class="frame" d="M0.5 '
        f'0.5H{_number(panel.width - 0.5)}V{_number(panel.height - 0.5)}H0.5Z"/>'
    )
    return (
        f'<svg x="{left}" y="{top}" width="{width}" '
        f'height="{height}"{named}>{"".join(content)}{edge}</svg>'
    )


def line(panel: Panel, x: Any, y: Any, look: str, colour: str) -> str:
    """A line through points; where a point is not finite it is broken."""
    places = zip(panel.across(x), panel.down(y), strict=True)
    path, pen = "", "M"
    for across, down in places:
        finite = math.isfinite(across) and math.isfinite(down)
        path += f"{pen}{_number(across)} {_number(down)}" if finite else ""
        pen = "L" if finite else "M"
    return stroke(path, f"line {look}".strip(), colour)


def band(panel: Panel, x: Any, low: Any, high: Any, colour: str) -> str:
    """What lies between two lines where both are finite, faintly filled."""
    x, low, high = (np.asarray(values, np.float64) for values in (x, low, high))
    known = np.isfinite(x) & np.isfinite(low) & np.isfinite(high)
    there, back = (
        zip(panel.across(x[known]), panel.down(side[known]), strict=True) for side in (low, high)
    )
    corners = [
        f"{_number(across)} {_number(down)}" for across, down in (*there, *reversed(list(back)))
    ]
    return fill(f"M{'L'.join(corners)}Z", "faint", colour)


def dots(panel: Panel, x: Any, y: Any, look: str, colour: str) -> str:
    """Round dots where both are finite."""
    places = [
        place
        for place in zip(panel.across(x), panel.down(y), strict=True)
        if all(map(math.isfinite, place))
    ]
    return stroke(
        "".join(f"M{_number(across)} {_number(down)}h0" for across, down in places), look, colour
    )


def stroke(path: str, look: str, colour: str) -> str:
    """A path drawn in a colour."""
    return f'<path class="{look}" style="stroke:var(--{colour})" d="{path}"/>' if path else ""


def fill(path: str, look: str, colour: str) -> str:
    """A path filled with a colour."""
    return f'<path class="filled {look}" style="fill:var(--{colour})" d="{path}"/>'


def text(
    x: float,
    y: float,
    words: str | Markup,
    look: str = "",
    anchor: str = "start",
    turn: bool = False,
) -> str:
    """A line of text, escaped unless it is `Markup`; `turn`ed it reads upwards."""
    place = (
        f'transform="translate({_number(x)} {_number(y)}) rotate(-90)"'
        if turn
        else f'x="{_number(x)}" y="{_number(y)}"'
    )
    kind = f' class="{look}"' if look else ""
    return f'<text {place}{kind} text-anchor="{anchor}">{escape(words)}</text>'


def symbol(name: str) -> Markup:
    """A parameter's symbol, with its index lowered."""

    def lowered(found: re.Match[str]) -> str:
        # What follows an index goes up again; where nothing does, a space of no width.
        after = found[2] or "\N{ZERO WIDTH SPACE}"
        return f'<tspan class="sub" dy="3">{found[1]}</tspan><tspan dy="-3">{after}</tspan>'

    return Markup(re.sub(r"<sub>(.*?)</sub>([^<]?)", lowered, str(names.symbol(name))))


def paragraph(x: float, y: float, width: float, words: str, look: str = "") -> tuple[str, float]:
    """Plain text broken into lines that fit a width, and their height [px]."""
    lines = [""]
    for word in words.split(" "):
        longer = f"{lines[-1]} {word}".strip()
        lines = (
            [*lines[:-1], longer]
            if len(longer) * LETTER <= width or not lines[-1]
            else [*lines, word]
        )
    return "".join(
        text(x, y + 13 + 18 * number, each, look) for number, each in enumerate(lines)
    ), 18.0 * len(lines)


def legend(
    y: float, width: float, entries: Sequence[tuple[str, str | Markup]]
) -> tuple[str, float]:
    """Samples (drawings of 24 x 12 px) with their names, in lines of a width; and their height."""
    parts, x, row = [], 0.0, 0
    for sample, name in entries:
        needed = 30 + len(Markup(name).striptags() if isinstance(name, Markup) else name) * LETTER
        if x > 0 and x + needed > width:
            x, row = 0.0, row + 1
        place = f"translate({_number(x)} {_number(y + ENTRY * row)})"
        parts.append(
            f'<g transform="{place}"><g transform="translate(0 '
            f'3)">{sample}</g>{text(30, 13, name)}</g>'
        )
        x += needed + 18
    return "".join(parts), ENTRY * (row + 1.0) if entries else 0.0


def ticks(low: float, high: float, most: int) -> tuple[list[float], list[str]]:
    """At most so many round numbers in a range, and how they are written."""
    rough = (high - low) / max(most, 1)
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(
        power * nice
        for nice in (1, 2, 2.5, 5, 10, 20)
        if math.floor(high / (power * nice)) - math.ceil(low / (power * nice)) < most
    )
    places = [
        step * number
        for number in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
    ]
    decimals = next(count for count in range(16) if round(step, count) == round(step, 15))
    return places, [written(place, decimals) for place in places]


def written(value: float, decimals: int) -> str:
    """A number with a minus that is as wide as a plus; never a negative zero."""
    shown = f"{value:.{decimals}f}"
    return shown.replace("-", "\N{MINUS SIGN}") if float(shown) else shown.removeprefix("-")


def axes(
    panel: Panel, below: str | None, beside: str, few: int = 6, left: bool = True, room: float = 35
) -> tuple[str, str]:
    """Numbers and names along a panel's lower and left edges, and the grid to draw first in it.

    Args:
        panel: the panel.
        below: name of the lower axis; `None` for neither name nor numbers there.
        beside: name of the left axis.
        few: most numbers along the lower axis.
        left: whether there are numbers along the left axis.
        room: from the left axis to its name [px].
    """
    x, across = ticks(*panel.x, few)
    y, up = ticks(*panel.y, max(2, min(6, int(panel.height / 32))))
    foot = panel.top + panel.height
    outside = []
    if below is not None:
        middles = zip(panel.across(x), across, strict=True)
        # A number at the right edge stays within the picture.
        outside += [
            text(panel.left + place, foot + 17, name, "", _anchor(place, panel.width))
            for place, name in middles
        ]
        outside.append(text(panel.left + panel.width / 2, foot + 36, below, "", "middle"))
    if left:
        levels = zip(panel.down(y), up, strict=True)
        outside += [
            text(
                panel.left - 6,
                panel.top + min(max(place, 6), panel.height - 2) + 4.5,
                name,
                "",
                "end",
            )
            for place, name in levels
        ]
    if beside:
        outside.append(
            text(panel.left - room, panel.top + panel.height / 2, beside, "", "middle", turn=True)
        )
    lines = "".join(f"M{_number(place)} 0V{_number(panel.height)}" for place in panel.across(x))
    lines += "".join(f"M0 {_number(place)}H{_number(panel.width)}" for place in panel.down(y))
    return "".join(outside), f'<path class="grid" d="{lines}"/>' if lines else ""


def _anchor(place: float, width: float) -> str:
    return "end" if place > width - 6 else "middle"


def margin(values: Any, floor: float = -math.inf) -> tuple[float, float]:
    """A range with a little room around the finite values, not below a floor; never empty."""
    finite = np.asarray(values, np.float64)
    finite = finite[np.isfinite(finite)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    room = 0.06 * (high - low)
    # Numbers that are equal but for their last bit are equal.
    if room <= 1e-6 * max(abs(low), abs(high)):
        room = 0.05 * max(abs(low), abs(high)) or 1.0
    return max(low - room, min(floor, low)) if floor > -math.inf else low - room, high + room


def _number(value: float) -> str:
    """A length in tenths of a pixel, as short as it can be.

    Far outside of any picture counts as far enough.
    """
    return f"{min(max(float(value), -1e5), 1e5):.1f}".removesuffix(".0")
