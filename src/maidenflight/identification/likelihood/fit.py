"""Maximising the likelihood over some parameters, while others follow.

Parameters that logs show by themselves are not searched for, and where a model finds thrust by its
moment it is what hovering takes.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from maidenflight.identification.likelihood.observation import BALANCED, ObservationModel
from maidenflight.identification.outcome.plausible import HOVERING
from maidenflight.identification.search.gauss_newton import (
    INSIDE,
    NormalEquations,
    Rules,
    descend,
    in_unit_cube,
    inside,
)
from maidenflight.identification.signals.lag import (
    LAG,
    SLOWING_DOWN,
    slope_by_ratio,
    speeding_up,
)
from maidenflight.identification.unknowns import Box
from maidenflight.parameters import Parameters, component, replace

_CLOSE = 0.02
"""Gain of the log likelihood of all flights [nats] below which a step is the last; a fifth of a
standard error changes it by as much."""


@dataclass(frozen=True)
class Fit:
    """Where a maximisation ended."""

    model: ObservationModel
    """The last that was maximised."""
    box: Box
    drone: Parameters
    points: Float[np.ndarray, "n d"]
    """Points evaluated on the last model, in the box's unit cube."""
    values: Float[np.ndarray, "n"]
    """Minus the mean log likelihood of a row there."""

    @property
    def optimum(self) -> Float[np.ndarray, "d"]:
        """Where the drone lies in the box's unit cube."""
        return self.box.unit_of(self.drone)

    @property
    def value(self) -> float:
        """Minus the mean log likelihood of a row at the optimum."""
        return float(self.values.min())


def fit(
    box: Box,
    evaluations: int,
    models: Sequence[ObservationModel],
    first: Parameters,
    measured_delays: Mapping[str, Float[np.ndarray, "N"]],
    on_evaluation: Callable[[], None],
    *,
    generator: np.random.Generator | None = None,
    close: float = 0.0,
) -> Fit:
    """Maximises one likelihood after another.

    Args:
        box: of the d parameters to fit.
        evaluations: most evaluations of each model.
        models: each is maximised until a step gains less than `_CLOSE` in all, or than `close` a
            row; one that is named twice, once.
        first: where to begin, and the fixed parameters.
        measured_delays: samples of parameters; of those in the box the median is taken.
        on_evaluation: called after each.
        generator: begin at a random point by it instead.
        close: log-likelihood gain of a row [nats] below which a step is the last.
    """
    names = box.names
    measured_delays = {name: samples for name, samples in measured_delays.items() if name in names}
    drone = _at_medians(first, measured_delays)
    free = tuple(
        name
        for name in names
        if name not in measured_delays and not (name in BALANCED and models[0].means is not None)
    )
    inner = box.part(free) if free else None
    if inner and generator:
        drone = inner.drone(drone, generator.random(len(free)))
    points, values = np.empty((0, len(names))), np.empty(0)
    for model in dict.fromkeys(models):
        small = max(close, _CLOSE / model.rows)
        rules = Rules(1, evaluations - 1, small_gain=small, easing=8.0, firmness=2.0)
        if inner:
            drones, values = _descended(
                model, rules, inner, box, drone, measured_delays, on_evaluation
            )
            drone = drones[int(np.argmin(values))]
        else:
            drone = balance(model, drone, box)
            drones, values = [drone], np.array([model(drone)])
            on_evaluation()
        points = np.array([box.unit_of(drone) for drone in drones])
    return Fit(models[-1], box, drone, points, values)


def _at_medians(
    drone: Parameters, measured_delays: Mapping[str, Float[np.ndarray, "N"]]
) -> Parameters:
    """The drone with the medians of what is seen.

    The lag that is seen is the equivalent one of motors that speed up and slow down.
    """
    if not measured_delays:
        return drone
    middle = {name: float(np.median(samples)) for name, samples in measured_delays.items()}
    if LAG in middle:
        ratio = middle.get(SLOWING_DOWN, float(drone.spin_down_ratio))
        middle[LAG] = speeding_up(middle[LAG], ratio)
    return replace(drone, **{name: np.float32(value) for name, value in middle.items()})


def balance(model: ObservationModel, drone: Parameters, box: Box) -> Parameters:
    """Returns the drone with the thrust and torques of a box that make mean errors zero."""
    limits = {
        name: (low, high)
        for name, low, high in zip(box.names, box.lower, box.upper, strict=True)
        if name in BALANCED
    }
    if model.means is None or not limits:
        return drone
    values = model.means.balance(drone)
    within = {
        name: np.float32(np.clip(values[name], low, high)) for name, (low, high) in limits.items()
    }
    return replace(drone, **within)


def _descended(
    model: ObservationModel,
    rules: Rules,
    inner: Box,
    box: Box,
    first: Parameters,
    measured_delays: Mapping[str, Float[np.ndarray, "N"]],
    on_evaluation: Callable[[], None],
) -> tuple[list[Parameters], Float[np.ndarray, "n"]]:
    """Drones evaluated from one on, and their values.

    Two parameters follow those of the inner box, and so do the derivatives: thrust, so that the
    mean vertical error stays zero, and a lag that is seen, the ratio of slowing down. Torques only
    follow, since no likelihood tells them.
    """
    drones, values = [], []
    thrust = model.means if HOVERING in box.names else None
    followers = [
        *([LAG] if LAG in measured_delays and SLOWING_DOWN in inner.names else []),
        *([HOVERING] if thrust else []),
    ]

    def equations(unit: np.ndarray) -> NormalEquations:
        on_evaluation()
        drone = inner.drone(drones[int(np.argmin(values))] if drones else first, unit)
        drone = balance(model, _at_medians(drone, measured_delays), box)
        names = (*inner.names, *followers)
        result = model.normal_equations(drone, names)
        if followers:
            along = np.eye(len(inner.names))
            if LAG in followers:
                chosen = np.array(inner.names) == SLOWING_DOWN
                slope = np.where(chosen, slope_by_ratio(drone), 0.0)
                along = np.concatenate([along, slope[None]])
            if thrust:
                climbs = thrust.climbs(drone, names)
                follow = climbs[None, :-1] @ along / climbs[-1]
                along = np.concatenate([along, -follow])
            result = NormalEquations(
                result.loss,
                along.T @ result.gradient,
                along.T @ result.curvature @ along,
                along.T @ result.majorant @ along,
            )
        drones.append(drone)
        values.append(result.loss)
        return in_unit_cube(result, inner, unit)

    point = inner.unit(np.array([float(component(first, name)) for name in inner.names]))
    descend(equations, np.clip(point, INSIDE, 1 - INSIDE), rules, inside, damping=0.0)
    return drones, np.array(values)
