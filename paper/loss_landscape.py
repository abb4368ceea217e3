"""The loss landscape of a replay: its objective over motor time constant and latency.

    python paper/loss_landscape.py run/identification.csv --drone run/drone.toml -o landscape.svg

Dots are the evaluations that `maidenflight identify --objective replay` wrote, contours those of a
quadratic fitted around the best of them, with all other parameters at their best.
"""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars
from jaxtyping import Bool, Float

from maidenflight import results
from maidenflight.errors import InputError
from maidenflight.identification import drone_file
from maidenflight.identification.drone_file import Estimate
from maidenflight.identification.outcome.posterior import basis
from maidenflight.reporting.figures import delays, picture
from maidenflight.reporting.figures.charts import Entry, Figure, Spec
from maidenflight.reporting.figures.delays import DELAYS

LEVELS = (0.3, 1.0, 3.0)
"""Contours of the loss landscape, above the optimum [%]."""
NAMED = 1.0
"""Up to here evaluations are dark [% above the best]."""
REACHES = (3.0, 10.0)
"""How far above the best evaluation a quadratic may have to reach, to rest on enough of them
[%]."""
WORST = 0.25
"""Root mean square error above which a quadratic cannot show where the objective is 1 % above its
best [%]."""
_FLAT = 1e-4
"""Curvature, in percent over the square of the evaluations' spread, that counts as none."""
_TURN = np.linspace(0.0, 2 * np.pi, 121)[:-1]


class Valley(NamedTuple):
    """A quadratic in two parameters: level = lowest + (x - centre)^T curvature (x - centre) / 2."""

    centre: Float[np.ndarray, "2"]
    curvature: Float[np.ndarray, "2 2"]
    lowest: float
    """[%] above the best evaluation."""
    reach: float
    """It was fitted to the evaluations up to this far above the best [%]."""
    evaluations: int
    """How many these are."""
    error: float
    """Root mean square of what it misses of them [%]."""

    def level(self, place: Float[np.ndarray, "2"]) -> float:
        """The objective at a place [% above the best evaluation]."""
        return float(
            self.lowest + (place - self.centre) @ self.curvature @ (place - self.centre) / 2
        )

    def contour(self, optimum: Float[np.ndarray, "2"], above: float) -> Float[np.ndarray, "120 2"]:
        """The ellipse on which the objective is `above` [%] higher than at the optimum."""
        rise = self.level(optimum) - self.lowest + above
        values, vectors = np.linalg.eigh(self.curvature)
        axes = vectors * np.sqrt(2 * rise / values)
        return self.centre + np.stack([np.cos(_TURN), np.sin(_TURN)], axis=1) @ axes.T


def valley(
    points: Float[np.ndarray, "n d"], objective: Float[np.ndarray, "n"], free: Sequence[int]
) -> Valley | None:
    """Fits a quadratic to evaluations of an objective and minimises it over all parameters but two.

    Args:
        points: values of the d parameters.
        objective: finite and positive.
        free: the columns of the two.

    Returns:
        The valley; `None` where the evaluations do not suffice: too few of them near the best, one
        that a quadratic does not fit, or no minimum.
    """
    above = (objective / objective.min() - 1) * 100
    for reach in REACHES:
        near = above <= reach
        spread = np.ptp(points[near], axis=0) > 1e-9 * np.abs(points[near]).max(axis=0)
        terms = (spread.sum() + 1) * (spread.sum() + 2) // 2
        if spread[list(free)].all() and near.sum() >= 2 * terms:
            return _fit(points[near], above[near], list(free), spread, reach)
    return None


def _fit(
    points: Float[np.ndarray, "n d"],
    above: Float[np.ndarray, "n"],
    free: list[int],
    spread: Bool[np.ndarray, "d"],
    reach: float,
) -> Valley | None:
    order = [*free, *(place for place in np.flatnonzero(spread) if place not in free)]
    middle, scale = points[:, order].mean(axis=0), points[:, order].std(axis=0)
    matrix = basis((points[:, order] - middle) / scale)
    coefficients = np.linalg.lstsq(matrix, above, rcond=None)[0]
    error = float(np.sqrt(np.mean((matrix @ coefficients - above) ** 2)))
    d = len(order)
    slope, curvature = coefficients[1 : d + 1], np.zeros((d, d))
    curvature[np.triu_indices(d)] = coefficients[d + 1 :]
    curvature += curvature.T
    if error > WORST or np.linalg.eigvalsh(curvature)[0] <= _FLAT:
        return None
    place = -np.linalg.solve(curvature, slope)
    # All others at their best: the Schur complement of their part of the curvature.
    across = (
        curvature[:2, 2:] @ np.linalg.solve(curvature[2:, 2:], curvature[2:, :2]) if d > 2 else 0.0
    )
    return Valley(
        centre=(middle + scale * place)[:2],
        curvature=(curvature[:2, :2] - across) / np.outer(scale[:2], scale[:2]),
        lowest=float(coefficients[0] + slope @ place / 2),
        reach=reach,
        evaluations=len(above),
        error=error,
    )


def loss_landscape(
    search: polars.DataFrame,
    estimates: Mapping[str, Estimate] | None = None,
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
    fitted = valley(
        rows.select(names).to_numpy(),
        rows["objective"].to_numpy(),
        [names.index(name) for name in DELAYS],
    )
    contours = (
        {level: 1e3 * fitted.contour(best / 1e3, level) for level in LEVELS} if fitted else {}
    )
    box = delays.box_of(truth)
    in_view = np.concatenate(
        [points[above <= LEVELS[-1]], [best, delays.of_the_paper()], box, *contours.values()]
    )
    drawn: list[Spec] = [
        {"series": series, "x": x, "y": y, "told": f"{higher:.2g} % above the best"}
        for series, chosen in _classes(above).items()
        for (x, y), higher in zip(points[chosen], above[chosen], strict=True)
    ]
    for level, curve in contours.items():
        drawn += delays.curve("contours", curve, f"{level:g} %")
    drawn += delays.marks(best, known, box)
    legend = [
        Entry(f"within {NAMED:g} % of the best", "low", "dot", "low"),
        Entry("within 10 %", "middle", "dot", "middle"),
        Entry("worse", "high", "dot", "high"),
    ]
    if contours:
        levels = ", ".join(f"{level:g} %" for level in contours)
        legend.append(Entry(f"{levels} above the optimum, fitted", "blue", "line", "contours"))
    legend += delays.legend_of_marks(float(best.sum()), bool(known), bool(truth))
    figure = delays.plane(
        "Loss landscape of the delays", drawn, in_view, legend, {"told": "objective"}
    )
    return figure, _fit_note(fitted, len(names) - 2)


def _classes(above: Float[np.ndarray, "n"]) -> dict[str, np.ndarray]:
    """Evaluations by their colour, which shows how far they are above the best."""
    return {"high": above > 10, "middle": (above > NAMED) & (above <= 10), "low": above <= NAMED}


def _fit_note(fitted: Valley | None, others: int) -> str:
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


def main(arguments: Sequence[str] | None = None) -> None:
    """Reads, draws and says how the contours came about."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("evaluations", type=Path, help="identification.csv of a replay")
    parser.add_argument("--drone", type=Path, help="the drone file, for optimum and intervals")
    parser.add_argument("-o", "--output", type=Path, required=True, help="the SVG file")
    options = parser.parse_args(arguments)
    rows = polars.read_csv(options.evaluations, comment_prefix="#")
    known = None if options.drone is None else drone_file.read(options.drone).estimates
    figure, note = loss_landscape(rows, known)
    results.write(options.output, picture.svg(figure, 560))
    print(note)


if __name__ == "__main__":
    main()
