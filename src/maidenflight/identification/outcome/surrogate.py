"""A quadratic model of the objective around its optimum, in two parameters.

All other parameters are at their best.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from maidenflight.identification.outcome.posterior import basis

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
