"""The corner plot of a posterior: each parameter against each other, and its distribution.

```python
found = maidenflight.identify(flights)
best = {name: estimate.value for name, estimate in found.estimates.items()}
Path("corner.svg").write_text(corner(found.posterior, best))
```

`width` is that of the place where a picture will stand [px]. Letters keep their size, so a narrow
picture shows fewer parameters.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from maidenflight.errors import InputError
from maidenflight.identification.posterior import LEVEL
from maidenflight.reporting import svg, text
from maidenflight.reporting.svg import Panel

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


def corner(
    draws: Mapping[str, Float[np.ndarray, "N"]],
    optimum: Mapping[str, float] | None = None,
    width: float = 720,
    level: float = LEVEL,
) -> str:
    """Posterior samples, each parameter against each other, with distributions on the diagonal.

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
    drawn = (
        f"{text.plural(len(values[shown[0].name]), 'draw')} of "
        f"{text.plural(len(shown), 'parameter')}{few}."
    )
    note, deep = svg.paragraph(0, top + len(shown) * side + foot, width, drawn)
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
    """Places of at most so many parameters, in their order: those with strongest correlations."""
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
    """Places of the interval's ends along a panel's side, far enough apart, and their labels."""
    low, high = (shown.ends - shown.range[0]) / (shown.range[1] - shown.range[0]) * side
    apart = max(12.0 - (high - low), 0.0) / 2
    width = shown.ends[1] - shown.ends[0]
    # Numbers that are equal but for their last bit are equal.
    decimals = text.places(width if width > 1e-6 * np.abs(shown.ends).max() else 0.0)
    return [
        (place, svg.written(end, decimals))
        for place, end in zip((low - apart, high + apart), shown.ends, strict=True)
    ]
