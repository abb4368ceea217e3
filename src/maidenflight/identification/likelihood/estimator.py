"""Estimating a drone's parameters by an observation model, whatever it observes.

Parameters are chosen by the likelihood of held-out flights, several trials descend to its maximum,
fits in other ways show what it does not know of, and samples of the posterior say how far each
parameter may lie from there. Requested and known parameters are a `Question`.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from jaxtyping import Float

from maidenflight.identification.drone_file import Estimate, GroupGain
from maidenflight.identification.likelihood import selection
from maidenflight.identification.likelihood.fit import Fit, balance, fit
from maidenflight.identification.likelihood.laplace import (
    NO_OTHERS,
    Others,
    Posterior,
    posterior,
)
from maidenflight.identification.likelihood.measured import Measured
from maidenflight.identification.likelihood.observation import BY_MOMENT, MOTORS, ObservationModel
from maidenflight.identification.likelihood.selection import Parts
from maidenflight.identification.methods import Likelihood
from maidenflight.identification.outcome.about_z import ABOUT_Z, AboutZ, with_inertia_z
from maidenflight.identification.outcome.bounds import all_reached
from maidenflight.identification.outcome.estimates import estimates_of
from maidenflight.identification.outcome.plausible import ExpectedInterval, Ranges
from maidenflight.identification.outcome.problem import Problem, require_identifiable
from maidenflight.identification.outcome.progress import FITTING, INTERVALS
from maidenflight.identification.signals.lag import DELAYS
from maidenflight.identification.uncertainty import Evidence, interval, inverse
from maidenflight.identification.unknowns import Box
from maidenflight.parameters import Parameters, component
from maidenflight.parameters import replace as replace_values

_LATTICE: Mapping[str, int] = dict(zip(DELAYS, (5, 11), strict=True))
"""Lags and latencies from bound to bound of which the likeliest begin the search: of latencies one
every 5 ms, as wide as the optima of logs at 500 Hz; paper/identification/truth_board.py."""


Ways = Mapping[str, tuple[ObservationModel, Sequence[str]]]
"""Other ways of fitting: the model and its parameters, by name."""


@dataclass(frozen=True)
class Question:
    """Parameters to estimate, and what is known besides."""

    model: ObservationModel
    names: tuple[str, ...]
    """Parameters to fit."""
    start: Parameters
    """Where the search begins, and the fixed parameters."""
    pilot: ObservationModel | None = None
    """A quicker model, on which a random start comes near the optimum."""
    parts: Parts | None = None
    """By which groups of parameters are chosen; none are without."""
    groups: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """Parameters that are added if they predict held-out flight better."""
    samples: Mapping[str, Float[np.ndarray, "N"]] = field(default_factory=dict)
    """Samples of parameters that logs show by themselves, and which are not searched for."""
    others: Callable[[Parameters], Others] = lambda drone: NO_OTHERS
    """From the drone found, parameters that are not fitted and have samples of their own."""
    ways: Callable[[tuple[str, ...]], Ways] = lambda names: {}
    """Other ways of fitting some parameters."""
    doubt: Callable[[Fit, Mapping[str, Fit]], Float[np.ndarray, "d d"]] = lambda fit, others: (
        np.zeros((len(fit.box.names),) * 2)
    )
    """From the fit and those in other ways, the covariance in the unit cube of what they show."""
    at_least_laplace: bool = False
    """Whether no variance is below that of a model which is right."""


@dataclass(frozen=True)
class Answer:
    """What answers a `Question`."""

    fits: tuple[Fit, ...]
    """One for each trial."""
    best: Fit
    """The lowest of them."""
    posterior: Posterior
    gains: tuple[GroupGain, ...]
    """Of each group of parameters that was tried."""
    unidentifiable: Ranges = field(default_factory=dict)
    """Requested parameters that keep the start's value, with the range that is plausible."""

    @property
    def samples(self) -> dict[str, Float[np.ndarray, "N"]]:
        """Samples of the posterior by parameter, SI units."""
        return self.posterior.samples

    def without(
        self, removed_ranges: Ranges, start: Parameters, generator: np.random.Generator
    ) -> "Answer":
        """Returns the same without some parameters.

        They have the start's values, and samples anywhere in the ranges that are plausible.
        """
        values = {name: np.float32(component(start, name)) for name in removed_ranges}
        drone = replace_values(self.best.drone, **values)
        others = {
            **self.posterior.others,
            **Others.from_ranges(removed_ranges, drone, generator).samples,
        }
        return replace(
            self,
            best=replace(self.best, drone=drone),
            posterior=replace(self.posterior, others=others),
            unidentifiable={**self.unidentifiable, **removed_ranges},
        )

    def surely_needed(self, names: Collection[str], start: Parameters) -> set[str]:
        """Returns those of some parameters whose start's value costs `SMALLEST_GAIN`.

        The others follow. They stay however wide they are: the start's value would be wrong, and so
        would all others beside it. Not those of motors, which what else the model lacks moves, nor
        those that no likelihood tells, nor those at a search bound.
        """
        best, error = self.best, self.posterior.error
        _, _, curvatures = best.model.derivatives(best.drone, best.box.names)
        variances = np.diag(inverse(curvatures.sum(axis=0)))
        needed = set()
        for name, variance in zip(best.box.names, variances, strict=True):
            moved = float(component(start, name)) - float(component(best.drone, name))
            judged = name in set(names) - {*MOTORS, *BY_MOMENT} and np.isfinite(error[name])
            if judged and 0.5 * moved**2 / variance > selection.SMALLEST_GAIN:
                needed.add(name)
        return needed


@dataclass(frozen=True)
class Joint:
    """What answers found together: a drone with the inertia about z that belongs to it."""

    drone: Parameters
    draws: Mapping[str, Float[np.ndarray, "N"]]
    """Samples of the posterior by parameter, SI units."""
    estimates: Mapping[str, Estimate]
    box: Box
    """Of the estimates' parameters."""
    runs: Sequence[tuple[np.ndarray, np.ndarray]]
    """Points evaluated in each trial, in the box's unit cube, and their values."""
    notes: tuple[str, ...]


def join(
    problem: Problem,
    answers: Sequence[Answer],
    unidentifiable: Collection[str],
    *,
    follows_about_z: bool = True,
) -> Joint:
    """Returns what answers about some flights found together.

    Args:
        problem: bounds of the search, and random numbers.
        answers: the last has the drone of all.
        unidentifiable: parameters that keep the start's value.
        follows_about_z: whether the inertia about z follows those about x and y.

    Raises:
        InputError: no requested parameter is identifiable.
    """
    draws = {name: samples for answer in answers for name, samples in answer.samples.items()}
    spread = {name: size for answer in answers for name, size in answer.posterior.spread.items()}
    about_z = AboutZ(answers[-1].best.drone, draws, spread, ())
    if follows_about_z and "inertia_z" not in (problem.over or ()):
        about_z = with_inertia_z(problem.start, *about_z[:3], unidentifiable, problem.generator)
    drone, draws, spread, notes = about_z
    names = tuple(name for name in draws if name not in unidentifiable)
    require_identifiable(names, unidentifiable)
    box = problem.box(names)
    fits = [fit for answer in answers for fit in sorted(answer.fits, key=lambda fit: fit.value)]
    runs = [_in_box(fit, box, drone) for fit in fits]
    optimum = box.unit_of(drone)
    optima = np.array([points[int(np.argmin(values))] for points, values in runs])
    optima[0] = optimum
    samples = box.unit(np.stack([draws[name] for name in names], axis=1))
    deviations = np.array([spread.get(name, 0.0) for name in names])
    ends = interval(np.clip(samples, 0.0, 1.0))
    estimates = estimates_of(box, optimum, optima, ends, deviations)
    return Joint(drone, draws, estimates, box, runs, notes)


@dataclass(frozen=True)
class Found:
    """What the likelihoods of some flights found, of which a result is put together."""

    answers: tuple[Answer, ...]
    signals: Measured
    """What signals showed by themselves."""
    joint: Joint
    unidentifiable: Ranges
    """Plausible range of each parameter that the flights cannot tell."""
    evidence: Sequence[Evidence]
    """What each signal says by itself of each parameter."""
    start_value: float
    """Minus the mean log likelihood of a row under the start."""
    windows: int
    notes: tuple[str, ...]
    """What makes these flights doubtful."""
    expected: Mapping[str, ExpectedInterval] = field(default_factory=dict)
    """What flights could tell, before anything was fitted."""
    noise: Mapping[str, float] = field(default_factory=dict)
    """Of sensors and motors, as fields of `parameters`."""


def _in_box(
    fit: Fit, box: Box, drone: Parameters
) -> tuple[Float[np.ndarray, "n d"], Float[np.ndarray, "n"]]:
    """Points of a search in a box of other parameters, those that it lacks as in the drone found.

    That about z, and what yaw shows as shares of it, is in proportion.
    """
    points, own = np.tile(box.unit_of(drone), (len(fit.points), 1)), fit.box.values(fit.points)
    values = box.values(points)
    about_z = float(component(drone, "inertia_z") / component(fit.drone, "inertia_z"))
    for column, name in enumerate(box.names):
        if name in fit.box.names:
            scale = about_z if name in (*ABOUT_Z, "inertia_z") else 1.0
            values[:, column] = scale * own[:, fit.box.names.index(name)]
    return box.unit(values), fit.values


def answer_question(problem: Problem, settings: Likelihood, question: Question) -> Answer:
    """Answers a question.

    Args:
        problem: bounds of the search, random numbers and what is told of progress.
        settings: uses `trials` and `evaluations`.
        question: the parameters to estimate.

    Raises:
        InputError: there is nothing to fit, or something that cannot be searched.
    """
    question = replace(question, start=_with_likeliest_delays(problem, question))
    names, first, gains = _choose(problem, settings.evaluations, question)
    fits, best = _trials(problem, settings, question, names, first)
    fit_result, tell = fits[best], problem.reporter.stage
    tell(INTERVALS, 0, 2)
    others = {
        way: fit(
            problem.box(some),
            settings.evaluations,
            [model],
            fit_result.drone,
            question.samples,
            problem.reporter.evaluated,
        )
        for way, (model, some) in question.ways(names).items()
    }
    tell(INTERVALS, 1, 2)
    posterior_samples = posterior(
        fit_result,
        question.samples,
        question.others(fit_result.drone),
        question.doubt(fit_result, others),
        problem.generator,
        at_least_laplace=question.at_least_laplace,
    )
    tell(INTERVALS, 2, 2)
    return Answer(tuple(fits), fit_result, posterior_samples, tuple(gains))


def _with_likeliest_delays(problem: Problem, question: Question) -> Parameters:
    """Returns the start with those lags and latencies of a lattice that suit the flights best.

    Along the latency the likelihood has optima rows apart, out of which no step leads: from one of
    flights without noise, an inertia of twice the start's ended at its bound.
    """
    searched = [name for name in DELAYS if name in question.names and name not in question.samples]
    if not searched:
        return question.start
    whole, model = problem.box(question.names), question.model
    box = whole.part(searched)
    lattice = product(*(np.linspace(0.0, 1.0, _LATTICE[name]) for name in searched))
    drones = [question.start, *(box.drone(question.start, np.array(unit)) for unit in lattice)]
    return min(drones, key=lambda drone: model(balance(model, drone, whole)))


def _choose(
    problem: Problem, evaluations: int, question: Question
) -> tuple[tuple[str, ...], Parameters, list[GroupGain]]:
    """The parameters that predict held-out flights better, and the best drone of the others."""
    names, parts, groups = question.names, question.parts, question.groups
    if parts is None:
        return names, question.start, []
    models = [parts.sample, parts.training]

    def roughly(names: Sequence[str], first: Parameters) -> Parameters:
        box, count = problem.box(names), problem.reporter.evaluated
        samples, close = question.samples, selection.ROUGH
        return fit(box, evaluations, models, first, samples, count, close=close).drone

    return selection.choose(
        parts,
        roughly,
        question.start,
        names,
        groups,
        problem.reporter.choosing(len(groups)),
        lambda drone, names: all_reached(drone, problem.box(names).limits),
    )


def _trials(
    problem: Problem,
    settings: Likelihood,
    question: Question,
    names: Sequence[str],
    first: Parameters,
) -> tuple[list[Fit], int]:
    """The end of each trial, and which is best."""
    box, most, reporter = problem.box(names), settings.evaluations, problem.reporter
    model, samples, count = question.model, question.samples, reporter.evaluated
    models = [question.pilot or model, model]
    fit_result = list[Fit]()
    for trial in range(settings.trials):
        reporter.stage(FITTING, trial, settings.trials)
        fit_result.append(
            fit(box, most, models, question.start, samples, count, generator=problem.generator)
            if trial
            else fit(box, most, [model], first, samples, count)
        )
    return fit_result, int(np.argmin([fit.value for fit in fit_result]))
