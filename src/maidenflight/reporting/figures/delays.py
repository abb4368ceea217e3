"""Motor time constant and latency, and how well flights tell them apart."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from maidenflight.errors import InputError
from maidenflight.identification.drone_file import Estimate
from maidenflight.identification.uncertainty import LEVEL
from maidenflight.parameters import crazyflie
from maidenflight.reporting import text
from maidenflight.reporting.figures import charts
from maidenflight.reporting.figures.charts import Entry, Figure, Spec

DELAYS = ("motor_time_constant", "latency")
SHARES = (0.5, 0.95)
"""Shares of the samples that the ellipses hold."""


def delay_posterior(
    draws: Mapping[str, Float[np.ndarray, "N"]],
    estimates: Mapping[str, Estimate],
    truth: Sequence[tuple[float, float]] = (),
) -> Figure:
    """Draws posterior samples of the two delays, and ellipses that hold shares of them.

    Args:
        draws: N values by parameter [SI]; an entry of each belongs together.
        estimates: optimum and interval by parameter.
        truth: what is true of a virtual drone: corners of a box, motor time constant and latency
            [s].

    Raises:
        InputError: draws or estimates of one of the two parameters are missing.
    """
    if not set(DELAYS) <= set(draws) or not set(DELAYS) <= set(estimates):
        raise InputError(
            f"no posterior to draw: expected draws and estimates of {' and '.join(DELAYS)}."
        )
    points = 1e3 * np.array([draws[name] for name in DELAYS], np.float64).T
    best = np.array([1e3 * estimates[name].value for name in DELAYS])
    box, paper = box_of(truth), of_the_paper()
    curves = {share: _ellipse(points, share) for share in SHARES}
    sides = np.array([1e3 * np.array(estimates[name].interval) for name in DELAYS]).T
    # The cloud fills the picture; what lies outside is marked at its edge.
    ends = _view(np.concatenate([points, sides, [best], *curves.values()]))
    mark_rows: list[Spec] = [{"series": "sample", "x": x, "y": y} for x, y in points]
    for share, ellipse in curves.items():
        mark_rows += curve("ellipses", ellipse, f"{100 * share:.0f} %")
    mark_rows += marks(best, estimates, box, ends)
    shares = " and ".join(f"{100 * share:.0f} %" for share in SHARES)
    beyond = "" if _inside(paper, ends) else f", outside at ({paper[0]:g} ms, {paper[1]:g} ms)"
    legend = [
        Entry("posterior sample", "blue", "dot", "sample"),
        Entry(f"{shares} of them", "blue", "line", "ellipses"),
        *legend_of_marks(float(best.sum()), bool(truth), beyond),
    ]
    return plane("Posterior of the delays", mark_rows, ends, legend)


def _view(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "2 2"]:
    """The least and largest delays of a picture that holds points [ms]."""
    low, high = points.min(axis=0).clip(0.0), points.max(axis=0)
    room = np.maximum(0.04 * (high - low), 0.02)
    return np.array([(low - room).clip(0.0), high + room])


def _inside(points: np.ndarray, ends: Float[np.ndarray, "2 2"]) -> bool:
    return bool(((points >= ends[0]) & (points <= ends[1])).all())


def _ellipse(points: Float[np.ndarray, "n 2"], share: float) -> Float[np.ndarray, "m 2"]:
    """The ellipse that holds a share of the normal distribution of the points."""
    turn = np.linspace(0, 2 * np.pi, 97)
    spread, axes = np.linalg.eigh(
        np.atleast_2d(np.cov(points.T)) if len(points) > 2 else np.zeros((2, 2))
    )
    radius = np.sqrt(-2 * np.log(1 - share) * np.maximum(spread, 0.0))
    return points.mean(axis=0) + np.stack([np.cos(turn), np.sin(turn)], axis=1) * radius @ axes.T


def of_the_paper() -> Float[np.ndarray, "2"]:
    """Returns the delays of the paper's drone [ms]."""
    return np.array([1e3 * float(getattr(crazyflie(), name)) for name in DELAYS])


def box_of(truth: Sequence[tuple[float, float]]) -> Float[np.ndarray, "n 2"]:
    """Returns the corners of a closed box [ms]."""
    return 1e3 * np.reshape(np.array([*truth, *truth[:1]], np.float64), (-1, 2))


def curve(series: str, points: Float[np.ndarray, "n 2"], name: str) -> list[Spec]:
    """Returns rows of a closed curve [ms]."""
    closed = np.concatenate([points, points[:1]])
    return [
        {"series": series, "x": x, "y": y, "curve": name, "order": order}
        for order, (x, y) in enumerate(closed)
    ]


def marks(
    best: np.ndarray,
    estimates: Mapping[str, Estimate],
    box: np.ndarray,
    ends: Float[np.ndarray, "2 2"],
) -> list[Spec]:
    """Returns rows of truth, paper's drone, line of equal sums, and optimum with its interval.

    Args:
        best: the optimum [ms].
        estimates: by parameter.
        box: see `box_of`.
        ends: of the picture [ms]; the paper's drone outside stands at its edge.
    """
    mark_rows: list[Spec] = [
        {"series": "truth", "x": x, "y": y, "curve": "truth", "order": order}
        for order, (x, y) in enumerate(box)
    ]
    inset = 0.015 * (ends[1] - ends[0])
    total, (lag, late) = float(best.sum()), of_the_paper().clip(ends[0] + inset, ends[1] - inset)
    mark_rows += [
        {"series": "total", "x": max(x, 0.0), "y": total - max(x, 0.0), "curve": "total"}
        | {"order": order}
        for order, x in enumerate((0.0, total))
    ]
    mark_rows.append({"series": "paper", "x": lag, "y": late, "mark": "the paper's drone"})
    centre = {"series": "identified", "x": best[0], "y": best[1]}
    for name, axis in zip(DELAYS, "xy", strict=True):
        low, high = (1e3 * end for end in estimates[name].interval)
        bar = {**centre, axis: low, f"{axis}2": high, "bar": axis}
        mark_rows.append(bar | {"x2": bar.get("x2", best[0]), "y2": bar.get("y2", best[1])})
    return [*mark_rows, {**centre, "mark": "identified"}]


def legend_of_marks(total: float, truth: bool, remark: str = "") -> list[Entry]:
    """Returns the entries of the legend for `marks`; a remark stands behind the paper's drone."""
    lag, late = map(text.plain_symbol, DELAYS)
    point_label = f"identified, {100 * LEVEL:.0f} % interval"
    return [
        *([Entry("truth", "green", "line", "truth")] if truth else []),
        Entry(f"paper's drone{remark}", "purple", "diamond", "paper"),
        Entry(point_label, "orange", "plus", "identified"),
        Entry(f"{lag} of speeding up + {late} = {total:.1f} ms", "soft", "dashed", "total"),
    ]


def plane(
    title: str,
    drawn: list[Spec],
    ends: Float[np.ndarray, "2 2"],
    legend: list[Entry],
) -> Figure:
    """Returns dots, curves and marks over motor time constant and latency.

    Args:
        title: of the figure.
        drawn: rows: those of `curve` and `marks`, and dots with `series`, `x` and `y` [ms].
        ends: least and largest delays in view [ms].
        legend: an entry for each series.
    """
    labels = {
        name: f"{words} {text.plain_symbol(name)} [ms]"
        for name, words in zip(DELAYS, ("motor time constant", "latency"), strict=True)
    }
    x, y = (
        charts.number(axis, label, **charts.within(low, high))
        for axis, label, (low, high) in zip("xy", labels.values(), ends.T, strict=True)
    )
    colours = {entry.series: entry.colour for entry in legend if entry.series}
    channels = {"x": x, "y": y, "color": charts.coloured(colours)}
    dots = " && ".join(f"!isValid(datum.{name})" for name in ("curve", "bar", "mark"))
    values = charts.tooltip({"x": labels[DELAYS[0]], "y": labels[DELAYS[1]]})
    named = charts.tooltip({"mark": "", "x": labels[DELAYS[0]], "y": labels[DELAYS[1]]})
    shapes = {"domain": ["paper", "identified"], "range": ["diamond", "cross"]}
    shape = {"field": "series", "type": "nominal", "scale": shapes}
    dashed = {"test": "datum.series === 'total'", "value": [7, 4]}
    dash = {"condition": dashed, "value": [1, 0]}
    curve_of = {"detail": {"field": "curve"}, "order": {"field": "order"}, "strokeDash": dash}
    dot = {"type": "point", "filled": True, "size": 24, "opacity": 0.7, "clip": True}
    dot |= {"stroke": charts.paint("line"), "strokeWidth": 0.6}
    line = {"type": "line", "clip": True, "strokeWidth": 1.6}
    bar = {"type": "rule", "strokeWidth": 2, "clip": True}
    mark = {"type": "point", "filled": True, "size": 130, "opacity": 1, "clip": True}
    ends_of = {"x2": {"field": "x2"}, "y2": {"field": "y2"}}
    layers = [
        charts.layer(dots, dot, **channels, tooltip=values),
        charts.layer("isValid(datum.curve)", line, **channels, **curve_of),
        charts.layer("isValid(datum.bar)", bar, **channels, **ends_of),
        charts.layer("isValid(datum.mark)", mark, **channels, shape=shape, tooltip=named),
    ]
    return Figure(title, [charts.panel(charts.rows(drawn), layers, height=380)], legend)
