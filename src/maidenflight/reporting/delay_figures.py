"""Pictures of motor time constant and latency, and of how well flights tell them apart.

The loss landscape is of a replay's objective, with the evaluations that identification made; the
posterior is of a likelihood.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import polars
from jaxtyping import Float

from maidenflight.errors import InputError
from maidenflight.identification.outcome import surrogate
from maidenflight.identification.outcome.posterior import LEVEL
from maidenflight.parameters import crazyflie
from maidenflight.reporting import charts, text
from maidenflight.reporting.charts import Entry, Figure, Spec

LEVELS = (0.3, 1.0, 3.0)
"""Contours of the loss landscape, above the optimum [%]."""
NAMED = 1.0
"""The contour that is drawn thick, with its name beside it [%]."""
DELAYS = ("motor_time_constant", "latency")


class Estimated(Protocol):
    """An identified parameter, SI units."""

    @property
    def value(self) -> float:
        """Where the objective is lowest."""
        ...

    @property
    def interval(self) -> tuple[float, float]:
        """95 %."""
        ...


def loss_landscape(
    search: polars.DataFrame,
    estimates: Mapping[str, Estimated] | None = None,
    truth: Sequence[tuple[float, float]] = (),
) -> tuple[Figure, str]:
    """The objective over motor time constant and latency, with all other parameters at their best.

    Dots are evaluations, each with the other parameters that it happens to have. Contours are those
    of a quadratic fitted to the evaluations near the best and minimised over the other parameters.
    Where none fits there are no contours, and the note says so.

    Args:
        search: a row an evaluation: values of the parameters [SI] and `objective`, as in
            identification.csv and `Identification.search` of a replay.
        estimates: optimum and interval by parameter; the best evaluation, without an interval,
            unless given.
        truth: what is true of a virtual drone: corners of a box, motor time constant and latency
            [s].

    Returns:
        The picture, and a note on the contours.

    Raises:
        InputError: no finite objective, one that is not above zero, or no column of one of the two
            parameters.
    """
    missing = [name for name in (*DELAYS, "objective") if name not in search.columns]
    rows = (
        search.clear()
        if missing
        else search.filter(polars.col("objective").is_finite()).sort("objective", descending=True)
    )
    if rows.height == 0:
        raise InputError(
            "no loss landscape to draw: "
            f"{f'no column {missing[0]}' if missing else 'no evaluation has a finite objective'}."
        )
    if rows["objective"][-1] <= 0:
        raise InputError(
            "no loss landscape to draw: objectives below zero, of which a share means nothing. Are "
            "they likelihoods? Draw `delay_posterior`."
        )
    names = [name for name in rows.columns if name not in ("trial", "objective")]
    above = (rows["objective"].to_numpy() / rows["objective"].min() - 1) * 100
    points = rows.select(DELAYS).to_numpy() * 1e3
    known = estimates if estimates is not None and set(DELAYS) <= set(estimates) else {}
    best = np.array([known[name].value * 1e3 for name in DELAYS]) if known else points[-1]
    fitted = surrogate.valley(
        rows.select(names).to_numpy(),
        rows["objective"].to_numpy(),
        [names.index(name) for name in DELAYS],
    )
    contours = (
        {level: 1e3 * fitted.contour(best / 1e3, level) for level in LEVELS} if fitted else {}
    )
    box = _corners(truth)
    seen = np.concatenate(
        [points[above <= LEVELS[-1]], [best, _of_the_paper()], box, *contours.values()]
    )
    drawn: list[Spec] = [
        {"series": series, "x": x, "y": y, "told": f"{higher:.2g} % above the best"}
        for series, chosen in _classes(above).items()
        for (x, y), higher in zip(points[chosen], above[chosen], strict=True)
    ]
    for level, curve in contours.items():
        drawn += _curve("contours", curve, f"{level:g} %")
    drawn += _marks(best, known, box)
    legend = [
        Entry(f"within {NAMED:g} % of the best", "low", "dot", "low"),
        Entry("within 10 %", "middle", "dot", "middle"),
        Entry("worse", "high", "dot", "high"),
    ]
    if contours:
        levels = ", ".join(f"{level:g} %" for level in contours)
        legend.append(Entry(f"{levels} above the optimum, fitted", "blue", "line", "contours"))
    legend += _legend_of_marks(float(best.sum()), bool(known), bool(truth))
    figure = _figure("Loss landscape of the delays", drawn, seen, legend, {"told": "objective"})
    return figure, _fit_note(fitted, len(names) - 2)


def _classes(above: Float[np.ndarray, "n"]) -> dict[str, np.ndarray]:
    """Evaluations by their colour, which shows how far they are above the best."""
    return {"high": above > 10, "middle": (above > NAMED) & (above <= 10), "low": above <= NAMED}


def _fit_note(fitted: surrogate.Valley | None, others: int) -> str:
    if fitted is None:
        return "No contours: too few evaluations near the best, or no quadratic fits them."
    best = (
        f", minimised over the other {'parameter' if others == 1 else f'{others} parameters'}"
        if others
        else ""
    )
    note = (
        f"Contours: a quadratic{best}, fitted to the {fitted.evaluations} evaluations within "
        f"{fitted.reach:g} % of the best, which it"
        f" misses by {fitted.error:.2g} % (rms). Each dot has its own values of the other "
        "parameters, so one inside a contour can be worse."
    )
    return note.replace(" %", "\N{NO-BREAK SPACE}%")


SHARES = (0.5, 0.95)
"""Shares of the samples that the ellipses hold."""


def delay_posterior(
    draws: Mapping[str, Float[np.ndarray, "N"]],
    estimates: Mapping[str, Estimated],
    truth: Sequence[tuple[float, float]] = (),
) -> Figure:
    """Posterior samples of motor time constant and latency, and ellipses that hold shares of them.

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
    box, paper = _corners(truth), _of_the_paper()
    curves = {share: _ellipse(points, share) for share in SHARES}
    sides = np.array([1e3 * np.array(estimates[name].interval) for name in DELAYS]).T
    near = np.concatenate([points, sides, [best], box, *curves.values()])
    middle, reach = (near.max(axis=0) + near.min(axis=0)) / 2, np.ptp(near, axis=0)
    # The samples are to be seen, though the paper's drone may be far from it.
    inside = bool((np.abs(paper - middle) < 1.5 * reach).all())
    seen = np.concatenate([near, [paper]]) if inside else near
    drawn: list[Spec] = [{"series": "sample", "x": x, "y": y} for x, y in points]
    for share, curve in curves.items():
        drawn += _curve("ellipses", curve, f"{100 * share:.0f} %")
    drawn += _marks(best, estimates, box)
    shares = " and ".join(f"{100 * share:.0f} %" for share in SHARES)
    far = "" if inside else f" ({paper[0]:g} ms, {paper[1]:g} ms) is far outside"
    legend = [
        Entry("posterior sample", "blue", "dot", "sample"),
        Entry(f"{shares} of them", "blue", "line", "ellipses"),
        *_legend_of_marks(float(best.sum()), True, bool(truth), far),
    ]
    return _figure("Posterior of the delays", drawn, seen, legend, {})


def _ellipse(points: Float[np.ndarray, "n 2"], share: float) -> Float[np.ndarray, "m 2"]:
    """The ellipse that holds a share of the normal distribution of the points."""
    turn = np.linspace(0, 2 * np.pi, 97)
    spread, axes = np.linalg.eigh(
        np.atleast_2d(np.cov(points.T)) if len(points) > 2 else np.zeros((2, 2))
    )
    radius = np.sqrt(-2 * np.log(1 - share) * np.maximum(spread, 0.0))
    return points.mean(axis=0) + np.stack([np.cos(turn), np.sin(turn)], axis=1) * radius @ axes.T


def _of_the_paper() -> Float[np.ndarray, "2"]:
    return np.array([1e3 * float(getattr(crazyflie(), name)) for name in DELAYS])


def _corners(truth: Sequence[tuple[float, float]]) -> Float[np.ndarray, "n 2"]:
    """A closed box [ms]."""
    return 1e3 * np.reshape(np.array([*truth, *truth[:1]], np.float64), (-1, 2))


def _curve(series: str, curve: Float[np.ndarray, "n 2"], name: str) -> list[Spec]:
    """A closed curve."""
    closed = np.concatenate([curve, curve[:1]])
    return [
        {"series": series, "x": x, "y": y, "curve": name, "order": order}
        for order, (x, y) in enumerate(closed)
    ]


def _marks(best: np.ndarray, known: Mapping[str, Estimated], box: np.ndarray) -> list[Spec]:
    """Truth, the paper's drone, the line of equal sums, and the optimum with its interval."""
    marks = [
        {"series": "truth", "x": x, "y": y, "curve": "truth", "order": order}
        for order, (x, y) in enumerate(box)
    ]
    total, (lag, late) = float(best.sum()), _of_the_paper()
    marks += [
        {"series": "total", "x": max(x, 0.0), "y": total - max(x, 0.0), "curve": "total"}
        | {"order": order}
        for order, x in enumerate((0.0, total))
    ]
    marks.append({"series": "paper", "x": lag, "y": late, "mark": "the paper's drone"})
    centre = {"series": "identified", "x": best[0], "y": best[1]}
    for name, axis in zip(DELAYS, "xy", strict=True):
        if known:
            low, high = (1e3 * end for end in known[name].interval)
            bar = {**centre, axis: low, f"{axis}2": high, "bar": axis}
            marks.append(bar | {"x2": bar.get("x2", best[0]), "y2": bar.get("y2", best[1])})
    return [*marks, {**centre, "mark": "identified" if known else "best evaluation"}]


def _legend_of_marks(total: float, known: bool, truth: bool, remark: str = "") -> list[Entry]:
    lag, late = map(text.plain_symbol, DELAYS)
    found = f"identified, {100 * LEVEL:.0f} % interval" if known else "best evaluation"
    return [
        *([Entry("truth", "green", "line", "truth")] if truth else []),
        Entry(f"paper's drone{remark}", "purple", "diamond", "paper"),
        Entry(found, "orange", "plus", "identified"),
        Entry(f"{lag} + {late} = {total:.1f} ms", "soft", "dashed", "total"),
    ]


_COLOURS = {
    **{name: name for name in ("high", "middle", "low")},
    **{"sample": "blue", "contours": "blue", "ellipses": "blue", "truth": "green"},
    **{"total": "soft", "paper": "purple", "identified": "orange"},
}
"""Of each series."""


def _figure(
    title: str,
    drawn: list[Spec],
    seen: Float[np.ndarray, "n 2"],
    legend: list[Entry],
    told: Mapping[str, str],
) -> Figure:
    ends = [
        (min(0.98 * low, low - 0.5), max(1.02 * high, high + 0.5))
        for low, high in zip(np.maximum(seen.min(axis=0), 0.0), seen.max(axis=0), strict=True)
    ]
    labels = {
        name: f"{words} {text.plain_symbol(name)} [ms]"
        for name, words in zip(DELAYS, ("motor time constant", "latency"), strict=True)
    }
    x, y = (
        charts.number(axis, label, **charts.within(max(low, 0.0), high))
        for axis, label, (low, high) in zip("xy", labels.values(), ends, strict=True)
    )
    place = {"x": x, "y": y, "color": charts.coloured(_COLOURS)}
    dots = {"high", "middle", "low", "sample"} & {row["series"] for row in drawn}
    values = charts.tooltip({"x": labels[DELAYS[0]], "y": labels[DELAYS[1]], **told})
    named = charts.tooltip({"mark": "", "x": labels[DELAYS[0]], "y": labels[DELAYS[1]]})
    shape = {
        "field": "series",
        "type": "nominal",
        "scale": {"domain": ["paper", "identified"], "range": ["diamond", "cross"]},
    }
    curved: dict[str, Any] = {**place, "detail": {"field": "curve"}, "order": {"field": "order"}}
    layers: list[Spec] = [
        {
            "transform": [{"filter": {"field": "series", "oneOf": sorted(dots)}}],
            "mark": {
                "type": "point",
                "filled": True,
                "size": 24,
                "opacity": 0.7,
                "clip": True,
                "stroke": charts.paint("line"),
                "strokeWidth": 0.6,
            },
            "encoding": {**place, "tooltip": values},
        },
        {
            "transform": [{"filter": "isValid(datum.curve)"}],
            "mark": {"type": "line", "clip": True, "strokeWidth": 1.6},
            "encoding": {
                **curved,
                "strokeDash": {
                    "condition": {"test": "datum.series === 'total'", "value": [7, 4]},
                    "value": [1, 0],
                },
            },
        },
        {
            "transform": [{"filter": "isValid(datum.bar)"}],
            "mark": {"type": "rule", "strokeWidth": 2, "clip": True},
            "encoding": {**place, "x2": {"field": "x2"}, "y2": {"field": "y2"}},
        },
        {
            "transform": [{"filter": "isValid(datum.mark)"}],
            "mark": {"type": "point", "filled": True, "size": 130, "opacity": 1, "clip": True},
            "encoding": {**place, "shape": shape, "tooltip": named},
        },
    ]
    return Figure(title, [charts.panel(charts.rows(drawn), layers, height=380)], legend)
