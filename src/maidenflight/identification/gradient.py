"""Identification by gradients through the simulator: Gauss-Newton steps, damped as far as the objective asks for it.

The objective is a sum of absolute values and of norms, so its curvature lies in their kinks. Two models of it are blended. The
one of Gauss and Newton, with rounded kinks, leads to the optimum in few steps. The one of iteratively reweighted least squares is
never too flat where residuals are linear in the parameters, and is right where a model fits without error. Damping blends from the
first to the second, and then scales the second.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

from maidenflight.identification.bayesian import Box
from maidenflight.identification.objective import NormalEquations

PILOT = 256
"""Windows of which the way from a random start to the optimum's neighbourhood is found; neighbouring windows overlap and say the same."""
_PILOT_STEPS = 20
"""Most steps on those windows."""
_SMALL = 3e-3
"""Step, as a share of the box, that is the last on all windows; on a few, three times as much."""
INSIDE = 1e-4
"""Distance that is kept from the box's faces: on a face, as where there is no latency at all, a slope can be one-sided."""


def in_unit_cube(equations: NormalEquations, box: Box, point: Float[np.ndarray, "d"]) -> NormalEquations:
    """Normal equations per unit of the search's cube instead of per SI unit of the parameters."""
    scale = box.slope(point)
    square = np.outer(scale, scale)
    return NormalEquations(equations.loss, equations.gradient * scale, equations.curvature * square, equations.majorant * square)


def minimise(
    objective: Callable[[Float[np.ndarray, "d"]], float],
    equations: Callable[[Float[np.ndarray, "d"], bool], NormalEquations],
    dimensions: int,
    evaluations: int,
    generator: np.random.Generator,
    on_evaluation: Callable[[], None] | None = None,
) -> tuple[Float[np.ndarray, "n d"], Float[np.ndarray, "n"]]:
    """Minimises the objective on the unit cube from one random start; call it again for another start.

    Args:
        objective: point to value.
        equations: the same with derivatives; if its second argument is true, of a few windows only.
        dimensions: d.
        evaluations: most evaluations on all windows, with derivatives or without.
        generator: random numbers.
        on_evaluation: called after each of those, for a progress bar.

    Returns:
        The points evaluated on all windows and their values, in the order of evaluation.

    Source: Marquardt 1963, An algorithm for least-squares estimation of nonlinear parameters; the blend is ours.
    """
    point = np.clip(generator.random(dimensions), INSIDE, 1 - INSIDE)
    damping = 1.0
    here = equations(point, True)
    for _ in range(_PILOT_STEPS):
        there = step(here, point, damping)
        small = bool(np.abs(there - point).max() < 3 * _SMALL)
        ahead = equations(there, True)
        if ahead.loss < here.loss:
            point, here, damping = there, corrected(ahead, here, there - point), damping / 4
        else:
            damping = max(4 * damping, 0.5)
        if small:
            break

    points, losses = [], []

    def record(point: np.ndarray, loss: float) -> None:
        points.append(point)
        losses.append(loss)
        if on_evaluation is not None:
            on_evaluation()

    # What the steps on a few windows taught of the curvature holds for all; starting with that saves one evaluation or two.
    here, damping = equations(point, False)._replace(curvature=here.curvature), 0.0
    record(point, here.loss)
    while len(losses) < evaluations:
        there = step(here, point, damping)
        if np.abs(there - point).max() < _SMALL or len(losses) == evaluations - 1:
            record(there, objective(there))
            break
        ahead = equations(there, False)
        record(there, ahead.loss)
        if ahead.loss < here.loss:
            point, here, damping = there, corrected(ahead, here, there - point), damping / 4
        else:
            damping = max(4 * damping, 0.5)
    return np.array(points), np.array(losses)


def corrected(ahead: NormalEquations, here: NormalEquations, shift: Float[np.ndarray, "d"]) -> NormalEquations:
    """Curvature that explains how the gradient changed over the last step: the update of Broyden, Fletcher, Goldfarb and Shanno."""
    change = ahead.gradient - here.gradient
    along, explained = ahead.curvature @ shift, float(shift @ change)
    if explained <= 0.1 * float(shift @ along):
        return ahead
    update = np.outer(change, change) / explained - np.outer(along, along) / float(shift @ along)
    return ahead._replace(curvature=ahead.curvature + update)


def step(equations: NormalEquations, point: Float[np.ndarray, "d"], damping: float) -> Float[np.ndarray, "d"]:
    """The point of the box at which the damped quadratic model is lowest."""
    blend = min(damping, 1.0)
    matrix = (1 - blend) * equations.curvature + blend * max(damping, 1.0) * equations.majorant
    # A parameter that moves nothing has no curvature; it stays where it is.
    matrix = matrix + np.diag(1e-6 * np.diag(equations.majorant) + 1e-9)
    values, vectors = np.linalg.eigh(matrix)
    root = np.sqrt(np.maximum(values, 1e-9 * values.max()))
    bounds = (INSIDE - point - 1e-12, 1 - INSIDE - point + 1e-12)
    shift = lsq_linear(root[:, None] * vectors.T, -(vectors.T @ equations.gradient) / root, bounds=bounds, method="bvls").x
    return np.clip(point + shift, INSIDE, 1 - INSIDE)
