"""Minimising the objective of a replay by gradients through the simulator.

The objective is a sum of absolute values and of norms, so its curvature lies in their kinks.
`curvature` rounds the kinks; `majorant`, that of iteratively reweighted least squares, is right
where a model fits without error.

Windows overlap, so few of them show nearly where the optimum is: a random start comes near on some
dozens of windows, then on every fifth, and only the last steps use all of them. Each stage keeps
the curvature that the one before it found.

Where a command arrives just when a physics step begins, the objective has a kink in the latency,
and its optimum often lies in one. So a step ends just behind the next kink; the slope there shows
whether to go on or back.
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from jaxtyping import Float

from maidenflight.identification.search.gauss_newton import (
    INSIDE,
    Descent,
    NormalEquations,
    Rules,
    descend,
)
from maidenflight.identification.unknowns import Box

FAR = 64
"""Windows, about, of the first steps from a random start: as many as are differentiated side by
side, so that so few cost one program. With 90 a latency beside a kink moves by 0.23 of half its
interval, with 45 none does (paper/identification/constants.py)."""
MIDDLE = 5
"""Of the next steps each fifth window is used; these overlap by little or nothing. It and what
follows are harmless within a factor of 1.4 (paper/identification/constants.py)."""
_FAR_STEPS, _MIDDLE_STEPS = 20, 8
"""Most steps on those windows; measured with `MIDDLE`."""
_FAR_SMALL, _MIDDLE_SMALL, _SMALL = 1e-2, 6e-3, 2.5e-3
"""Step, as a share of the box, below which a search ends: on few windows, whose optimum is not that
of all, and on all; measured with `MIDDLE`."""
_FEWEST = 2
"""Steps on all windows, however small: before, the curvature is that of some windows."""
_BEHIND = 1e-6
"""Distance behind a kink at which a step across it ends; measured with `MIDDLE`."""


def kinks(box: Box, period: float) -> list[Float[np.ndarray, "k"]]:
    """Coordinates in the unit cube at which the objective's slope jumps, for each dimension.

    They are latencies of whole command periods, where a command arrives in another row.
    """
    descent = []
    for name, low, high in zip(box.names, box.lower, box.upper, strict=True):
        every = np.arange(np.ceil(low / period), np.floor(high / period) + 1)
        rows = every if name == "latency" else np.empty(0)
        descent.append((rows * period - low) / (high - low))
    return descent


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
            descent = equations(np.clip(point, INSIDE, 1 - INSIDE), every)
            if every == 1:
                record(point, descent.loss)
            return descent

        return derived

    far = max(1, size // FAR)
    stages = []
    if far > 1:
        stages.append((far, [np.empty(0)] * len(kinks), Rules(0, _FAR_STEPS, _FAR_SMALL)))
    if far > MIDDLE:
        stages.append((MIDDLE, kinks, Rules(0, _MIDDLE_STEPS, _MIDDLE_SMALL)))
    stages.append((1, kinks, Rules(_FEWEST, max(0, evaluations - 3), _SMALL)))
    point, curvature, result = generator.random(len(kinks)), None, None
    for every, places, rules in stages:
        damping = 1.0 if curvature is None else 0.0
        result = descend(on_each(every), point, rules, partial(cell, places), damping, curvature)
        point, curvature = result.ahead, result.equations.curvature
    assert result is not None
    # The last two evaluations are without derivatives, at a fifth of the cost.
    if len(losses) < evaluations:
        loss = plain(result.ahead)
        if len(losses) < evaluations:
            plain(_along(result, loss))
    return np.array(points), np.array(losses)


def cell(
    kinks: Sequence[Float[np.ndarray, "k"]],
    point: Float[np.ndarray, "d"],
    came: Float[np.ndarray, "d"],
) -> tuple[Float[np.ndarray, "d"], Float[np.ndarray, "d"]]:
    """Returns lowest and highest coordinates of a step, just behind the next kinks.

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


def _along(descent: Descent, loss: float) -> Float[np.ndarray, "d"]:
    """The lowest point on the line of the last step, by a parabola; `loss` is that at its end."""
    shift = descent.ahead - descent.point
    slope = float(descent.equations.gradient @ shift)
    bend = 2 * (loss - descent.equations.loss - slope)
    share = np.clip(-slope / bend, 0.25, 4.0) if bend > 0 else 2.0
    return np.clip(descent.point + share * shift, descent.low, descent.high)
