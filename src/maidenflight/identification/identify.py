"""Identifying a drone's parameters from flights: values, intervals and the noise.

The class of the settings chooses the method. `Likelihood` looks one row ahead and models what it
cannot predict; feedback does not bias it. `Replay` is the paper's: it looks many rows ahead, open
loop.
"""

import dataclasses
import time
from collections.abc import Callable, Iterable, Mapping, Sequence

from jaxtyping import Array

from maidenflight.errors import InputError
from maidenflight.flights.log import Flight, flights_of
from maidenflight.identification.likelihood import with_state, without_state
from maidenflight.identification.likelihood.estimator import Found
from maidenflight.identification.methods import Likelihood, Replay
from maidenflight.identification.outcome.battery_laws import average_laws
from maidenflight.identification.outcome.estimates import (
    Identification,
    evaluations_table,
    note_gains_lost,
    note_worse_than_start,
    notes_on,
)
from maidenflight.identification.outcome.narrowing import (
    advise,
    inseparable_from_thrust,
    note_inseparable,
)
from maidenflight.identification.outcome.plausible import ExpectedInterval, prior_ranges
from maidenflight.identification.outcome.problem import AUTO, Problem
from maidenflight.identification.outcome.progress import Progress
from maidenflight.identification.posterior import Posterior
from maidenflight.identification.replay import replay
from maidenflight.identification.signals import lag
from maidenflight.identification.signals.alignment import align_commands
from maidenflight.inputs import PATHS, StrPath
from maidenflight.parameters import Parameters, check, read_drone


def identify(
    flights: Iterable[Flight] | StrPath,
    settings: Likelihood | Replay | None = None,
    *,
    start: Parameters | StrPath | None = None,
    over: Sequence[str] | str | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    key: Array | int | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> Identification:
    """Identifies parameters from flights.

    Args:
        flights: checked flights of one rate, or a log or folder of logs. All of them stay in
            memory; of many hours, give what `sampling.sampled` keeps.
        settings: of the method, which their class chooses; `Likelihood()` by default.
        start: the drone of the other parameters, or its name or file; the paper's Crazyflie by
            default.
        over: names of `parameters.COMPONENTS` to identify, or `AUTO`: those that predict held-out
            flights better (likelihood only). By default `AUTO`; for a replay the paper's three.
        bounds: search bounds by name, SI units; by default physical ones for a likelihood and
            the paper's for a replay.
        key: random key, or a whole number that makes one.
        on_progress: called with the stage and how far it is; once with `expected_intervals`, before
            anything is fitted by likelihood.

    Returns:
        The best point found in any trial, its interval, and how it was found. Cost grows linearly
        with the windows.

    Raises:
        InputError: an unknown or unbounded parameter, too little flight, or rows farther apart than
            `LONGEST_PERIOD`.
    """
    began = time.perf_counter()
    settings = Likelihood() if settings is None else settings
    if not isinstance(settings, Likelihood | Replay):
        raise InputError(f"settings = {settings!r}; expected Likelihood(...) or Replay(...).")
    if over == AUTO and isinstance(settings, Replay):
        raise InputError(
            "parameters are chosen by likelihood only: a replay rewards whatever damps. Use "
            "Likelihood, or name them."
        )
    flights, left_out = of_one_kind(flights)
    stateless = bool(flights) and not flights[0].has_state
    if stateless and isinstance(settings, Replay):
        raise InputError(
            f"{flights[0].name}: no position, velocity and attitude in it, which a replay is "
            "compared with. Use Likelihood (--objective likelihood)."
        )
    problem = Problem.of(flights, _drone(start), over, bounds, key, on_progress)
    flights, late = align_commands(problem.flights, problem.start)
    problem = dataclasses.replace(problem, flights=flights)
    if isinstance(settings, Replay):
        result = replay.identified(problem, settings)
    else:
        find = without_state.find if stateless else with_state.find
        result = _result(problem, find(problem, settings))
    result = average_laws(result, flights, problem.generator)
    searched = {
        name: estimate.bounds or estimate.interval for name, estimate in result.estimates.items()
    }
    plausible = prior_ranges(problem.start, searched)
    estimates = {
        name: dataclasses.replace(estimate, plausible=plausible[name])
        for name, estimate in result.estimates.items()
    }
    worse = note_worse_than_start(result.value, result.start_value, result.objective)
    notes = (*worse, *left_out, *result.notes)
    seconds = time.perf_counter() - began
    return dataclasses.replace(
        result, estimates=estimates, notes=notes, warnings=tuple(late), seconds=seconds
    )


def _result(problem: Problem, found: Found) -> Identification:
    """Puts together what likelihoods found, whatever they are of."""
    joint, motors, unidentifiable = found.joint, found.signals.motors, found.unidentifiable
    delays = lag.delay_evidence(motors, joint.draws, unidentifiable, joint.drone)
    gains = tuple(gain for answer in found.answers for gain in answer.gains)
    segments = found.answers[0].best.model.segments
    inseparable = inseparable_from_thrust(joint.estimates, joint.draws, problem.flights)
    others = {
        name: estimate for name, estimate in joint.estimates.items() if name not in inseparable
    }
    return Identification(
        parameters=check(joint.drone, "identified parameters"),
        estimates=joint.estimates,
        unidentified=unidentifiable,
        expected=found.expected,
        objective="likelihood",
        value=sum(answer.best.value for answer in found.answers),
        start_value=found.start_value,
        source=problem.source,
        windows=found.windows,
        evaluations=sum(len(values) for _, values in joint.runs),
        search=evaluations_table(joint.box, joint.runs),
        posterior=Posterior(joint.draws),
        advice=advise(joint.estimates, unidentifiable, joint.draws, motors, inseparable),
        gains=gains,
        noise=found.noise,
        notes=(
            *notes_on(others, segments, problem.by_battery_law),
            *note_inseparable(inseparable, problem.flights),
            *note_gains_lost(gains),
            *found.notes,
            *joint.notes,
            *lag.notes(delays, motors),
        ),
        evidence=(*delays, *found.evidence),
    )


def of_one_kind(flights: Iterable[Flight] | StrPath) -> tuple[list[Flight], list[str]]:
    """Returns the flights with a state if any has one, else all; and a note on those left out."""
    flights = flights_of(flights)
    whole = [flight for flight in flights if flight.has_state]
    bare = list(dict.fromkeys(flight.name for flight in flights if not flight.has_state))
    if not whole or not bare:
        return flights, []
    return whole, [
        f"{len(bare)} flights without position, velocity and attitude left out "
        f"({', '.join(bare[:3])}{' ...' if len(bare) > 3 else ''}), since others have them; "
        "identify from those alone to compare."
    ]


def _drone(start: Parameters | StrPath | None) -> Parameters | None:
    return read_drone(start) if isinstance(start, PATHS) else start


def expected_intervals(
    flights: Iterable[Flight] | StrPath,
    settings: Likelihood | None = None,
    *,
    start: Parameters | StrPath | None = None,
    over: Sequence[str] | str | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    key: Array | int | None = None,
) -> dict[str, ExpectedInterval]:
    """Returns what flights can tell of each parameter, before anything is fitted; in seconds.

    Args:
        flights: as of `identify`.
        settings: of the likelihood; `Likelihood()` by default.
        start: the drone about which intervals are expected; the paper's Crazyflie by default.
        over: names of `parameters.COMPONENTS`, or `AUTO`: all that may be chosen, as by default.
        bounds: search bounds by name, SI units, which no plausible range exceeds.
        key: random key, or a whole number that makes one.

    Returns:
        By parameter the plausible range, the interval to expect, and whether the flights say more
        than that range.

    Raises:
        InputError: an unknown or unbounded parameter, or too little flight.
    """
    flights, _ = of_one_kind(flights)
    if flights and not flights[0].has_state:
        raise InputError(
            f"{flights[0].name}: no position, velocity and attitude in it, without which nothing "
            "is said beforehand. Identify from it."
        )
    problem = Problem.of(flights, _drone(start), over, bounds, key)
    return with_state.expected_intervals(problem, settings or Likelihood())
