"""Identification by gradients through the simulator: Gauss-Newton steps, damped as far as the
objective asks for it.

The objective is a sum of absolute values and of norms, so its curvature lies in their kinks. Two
models of it are blended. The one of Gauss and Newton, with rounded kinks, leads to the optimum in
few steps. The one of iteratively reweighted least squares is never too flat where residuals are
linear in the parameters, and is right where a model fits without error. Damping blends from the
first to the second, and then scales the second.

Windows overlap, so few of them tell nearly where the optimum is: a far start comes near on some
dozens, then on every fifth, and only the last steps see all. The curvature that they teach is
carried along.

Where a command arrives just when a physics step begins, the objective has a kink in the latency,
and its optimum likes to lie in one. So no step looks across a kink. It ends just behind it; what
the slope says there tells whether to go on or back.
"""

from collections.abc import Callable, Sequence
from itertools import count
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

from maidenflight.identification.bayesian import Box
from maidenflight.identification.objective import NormalEquations

FAR = 64
"""Windows, about, of which the way from a random start is found."""
MIDDLE = 5
"""Then each so manieth window, which overlaps the next one used by little or nothing."""
_FAR_STEPS, _MIDDLE_STEPS = 20, 8
"""Most steps on those windows."""
_FAR_SMALL, _MIDDLE_SMALL, _SMALL = 1e-2, 6e-3, 2.5e-3
"""Step, as a share of the box, that is the last: on few windows, where the optimum of all is not to
be had, and on all."""
_FEWEST = 2
"""Steps on all windows, however small: a step says how far the optimum is only once the curvature
is that of all."""
INSIDE = 1e-7
"""Distance from the box's faces at which slopes are taken: on a face, as where there is no latency
at all, one can be one-sided."""
_BEHIND = 1e-6
"""Distance behind a kink at which a step across it ends."""


def kinks(box: Box, time_step: float) -> list[Float[np.ndarray, "k"]]:
    """Where in the search's cube the objective's slope jumps, for each dimension: at latencies that
    are whole physics steps.

    A held command acts on a physics step by its mean over it. That is linear in the latency, until
    the command arrives in another step.
    """
    found = []
    for name, low, high in zip(box.names, box.lower, box.upper, strict=True):
        steps = (
            np.arange(np.ceil(low / time_step), np.floor(high / time_step) + 1)
            if name == "latency"
            else np.empty(0)
        )
        found.append((steps * time_step - low) / (high - low))
    return found


def in_unit_cube(
    equations: NormalEquations, box: Box, point: Float[np.ndarray, "d"]
) -> NormalEquations:
    """Normal equations per unit of the search's cube instead of per SI unit of the parameters."""
    scale = box.slope(point)
    square = np.outer(scale, scale)
    return NormalEquations(
        equations.loss,
        equations.gradient * scale,
        equations.curvature * square,
        equations.majorant * square,
    )


def minimise(
    objective: Callable[[Float[np.ndarray, "d"]], float],
    equations: Callable[[Float[np.ndarray, "d"], int], NormalEquations],
    size: int,
    kinks: Sequence[Float[np.ndarray, "k"]],
    evaluations: int,
    generator: np.random.Generator,
    on_evaluation: Callable[[], None] | None = None,
) -> tuple[Float[np.ndarray, "n d"], Float[np.ndarray, "n"]]:
    """Minimises the objective on the unit cube from one random start.

    Call it again for another start.

    Args:
        objective: point to value.
        equations: the same with derivatives; if its second argument is n, of each n-th window.
        size: how many windows there are.
        kinks: for each of d dimensions, where the objective's slope jumps.
        evaluations: most evaluations on all windows, with derivatives or without.
        generator: random numbers.
        on_evaluation: called after each of those, for a progress bar.

    Returns:
        The points evaluated on all windows and their values, in the order of evaluation.

    Source: Marquardt 1963, An algorithm for least-squares estimation of nonlinear parameters; the
    blend is ours.
    """
    points, losses = [], []

    def record(point: np.ndarray, loss: float) -> None:
        points.append(point)
        losses.append(loss)
        if on_evaluation is not None:
            on_evaluation()

    def plain(point: np.ndarray) -> float:
        loss = objective(point)
        record(point, loss)
        return loss

    def on_each(every: int) -> Callable[[np.ndarray], NormalEquations]:
        def derived(point: np.ndarray) -> NormalEquations:
            found = equations(np.clip(point, INSIDE, 1 - INSIDE), every)
            if every == 1:
                record(point, found.loss)
            return found

        return derived

    far = max(1, size // FAR)
    stages = []
    if far > 1:
        stages.append((far, [np.empty(0)] * len(kinks), _FAR_STEPS, _FAR_SMALL))
    if far > MIDDLE:
        stages.append((MIDDLE, kinks, _MIDDLE_STEPS, _MIDDLE_SMALL))
    point, curvature = generator.random(len(kinks)), None
    for every, places, steps, small in stages:
        found = descend(on_each(every), point, curvature, places, 0, steps, small)
        point, curvature = found.ahead, found.equations.curvature
    found = descend(on_each(1), point, curvature, kinks, _FEWEST, max(0, evaluations - 3), _SMALL)
    # The last two evaluations are without derivatives, at a fifth of the cost.
    if len(losses) < evaluations:
        loss = plain(found.ahead)
        if len(losses) < evaluations:
            plain(_along(found, loss))
    return np.array(points), np.array(losses)


class Descent(NamedTuple):
    """Where a descent ended."""

    point: Float[np.ndarray, "d"]
    """The lowest point."""
    equations: NormalEquations
    """Derivatives there."""
    ahead: Float[np.ndarray, "d"]
    """Where the next step would lead."""
    low: Float[np.ndarray, "d"]
    high: Float[np.ndarray, "d"]
    """How far it may lead."""


def descend(
    equations: Callable[[Float[np.ndarray, "d"]], NormalEquations],
    point: Float[np.ndarray, "d"],
    curvature: Float[np.ndarray, "d d"] | None,
    kinks: Sequence[Float[np.ndarray, "k"]],
    fewest: int,
    steps: int,
    small: float,
) -> Descent:
    """Goes down until a step would be small.

    Args:
        equations: point to the objective with derivatives.
        point: where to begin.
        curvature: what other windows taught of it, if anything; it is kept, and corrected only by
            how the gradient changes. In it is what the method of Gauss and Newton leaves out, here
            as much as half of it.
        kinks: for each of d dimensions, where the objective's slope jumps.
        fewest: steps that are taken however small they are.
        steps: most steps.
        small: a step that is small, in each dimension.
    """
    came, here = point, equations(point)
    keeps, damping = curvature is not None, 1.0
    if keeps:
        here, damping = here._replace(curvature=curvature), 0.0
    for number in count():
        low, high = cell(kinks, point, came)
        there = step(here, point, damping, low, high)
        if (number >= fewest and np.abs(there - point).max() < small) or number >= steps:
            return Descent(point, here, there, low, high)
        ahead = equations(there)
        if ahead.loss < here.loss:
            ahead = ahead._replace(curvature=here.curvature) if keeps else ahead
            # Across a kink the slope jumps, which is no curvature.
            crossed = ((there == low) & (low > 0)) | ((there == high) & (high < 1))
            ahead = ahead if crossed.any() else corrected(ahead, here, there - point)
            came, point, here, damping = point, there, ahead, damping / 4
        else:
            damping = max(4 * damping, 0.5)
    raise AssertionError("unreachable")


def cell(
    kinks: Sequence[Float[np.ndarray, "k"]],
    point: Float[np.ndarray, "d"],
    came: Float[np.ndarray, "d"],
) -> tuple[Float[np.ndarray, "d"], Float[np.ndarray, "d"]]:
    """Lowest and highest coordinates that a step from a point may reach: the nearest kinks, and a
    little behind them.

    A kink beside which the point lies is no limit, unless the last step came across it: then what
    is behind it is known to rise.
    """
    low, high = np.zeros(len(point)), np.ones(len(point))
    for k, (places, here, before) in enumerate(zip(kinks, point, came, strict=True)):
        below = places[(places < here) & ((here - places > 2 * _BEHIND) | (before < places))]
        above = places[(places > here) & ((places - here > 2 * _BEHIND) | (before > places))]
        low[k] = max(0.0, below.max(initial=0.0) - _BEHIND)
        high[k] = min(1.0, above.min(initial=1.0) + _BEHIND)
    return low, high


def _along(found: Descent, loss: float) -> Float[np.ndarray, "d"]:
    """The lowest point on the line of the last step, by the parabola through both ends and the
    slope; `loss` is that at its end.
    """
    shift = found.ahead - found.point
    slope = float(found.equations.gradient @ shift)
    bend = 2 * (loss - found.equations.loss - slope)
    share = np.clip(-slope / bend, 0.25, 4.0) if bend > 0 else 2.0
    return np.clip(found.point + share * shift, found.low, found.high)


def corrected(
    ahead: NormalEquations, here: NormalEquations, shift: Float[np.ndarray, "d"]
) -> NormalEquations:
    """Curvature that explains how the gradient changed over the last step: the update of Broyden,
    Fletcher, Goldfarb and Shanno.
    """
    change = ahead.gradient - here.gradient
    along, explained = ahead.curvature @ shift, float(shift @ change)
    if explained <= 0.1 * float(shift @ along):
        return ahead
    update = np.outer(change, change) / explained - np.outer(along, along) / float(shift @ along)
    return ahead._replace(curvature=ahead.curvature + update)


def step(
    equations: NormalEquations,
    point: Float[np.ndarray, "d"],
    damping: float,
    low: Float[np.ndarray, "d"] | float = INSIDE,
    high: Float[np.ndarray, "d"] | float = 1 - INSIDE,
) -> Float[np.ndarray, "d"]:
    """The point between `low` and `high` at which the damped quadratic model is lowest."""
    blend = min(damping, 1.0)
    matrix = (1 - blend) * equations.curvature + blend * max(damping, 1.0) * equations.majorant
    # A parameter that moves nothing has no curvature; it stays where it is.
    matrix = matrix + np.diag(1e-6 * np.diag(equations.majorant) + 1e-9)
    values, vectors = np.linalg.eigh(matrix)
    root = np.sqrt(np.maximum(values, 1e-9 * values.max()))
    bounds = (low - point - 1e-12, high - point + 1e-12)
    shift = lsq_linear(
        root[:, None] * vectors.T,
        -(vectors.T @ equations.gradient) / root,
        bounds=bounds,
        method="bvls",
    ).x
    return np.clip(point + shift, low, high)
