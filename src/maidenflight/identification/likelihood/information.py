"""What flights can tell of a drone before anything is fitted: expected intervals of its parameters.

The information of the one-step likelihood, with the noise model that fits best at the start's
parameters, is joined with the range that is plausible for each parameter beforehand. A parameter
of which the flights say less than that range does is not identifiable from them.

This presumes the model: what a real drone does beyond it is not foreseen.

Source: Ljung 1999, System identification: theory for the user, sec. 9.2-9.3 (covariance of
prediction error estimates) and 13.3 (informative experiments).
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float

from maidenflight.identification.likelihood.observation import ObservationModel
from maidenflight.identification.outcome.plausible import (
    HOVERING,
    NEXT_FLIGHT,
    OTHER_DAY,
    UNIFORM,
    ExpectedInterval,
    Ranges,
    is_identifiable,
)
from maidenflight.identification.signals.lag import (
    DELAYS,
    LAG,
    SLOWING_DOWN,
    slope_by_ratio,
    speeding_up,
)
from maidenflight.identification.signals.motor_response import DELAY_ERROR
from maidenflight.identification.uncertainty import between_segments
from maidenflight.parameters import Parameters, component

_SEEN = 2.0
"""Standard deviations from which on an effect will be found."""


def expected_intervals(
    model: ObservationModel,
    start: Parameters,
    names: Sequence[str],
    priors: Ranges,
    measured_delays: Mapping[str, Float[np.ndarray, "N"]] | None = None,
    *,
    is_truth: bool = False,
) -> dict[str, ExpectedInterval]:
    """Returns what flights can tell of some parameters together.

    Args:
        model: of all the flights.
        start: the drone about which intervals are expected.
        names: of `parameters.COMPONENTS`.
        priors: plausible range of each.
        measured_delays: samples of parameters that other signals than the likelihood determine.
        is_truth: whether the start flew: effects too small to be seen will not be in the model
            beside the others, and segments differ from it as they will from the drone found.
    """
    _, scores, curvatures = model.derivatives(start, names)
    directions = {}
    for name, samples in (measured_delays or {}).items():
        if name not in names:
            continue
        row = np.eye(len(names))[names.index(name)]
        ratio = float(start.spin_down_ratio)
        share = speeding_up(1.0, ratio) if name == LAG else 1.0
        if name == LAG and SLOWING_DOWN in names:
            row[names.index(SLOWING_DOWN)] = -slope_by_ratio(start)
        directions[name] = row, float(np.var(share * samples))
    if HOVERING in names and model.means:
        climbs = model.means.climbs(start, names)
        spread = float(np.std(model.means.hovering(start)))
        variance = spread**2 * (1 / model.segments + 1 / NEXT_FLIGHT)
        directions[HOVERING] = climbs / climbs[names.index(HOVERING)], variance
    widths = np.array([priors[name][1] - priors[name][0] for name in names])

    def together(some: Bool[np.ndarray, "d"]) -> Float[np.ndarray, "e"]:
        """Returns standard deviations of some parameters where the others are known."""
        rows = {name: (row[some], variance) for name, (row, variance) in directions.items()}
        curvature = curvatures.sum(axis=0)[np.ix_(some, some)] * model.rows
        chosen = [name for name, is_in in zip(names, some, strict=True) if is_in]
        return np.sqrt(np.diag(covariance(information(curvature, chosen, rows), widths[some])))

    deviations = together(np.ones(len(names), bool))
    if is_truth:
        off = np.array([1.0 if name == SLOWING_DOWN else 0.0 for name in names])
        effect = np.abs([float(component(start, name)) for name in names] - off)
        visible = (effect > _SEEN * deviations) | [name in directions for name in names]
        deviations[visible] = together(visible)
        likely = visible & [name not in directions for name in names]
        scores, curvatures = scores[:, likely], curvatures[:, likely][:, :, likely]
        spread = between_segments(scores * model.rows, curvatures * model.rows)[0]
        least = np.array([DELAY_ERROR if name in DELAYS else 0.0 for name in names])[likely]
        spread = np.hypot(spread / np.sqrt(NEXT_FLIGHT), least)
        deviations[likely] = np.hypot(deviations[likely], spread)
    result = {}
    for name, deviation in zip(names, deviations, strict=True):
        low, high = priors[name]
        here = float(np.clip(component(start, name), low, high))
        other_day = OTHER_DAY * here if name == HOVERING else 0.0
        reach = 1.96 * float(np.hypot(deviation, other_day))
        result[name] = ExpectedInterval(
            (low, high),
            (max(low, here - reach), min(high, here + reach)),
            is_identifiable(float(deviation), (low, high)),
        )
    return result


def information(
    curvature: Float[np.ndarray, "d d"],
    names: Sequence[str],
    directions: Mapping[str, tuple[Float[np.ndarray, "d"], float]],
) -> Float[np.ndarray, "d d"]:
    """Returns the information of flights on some parameters, as identification uses it.

    Args:
        curvature: of minus the log likelihood of all rows.
        names: of the parameters.
        directions: of each parameter that is not found by the likelihood, the combination of all
            parameters that something else shows, with a weight of 1 of this one, and the
            combination's variance.
    """
    towards, indices = np.eye(len(names)), [names.index(name) for name in directions]
    for number, (row, _) in zip(indices, directions.values(), strict=True):
        towards[number] = row
    back = np.linalg.inv(towards)
    information = back.T @ curvature @ back
    rest = [number for number in range(len(names)) if number not in indices]
    scale = np.sqrt(np.maximum(np.diag(information)[rest], 1e-30))
    likely = information[np.ix_(rest, rest)] / np.outer(scale, scale) + 1e-9 * np.eye(len(rest))
    pull = information[np.ix_(rest, indices)] / scale[:, None]
    # So that, the likelihood's parameters eliminated, only the other signals' information is left.
    information[np.ix_(indices, indices)] = pull.T @ np.linalg.solve(likely, pull) + np.diag(
        [1 / max(variance, 1e-30) for _, variance in directions.values()]
    )
    return towards.T @ information @ towards


def covariance(
    matrix: Float[np.ndarray, "d d"], widths: Float[np.ndarray, "d"]
) -> Float[np.ndarray, "d d"]:
    """Returns the covariance of parameters that are uniform over some widths before the flights.

    Args:
        matrix: information of the flights.
        widths: of the parameters' ranges.
    """
    scale = np.outer(widths, widths)
    return np.linalg.inv(matrix * scale + UNIFORM * np.eye(len(widths))) * scale
