"""Pictures of motor time constant and latency, and of how well flights tell them apart.

The loss landscape is of a replay's objective, with the evaluations that identification made; the
posterior is of a likelihood.
"""

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
import polars
from jaxtyping import Float
from markupsafe import Markup

from maidenflight.errors import InputError
from maidenflight.identification import surrogate
from maidenflight.identification.posterior import LEVEL
from maidenflight.parameters import crazyflie
from maidenflight.reporting import svg
from maidenflight.reporting.svg import Panel

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
    width: float = 720,
) -> str:
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
        width: of the picture [px].

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
    paper = np.array([1e3 * float(getattr(crazyflie(), name)) for name in DELAYS])
    box = 1e3 * np.reshape(np.array([*truth, *truth[:1]], np.float64), (-1, 2))
    fitted = surrogate.valley(
        rows.select(names).to_numpy(),
        rows["objective"].to_numpy(),
        [names.index(name) for name in DELAYS],
    )
    contours = (
        {level: 1e3 * fitted.contour(best / 1e3, level) for level in LEVELS} if fitted else {}
    )
    seen = np.concatenate([points[above <= LEVELS[-1]], [best, paper], box, *contours.values()])

    legend, tall = svg.legend(
        svg.TITLE, width, _legend(float(best.sum()), bool(known), bool(contours), bool(truth))
    )
    ranges = (svg.margin(seen[:, side], floor=0.0) for side in range(2))
    panel = Panel(56, svg.TITLE + tall + 8, width - 64, max(0.42 * width, 270), *ranges)
    content = [
        svg.evaluations(panel, points[chosen], colour) for colour, chosen in _classes(above).items()
    ]
    content.append(svg.line(panel, best.sum() - np.array(panel.y), panel.y, "thin dashed", "soft"))
    content += [_contour(panel, level, curve) for level, curve in contours.items()]
    sides = np.array([1e3 * np.array(known[name].interval) for name in DELAYS]).T if known else None
    content.append(_marked(panel, best, paper, box, sides))
    note, deep = svg.paragraph(
        0, panel.top + panel.height + 46, width, _fit_note(fitted, len(names) - 2)
    )
    axes = svg.axes(
        panel,
        _label("motor time constant", DELAYS[0]),
        _label("latency", DELAYS[1]),
        room=42,
    )
    parts = [legend, axes[0], svg.framed(panel, [axes[1], *content], "delays"), note]
    return svg.picture(
        width, panel.top + panel.height + 50 + deep, "Loss landscape of the delays", parts
    )


def _label(words: str, name: str) -> Markup:
    return Markup("{} {} [ms]").format(words, svg.symbol(name))


def _classes(above: Float[np.ndarray, "n"]) -> dict[str, np.ndarray]:
    """Evaluations by their colour, which shows how far they are above the best."""
    return {"high": above > 10, "middle": (above > NAMED) & (above <= 10), "low": above <= NAMED}


def _legend(
    total: float, known: bool, contours: bool, truth: bool
) -> list[tuple[str, str | Markup]]:
    dots = {"low": f"within {NAMED:g} % of the best", "middle": "within 10 %", "high": "worse"}
    spot = Panel(0, 0, 24, 12, (0, 2), (0, 2))
    entries = [
        (svg.evaluations(spot, np.ones((1, 2)), colour), name) for colour, name in dots.items()
    ]
    if contours:
        others = " and ".join(f"{level:g} %" for level in LEVELS if level != NAMED)
        entries.append(
            (svg.stroke("M0 6H24", "line", "blue"), f"{NAMED:g} % above the optimum, fitted")
        )
        entries.append((svg.stroke("M0 6H24", "thin", "blue"), others))
    return [*entries, *_marks(total, known, truth)]


def _marks(
    total: float, known: bool, truth: bool, remark: str = ""
) -> list[tuple[str, str | Markup]]:
    """Legend of what is in both pictures."""
    return [
        *([(svg.stroke("M0 6H24", "line", "green"), "truth")] if truth else []),
        (svg.diamond(12, 6, "purple"), f"paper's drone{remark}"),
        (
            svg.cross(12, 6, "orange"),
            f"identified, {100 * LEVEL:.0f} % interval" if known else "best evaluation",
        ),
        (
            svg.stroke("M0 6H24", "thin dashed", "soft"),
            Markup("{} + {} = {} ms").format(*map(svg.symbol, DELAYS), f"{total:.1f}"),
        ),
    ]


def _contour(panel: Panel, level: float, curve: Float[np.ndarray, "n 2"]) -> str:
    """A closed curve; only one has its name beside it, for the others lie too close on a phone."""
    closed = np.concatenate([curve, curve[:1]])
    if level != NAMED:
        return svg.line(panel, closed[:, 0], closed[:, 1], "thin", "blue")
    across, down = panel.at(*curve[np.argmin(curve[:, 0])])
    return svg.line(panel, closed[:, 0], closed[:, 1], "", "blue") + svg.text(
        across - 4, down + 4, f"{level:g} %", "small halo", "end"
    )


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
    width: float = 720,
) -> str:
    """Posterior samples of motor time constant and latency, and ellipses that hold shares of them.

    Args:
        draws: N values by parameter [SI]; an entry of each belongs together.
        estimates: optimum and interval by parameter.
        truth: what is true of a virtual drone: corners of a box, motor time constant and latency
            [s].
        width: of the picture [px].

    Raises:
        InputError: draws or estimates of one of the two parameters are missing.
    """
    if not set(DELAYS) <= set(draws) or not set(DELAYS) <= set(estimates):
        raise InputError(
            f"no posterior to draw: expected draws and estimates of {' and '.join(DELAYS)}."
        )
    points = 1e3 * np.array([draws[name] for name in DELAYS], np.float64).T
    best = np.array([1e3 * estimates[name].value for name in DELAYS])
    paper = np.array([1e3 * float(getattr(crazyflie(), name)) for name in DELAYS])
    box = 1e3 * np.reshape(np.array([*truth, *truth[:1]], np.float64), (-1, 2))
    curves = {share: _ellipse(points, share) for share in SHARES}
    sides = np.array([1e3 * np.array(estimates[name].interval) for name in DELAYS]).T
    near = np.concatenate([points, sides, [best], box, *curves.values()])
    middle, reach = (near.max(axis=0) + near.min(axis=0)) / 2, np.ptp(near, axis=0)
    # The samples are to be seen, though the paper's drone may be far from it.
    inside = bool((np.abs(paper - middle) < 1.5 * reach).all())
    seen = np.concatenate([near, [paper]]) if inside else near
    spot = Panel(0, 0, 24, 12, (0, 2), (0, 2))
    entries = [(svg.dots(spot, [1], [1], "fine", "blue"), "posterior sample")]
    entries.append((svg.stroke("M0 6H24", "line", "blue"), f"{100 * SHARES[1]:.0f} % of them"))
    entries.append((svg.stroke("M0 6H24", "thin", "blue"), f"{100 * SHARES[0]:.0f} %"))
    legend, tall = svg.legend(
        svg.TITLE,
        width,
        [
            *entries,
            *_marks(
                float(best.sum()),
                True,
                bool(truth),
                "" if inside else f" ({paper[0]:g} ms, {paper[1]:g} ms) is far outside",
            ),
        ],
    )
    ranges = (svg.margin(seen[:, side], floor=0.0) for side in range(2))
    panel = Panel(56, svg.TITLE + tall + 8, width - 64, max(0.36 * width, 270), *ranges)
    content = [svg.dots(panel, points[:, 0], points[:, 1], "fine", "blue")]
    content.append(svg.line(panel, best.sum() - np.array(panel.y), panel.y, "thin dashed", "soft"))
    content += [
        svg.line(panel, curve[:, 0], curve[:, 1], "" if share == SHARES[1] else "thin", "blue")
        for share, curve in curves.items()
    ]
    content.append(_marked(panel, best, paper, box, sides))
    outside, grid = svg.axes(
        panel,
        _label("motor time constant", DELAYS[0]),
        _label("latency", DELAYS[1]),
        room=42,
    )
    parts = [legend, outside, svg.framed(panel, [grid, *content], "delays")]
    return svg.picture(width, panel.top + panel.height + 46, "Posterior of the delays", parts)


def _ellipse(points: Float[np.ndarray, "n 2"], share: float) -> Float[np.ndarray, "m 2"]:
    """The ellipse that holds a share of the normal distribution of the points."""
    turn = np.linspace(0, 2 * np.pi, 97)
    spread, axes = np.linalg.eigh(
        np.atleast_2d(np.cov(points.T)) if len(points) > 2 else np.zeros((2, 2))
    )
    radius = np.sqrt(-2 * np.log(1 - share) * np.maximum(spread, 0.0))
    return points.mean(axis=0) + np.stack([np.cos(turn), np.sin(turn)], axis=1) * radius @ axes.T


def _marked(
    panel: Panel, best: np.ndarray, paper: np.ndarray, box: np.ndarray, sides: np.ndarray | None
) -> str:
    """Truth, the paper's drone and the optimum with its interval, the later over the earlier."""
    drawn = svg.line(panel, box[:, 0], box[:, 1], "", "green") + svg.diamond(
        *panel.at(*paper), "purple"
    )
    if sides is not None:
        drawn += svg.line(panel, sides[:, 0], [best[1]] * 2, "", "orange") + svg.line(
            panel, [best[0]] * 2, sides[:, 1], "", "orange"
        )
    return drawn + svg.cross(*panel.at(*best), "orange")
