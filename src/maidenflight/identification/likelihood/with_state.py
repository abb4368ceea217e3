"""Identification of flights with a state: the drone under which the next rows are most likely.

`find` finds it and the noise of its sensors and motors, `expected_intervals` what the flights can
tell of it.
"""

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace as replace_
from functools import partial

import numpy as np

from maidenflight.flights.log import Flight
from maidenflight.identification.likelihood import information, other_ways, selection
from maidenflight.identification.likelihood.compiling import start_compiling
from maidenflight.identification.likelihood.estimator import (
    Answer,
    Found,
    Question,
    answer_question,
    join,
)
from maidenflight.identification.likelihood.fit import balance
from maidenflight.identification.likelihood.flight_differences import (
    differences,
    flight_to_flight_sd,
)
from maidenflight.identification.likelihood.laplace import Others
from maidenflight.identification.likelihood.measured import Measured, Samples, measure
from maidenflight.identification.likelihood.noise_levels import (
    correct_walks,
    drift_by_turns,
    noise_levels,
)
from maidenflight.identification.likelihood.observation import BALANCED
from maidenflight.identification.likelihood.one_step import LENGTH, OneStep, one_step_objective
from maidenflight.identification.likelihood.one_step_errors import ORDER
from maidenflight.identification.likelihood.selection import Parts
from maidenflight.identification.methods import Likelihood
from maidenflight.identification.outcome.bounds import equivalent_lag_estimates
from maidenflight.identification.outcome.estimates import (
    note_doubts,
)
from maidenflight.identification.outcome.plausible import (
    HOVERING,
    VARIANCE_SHARE,
    ExpectedInterval,
    Ranges,
    is_identifiable,
    prior_ranges,
)
from maidenflight.identification.outcome.problem import Problem, require_identifiable
from maidenflight.identification.outcome.progress import EXPECTING
from maidenflight.identification.signals.flight_signals import stride, undo_filter_delay
from maidenflight.identification.signals.lag import DELAYS, LAG
from maidenflight.identification.signals.motor_response import is_clear
from maidenflight.identification.uncertainty import Evidence, of_samples
from maidenflight.parameters import Parameters, replace


def find(problem: Problem, settings: Likelihood) -> Found:
    """Finds the drone and the noise under which the flights are most likely.

    Raises:
        InputError: too little flight, or a parameter that cannot be searched.
    """
    if problem.over is not None:
        problem.box(problem.over)
    model = one_step_objective(problem.flights, settings)
    # To look at the motors takes one core.
    threads = start_compiling(problem.flights[0], settings.lead_in)
    signals = measure(problem)
    motors = signals.motors
    problem.reporter.stage(EXPECTING, 0, 1)
    for thread in threads:
        thread.join()
    if motors:
        problem = replace_(problem, flights=list(map(undo_filter_delay, problem.flights)))
        model = one_step_objective(problem.flights, settings)
    flights, measured = problem.flights, _measured(problem, model, signals)
    answer, expected = _answer(problem, settings, model, measured)
    unidentifiable = dict(answer.unidentifiable)
    if motors and motors.usual_latency and "latency" in answer.samples:
        # It belongs to the lag that is told, so that the drone has it, and not the start's.
        unidentifiable["latency"] = motors.usual_latency
    # Who names parameters knows the others.
    joint = join(problem, [answer], unidentifiable, follows_about_z=problem.over is None)
    drone = replace(joint.drone, turn_drift=np.float32(drift_by_turns(flights)))
    products = model.products_about_means(answer.best.drone)
    noise = noise_levels(products, drone, stride(flights[0]) * flights[0].period)
    noise = correct_walks(noise, flights)
    drone = replace(drone, **{name: np.float32(value) for name, value in noise.items()})
    estimates = {**joint.estimates, **flight_to_flight_sd(joint.estimates, flights, drone)}
    if motors and LAG in estimates:
        estimates = equivalent_lag_estimates(estimates)
    return Found(
        (answer,),
        signals,
        replace_(joint, drone=drone, estimates=estimates),
        unidentifiable,
        _evidence(model, answer, signals),
        # A likelihood of one row ahead may fall by the thrust and torques that carry and trim the
        # flights, where rows sample a faster loop: the start has them too.
        start_value=model(balance(model, problem.start, problem.box(BALANCED))),
        windows=int(model.rows) // (LENGTH - ORDER),
        notes=(
            *note_doubts(noise, flights),
            *map(str, differences(flights, model, answer.best.drone, motors)),
        ),
        expected=expected,
        noise=noise,
    )


def _answer(
    problem: Problem, settings: Likelihood, model: OneStep, measured: Samples
) -> tuple[Answer, dict[str, ExpectedInterval]]:
    """Asks again until flights tell all that is asked, and nothing besides; and what they could."""
    expected = _expected_intervals(problem, model, measured)
    problem.reporter.expected(expected)
    unidentifiable = {
        name: interval.prior for name, interval in expected.items() if not interval.identifiable
    }
    decided, groups = set[str](), _groups(problem, measured)
    while True:
        question = _question(problem, settings, model, measured, unidentifiable)
        answer = answer_question(problem, settings, question)
        searched = [name for name in answer.best.box.names if name in expected]
        needed = answer.surely_needed(searched, problem.start) | measured.keys()
        judged = [name for name in searched if name not in needed]
        wide = _too_wide(answer.samples, judged, expected, groups)
        # About a start that is far away noise seems large, and hides what flights tell.
        names = unidentifiable.keys() - decided
        about = _expected_intervals(problem, model, measured, answer.best.drone) if names else {}
        identifiable = {name: about[name] for name in names if about[name].identifiable}
        decided |= {*wide, *identifiable}
        if not wide and not identifiable:
            return replace_(answer, unidentifiable=unidentifiable), expected
        unidentifiable |= {name: expected[name].prior for name in wide}
        expected |= identifiable
        unidentifiable = {
            name: prior for name, prior in unidentifiable.items() if name not in identifiable
        }


def expected_intervals(problem: Problem, settings: Likelihood) -> dict[str, ExpectedInterval]:
    """Returns what flights of the start can tell of the requested parameters, or all.

    Raises:
        InputError: too little flight, or a parameter that cannot be searched.
    """
    signals = measure(problem)
    if signals.motors:
        problem = replace_(problem, flights=list(map(undo_filter_delay, problem.flights)))
    model = one_step_objective(problem.flights, settings)
    return _expected_intervals(problem, model, _measured(problem, model, signals), is_truth=True)


def _expected_intervals(
    problem: Problem,
    model: OneStep,
    measured: Samples,
    drone: Parameters | None = None,
    *,
    is_truth: bool = False,
) -> dict[str, ExpectedInterval]:
    """What flights tell about a drone, or about the start."""
    names, parameter_groups = problem.over, problem.over
    if names is None or parameter_groups is None:
        every = selection.WITH_KNOWN_LAG if LAG in measured else selection.GROUPS
        names, parameter_groups = (
            tuple(dict.fromkeys([*selection.ALWAYS, *measured, *itertools.chain(*some.values())]))
            for some in (every, _groups(problem, measured))
        )
    priors = prior_ranges(problem.start, problem.box(names).limits)
    fit_result = information.expected_intervals(
        *(model, problem.start if drone is None else drone, names, priors),
        measured,
        is_truth=is_truth,
    )
    # What is not even looked for in such flights cannot be told by them either.
    # Of what signals show by themselves its own width decides, not the range about some start.
    known = {name: is_clear(samples) for name, samples in measured.items() if name not in DELAYS}
    if LAG in measured:
        known |= {LAG: is_clear(measured[LAG] + measured["latency"]), "latency": True}
    return {
        name: replace_(
            interval,
            identifiable=known.get(name, interval.identifiable) and name in parameter_groups,
        )
        for name, interval in fit_result.items()
    }


def _groups(problem: Problem, measured: Collection[str]) -> Mapping[str, Sequence[str]]:
    """Parameters that may be chosen."""
    every = selection.groups(problem.flights, has_measured_lag=LAG in measured)
    return selection.leave_out(every, measured)


def _too_wide(
    draws: Mapping[str, np.ndarray],
    names: Sequence[str],
    expected: Mapping[str, ExpectedInterval],
    groups: Mapping[str, Sequence[str]],
) -> list[str]:
    """The parameter that flights tell least beyond its plausible range, and those of its group.

    None at all if they tell all of them. Others may be wide only because of this one. A group is
    there because held-out flights gain by it; without it the others would be biased, so that its
    parameters go only where they are as wide as before.
    """
    added = {name for group in groups.values() for name in group}
    share = {
        name: float(np.std(draws[name]) / np.ptp(expected[name].prior))
        for name in names
        if not is_identifiable(
            float(np.std(draws[name])),
            expected[name].prior,
            1.0 if name in added else VARIANCE_SHARE,
        )
    }
    if not share:
        return []
    widest = max(share, key=lambda name: share[name])
    alike = next((group for group in groups.values() if widest in group), (widest,))
    return [name for name in alike if name in share]


def _question(
    problem: Problem,
    settings: Likelihood,
    model: OneStep,
    measured: Samples,
    unidentifiable: Ranges,
) -> Question:
    """Returns the question about what may be identifiable.

    Raises:
        InputError: no requested parameter is identifiable.
    """
    request = problem.over or tuple(dict.fromkeys([*selection.ALWAYS, *measured]))
    names = tuple(name for name in request if name not in unidentifiable)
    if problem.over is not None:
        require_identifiable(names, unidentifiable)
    return Question(
        model,
        names,
        problem.start,
        _pilot(problem.flights, settings, model),
        _parts(problem.flights, settings) if problem.over is None else None,
        selection.leave_out(_groups(problem, measured), unidentifiable),
        measured,
        partial(Others.from_ranges, unidentifiable, generator=problem.generator),
        partial(other_ways.ways_of_states, problem.flights, settings),
        partial(other_ways.doubt_of_states, measured=LAG in measured),
    )


def _evidence(model: OneStep, answer: Answer, signals: Measured) -> list[Evidence]:
    """What rows, means and signals say of each parameter by themselves."""
    drone, names = answer.best.drone, answer.best.box.names
    likely = [name for name in names if name not in BALANCED]
    means = {name: answer.samples[name] for name in names if name in BALANCED}
    return [
        *of_samples("mean force and torque", means),
        *model.evidence("one row ahead", drone, likely),
        *signals.evidence(float(drone.thrust_to_weight)),
    ]


def _measured(problem: Problem, model: OneStep, signals: Measured) -> Samples:
    """Samples of the parameters that are not searched for but seen, those of thrust apart.

    Lag and gain of a loop belong together: an inertia found by the likelihood beside that lag has
    two optima on short logs of brushless motors, a factor of two apart. Measured speeds tell the
    inertia better.
    """
    if signals.motors is None:
        return signals.inertia
    per_thrust = {} if signals.inertia else signals.motors.inertia_per_thrust
    thrust = model.balance(problem.start)[HOVERING] if per_thrust else 0.0
    by_loop = {name: thrust * samples for name, samples in per_thrust.items()}
    return {**signals.delays, **by_loop, **signals.inertia}


def _parts(flights: Sequence[Flight], settings: Likelihood) -> Parts:
    """The objectives on flights to fit and to judge by."""
    fitting_flights, held_out_flights = selection.split(flights)
    training, held_out = (
        one_step_objective(part, settings) for part in (fitting_flights, held_out_flights)
    )
    return Parts(training, held_out, _pilot(fitting_flights, settings, training))


def _pilot(flights: Sequence[Flight], settings: Likelihood, whole: OneStep) -> OneStep:
    """The objective on some of the windows, or the whole itself where there are hardly more."""
    every = whole.size // settings.pilot_windows
    if every < 2:
        return whole
    return one_step_objective(flights, settings, every)
