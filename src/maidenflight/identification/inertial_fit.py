"""Fitting parameters to what one sensor measured, and what that leaves open.

Each fit is done again in other ways, and what they differ by counts as a standard error: half of it
with white noise, which weighs slow motion more and takes the answers of a controller for causes,
and for inertia with a lag of the gyro's own, so that flights which hardly excite an axis have wide
intervals; all of it on every second row, where commands are samples of a faster loop
(`likelihood` says why).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from dataclasses import replace as replace_

import numpy as np
from jaxtyping import Float

from maidenflight.flights.log import thinned
from maidenflight.identification import posterior, selection
from maidenflight.identification.bounds import any_reached
from maidenflight.identification.box import Box, physical_bounds, search_box
from maidenflight.identification.drone_file import GroupGain
from maidenflight.identification.gauss_newton import (
    INSIDE,
    NormalEquations,
    Rules,
    descend,
    in_unit_cube,
    inside,
)
from maidenflight.identification.inertial_errors import InertialErrors
from maidenflight.identification.inertial_signals import signals
from maidenflight.identification.information import (
    DELAYS,
    HOVERING,
    NEXT_FLIGHT,
    Ranges,
    other_days,
)
from maidenflight.identification.likelihood import Likelihood
from maidenflight.identification.problem import Problem
from maidenflight.identification.progress import FITTING, INTERVALS
from maidenflight.parameters import Parameters, component, replace

ABOUT_Z = ("torque_to_thrust", "rotor_momentum", "torque_bias_z")
"""Parameters that yaw shows, as shares of the inertia about z. Of what white noise differs by, all
counts: no lag of its own tells of a controller's answers there."""
WHITE, OWN_LAG, SPARSER = "white noise", "its own lag", "every second row"
"""Other ways of fitting."""
_SHARES = {WHITE: 0.5, OWN_LAG: 0.5, SPARSER: 1.0}
"""What of their difference counts as a standard error."""
_ANSWERS = 0.15
"""Share of an inertia beyond which white noise only shows a controller's answers, which are hardly
left in the fit itself; its own lag tells where they are."""
FILTER = 1e-3
"""Standard error of the delay of a sensor's own filter [s], which passes for latency. Where
commands are samples of a faster loop, half a row is added."""
_CLOSE = 0.02
"""Gain of the log likelihood of all flights [nats] below which a step is the last."""
_MOST = 20
"""Evaluations of a search at most."""
_AT_BOUND = 0.01
"""Distance from a search bound, as a share of the range, within which a value lies at it."""


@dataclass(frozen=True)
class Fit:
    """The end of one search."""

    target: InertialErrors
    box: Box
    drone: Parameters
    points: Float[np.ndarray, "n d"]
    """Points evaluated, in the box's unit cube."""
    values: Float[np.ndarray, "n"]
    """Minus the mean log likelihood of a step there."""


@dataclass(frozen=True)
class Told:
    """What one sensor tells of d parameters."""

    fits: tuple[Fit, ...]
    """One for each trial, the best first."""
    others: Mapping[str, Fit]
    """Fits done in another way."""
    error: Mapping[str, float]
    """Standard error by parameter, SI units; infinite at a search bound."""
    draws: Mapping[str, Float[np.ndarray, "N"]]
    """Samples of the posterior by parameter, SI units."""
    spread: Mapping[str, float]
    """Standard deviation between segments by parameter, SI units."""
    gains: tuple[GroupGain, ...]
    untold: Ranges = field(default_factory=dict)
    """What was asked for and keeps the start's value, with the range that is plausible."""

    @property
    def best(self) -> Fit:
        """The best trial."""
        return self.fits[0]

    def without(self, lost: Ranges, start: Parameters, generator: np.random.Generator) -> "Told":
        """The same without some parameters.

        They have the start's values, and samples anywhere in the ranges that are plausible.
        """
        values = {name: np.float32(component(start, name)) for name in lost}
        first = replace_(self.best, drone=replace(self.best.drone, **values))
        draws = posterior.RESAMPLES
        anywhere = {name: generator.uniform(*ends, draws) for name, ends in lost.items()}
        return replace_(
            self,
            fits=(first, *self.fits[1:]),
            draws={**self.draws, **anywhere},
            untold={**self.untold, **lost},
        )


def bounds(start: Parameters) -> dict[str, tuple[float, float]]:
    """Physical search bounds about a drone by component, much as `box.physical_bounds`."""
    return {
        **physical_bounds(start),
        "thrust_offset": (-0.5, 0.5),
        "thrust_linear": (-1.0, 2.0),
        # Of logs on board. Where little is excited, a longer latency passes for lag.
        "latency": (0.0, 0.02),
    }


def box_of(problem: Problem, names: Sequence[str]) -> Box:
    """The search box of some parameters."""
    return search_box(names, {**bounds(problem.start), **problem.bounds})


def told(
    problem: Problem,
    settings: Likelihood,
    target: InertialErrors,
    names: tuple[str, ...],
    groups: Mapping[str, Sequence[str]],
    start: Parameters,
    known: Mapping[str, Float[np.ndarray, "N"]],
) -> Told:
    """Fits some parameters to a sensor.

    Args:
        problem: bounds of the search, random numbers and what counts evaluations.
        settings: uses `trials` and `evaluations`.
        target: what the sensor measured.
        names: of the parameters.
        groups: of parameters that are added if they predict held-out flight better.
        start: where to begin, and the parameters that are kept.
        known: samples of some of these, which the others follow.
    """
    gains: list[GroupGain] = []
    most, tell = min(settings.evaluations, _MOST), problem.reporter.stage
    first, parts = start, target.parted() if groups else None
    if parts:
        fitted, judged = parts

        def roughly(some: Sequence[str], begin: Parameters) -> Parameters:
            return _searched(problem, most, fitted, some, begin, selection.ROUGH).drone

        names, first, gains = selection.choose(
            fitted,
            judged,
            roughly,
            start,
            groups,
            problem.reporter.choosing(len(groups)),
            first=names,
            at_bound=lambda drone, names: any_reached(drone, box_of(problem, names).limits),
        )
    tell(FITTING, 0, settings.trials)
    fits = [_searched(problem, most, target, names, first)]
    for trial in range(1, settings.trials):
        tell(FITTING, trial, settings.trials)
        random = problem.generator.random(len(names))
        anywhere = box_of(problem, names).drone(start, random)
        fits.append(_searched(problem, most, target, names, anywhere))
    fits.sort(key=lambda fit: float(fit.values.min()))
    best = fits[0].drone
    tell(INTERVALS, 0, 1)
    others = {WHITE: _searched(problem, most, target.white(), names, best)}
    if {"inertia_x", "inertia_y"} <= set(names):
        others[OWN_LAG] = _searched(problem, most, target, (*names, *DELAYS), best)
    late = FILTER
    if not all(flight.zero_order_hold for flight in problem.flights):
        late = np.hypot(late, problem.flights[0].period / np.sqrt(12))
        sparse = signals([thinned(one, 2) for one in problem.flights], target.signals.sensor)
        sparser = InertialErrors(sparse, target.priors)
        others[SPARSER] = _searched(problem, most, sparser, names, best)
    found = _posterior(fits[0], others, known, float(late), problem.generator)
    tell(INTERVALS, 1, 1)
    return Told(tuple(fits), others, *found, tuple(gains))


def _searched(
    problem: Problem,
    most: int,
    target: InertialErrors,
    names: Sequence[str],
    first: Parameters,
    close: float = 0.0,
) -> Fit:
    """Descends from a drone, until a step gains less than `_CLOSE` in all or `close` a step."""
    box, drones, points, values = box_of(problem, names), [], [], []

    def equations(unit: np.ndarray) -> NormalEquations:
        problem.reporter.evaluated()
        drone = box.drone(first, unit)
        found = target.normal_equations(drone, names)
        drones.append(drone)
        points.append(unit)
        values.append(found.loss)
        return in_unit_cube(found, box, unit)

    small = max(close, _CLOSE / target.rows)
    rules = Rules(1, most - 1, small_gain=small, easing=8.0, firmness=2.0)
    descend(equations, np.clip(box.unit_of(first), INSIDE, 1 - INSIDE), rules, inside, damping=0.0)
    return Fit(target, box, drones[int(np.argmin(values))], np.array(points), np.array(values))


def _posterior(
    fit: Fit,
    others: Mapping[str, Fit],
    known: Mapping[str, Float[np.ndarray, "N"]],
    late: float,
    generator: np.random.Generator,
) -> tuple[dict[str, float], dict[str, Float[np.ndarray, "N"]], dict[str, float]]:
    """Standard errors, samples of the posterior, and the spread between segments, SI units.

    Laplace's approximation with the sandwich covariance, Laplace's own where that is larger;
    widened by the spread, to hold another flight, and by what the `others` differ by. The latency
    has another standard error of `late` [s]. Parameters that are `known` have samples of their own,
    which the others follow.
    """
    names, box, size = fit.box.names, fit.box, len(fit.box.names)
    unit = box.unit_of(fit.drone)
    slope = box.slope(unit)
    _, scores, curvatures = fit.target.derivatives(fit.drone, (*names, *known))
    scores, curvatures = scores * fit.target.rows, curvatures * fit.target.rows
    own, bent = scores[:, :size] * slope, curvatures[:, :size, :size] * np.outer(slope, slope)
    spread = posterior.between_segment_sd(own, bent)
    curvature = bent.sum(axis=0)
    inverse = posterior.inverse(curvature)
    covariance = posterior.sandwich(own, curvature)
    covariance += np.diag(np.maximum(np.diag(inverse) - np.diag(covariance), 0.0))
    covariance += np.diag(spread**2 / NEXT_FLIGHT)
    for way, other in others.items():
        apart = _SHARES[way] * (box.unit_of(other.drone) - unit)
        if way == WHITE:
            about_z = np.array([name in ABOUT_Z for name in names])
            apart = np.where(about_z, 2.0 * apart, apart)
        if way == WHITE and OWN_LAG in others:
            most = _ANSWERS * np.abs(box.values(unit)) / slope
            level = np.array([name in ("inertia_x", "inertia_y") for name in names])
            apart = np.where(level, np.clip(apart, -most, most), apart)
        covariance += np.outer(apart, apart)
    covariance += np.diag([late**2 if name == "latency" else 0.0 for name in names]) / slope**2
    moves = generator.multivariate_normal(
        np.zeros(size), covariance, posterior.RESAMPLES, method="eigh"
    )
    if known:
        values = np.array([float(component(fit.drone, name)) for name in known])
        shifts = np.stack(list(known.values()), axis=1) - values
        crossed = slope[:, None] * curvatures[:, :size, size:].sum(axis=0)
        moves -= shifts @ (inverse @ crossed).T
    if HOVERING in names:
        place = names.index(HOVERING)
        moves[:, place] += other_days(fit.drone, posterior.RESAMPLES, generator) / slope[place]
    errors = np.std(moves, axis=0) * slope
    # A latency or drag of zero is no search bound but where nature ends.
    bounded = (unit > 1 - _AT_BOUND) | ((unit < _AT_BOUND) & (np.array(box.lower) != 0.0))
    samples = box.values(np.clip(unit + moves, 0.0, 1.0))
    return (
        dict(zip(names, np.where(bounded, np.inf, errors).tolist(), strict=True)),
        dict(zip(names, samples.T, strict=True)),
        dict(zip(names, (spread * slope).tolist(), strict=True)),
    )
