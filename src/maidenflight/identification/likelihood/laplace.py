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
    about = _about(fit, others)
    measured = {name: some for name, some in measured_delays.items() if name in box.names}
    free = _free(about, measured, doubt, generator)
    known = _known_moves(about, free.indices, measured, others, generator)
    spread = about.spread.copy()
    if free.hover is not None:
        spread[free.hover] = free.hover_spread
    spread[[index for index in known if index < size]] = 0.0
    sizes = spread / about.slope[:size] / np.sqrt(NEXT_FLIGHT)
    doubt = doubt + about.alike * np.outer(sizes, sizes)
    moves = _moves(about, free, known, doubt, generator, at_least_laplace=at_least_laplace)
    if HOVERING in box.names:
        index = box.names.index(HOVERING)
        moves[:, index] += other_days(fit.drone, RESAMPLES, generator) / about.slope[index]
    # A latency or drag of zero is no search bound but where nature ends.
    bounded = (unit > 1 - AT_BOUND) | ((unit < AT_BOUND) & (np.array(box.lower) != 0.0))
    error = np.where(bounded, np.inf, np.std(moves, axis=0) * about.slope[:size])
    spread, error = (dict(zip(box.names, sizes.tolist(), strict=True)) for sizes in (spread, error))
    return Posterior(box, np.clip(unit + moves, 0.0, 1.0), spread, error, others.samples)


class _About(NamedTuple):
    """The likelihood about a fit of d parameters, by them and k others: n in all."""

    fit: Fit
    names: tuple[str, ...]
    slope: Float[np.ndarray, "n"]
    """SI units to a unit of the scales on which it is quadratic; those of the next two."""
    scores: Float[np.ndarray, "S n"]
    curvature: Float[np.ndarray, "n n"]
    spread: Float[np.ndarray, "d"]
    """Standard deviation between segments, SI units."""
    alike: Float[np.ndarray, "d d"]
    """Its correlations."""


def _about(fit: Fit, others: Others) -> _About:
    names, size = (*fit.box.names, *others.samples), len(fit.box.names)
    slope = np.concatenate([fit.box.slope(fit.optimum), others.slope])
    _, scores, curvatures = fit.model.derivatives(fit.drone, names)
    vary = len(names) if others.vary else size
    spread, alike = between_segments(
        scores[:, :vary] * fit.model.rows, curvatures[:, :vary, :vary] * fit.model.rows
    )
    curvature = curvatures.sum(axis=0) * np.outer(slope, slope)
    return _About(fit, names, slope, scores * slope, curvature, spread[:size], alike[:size, :size])


class _Free(NamedTuple):
    """Parameters that move by themselves, and how others follow."""

    indices: list[int]
    """Of m of the n parameters: all, or all but the thrust-to-weight ratio."""
    along: Float[np.ndarray, "n m"]
    """How all parameters move with these."""
    hover: int | None
    """Index of that ratio where mean forces tell it; None where a likelihood does."""
    noise: Float[np.ndarray, "N 1"]
    """What the ratio may be off by itself, in the unit cube."""
    hover_spread: float
    """Its standard deviation between segments, SI units."""


def _free(
    about: _About,
    measured_delays: Mapping[str, Float[np.ndarray, "N"]],
    doubt: Float[np.ndarray, "d d"],
    generator: np.random.Generator,
) -> _Free:
    """Returns how thrust keeps the balance, and the lag speeding up the equivalent one.

    The lag that is seen is that of speeding up and slowing down. With another ratio of them it
    stays the same, and that of speeding up does not.
    """
    fit, names, slope = about.fit, about.names, about.slope
    along, hover, spread = np.eye(len(names)), None, 0.0
    noise, means = np.zeros((RESAMPLES, 1)), fit.model.means
    indices = list(range(len(names)))
    if means is not None and HOVERING in fit.box.names:
        hover = fit.box.names.index(HOVERING)
        del indices[hover]
        along = np.delete(along, hover, axis=1)
        climbs = means.climbs(fit.drone, names) * slope
        along[hover] = -np.delete(climbs, hover) / climbs[hover]
        spread = float(np.std(means.hovering(fit.drone)))
        error = spread * np.sqrt(1 / fit.model.segments + 1 / NEXT_FLIGHT)
        error = np.hypot(error / slope[hover], np.sqrt(doubt[hover, hover]))
        noise = generator.normal(0.0, error, (RESAMPLES, 1))
    if LAG in measured_delays and SLOWING_DOWN in names:
        lag, ratio = names.index(LAG), names.index(SLOWING_DOWN)
        steps = np.eye(len(indices))
        steps[indices.index(lag), indices.index(ratio)] = (
            slope_by_ratio(fit.drone) * slope[ratio] / slope[lag]
        )
        along = along @ steps
    return _Free(indices, along, hover, noise, spread)


def _known_moves(
    about: _About,
    indices: Sequence[int],
    measured_delays: Mapping[str, Float[np.ndarray, "N"]],
    others: Others,
    generator: np.random.Generator,
) -> dict[int, Float[np.ndarray, "N"]]:
    """Moves of those parameters that have samples of their own, by index, about the drone's."""
    fit, size = about.fit, len(about.fit.box.names)
    moves = {}
    for index in indices:
        name = about.names[index]
        if index >= size:
            moves[index] = others.moves[:, index - size]
        elif name in measured_delays:
            samples = measured_delays[name] * (
                float(component(fit.drone, name)) / max(np.median(measured_delays[name]), 1e-9)
            )
            if len(samples) != RESAMPLES:
                samples = generator.choice(samples, RESAMPLES)
            unit = fit.box.unit(np.tile(samples[:, None], (1, size)))
            moves[index] = unit[:, index] - fit.optimum[index]
    return moves


def _moves(
    about: _About,
    free: _Free,
    known: Mapping[int, Float[np.ndarray, "N"]],
    doubt: Float[np.ndarray, "d d"],
    generator: np.random.Generator,
    *,
    at_least_laplace: bool,
) -> Float[np.ndarray, "N d"]:
    """Moves of the fit's parameters from its optimum, in the unit cube."""
    moves = np.zeros((RESAMPLES, len(free.indices)))
    is_known = np.array([index in known for index in free.indices], bool)
    if known:
        moves[:, is_known] = np.stack(list(known.values()), axis=1)
    if not is_known.all():
        own = [index for index in free.indices if index not in known]
        reduced = free.along.T @ about.curvature @ free.along
        inner = reduced[np.ix_(~is_known, ~is_known)]
        covariance = sandwich((about.scores @ free.along)[:, ~is_known], inner)
        if at_least_laplace:
            least = np.diag(inverse(inner)) / about.fit.model.rows
            covariance += np.diag(np.maximum(least - np.diag(covariance), 0.0))
        covariance += doubt[np.ix_(own, own)]
        by_chance = generator.multivariate_normal(
            np.zeros(len(own)), covariance, RESAMPLES, method="eigh"
        )
        # The rest of the optimum follows what is known of the others, and of hovering.
        pull = moves[:, is_known] @ reduced[np.ix_(is_known, ~is_known)]
        if free.hover is not None:
            pull += free.noise * (free.along.T @ about.curvature[:, free.hover])[~is_known]
        moves[:, ~is_known] = by_chance - pull @ inverse(inner)
    moves = (moves @ free.along.T)[:, : len(about.fit.box.names)]
    if free.hover is not None:
        moves[:, free.hover] += free.noise[:, 0]
    return moves
