"""Identification by maximum likelihood: the drone under which the flights are most likely.

`identified` finds it and the noise of its sensors and motors, `expected_intervals` what the flights
can tell of it.
"""

from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace as replace_

import numpy as np
from jaxtyping import Float

from maidenflight.flights.log import Flight, thinned
from maidenflight.identification import information, lag, laplace, one_step, posterior, selection
from maidenflight.identification.bounds import any_reached, of_seen_lag
from maidenflight.identification.drone_file import GroupGain
from maidenflight.identification.ensembles import as_flights_differ
from maidenflight.identification.estimates import (
    Identification,
    doubts,
    estimates_of,
    evaluations_table,
    notes_on,
)
from maidenflight.identification.fitting import Fit, box_of, fit
from maidenflight.identification.flight_differences import differences
from maidenflight.identification.flight_signals import sharp, stride
from maidenflight.identification.information import DELAYS, LAG, Expected
from maidenflight.identification.likelihood import Likelihood, one_step_objective
from maidenflight.identification.motor_response import MotorResponse, motor_response
from maidenflight.identification.noise_levels import noise_levels
from maidenflight.identification.one_step import OneStep
from maidenflight.identification.one_step_errors import ORDER
from maidenflight.identification.problem import Problem, must_tell
from maidenflight.identification.progress import EXPECTING, FITTING, INTERVALS, MOTOR_LAG
from maidenflight.parameters import Parameters, check, replace

_SPARSER = 2
"""Rows to one that is kept, where it is tried what a sparser log would change."""
_TURNING = (*selection.FIRST, "spin_down_ratio", "inertia_x", "inertia_y")
"""What decides, together, how fast the drone answers a command."""
_LATENCIES = (0.002, 0.02)
"""Latencies from which an optimum is looked for too [s]."""
_APART = 0.005
"""Difference from the start's latency above which that is another place to begin [s]."""
_CLEARLY = 0.1
"""Log-likelihood gain of a row [nats] above which another optimum is clearly better."""


def identified(problem: Problem, settings: Likelihood) -> Identification:
    """Finds the drone and the noise under which the flights are most likely.

    Raises:
        InputError: too little flight, or a parameter that cannot be searched.
    """
    if problem.over is not None:
        box_of(problem, problem.over)
    start, coarse = problem.start, _coarse(problem, settings)
    # Programs depend on the flights' shapes alone, and to look at the motors takes one core.
    with ThreadPoolExecutor(1) as pool:
        compiled = pool.submit(coarse.compile, start)
        motors = _motors(problem)
        problem.reporter.stage(EXPECTING, 0, 1)
        compiled.result()
    if motors:
        problem = _sharp(problem)
        coarse = _coarse(problem, settings)
    flights = problem.flights
    fine = one_step_objective(flights, settings, settings.physics_step)
    expected = _expected(problem, coarse, motors)
    problem.reporter.expected(expected)
    untold = {name: one.prior for name, one in expected.items() if not one.identifiable}
    while True:
        found, best, gains = _searched(problem, settings, coarse, fine, motors, untold)
        drone, box, optimum, _, values = found[best]
        seen = _seen(motors, box.names)
        problem.reporter.stage(INTERVALS, 0, 2)
        missed = _sampling_error(problem, settings, found[best], seen)
        problem.reporter.stage(INTERVALS, 1, 2)
        samples, whole, deviation = laplace.samples(
            fine, found[best], seen, untold, missed, problem.generator
        )
        draws = dict(zip(whole.names, whole.values(samples).T, strict=True))
        wide = _too_wide(draws, box.names, expected, _groups(problem, motors))
        if not wide:
            break
        untold |= {name: expected[name].prior for name in wide}
    problem.reporter.stage(INTERVALS, 2, 2)
    interval = posterior.interval(samples[:, : len(box.names)])
    left = fine.products_about_means(drone)
    noise = noise_levels(left, drone, stride(flights[0]) * flights[0].period)
    drone = replace(drone, **{name: np.float32(value) for name, value in noise.items()})
    optima = np.array([one.points[int(np.argmin(one.values))] for one in found])
    estimates = estimates_of(box, optimum, optima, interval, deviation)
    estimates |= as_flights_differ(estimates, flights, drone)
    if LAG in seen:
        estimates = of_seen_lag(estimates)
    looks = lag.looks(motors, flights, draws, untold, drone)
    return Identification(
        parameters=check(drone, "identified parameters"),
        estimates=estimates,
        unidentified=untold,
        expected=expected,
        objective="likelihood",
        value=float(values.min()),
        start_value=fine(start),
        source=problem.source,
        windows=int(fine.rows) // (one_step.LENGTH - ORDER),
        evaluations=sum(len(one.values) for one in found),
        seconds=0.0,
        search=evaluations_table(box, [(one.points, one.values) for one in found]),
        posterior=draws,
        gains=tuple(gains),
        noise=noise,
        notes=(
            *notes_on(estimates, fine.segments),
            *doubts(noise, flights),
            *map(str, differences(flights, coarse, drone, motors)),
            *lag.notes(looks, motors),
        ),
        lag_looks=looks,
    )


def expected_intervals(problem: Problem, settings: Likelihood) -> dict[str, Expected]:
    """What the flights can tell of the parameters that are asked for, or that may be chosen.

    Raises:
        InputError: too little flight, or a parameter that cannot be searched.
    """
    motors = _motors(problem)
    if motors:
        problem = _sharp(problem)
    return _expected(problem, _coarse(problem, settings), motors)


def _sharp(problem: Problem) -> Problem:
    """The flights with the gyro's delay undone, for those that show the motors."""
    return replace_(problem, flights=[sharp(flight) for flight in problem.flights])


def _coarse(problem: Problem, settings: Likelihood) -> OneStep:
    """The objective by which parameters are chosen."""
    return one_step_objective(problem.flights, settings, settings.coarse_physics_step)


def _expected(
    problem: Problem, coarse: OneStep, motors: MotorResponse | None
) -> dict[str, Expected]:
    names, offered = problem.over, problem.over
    if names is None or offered is None:
        every = selection.WITH_KNOWN_LAG if motors else selection.GROUPS
        names, offered = (
            (*selection.FIRST, *(name for group in some.values() for name in group))
            for some in (every, _groups(problem, motors))
        )
    priors = information.prior_ranges(problem.start, box_of(problem, names).limits)
    found = information.expected(coarse, problem.start, names, priors, _seen(motors, names))
    # What is not even looked for in such flights cannot be told by them either.
    return {
        name: replace_(one, identifiable=one.identifiable and name in offered)
        for name, one in found.items()
    }


def _groups(problem: Problem, motors: MotorResponse | None) -> Mapping[str, Sequence[str]]:
    """Parameters that may be chosen."""
    return selection.groups(problem.flights, lag_seen=motors is not None)


def _too_wide(
    draws: Mapping[str, np.ndarray],
    names: Sequence[str],
    expected: Mapping[str, Expected],
    groups: Mapping[str, Sequence[str]],
) -> list[str]:
    """The parameter whose interval exceeds its plausible range most, and those of its group.

    None at all if all are narrower. Others may be wide only because of this one.
    """
    share = {}
    for name in names:
        low, high = posterior.interval(draws[name])
        share[name] = float((high - low) / np.ptp(expected[name].prior))
    widest = max(share, key=lambda name: share[name])
    alike = next((group for group in groups.values() if widest in group), (widest,))
    return [name for name in alike if share.get(name, 0.0) >= 1.0]


def _searched(
    problem: Problem,
    settings: Likelihood,
    coarse: OneStep,
    fine: OneStep,
    motors: MotorResponse | None,
    untold: Collection[str],
) -> tuple[list[Fit], int, list[GroupGain]]:
    """The end of each trial, which is best, and the gain of each group that was tried.

    Raises:
        InputError: the flights tell no parameter that is asked for.
    """
    start, over, gains = problem.start, problem.over, []
    first = start
    if over is None:
        over, first, gains = _chosen(problem, settings, motors, untold)
    over = tuple(name for name in over if name not in untold)
    must_tell(over, untold)
    seen, most = _seen(motors, over), settings.evaluations
    pilot = _pilot(problem.flights, settings, coarse)
    fits, tell = settings.trials + 1, problem.reporter.stage
    tell(FITTING, 0, fits)
    # The last steps are the fine objective's, whose optimum is farther away than this.
    rough = selection.ROUGH
    found = [fit(problem, most, [coarse], over, first, seen, close=rough)]
    for trial in range(1, settings.trials):
        tell(FITTING, trial, fits)
        found.append(
            fit(problem, most, [pilot, coarse], over, start, seen, at_random=True, close=rough)
        )
    best = int(np.argmin([one.values.min() for one in found]))
    tell(FITTING, settings.trials, fits)
    found[best] = fit(problem, most, [fine], over, found[best].drone, seen)
    return found, best, gains


def _motors(problem: Problem) -> MotorResponse | None:
    """What logs show of the motors' lag, if it is asked for."""
    asked = selection.FIRST if problem.over is None else problem.over
    if not set(DELAYS) <= set(asked):
        return None

    def looked(done: int, of: int) -> None:
        problem.reporter.stage(MOTOR_LAG, done, of)

    looked(0, 0)
    return motor_response(problem.flights, problem.generator, problem.start, looked)


def _seen(motors: MotorResponse | None, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Samples of the parameters that are not searched for but seen, those of thrust apart."""
    if motors is None:
        return {}
    seen = dict(zip(DELAYS, (motors.lag, motors.latency), strict=True))
    return {name: samples for name, samples in seen.items() if name in names}


def _sampling_error(
    problem: Problem, settings: Likelihood, found: Fit, seen: Mapping[str, np.ndarray]
) -> Float[np.ndarray, "d"]:
    """Standard deviation, in the unit cube, that comes from commands which the logs do not hold.

    Parameters of logs with one command in several are identified from every second row too. An
    error that grows with the distance of rows is as large as what this changes.

    Source: Richardson 1911, The approximate arithmetical solution by finite differences (error from
    the change with the step).
    """
    if all(one.zero_order_hold for one in problem.flights):
        return np.zeros(len(found.optimum))
    sparse = [thinned(one, _SPARSER) for one in problem.flights]
    target = one_step_objective(sparse, settings, _SPARSER * settings.physics_step)
    there = fit(problem, settings.evaluations, [target], found.box.names, found.drone, seen)
    return np.abs(there.optimum - found.optimum)


def _chosen(
    problem: Problem,
    settings: Likelihood,
    motors: MotorResponse | None,
    untold: Collection[str],
) -> tuple[tuple[str, ...], Parameters, list[GroupGain]]:
    """The parameters that predict held-out flights better, and the best drone of the others."""
    fitted, judged = selection.split(problem.flights)
    training, held_out = (
        one_step_objective(part, settings, settings.coarse_physics_step)
        for part in (fitted, judged)
    )
    sample = _pilot(fitted, settings, training)
    always = tuple(name for name in selection.FIRST if name not in untold)
    seen = _seen(motors, always)
    groups = {
        group: told
        for group, names in _groups(problem, motors).items()
        if (told := tuple(name for name in names if name not in untold))
    }

    def roughly(names: Sequence[str], first: Parameters) -> Parameters:
        return fit(
            problem,
            settings.evaluations,
            [sample, training],
            names,
            first,
            seen,
            close=selection.ROUGH,
        ).drone

    return selection.choose(
        training,
        held_out,
        roughly,
        problem.start if motors else _beside_optimum(problem, settings, sample, untold),
        groups,
        problem.reporter.choosing(len(groups)),
        sample,
        always,
        lambda drone, names: any_reached(drone, box_of(problem, names).limits),
    )


def _beside_optimum(
    problem: Problem, settings: Likelihood, sample: OneStep, untold: Collection[str]
) -> Parameters:
    """The start, or the start with another lag and latency if these lead to a better optimum.

    Without noise the likelihood has an optimum for each latency of about a row, of which the start
    may be beside the wrong one: all that turns the drone then makes up for it.
    """
    names = tuple(name for name in _TURNING if name not in untold)
    best, least = problem.start, np.inf
    for latency in (None, *_LATENCIES):
        if latency is None:
            begin = problem.start
        elif abs(latency - float(problem.start.latency)) > _APART:
            begin = replace(problem.start, latency=np.float32(latency))
        else:
            continue
        found = fit(problem, settings.evaluations, [sample], names, begin, {}, close=_CLEARLY)
        value = float(found.values.min())
        if value < least - _CLEARLY:
            kept = {name: getattr(found.drone, name) for name in DELAYS if name in names}
            least = value
            best = problem.start if latency is None else replace(problem.start, **kept)
    return best


def _pilot(flights: Sequence[Flight], settings: Likelihood, whole: OneStep) -> OneStep:
    """The objective on some of the windows, or the whole itself where there are hardly more."""
    every = whole.size // settings.pilot_windows
    if every < 2:
        return whole
    return one_step_objective(flights, settings, settings.coarse_physics_step, every)
