"""Pictures of what flights tell of a drone: how sure they are of its parameters, and how well
models predict them.

Each is a function from plain tables to SVG text, for the report and for use from Python:

```python
from maidenflight.identification.prediction import predicted_windows
from maidenflight.reporting.identification_figures import corner, horizons, valley, windows

found = maidenflight.identify(flights, maidenflight.Replay())  # a likelihood has draws for the corner
plot, but no valley best = {name: estimate.value for name, estimate in found.estimates.items()}
Path("valley.svg").write_text(valley(found.history, found.estimates))
Path("corner.svg").write_text(corner(found.draws, best)) models = {"identified": found.parameters,
"paper's crazyflie": maidenflight.crazyflie()}
Path("horizons.svg").write_text(horizons(maidenflight.prediction_error(held_out, models)))
Path("windows.svg").write_text(windows(predicted_windows(held_out, models)))
```

`width` is that of the place where a picture will stand [px]. Letters keep their size, so a narrow
picture shows less at once.
"""

from collections.abc import Mapping, Sequence
from html import escape
from typing import NamedTuple

import numpy as np
import polars
from jaxtyping import Float

from maidenflight.errors import InputError
from maidenflight.identification.posterior import LEVEL
from maidenflight.identification.prediction import LOGGED, NOTHING_CHANGES
from maidenflight.reporting import svg, text
from maidenflight.reporting.svg import Panel
from maidenflight.reporting.valley import valley as valley

WIDE, NARROW = 1072, 343
"""Widths of the report on a screen and on a phone, less its margins [px]."""
SMALLEST = 62.0
"""Side of a panel of the corner plot; where one would be smaller, fewer parameters are shown
[px]."""
MOST = 8
"""Parameters that the corner plot shows at most; of more, letters and clouds are too small to
read."""
SHOWN = 200
"""Draws that a panel of the corner plot shows as dots; histograms, intervals and correlations count
all of them."""
STRONG = 0.5
"""Correlation from which on the corner plot prints it bold."""
_LOOKS = (("", "orange"), ("dashed", "purple"), ("", "blue"), ("dashed", "green"))
"""How models are drawn, in their order: the identified drone and the paper's have the colours that
they have in the valley."""
_ERRORS = {
    "position": ("position [cm]", 100.0),
    "velocity": ("velocity [m/s]", 1.0),
    "attitude": ("attitude [°]", 180 / np.pi),
    "body_rates": ("body rates [rad/s]", 1.0),
}
"""Label and shown value per SI value of the errors."""
_SIGNALS = {
    "roll": ("roll [°]", 180 / np.pi),
    "pitch": ("pitch [°]", 180 / np.pi),
    "body_rate_x": ("roll rate [rad/s]", 1.0),
    "body_rate_y": ("pitch rate [rad/s]", 1.0),
    "position_z": ("height gained [cm]", 100.0),
}
"""Label and shown value per SI value of what is drawn of windows; heights count from a window's
start."""


def corner(
    draws: Mapping[str, Float[np.ndarray, "N"]],
    optimum: Mapping[str, float] | None = None,
    width: float = 720,
    level: float = LEVEL,
) -> str:
    """Draws of a posterior, each parameter against each other, with their distributions on the
    diagonal.

    Where there are more than `MOST` or than fit the width, those with the strongest correlations
    are shown, and the note below says so.

    Args:
        draws: N values by parameter [SI], names as in `parameters.COMPONENTS`; an entry of each
            belongs together.
        optimum: the point that is marked; none unless given.
        width: of the picture [px].
        level: share of the draws in the central interval that is marked.

    Raises:
        InputError: no draws, draws that are not finite, or of different numbers.
    """
    values = {name: np.asarray(each, np.float64) for name, each in draws.items()}
    if len({each.shape for each in values.values()}) != 1 or next(iter(values.values())).size == 0:
        raise InputError(
            "no posterior to draw; expected as many draws, and at least one, of each of one or "
            "more parameters."
        )
    if not all(np.isfinite(each).all() for each in values.values()):
        raise InputError("draws of a posterior that are not finite; leave them out.")
    left, foot = 80.0, 84.0
    correlation = _correlations(np.array(list(values.values())))
    kept = _most_correlated(correlation, min(max(int((width - left) // SMALLEST), 2), MOST))
    shown = [
        _marginal(name, values[name], (optimum or {}).get(name, np.nan), level)
        for name in (list(values)[place] for place in kept)
    ]
    entries = [
        (
            svg.fill("M2 0H22V12H2Z", "faint", "blue"),
            f"central {100 * level:.0f} %, ends at the axes",
        )
    ]
    entries += [(svg.stroke("M12 0V12", "line", "orange"), "optimum")] if optimum else []
    legend, tall = svg.legend(
        svg.TITLE, width, [*entries, ("", f"number: correlation, bold from ±{STRONG:g}")]
    )
    top, side = svg.TITLE + tall + 8, min((width - left) / len(shown), 190.0)
    parts = [legend]
    for row, upward in enumerate(shown):
        for column, across in enumerate(shown[: row + 1]):
            panel = Panel(
                left + column * side,
                top + row * side,
                side - 4,
                side - 4,
                across.range,
                upward.range,
            )
            cloud = row != column
            content = (
                _cloud(panel, across, upward, correlation[kept[row], kept[column]])
                if cloud
                else _histogram(panel, across)
            )
            parts.append(svg.framed(panel, [content], f"{across.name} {upward.name}"))
        parts.append(_below(upward, left + row * side, top + len(shown) * side, side))
        parts.append(_beside(upward, left, top + row * side, side) if row else "")
    few = (
        f", those of its {len(values)} parameters with the strongest correlations"
        if len(shown) < len(values)
        else ""
    )
    told = (
        f"{text.plural(len(values[shown[0].name]), 'draw')} of "
        f"{text.plural(len(shown), 'parameter')}{few}."
    )
    note, deep = svg.paragraph(0, top + len(shown) * side + foot, width, told)
    return svg.picture(
        width, top + len(shown) * side + foot + deep + 4, "Posterior", [*parts, note]
    )


class _Marginal(NamedTuple):
    """One parameter of a corner plot, in the unit in which it is shown."""

    name: str
    unit: str
    values: Float[np.ndarray, "N"]
    range: tuple[float, float]
    ends: Float[np.ndarray, "2"]
    """Of the central interval."""
    best: float
    """The optimum; NaN where none is known."""


def _marginal(name: str, values: Float[np.ndarray, "N"], best: float, level: float) -> _Marginal:
    scale, unit = text.scale(name, values)
    shown, point = scale * values, scale * best
    ends = np.quantile(shown, [(1 - level) / 2, (1 + level) / 2])
    return _Marginal(
        name,
        unit,
        shown,
        svg.margin([*shown, *([point] if np.isfinite(point) else [])]),
        ends,
        point,
    )


def _correlations(rows: Float[np.ndarray, "d N"]) -> Float[np.ndarray, "d d"]:
    """Correlations; NaN where a parameter does not vary."""
    # float32 draws of one number differ in their last bit from their mean.
    centred = rows - rows.mean(axis=1, keepdims=True)
    size = np.sqrt(np.sum(centred**2, axis=1))
    moving = size > 1e-6 * np.abs(rows).max(axis=1) * np.sqrt(rows.shape[1])
    unit = np.divide(
        centred, size[:, None], out=np.full_like(centred, np.nan), where=moving[:, None]
    )
    return unit @ unit.T


def _most_correlated(correlation: Float[np.ndarray, "d d"], most: int) -> list[int]:
    """Places of at most so many parameters: those of the strongest correlations, in their own
    order.
    """
    if len(correlation) <= most:
        return list(range(len(correlation)))
    pairs = np.argwhere(np.tril(np.ones_like(correlation), -1) > 0)
    strength = np.nan_to_num(np.abs(correlation[tuple(pairs.T)]))
    kept: set[int] = set()
    for pair in pairs[np.argsort(-strength, kind="stable")]:
        if len(kept | set(pair.tolist())) <= most:
            kept |= set(pair.tolist())
    return sorted(kept)


def _histogram(panel: Panel, shown: _Marginal) -> str:
    counts, edges = np.histogram(
        shown.values, bins=max(8, min(24, int(panel.width / 5))), range=shown.range
    )
    heights = panel.height * (1 - 0.9 * counts / counts.max())
    steps = "".join(
        f"V{down:.1f}H{end:.1f}" for down, end in zip(heights, panel.across(edges)[1:], strict=True)
    )
    low, high = panel.across(shown.ends)
    return (
        svg.fill(
            f"M{low:.1f} 0H{max(high, low + 1):.1f}V{panel.height:.1f}H{low:.1f}Z", "faint", "blue"
        )
        + svg.stroke(f"M0 {panel.height:.1f}{steps}V{panel.height:.1f}", "thin", "blue")
        + svg.line(panel, [shown.best] * 2, shown.range, "", "orange")
    )


def _cloud(panel: Panel, x: _Marginal, y: _Marginal, correlation: float) -> str:
    chosen = np.unique(np.linspace(0, len(x.values) - 1, min(len(x.values), SHOWN)).astype(int))
    content = (
        svg.dots(
            panel,
            x.values[chosen],
            y.values[chosen],
            "fine" if panel.width > 100 else "finest",
            "blue",
        )
        + svg.line(panel, [x.best] * 2, y.range, "thin", "orange")
        + svg.line(panel, x.range, [y.best] * 2, "thin", "orange")
    )
    if not np.isfinite(correlation):
        return content
    # In the corner that a cloud of this correlation leaves free.
    place, anchor = (4.0, "start") if correlation >= 0 else (panel.width - 4.0, "end")
    size = "" if panel.width > 100 else "small "
    look = f"{size}halo{' strong' if abs(correlation) >= STRONG else ''}"
    return content + svg.text(
        place, 15 if panel.width > 100 else 13, svg.written(correlation, 2), look, anchor
    )


def _below(shown: _Marginal, left: float, foot: float, side: float) -> str:
    """The interval's ends, symbol and unit of a parameter below its column."""
    middle = left + side / 2 - 2
    names = svg.text(middle, foot + 58, svg.symbol(shown.name), "strong", "middle") + svg.text(
        middle, foot + 74, shown.unit, "small", "middle"
    )
    return names + "".join(
        svg.text(left + place + 4, foot + 2, label, "small", "end", turn=True)
        for place, label in _ends(shown, side - 4)
    )


def _beside(shown: _Marginal, left: float, top: float, side: float) -> str:
    """The same beside a parameter's row."""
    middle = top + side / 2 - 2
    names = svg.text(12, middle, svg.symbol(shown.name), "strong", "middle", turn=True)
    names += svg.text(27, middle, shown.unit, "small", "middle", turn=True)
    return names + "".join(
        svg.text(left - 6, top + side - place, label, "small", "end")
        for place, label in _ends(shown, side - 4)
    )


def _ends(shown: _Marginal, side: float) -> list[tuple[float, str]]:
    """Where the interval's ends are along a panel's side, far enough apart to be read, and what
    they are.
    """
    low, high = (shown.ends - shown.range[0]) / (shown.range[1] - shown.range[0]) * side
    apart = max(12.0 - (high - low), 0.0) / 2
    width = shown.ends[1] - shown.ends[0]
    # Numbers that are equal but for their last bit are equal.
    decimals = text.places(width if width > 1e-6 * np.abs(shown.ends).max() else 0.0)
    return [
        (place, svg.written(end, decimals))
        for place, end in zip((low - apart, high + apart), shown.ends, strict=True)
    ]


def horizons(errors: polars.DataFrame, width: float = 720) -> str:
    """How the errors of open-loop predictions grow, a line a model with its 95 % interval.

    Dotted, what predicts that nothing changes.

    Args:
        errors: as `prediction_error` gives them.
        width: of the picture [px].
    """
    names = errors["model"].unique(maintain_order=True).to_list()
    looks = _looks(names)
    legend, tall = svg.legend(svg.TITLE, width, _line_legend(looks))
    columns = 4 if width >= 900 else 2 if width >= 500 else 1
    side, high = width / columns, 200.0
    last = float(errors["horizon"].to_numpy().max())
    parts = [legend]
    for number, (column, (label, scale)) in enumerate(_ERRORS.items()):
        most = scale * float(errors[column].to_numpy().max())
        place = (
            number % columns * side + 40,
            svg.TITLE + tall + 32 + number // columns * (high + 74),
        )
        panel = Panel(
            *place, side - 52, high, (0.0, last * 1.02), svg.margin([0.0, most], floor=0.0)
        )
        axes = svg.axes(panel, "time ahead [s]", "", few=5)
        content = [axes[1]]
        for name in reversed(names):
            rows = errors.filter(polars.col("model") == name).sort("horizon")
            ahead = np.concatenate([[0.0], rows["horizon"].to_numpy()])
            middle, low, upper = (
                np.concatenate([[0.0], scale * rows[f"{column}{end}"].to_numpy()])
                for end in ("", "_low", "_high")
            )
            look, colour = looks[name]
            content.append(
                svg.band(panel, ahead, low, upper, colour)
                + svg.line(panel, ahead, middle, look, colour)
            )
            content.append(svg.dots(panel, ahead[1:], middle[1:], "spots", colour))
        parts += [
            svg.text(panel.left, panel.top - 9, label, "strong"),
            axes[0],
            svg.framed(panel, content, column),
        ]
    rows = -(-len(_ERRORS) // columns)
    return svg.picture(
        width, svg.TITLE + tall + 20 + rows * (high + 74), "Errors over the time predicted", parts
    )


def windows(rows: polars.DataFrame, width: float = 720) -> str:
    """Logged flight and what models make of its commands alone, window by window.

    A narrow picture shows the first windows only, and its title says how many of all.

    Args:
        rows: as `predicted_windows` gives them.
        width: of the picture [px].
    """
    known = rows["window"].unique(maintain_order=True).to_list()
    fit = known[: max(1, int((width - 50) // 145))]
    names = [name for name in rows["model"].unique(maintain_order=True).to_list() if name != LOGGED]
    looks = _looks(names)
    logged = (
        svg.dots(Panel(0, 0, 24, 12, (0, 4), (0, 2)), [0.5, 1.5, 2.5, 3.5], [1] * 4, "dots", "ink"),
        LOGGED,
    )
    legend, tall = svg.legend(svg.TITLE, width, [logged, *_line_legend(looks)])
    side, high, gap = (width - 46) / len(fit), 100.0, 34.0
    top = svg.TITLE + tall + 28
    shown = rows.filter(polars.col("window").is_in(fit)).with_columns(
        position_z=polars.col("position_z")
        - polars.col("position_z").first().over("window", "model")
    )
    last = float(shown["time"].to_numpy().max())
    parts = [legend]
    for line, (column, (label, scale)) in enumerate(_SIGNALS.items()):
        y = svg.margin(scale * shown[column].to_numpy())
        for number, window in enumerate(fit):
            panel = Panel(
                46 + number * side,
                top + line * (high + gap),
                side - 10,
                high,
                (0.0, 1.02 * last),
                y,
            )
            part = shown.filter(polars.col("window") == window)
            below = "time [s]" if line == len(_SIGNALS) - 1 else None
            axes = svg.axes(panel, below, "", few=3, left=number == 0)
            content = [axes[1]]
            measured = part.filter(polars.col("model") == LOGGED)
            every = max(1, round(measured.height * 4.5 / panel.width))
            content.append(
                svg.dots(
                    panel,
                    measured["time"][::every],
                    scale * measured[column][::every].to_numpy(),
                    "dots",
                    "ink",
                )
            )
            for name in reversed(names):
                predicted = part.filter(polars.col("model") == name)
                content.append(
                    svg.line(
                        panel, predicted["time"], scale * predicted[column].to_numpy(), *looks[name]
                    )
                )
            parts += [axes[0], svg.framed(panel, content, f"{column} {window}")]
        parts.append(svg.text(46, top + line * (high + gap) - 8, label, "strong"))
    some = f", {len(fit)} of {len(known)}" if len(fit) < len(known) else ""
    return svg.picture(
        width, top + len(_SIGNALS) * (high + gap) + 30, f"Predicted windows{some}", parts
    )


def _looks(names: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Look and colour of each model's line."""
    models = [name for name in names if name != NOTHING_CHANGES]
    looks = {name: _LOOKS[number % len(_LOOKS)] for number, name in enumerate(models)}
    return looks | ({NOTHING_CHANGES: ("dotted", "soft")} if NOTHING_CHANGES in names else {})


def _line_legend(looks: Mapping[str, tuple[str, str]]) -> list[tuple[str, str]]:
    return [
        (svg.stroke("M0 6H24", f"line {look}".strip(), colour), escape(name))
        for name, (look, colour) in looks.items()
    ]
