"""Damped Gauss-Newton steps in the unit cube: the loop that both objectives are minimised by.

An objective gives two models of its curvature. `curvature` is the one of Gauss and Newton, which
leads to the optimum in few steps. `majorant` is never too flat. Damping blends from the first to
the second, and then scales the second.

Source: Marquardt 1963, An algorithm for least-squares estimation of nonlinear parameters; the
blend is ours.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from maidenflight.identification.unknowns import Box

INSIDE = 1e-7
"""Distance from the box's faces at which slopes are taken: on a face, as where the latency is zero,
a slope can be one-sided. Harmless within a factor of 1.4 (paper/identification/constants.py)."""

Limits = Callable[
    [Float[np.ndarray, "d"], Float[np.ndarray, "d"]],
    tuple[Float[np.ndarray, "d"], Float[np.ndarray, "d"]],
]
"""(point, point before it) to the lowest and highest coordinates that a step may reach."""


class NormalEquations(NamedTuple):
    """An objective around a point: its slope, and two models of how it curves.

    Per unit of each of d parameters.
    """

    loss: float
    """The objective's value."""
    gradient: Float[np.ndarray, "d"]
    """Its gradient."""
    curvature: Float[np.ndarray, "d d"]
    """Gauss-Newton's second derivative, best near an optimum."""
    majorant: Float[np.ndarray, "d d"]
    """A curvature that is never too flat where residuals are linear in the parameters."""


@dataclass(frozen=True)
class Rules:
    """When to stop, and how far to trust the next step."""

    fewest: int
    """Steps before a small one may be the last."""
    most: int
    """Steps at most."""
    small_step: float = 0.0
    """Step, in each dimension as a share of the box, below which it is not taken."""
    small_gain: float = 0.0
    """Gain below which a step is the last. One that promises less than a quarter of it is not
    taken: to confirm it costs as much as any."""
    easing: float = 4.0
    """What the damping is divided by after a step down."""
    firmness: float = 0.5
    """Damping after a failed step, at least."""


class Descent(NamedTuple):
    """Where a descent ended."""

    point: Float[np.ndarray, "d"]
    """The lowest point."""
    equations: NormalEquations
    """Derivatives there."""
    ahead: Float[np.ndarray, "d"]
    """Where the next step would lead."""
    low: Float[np.ndarray, "d"]
    """Lowest coordinates that it may reach."""
    high: Float[np.ndarray, "d"]
    """Highest coordinates that it may reach."""


def descend(
    equations: Callable[[Float[np.ndarray, "d"]], NormalEquations],
    point: Float[np.ndarray, "d"],
    rules: Rules,
    limits: Limits,
    damping: float,
    curvature: Float[np.ndarray, "d d"] | None = None,
) -> Descent:
    """Returns steps down until a step is small.

    How the gradient changes over a step corrects the curvature.

    Args:
        equations: point to the objective with derivatives.
        point: where to begin.
        rules: when to stop.
        limits: how far a step may lead. One that ends at a limit within the cube has crossed a
            kink, where the slope jumps; that jump does not correct the curvature.
        damping: of the first step.
        curvature: found on other data, if any. It stays, and is corrected only by how the gradient
            changes: it holds what Gauss-Newton's leaves out.
    """
    came, here = point, equations(point)
    if curvature is not None:
        here = here._replace(curvature=curvature)
    number = -1
    while True:
        number += 1
        low, high = limits(point, came)
        there = step(here, point, damping, low, high)
        promise = here.gradient @ (point - there)
        small = np.abs(there - point).max() < rules.small_step
        idle = damping < 1 and promise < rules.small_gain / 4
        if (number >= rules.fewest and (small or idle)) or number >= rules.most:
            break
        ahead = equations(there)
        gain = here.loss - ahead.loss
        if gain > 0:
            if curvature is not None:
                ahead = ahead._replace(curvature=here.curvature)
            crossed = ((there == low) & (low > INSIDE)) | ((there == high) & (high < 1 - INSIDE))
            if not crossed.any():
                ahead = corrected(ahead, here, there - point)
            came, point, here, damping = point, there, ahead, damping / rules.easing
        else:
            damping = max(4 * damping, rules.firmness)
        if (gain if gain > 0 else promise) < rules.small_gain:
            break
    return Descent(point, here, there, low, high)


def step(
    equations: NormalEquations,
    point: Float[np.ndarray, "d"],
    damping: float,
    low: Float[np.ndarray, "d"],
    high: Float[np.ndarray, "d"],
) -> Float[np.ndarray, "d"]:
    """Returns the point between `low` and `high` at which the damped quadratic model is lowest."""
    blend = min(damping, 1.0)
    matrix = (1 - blend) * equations.curvature + blend * max(damping, 1.0) * equations.majorant
    # A parameter that moves nothing has no curvature; it stays where it is.
    matrix = matrix + np.diag(1e-6 * np.diag(equations.majorant) + 1e-9)
    values, vectors = np.linalg.eigh(matrix)
    root = np.sqrt(np.maximum(values, 1e-9 * values.max()))
    shift = scipy.optimize.lsq_linear(
        root[:, None] * vectors.T,
        -(vectors.T @ equations.gradient) / root,
        bounds=(low - point - 1e-12, high - point + 1e-12),
        method="bvls",
    ).x
    return np.clip(point + shift, low, high)


def corrected(
    ahead: NormalEquations, here: NormalEquations, shift: Float[np.ndarray, "d"]
) -> NormalEquations:
    """Returns the curvature that explains how the gradient changed over the last step.

    Source: the update of Broyden, Fletcher, Goldfarb and Shanno (Nocedal and Wright 2006, Numerical
    optimization, eq. 6.19).
    """
    change = ahead.gradient - here.gradient
    along, explained = ahead.curvature @ shift, float(shift @ change)
    if explained <= 0.1 * float(shift @ along):
        return ahead
    update = np.outer(change, change) / explained - np.outer(along, along) / float(shift @ along)
    return ahead._replace(curvature=ahead.curvature + update)


def in_unit_cube(
    equations: NormalEquations, box: Box, point: Float[np.ndarray, "d"]
) -> NormalEquations:
    """Converts normal equations from SI units to units of the search's cube."""
    scale = box.slope(point)
    square = np.outer(scale, scale)
    return NormalEquations(
        equations.loss,
        equations.gradient * scale,
        equations.curvature * square,
        equations.majorant * square,
    )


def inside(
    point: Float[np.ndarray, "d"], _: Float[np.ndarray, "d"]
) -> tuple[Float[np.ndarray, "d"], Float[np.ndarray, "d"]]:
    """Limits of a step that are the whole cube, but for its faces."""
    return np.full(len(point), INSIDE), np.full(len(point), 1 - INSIDE)
