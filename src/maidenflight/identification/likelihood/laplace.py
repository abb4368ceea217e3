"""The posterior of a likelihood's maximum, by Laplace's approximation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from maidenflight.identification.likelihood.fit import Fit
from maidenflight.identification.outcome.bounds import AT_BOUND
from maidenflight.identification.outcome.plausible import (
    HOVERING,
    NEXT_FLIGHT,
    Ranges,
    other_days,
)
from maidenflight.identification.signals.lag import LAG, SLOWING_DOWN, slope_by_ratio
from maidenflight.identification.uncertainty import (
    RESAMPLES,
    between_segments,
    inverse,
    sandwich,
)
from maidenflight.identification.unknowns import Box
from maidenflight.parameters import Parameters, component


class Others(NamedTuple):
    """Parameters that are not fitted and have samples of their own, which those fitted follow."""

    samples: Mapping[str, Float[np.ndarray, "N"]]
    """SI units, by name of the k parameters."""
    moves: Float[np.ndarray, "N k"]
    """From the drone, on the scales on which the likelihood is taken for quadratic."""
    slope: Float[np.ndarray, "k"]
    """SI units to a unit of these scales."""
    vary: bool
    """Whether segments of flight may differ in them."""

    @classmethod
    def from_samples(
        cls, samples: Mapping[str, Float[np.ndarray, "N"]], drone: Parameters
    ) -> "Others":
        """Returns parameters of a drone of which another sensor gave samples."""
        if not samples:
            return NO_OTHERS
        values = np.array([float(component(drone, name)) for name in samples])
        moves = np.stack(list(samples.values()), axis=1) - values
        return cls(samples, moves, np.ones(len(values)), False)

    @classmethod
    def from_ranges(
        cls, ranges: Ranges, drone: Parameters, generator: np.random.Generator
    ) -> "Others":
        """Returns parameters of a drone that may be anywhere in their ranges."""
        samples = {name: generator.uniform(*ends, RESAMPLES) for name, ends in ranges.items()}
        if not samples:
            return NO_OTHERS
        box = Box(tuple(ranges), *zip(*ranges.values(), strict=True))
        unit = box.unit_of(drone)
        moves = box.unit(np.stack(list(samples.values()), axis=1)) - unit
        return cls(samples, moves, box.slope(unit), True)


NO_OTHERS = Others({}, np.empty((RESAMPLES, 0)), np.empty(0), False)
"""None of them."""


@dataclass(frozen=True)
class Posterior:
    """Samples about a likelihood's maximum over d parameters."""

    box: Box
    unit: Float[np.ndarray, "N d"]
    """Samples in the box's unit cube."""
    spread: Mapping[str, float]
    """Standard deviation between segments of flight by parameter, SI units."""
    error: Mapping[str, float]
    """Standard error by parameter, SI units; infinite at a search bound."""
    others: Mapping[str, Float[np.ndarray, "N"]]
    """Samples of parameters that were not fitted, SI units."""

    @property
    def samples(self) -> dict[str, Float[np.ndarray, "N"]]:
        """Samples of all parameters by name, SI units."""
        own = zip(self.box.names, self.box.values(self.unit).T, strict=True)
        return {**dict(own), **self.others}


def posterior(
    fit: Fit,
    measured_delays: Mapping[str, Float[np.ndarray, "N"]],
    others: Others,
    doubt: Float[np.ndarray, "d d"],
    generator: np.random.Generator,
    *,
    at_least_laplace: bool = False,
) -> Posterior:
    """Draws from the posterior of d parameters.

    Laplace's approximation with the sandwich covariance, conditional on the measured parameters and
    the others; these have samples of their own, which the rest follows. Of the spread between
    segments so much is added that the interval holds what another flight of `NEXT_FLIGHT` segments
    will show, on another day.

    Args:
        fit: the maximum.
        measured_delays: samples of parameters that logs show by themselves; those of the fit count.
        others: parameters that are not fitted.
        doubt: covariance in the unit cube of what the likelihood does not know of.
        generator: random numbers.
        at_least_laplace: no variance is below Laplace's own, the inverse of the curvature.
    """
    box, unit, size = fit.box, fit.optimum, len(fit.box.names)
    names = (*box.names, *others.samples)
    slope = np.concatenate([box.slope(unit), others.slope])
    _, scores, curvatures = fit.model.derivatives(fit.drone, names)
    vary = len(names) if others.vary else size
    spread, alike = between_segments(
        scores[:, :vary] * fit.model.rows, curvatures[:, :vary, :vary] * fit.model.rows
    )
    spread = spread[:size]
    measured = {name: some for name, some in measured_delays.items() if name in box.names}
    hover = _balance(fit, names, slope, doubt, generator)
    if hover.column is not None:
        spread[hover.column] = hover.spread
    indices = [index for index in range(len(names)) if index != hover.column]
    along = hover.along @ _fixed_equivalent_lag(
        [names[index] for index in indices], fit, measured, slope[indices]
    )
    curvature = curvatures.sum(axis=0) * np.outer(slope, slope)
    is_known = np.array([names[index] in {*measured, *others.samples} for index in indices], bool)
    moves = np.zeros((RESAMPLES, len(indices)))
    for number, index in enumerate(indices):
        if index >= size:
            moves[:, number] = others.moves[:, index - size]
        elif is_known[number]:
            moves[:, number] = _with_measured_delays(fit, index, measured, generator)
            spread[index] = 0.0
    if not is_known.all():
        own = [index for index, known in zip(indices, is_known, strict=True) if not known]
        reduced = along.T @ curvature @ along
        inner = reduced[np.ix_(~is_known, ~is_known)]
        covariance = sandwich(((scores * slope) @ along)[:, ~is_known], inner)
        if at_least_laplace:
            least = np.diag(inverse(inner)) / fit.model.rows
            covariance += np.diag(np.maximum(least - np.diag(covariance), 0.0))
        sizes = (spread / slope[:size])[own] / np.sqrt(NEXT_FLIGHT)
        covariance += alike[np.ix_(own, own)] * np.outer(sizes, sizes) + doubt[np.ix_(own, own)]
        free = generator.multivariate_normal(
            np.zeros(len(own)), covariance, RESAMPLES, method="eigh"
        )
        # The rest of the optimum follows what is known of the others, and of hovering.
        pull = moves[:, is_known] @ reduced[np.ix_(is_known, ~is_known)]
        if hover.column is not None:
            pull += hover.noise * (along.T @ curvature[:, hover.column])[~is_known]
        moves[:, ~is_known] += free - pull @ inverse(inner)
    moves = (moves @ along.T)[:, :size]
    if hover.column is not None:
        moves[:, hover.column] += hover.noise[:, 0]
    if HOVERING in box.names:
        index = box.names.index(HOVERING)
        moves[:, index] += other_days(fit.drone, RESAMPLES, generator) / slope[index]
    # A latency or drag of zero is no search bound but where nature ends.
    bounded = (unit > 1 - AT_BOUND) | ((unit < AT_BOUND) & (np.array(box.lower) != 0.0))
    error = np.where(bounded, np.inf, np.std(moves, axis=0) * slope[:size])
    spread, error = (dict(zip(box.names, sizes.tolist(), strict=True)) for sizes in (spread, error))
    return Posterior(box, np.clip(unit + moves, 0.0, 1.0), spread, error, others.samples)


class _Hover(NamedTuple):
    """The balance of mean forces, by which thrust follows the other parameters."""

    column: int | None
    """Of the thrust-to-weight ratio among n parameters; None where a likelihood tells it."""
    along: Float[np.ndarray, "n m"]
    """How all parameters move with the m others."""
    noise: Float[np.ndarray, "N 1"]
    """What the ratio may be off by itself, in the unit cube."""
    spread: float
    """Its standard deviation between segments, SI units."""


def _balance(
    fit: Fit,
    names: Sequence[str],
    slope: Float[np.ndarray, "n"],
    doubt: Float[np.ndarray, "d d"],
    generator: np.random.Generator,
) -> _Hover:
    """Returns how thrust keeps the balance; all move by themselves without mean errors."""
    box, means = fit.box, fit.model.means
    if means is None or HOVERING not in box.names:
        return _Hover(None, np.eye(len(names)), np.zeros((RESAMPLES, 1)), 0.0)
    index = box.names.index(HOVERING)
    along = np.delete(np.eye(len(names)), index, axis=1)
    climbs = means.climbs(fit.drone, names) * slope
    along[index] = -np.delete(climbs, index) / climbs[index]
    spread = float(np.std(means.hovering(fit.drone)))
    error = spread * np.sqrt(1 / fit.model.segments + 1 / NEXT_FLIGHT)
    error = np.hypot(error / slope[index], np.sqrt(doubt[index, index]))
    return _Hover(index, along, generator.normal(0.0, error, (RESAMPLES, 1)), spread)


def _fixed_equivalent_lag(
    names: Sequence[str],
    fit: Fit,
    measured_delays: Mapping[str, Float[np.ndarray, "N"]],
    slope: Float[np.ndarray, "n"],
) -> Float[np.ndarray, "n n"]:
    """How parameters move in the unit cube where the ratio of slowing down moves.

    The lag that is seen is the equivalent one of speeding up and slowing down. With another ratio
    it stays the same, and that of speeding up does not.
    """
    unit_steps = np.eye(len(names))
    if LAG in measured_delays and LAG in names and SLOWING_DOWN in names:
        lag, ratio = names.index(LAG), names.index(SLOWING_DOWN)
        unit_steps[lag, ratio] = slope_by_ratio(fit.drone) * slope[ratio] / slope[lag]
    return unit_steps


def _with_measured_delays(
    fit: Fit,
    number: int,
    measured_delays: Mapping[str, Float[np.ndarray, "N"]],
    generator: np.random.Generator,
) -> Float[np.ndarray, "N"]:
    """Moves in the unit cube of a parameter that is seen, about the drone's, as many as samples."""
    box, name = fit.box, fit.box.names[number]
    samples = measured_delays[name] * (
        float(component(fit.drone, name)) / max(np.median(measured_delays[name]), 1e-9)
    )
    if len(samples) != RESAMPLES:
        samples = generator.choice(samples, RESAMPLES)
    unit = box.unit(np.tile(samples[:, None], (1, len(box.names))))
    return unit[:, number] - fit.optimum[number]
