"""Which parameters flights can tell: one group after another, as long as flights held out are
predicted better for it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from maidenflight.identification.one_step import OneStep
from maidenflight.parameters import Parameters

FIRST = ("thrust_to_weight", "motor_time_constant", "latency")
"""The paper's three, which every model has."""
GROUPS: dict[str, tuple[str, ...]] = {
    "motor_coasting": ("motor_coasting",),
    "spin_down_ratio": ("spin_down_ratio",),
    "inertia": ("inertia_x", "inertia_y"),
    "torque_to_thrust": ("torque_to_thrust",),
    "rotor_momentum": ("rotor_momentum",),
    "torque_bias": ("torque_bias_x", "torque_bias_y", "torque_bias_z"),
    "flapping_moment": ("flapping_moment",),
    "drag": ("drag_x", "drag_y"),
}
"""What may be added, a group at a time: its name, and the parameters in it.

Not among them are damping of the rates and the thrust curve: a little misfit of the sensors' lag
passes for damping one step ahead, and policies that crashed within a second are then predicted to
fly (docs/identification.md). Name them to identify them."""
HELD_OUT = 3
"""Every third flight judges; if there are fewer flights, every third stretch."""
SURE = 2.0
"""Gain on held-out stretches over its standard error from which a group is believed."""
WORTH = 1e-3
"""Gain of log likelihood a row below which a group is not worth its place."""
ROUGH = WORTH / 50
"""Gain of log likelihood a row below which a fit need not be improved to tell what a group is
worth."""


@dataclass(frozen=True)
class Step:
    """What adding a group bought."""

    group: str
    gain: float
    """Of log likelihood a row, on flights held out."""
    error: float
    """Standard error of that gain, over stretches of flight."""
    kept: bool


def choose(
    training: OneStep,
    held_out: OneStep,
    fit: Callable[[Sequence[str], Parameters], Parameters],
    start: Parameters,
    groups: Mapping[str, Sequence[str]] = GROUPS,
    on_step: Callable[[Step], None] | None = None,
    sample: OneStep | None = None,
) -> tuple[tuple[str, ...], Parameters, list[Step]]:
    """Adds the group that promises most, fits anew, and keeps it if held-out flights gain.

    Until each is kept or has failed.

    What a group promises is the gain of the quadratic model of the likelihood around the fit
    without it, so that adding a group costs one fit and not one for each of its rivals.

    Args:
        training: flights to fit.
        held_out: flights to judge by.
        fit: names and where to begin, to the training flights' best drone.
        start: where the first fit begins.
        groups: what may be added.
        on_step: called with what each group bought.
        sample: some of the training flights' windows, by which the groups are put in order; all of
            them unless given.

    Returns:
        Names of the parameters chosen, the training flights' best drone, and what each group
        bought, in the order of trying.

    Source: Rao 1948 (score test); forward selection judged by held-out likelihood.
    """
    names, left, steps = FIRST, dict(groups), []
    drone = fit(names, start)
    value = held_out.per_block(drone, training.noise_model(drone))
    sample = training if sample is None else sample
    while left:
        everything = (*names, *(name for group in left.values() for name in group))
        equations = sample.normal_equations(drone, everything)
        promised = {
            group: _promise(
                equations.gradient, equations.curvature, everything, (*names, *left[group])
            )
            for group in left
        }
        group = max(promised, key=lambda one: promised[one])
        wider = (*names, *left.pop(group))
        ahead = fit(wider, drone)
        value_ahead = held_out.per_block(ahead, training.noise_model(ahead))
        gain, error = _mean_gain(value - value_ahead, held_out.rows_per_block)
        steps.append(Step(group, gain, error, gain > max(WORTH, SURE * error)))
        if on_step is not None:
            on_step(steps[-1])
        if steps[-1].kept:
            names, drone, value = wider, ahead, value_ahead
    return names, drone, steps


def _promise(
    gradient: Float[np.ndarray, "d"],
    curvature: Float[np.ndarray, "d d"],
    all_names: Sequence[str],
    names: Sequence[str],
) -> float:
    """Gain of the quadratic model when these parameters may move."""
    place = [all_names.index(name) for name in names]
    slope, matrix = gradient[place], curvature[np.ix_(place, place)]
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-30))
    scaled = matrix / np.outer(scale, scale) + 1e-9 * np.eye(len(place))
    return 0.5 * float(slope / scale @ np.linalg.solve(scaled, slope / scale))


def _mean_gain(gain: Float[np.ndarray, "B"], rows: Float[np.ndarray, "B"]) -> tuple[float, float]:
    """Gain a row, and its standard error with stretches of flight as what is independent."""
    mean = float(gain.sum() / rows.sum())
    left = gain - mean * rows
    return mean, float(np.sqrt(np.sum(left**2) * len(rows) / max(len(rows) - 1, 1)) / rows.sum())
