"""The corner plot of a posterior: each parameter against each other, and its distribution."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from maidenflight.errors import InputError
from maidenflight.identification.uncertainty import LEVEL
from maidenflight.reporting import text
from maidenflight.reporting.figures import charts
from maidenflight.reporting.figures.charts import Entry, Figure, Spec

MAX_PARAMETERS = 8
"""Parameters that the corner plot shows at most; of more, letters and clouds are too small to
read."""
MAX_POINTS = 200
"""Draws that a panel of the corner plot shows as dots; histograms, intervals and correlations count
all of them."""
STRONG = 0.5
"""Correlation from which on the corner plot prints it bold."""
_AXIS_WIDTH = 70
"""Room for the numbers beside the first column [px]."""


def corner(
    draws: Mapping[str, Float[np.ndarray, "N"]],
    optimum: Mapping[str, float] | None = None,
) -> Figure:
    """Draws posterior samples of each pair of parameters, with distributions on the diagonal.

    Of more than `MAX_PARAMETERS` those with the strongest correlations stand; the title says so.
    Draws are in SI units, by names of `parameters.COMPONENTS`; the optimum is marked where it is
    known.

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
    correlation = _correlations(np.array(list(values.values())))
    places = _most_correlated(correlation, MAX_PARAMETERS)
    names, best = list(values), optimum or {}
    marginals = [
        _marginal(name, values[name], best.get(name, np.nan))
        for name in (names[index] for index in places)
    ]
    count = len(values[marginals[0].name])
    indices = np.unique(np.linspace(0, count - 1, min(count, MAX_POINTS)).astype(int))
    lines = []
    for row, upward in enumerate(marginals):
        cells = []
        for column, across in enumerate(marginals[: row + 1]):
            first, last = column == 0, row == len(marginals) - 1
            cells.append(
                _histogram(across, last)
                if row == column
                else _cloud(across, upward, correlation[places[row], places[column]], first, last)
            )
        lines.append({"hconcat": cells, "bounds": "flush", "spacing": 6})
    data = charts.table({each.name: each.values[indices] for each in marginals})
    spec: Spec = {"data": data, "vconcat": _cells(lines, len(marginals)), "spacing": 6}
    title = f"Posterior: {text.plural(count, 'draw')} of {text.plural(len(marginals), 'parameter')}"
    if len(marginals) < len(values):
        title += f", those of its {len(values)} parameters with the strongest correlations"
    legend = [Entry(f"central {100 * LEVEL:.0f} %", "blue", "area")]
    legend += [Entry("optimum", "orange", "tick")] if optimum else []
    legend.append(Entry(f"number: correlation, bold from ±{STRONG:g}", "soft", "dot"))
    return Figure(title, [spec], legend, least=len(marginals) * 96 + _AXIS_WIDTH, columns=1)


class _Marginal(NamedTuple):
    """One parameter of a corner plot, in its display unit."""

    name: str
    label: tuple[str, ...]
    """Symbol and unit."""
    values: Float[np.ndarray, "N"]
    range: tuple[float, float]
    ends: Float[np.ndarray, "2"]
    """Of the central interval."""
    best: float
    """The optimum; NaN where none is known."""


def _marginal(name: str, values: Float[np.ndarray, "N"], best: float) -> _Marginal:
    scale, unit = text.scale(name, values)
    scaled, point = scale * values, scale * best
    ends = np.quantile(scaled, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    label = tuple(filter(None, (text.plain_symbol(name), unit)))
    reached = [*scaled, *([point] if np.isfinite(point) else [])]
    return _Marginal(name, label, scaled, charts.margin(reached), ends, point)


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
    places: set[int] = set()
    for pair in pairs[np.argsort(-strength, kind="stable")]:
        if len(places | set(pair.tolist())) <= most:
            places |= set(pair.tolist())
    return sorted(places)


def _cells(lines: list[Spec], count: int) -> list[Spec]:
    """The lines with the size of their cells, which the page works out of its width."""
    side = {"share": count, "less": 6 + _AXIS_WIDTH / count + 4}
    for line in lines:
        line["hconcat"] = [{**cell, "width": side, "height": side} for cell in line["hconcat"]]
    return lines


def _axis(marginal: _Marginal, there: bool, left_axis: bool) -> Spec:
    """Numbers along the outer cells only."""
    if not there:
        return {"axis": {"labels": False, "ticks": False, "title": None, "grid": False}}
    width = {"minExtent": _AXIS_WIDTH - 34, "maxExtent": _AXIS_WIDTH - 34} if left_axis else {}
    axis = {"tickCount": 3, "labelFontSize": 11, "grid": False, "labelFlush": False, **width}
    # A label at the edge of its cell may reach into the gap beside it.
    return {"axis": {**axis, "labelBound": 8, "labelOverlap": "greedy"}, "title": [*marginal.label]}


def _channel(marginal: _Marginal, there: bool, left_axis: bool) -> Spec:
    channel = charts.number(marginal.name, **charts.within(*marginal.range))
    return {**channel, **_axis(marginal, there, left_axis)}


def _axis_title(marginal: _Marginal) -> str:
    symbol, *unit = marginal.label
    return f"{symbol} [{' '.join(unit)}]"


def _histogram(marginal: _Marginal, last: bool) -> Spec:
    counts, edges = np.histogram(marginal.values, bins=20, range=marginal.range)
    blue, orange = charts.paint("blue"), charts.paint("orange")
    x = {**charts.number("from", **charts.within(*marginal.range)), **_axis(marginal, last, False)}
    y = charts.number("count", **charts.within(0.0, 1.1 * float(counts.max())), axis=None)
    tooltip = {"from": f"{_axis_title(marginal)} from [ ]", "to": "to [ ]", "count": "draws"}
    band = {"type": "rect", "color": blue, "opacity": 0.15}
    bar = {"type": "rect", "color": blue, "opacity": 0.6}
    shared: Spec = {"x": x, "x2": {"field": "to"}}
    level: Spec = {"y": y, "y2": {"datum": 0}, "tooltip": charts.tooltip(tooltip)}
    low, high = marginal.ends
    bars = charts.table({"from": edges[:-1], "to": edges[1:], "count": counts})
    layers = [
        {"data": charts.table({"from": [low], "to": [high]}), **charts.layer("", band, **shared)},
        {"data": bars, **charts.layer("", bar, **shared, **level)},
    ]
    if np.isfinite(marginal.best):
        best = charts.table({"from": [marginal.best]})
        rule = {"type": "rule", "color": orange, "strokeWidth": 2}
        layers.append({"data": best, **charts.layer("", rule, x=x)})
    return {"layer": layers}


def _cloud(x: _Marginal, y: _Marginal, correlation: float, first: bool, last: bool) -> Spec:
    across, up = _channel(x, last, False), _channel(y, first, True)
    tooltip = charts.tooltip({each.name: _axis_title(each) for each in (x, y)})
    dot = {"type": "point", "filled": True, "size": 8, "opacity": 1, "clip": True}
    # In a PDF each mark with an opacity of its own, not of its filling, is a picture.
    dot["fillOpacity"] = 0.55
    dot["color"] = charts.paint("blue")
    zoom = {"params": [charts.zoom(name=f"zoom_{x.name}_{y.name}")]}
    layers = [{**zoom, **charts.layer("", dot, x=across, y=up, tooltip=tooltip)}]
    rule = {"type": "rule", "color": charts.paint("orange"), "clip": True}
    for axis, marginal, channel in (("x", x, across), ("y", y, up)):
        if np.isfinite(marginal.best):
            best = charts.table({marginal.name: [marginal.best]})
            layers.append({"data": best, **charts.layer("", rule, **{axis: channel})})
    if np.isfinite(correlation):
        # In the corner that a cloud of this correlation leaves free.
        weight = "bold" if abs(correlation) >= STRONG else "normal"
        words = text.fixed(correlation, 2)
        mark = {"type": "text", "text": words, "y": 9, "dx": -4, "align": "right"}
        width: Spec = {"value": "width"}
        if correlation >= 0:
            mark, width = {**mark, "dx": 4, "align": "left"}, {"value": 0}
        number = charts.layer("", {**mark, "fontWeight": weight}, x=width)
        layers.append({"data": charts.table({"one": [1]}), **number})
    return {"layer": layers}
