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
from jaxtyping import Float

from maidenflight.identification.likelihood.observation import ObservationModel
from maidenflight.identification.outcome.plausible import (
    HOVERING,
    NEXT_FLIGHT,
    OTHER_DAY,
    UNIFORM,
    Expected,
    Ranges,
    is_told,
)
from maidenflight.identification.signals.lag import LAG
from maidenflight.parameters import Parameters, component


def expected(
    model: ObservationModel,
    start: Parameters,
    names: Sequence[str],
    priors: Ranges,
    seen: Mapping[str, Float[np.ndarray, "N"]] | None = None,
) -> dict[str, Expected]:
    """Returns what flights can tell of some parameters together.

    Args:
        model: of all the flights.
        start: the drone about which intervals are expected.
        names: of `parameters.COMPONENTS`.
        priors: plausible range of each.
        seen: samples of parameters that are not found by the likelihood but seen by other signals.
    """
    _, _, curvatures = model.derivatives(start, names)
    apart = {}
    for name, samples in (seen or {}).items():
        if name not in names:
            continue
        row = np.eye(len(names))[names.index(name)]
        ratio = float(start.spin_down_ratio)
        share = 2 / (1 + ratio) if name == LAG else 1.0
        if name == LAG and "spin_down_ratio" in names:
            row[names.index("spin_down_ratio")] = float(start.motor_time_constant) / (1 + ratio)
        apart[name] = row, float(np.var(share * samples))
    if HOVERING in names and model.thrust:
        climbs = model.thrust.climbs(start, names)
        spread = float(np.std(model.thrust.hovering(start)[1]))
        variance = spread**2 * (1 / model.segments + 1 / NEXT_FLIGHT)
        apart[HOVERING] = climbs / climbs[names.index(HOVERING)], variance
    matrix = information(curvatures.sum(axis=0) * model.rows, names, apart)
    widths = np.array([priors[name][1] - priors[name][0] for name in names])
    deviations = np.sqrt(np.diag(covariance(matrix, widths)))
    found = {}
    for name, deviation in zip(names, deviations, strict=True):
        low, high = priors[name]
        here = float(np.clip(component(start, name), low, high))
        other_day = OTHER_DAY * here if name == HOVERING else 0.0
        reach = 1.96 * float(np.hypot(deviation, other_day))
        found[name] = Expected(
            (low, high),
            (max(low, here - reach), min(high, here + reach)),
            is_told(float(deviation), (low, high)),
        )
    return found


def information(
    curvature: Float[np.ndarray, "d d"],
    names: Sequence[str],
    apart: Mapping[str, tuple[Float[np.ndarray, "d"], float]],
) -> Float[np.ndarray, "d d"]:
    """Information of flights on some parameters, as identification uses it.

    Args:
        curvature: of minus the log likelihood of all rows.
        names: of the parameters.
        apart: of each parameter that is not found by the likelihood, the combination of all
            parameters that something else shows, with a weight of 1 of this one, and the
            combination's variance.
    """
    towards, place = np.eye(len(names)), [names.index(name) for name in apart]
    for number, (row, _) in zip(place, apart.values(), strict=True):
        towards[number] = row
    back = np.linalg.inv(towards)
    found = back.T @ curvature @ back
    rest = [number for number in range(len(names)) if number not in place]
    scale = np.sqrt(np.maximum(np.diag(found)[rest], 1e-30))
    likely = found[np.ix_(rest, rest)] / np.outer(scale, scale) + 1e-9 * np.eye(len(rest))
    pull = found[np.ix_(rest, place)] / scale[:, None]
    # So that, the likelihood's parameters eliminated, only the other signals' information is left.
    found[np.ix_(place, place)] = pull.T @ np.linalg.solve(likely, pull) + np.diag(
        [1 / max(variance, 1e-30) for _, variance in apart.values()]
    )
    return towards.T @ found @ towards


def covariance(
    matrix: Float[np.ndarray, "d d"], widths: Float[np.ndarray, "d"]
) -> Float[np.ndarray, "d d"]:
    """Covariance of parameters that are uniform over some widths before the flights.

    Args:
        matrix: information of the flights.
        widths: of the parameters' ranges.
    """
    scale = np.outer(widths, widths)
    return np.linalg.inv(matrix * scale + UNIFORM * np.eye(len(widths))) * scale
