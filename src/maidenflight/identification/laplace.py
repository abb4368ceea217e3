"""The posterior of a likelihood's maximum, by Laplace's approximation."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from maidenflight.identification.box import Box
from maidenflight.identification.fitting import Fit
from maidenflight.identification.information import (
    HOVERING,
    LAG,
    NEXT_FLIGHT,
    Ranges,
    other_days,
)
from maidenflight.identification.one_step import OneStep
from maidenflight.identification.posterior import (
    RESAMPLES,
    between_segment_sd,
    inverse,
    sandwich,
)
from maidenflight.parameters import component

SLOWING_DOWN = "spin_down_ratio"
"""Slowing down over speeding up."""


def samples(
    target: OneStep,
    fit: Fit,
    seen: Mapping[str, np.ndarray],
    untold: Ranges,
    sampling_error: Float[np.ndarray, "d"],
    generator: np.random.Generator,
) -> tuple[Float[np.ndarray, "N d+u"], Box, Float[np.ndarray, "d"]]:
    """Samples of the posterior, and the spread between segments in SI units.

    Laplace's approximation with the sandwich covariance, given the parameters that are seen; these
    have samples of their own, which the others follow. Of the spread so much is added that the
    interval holds what another flight of `NEXT_FLIGHT` segments will show, on another day.

    Args:
        target: the likelihood.
        fit: its maximum, over d parameters.
        seen: samples of parameters that logs show by themselves.
        untold: ranges of u further parameters that flights cannot tell. Samples are anywhere in
            them, and the others follow.
        sampling_error: standard deviation of each parameter, in the unit cube, that comes from the
            commands which a log does not hold.
        generator: random numbers.

    Returns:
        Samples in the unit cube of a box of all parameters, this box, and the spread of the d.
    """
    box, count, fitted = fit.box.beside(untold), RESAMPLES, len(fit.box.names)
    names, optimum = box.names, box.unit_of(fit.drone)
    by_moment = HOVERING in fit.box.names
    sampling_error = np.concatenate([sampling_error, np.zeros(len(untold))])
    anywhere = {name: generator.uniform(*ends, count) for name, ends in untold.items()}
    _, scores, curvatures = target.derivatives(fit.drone, names)
    slope = box.slope(optimum)
    spread = between_segment_sd(scores * target.rows, curvatures * target.rows)
    others = [place for place, name in enumerate(names) if not (by_moment and name == HOVERING)]
    along, noise = np.eye(len(names))[:, others], np.zeros((count, 1))
    if by_moment:
        place = names.index(HOVERING)
        climbs = target.climbs(fit.drone, names) * slope
        along[place] = -climbs[others] / climbs[place]
        spread[place] = float(np.std(target.hovering(fit.drone)[1]))
        error = spread[place] * np.sqrt(1 / target.segments + 1 / NEXT_FLIGHT)
        error = np.hypot(error / slope[place], sampling_error[place])
        noise = generator.normal(0.0, error, (count, 1))
    along = along @ _mean_lag_kept([names[place] for place in others], fit, seen, slope[others])
    curvature = curvatures.sum(axis=0) * np.outer(slope, slope)
    reduced = along.T @ curvature @ along
    known = np.array([names[place] in {*seen, *untold} for place in others], bool)
    moves = np.zeros((count, len(others)))
    for number, place in enumerate(others):
        if known[number]:
            shown = anywhere.get(names[place])
            if shown is None:
                middle = float(component(fit.drone, names[place]))
                shown = seen[names[place]] * (middle / max(np.median(seen[names[place]]), 1e-9))
            moves[:, number] = _resized(box, place, shown, generator) - optimum[place]
            spread[place] = 0.0
    if others and not known.all():
        inner = reduced[np.ix_(~known, ~known)]
        covariance = sandwich(((scores * slope) @ along)[:, ~known], inner)
        between = (spread / slope)[others][~known]
        missed = sampling_error[others][~known]
        covariance += np.diag(between**2 / NEXT_FLIGHT + missed**2)
        free = generator.multivariate_normal(np.zeros(len(inner)), covariance, count, method="eigh")
        follow = inverse(inner)
        free -= moves[:, known] @ (follow @ reduced[np.ix_(~known, known)]).T
        if by_moment:
            pulls = (along.T @ curvature[:, [names.index(HOVERING)]])[~known]
            free -= noise @ (follow @ pulls).T
        moves[:, ~known] += free
    draws = optimum + moves @ along.T
    if by_moment:
        place = names.index(HOVERING)
        draws[:, place] += noise[:, 0] + other_days(fit.drone, count, generator) / slope[place]
    return np.clip(draws, 0.0, 1.0), box, spread[:fitted]


def _mean_lag_kept(
    names: Sequence[str],
    fit: Fit,
    seen: Mapping[str, np.ndarray],
    slope: Float[np.ndarray, "n"],
) -> Float[np.ndarray, "n n"]:
    """How parameters move in the unit cube where the ratio of slowing down moves.

    The lag that is seen is the mean of speeding up and slowing down, T_m (1 + ratio) / 2. With
    another ratio it stays the same, and T_m does not.
    """
    moved = np.eye(len(names))
    if LAG in seen and LAG in names and SLOWING_DOWN in names:
        lag, ratio = names.index(LAG), names.index(SLOWING_DOWN)
        change = -float(fit.drone.motor_time_constant) / (1 + float(fit.drone.spin_down_ratio))
        moved[lag, ratio] = change * slope[ratio] / slope[lag]
    return moved


def _resized(
    box: Box, place: int, samples: np.ndarray, generator: np.random.Generator
) -> Float[np.ndarray, "N"]:
    """Samples of one parameter in the box's unit cube, as many as the posterior has."""
    chosen = samples if len(samples) == RESAMPLES else generator.choice(samples, RESAMPLES)
    unit = box.unit(np.tile(chosen[:, None], (1, len(box.names))))
    return unit[:, place]
