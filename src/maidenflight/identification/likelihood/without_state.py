"""Identification from accelerometer, gyro and motor commands alone.

Thrust and motors are what the accelerometer tells, inertia and torques what the gyro tells, given
the motors: a controller answers the gyro within milliseconds, so that whatever the model lacks
would move the lag there. Drag across and what else these sensors do not show keeps the start's
value, and so does what the flights tell no better than is known without them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace as replace_
from functools import partial

import numpy as np
from jaxtyping import Float

from maidenflight.errors import InputError
from maidenflight.identification.likelihood import other_ways
from maidenflight.identification.likelihood.estimator import (
    Answer,
    Found,
    Question,
    answer_question,
    join,
)
from maidenflight.identification.likelihood.laplace import Others
from maidenflight.identification.likelihood.measured import (
    Measured,
    Samples,
    inertia_of_loop,
    measure,
)
from maidenflight.identification.likelihood.observation import MOTORS
from maidenflight.identification.likelihood.sensor_errors import (
    EVALUATIONS,
    AccelerometerErrors,
    GyroErrors,
    SensorErrors,
)
from maidenflight.identification.methods import Likelihood
from maidenflight.identification.outcome.plausible import (
    HOVERING,
    VARIANCE_SHARE,
    Ranges,
    is_identifiable,
    prior_ranges,
)
from maidenflight.identification.outcome.problem import Problem
from maidenflight.identification.signals.lag import DELAYS, LAG, SLOWING_DOWN
from maidenflight.identification.signals.motor_response import LATENCIES
from maidenflight.identification.signals.thrust_law import note_unexplained, thrust_law
from maidenflight.identification.unknowns import INERTIA
from maidenflight.parameters import QUANTITIES, Parameters, component, replace

FORCE = ("thrust_to_weight", "thrust_linear", *DELAYS, "drag_z")
"""Parameters of the accelerometer."""
FORCE_GROUPS: dict[str, tuple[str, ...]] = {"slowing_down": ("motor_coasting", "spin_down_ratio")}
"""What is added if it predicts held-out flight better. Together, since each passes for much of the
other, and the inertia then found is a fifth off. The thrust of a rotor that stands is not
among it: it is zero, and a motor that coasts passes for it."""
TORQUE = (
    *INERTIA,
    "torque_to_thrust",
    "torque_bias_x",
    "torque_bias_y",
    "torque_bias_z",
)
"""Parameters of the gyro."""
TORQUE_GROUPS: dict[str, tuple[str, ...]] = {"rotor_momentum": ("rotor_momentum",)}
"""Likewise."""
OF_ACCELEROMETER = (
    *FORCE,
    "thrust_offset",
    "motor_coasting",
    "spin_down_ratio",
)
OF_GYRO = (*TORQUE, "inertia_z", "rotor_momentum", "rotational_damping")
CLIMB_DRAG = 0.3
"""Standard deviation of `drag_z` beforehand [1/s]: that of a Crazyflie's climb is 0.4."""
SHAPE, SHAPE_OF_PWM = 0.1, 0.3
"""Standard deviation of `thrust_linear` beforehand: of commands that a battery law made of logged
PWM and voltage, and of others, such as PWM alone, of which a Crazyflie's thrust has 0.27."""
BOUNDS: Mapping[str, tuple[float, float]] = {
    "thrust_linear": (QUANTITIES["thrust_linear"].lower, QUANTITIES["thrust_linear"].upper),
    # Of logs on board. Where little is excited, a longer latency passes for lag.
    "latency": (0.0, float(LATENCIES[-1])),
}
"""Search bounds where they are not those of a log with a state."""


def find(problem: Problem, settings: Likelihood) -> Found:
    """Finds the drone under which what accelerometer and gyro measured is most likely.

    Args:
        problem: its flights need no position, velocity or attitude.
        settings: uses `trials` and `evaluations`.

    Raises:
        InputError: too little flight, or a parameter that these sensors do not show.
    """
    by_force, by_torque = _names_by_sensor(problem.over)
    law = thrust_law(problem.flights, float(problem.start.motor_time_constant))
    flights, bounds = law.read(problem.flights), {**BOUNDS, **problem.bounds}
    problem = replace_(problem, flights=flights, bounds=bounds)
    settings = replace_(settings, evaluations=min(settings.evaluations, EVALUATIONS))
    signals = measure(problem)
    force = _force(problem, settings, by_force, signals, law.limit)
    torque = _torque(problem, settings, by_torque, force, signals, law.limit)
    answers = tuple(answer for answer in (force, torque) if answer is not None)
    unidentifiable = {
        name: ends for answer in answers for name, ends in answer.unidentifiable.items()
    }
    joint = join(problem, answers, unidentifiable)
    evidence = signals.evidence(float(joint.drone.thrust_to_weight))
    for sensor, answer, more in (("accelerometer", force, DELAYS), ("gyro", torque, INERTIA)):
        if answer is not None:
            names = tuple(dict.fromkeys([*answer.best.box.names, *more]))
            evidence += answer.best.model.evidence(sensor, answer.best.drone, names)
    return Found(
        answers,
        signals,
        joint,
        unidentifiable,
        evidence,
        start_value=sum(answer.best.model(problem.start) for answer in answers),
        windows=answers[0].best.model.segments,
        notes=(*law.notes(), *note_unexplained(flights, law, joint.drone)),
    )


def _names_by_sensor(
    over: Sequence[str] | None,
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Parameters to estimate from the accelerometer and from the gyro."""
    if over is None:
        return FORCE, TORQUE
    insensitive_names = [name for name in over if name not in (*OF_ACCELEROMETER, *OF_GYRO)]
    if insensitive_names:
        raise InputError(
            f"{', '.join(insensitive_names)}: not identifiable from accelerometer, gyro and "
            f"commands alone; these are: {', '.join((*OF_ACCELEROMETER, *OF_GYRO))}."
        )
    if {"inertia_z", "torque_to_thrust"} <= set(over):
        raise InputError(
            "inertia_z and torque_to_thrust: yaw shows only their ratio. Name one, or none, where "
            "inertia_z follows inertia_x and inertia_y."
        )
    by_force, by_torque = (
        tuple(name for name in over if name in names) for names in (OF_ACCELEROMETER, OF_GYRO)
    )
    return by_force, by_torque


def _force(
    problem: Problem,
    settings: Likelihood,
    names: tuple[str, ...],
    signals: Measured,
    limit: float,
) -> Answer | None:
    """Fits what the accelerometer shows better than it was known before."""
    if not names:
        return None
    model = AccelerometerErrors.of(problem.flights, _force_priors(problem), limit)
    answer = _force_at_lag(problem, settings, names, model, signals)
    removed_ranges, others = _unchanged(problem, answer)
    answer = _without(problem, settings, model, answer, removed_ranges)
    return replace_(answer, unidentifiable={**answer.unidentifiable, **others})


def _force_at_lag(
    problem: Problem,
    settings: Likelihood,
    names: tuple[str, ...],
    model: AccelerometerErrors,
    signals: Measured,
) -> Answer:
    """Fits what the accelerometer shows, given the lag of measured speeds or the gyro."""
    groups, start = FORCE_GROUPS if problem.over is None else {}, problem.start
    motors = signals.motors
    known = motors if motors and motors.is_identifiable and set(DELAYS) < set(names) else None
    if known is None or known.spin_down_ratio is None:
        answer = _ask_sensor(problem, settings, model, names, groups, start)
        plausible = _plausible(problem, tuple(answer.samples), model.priors)
        identifiable = _lag_is_identifiable(answer, plausible)
        removed_names = [name for name in DELAYS if name in names and not identifiable]
        if not removed_names or known is None:
            if removed_names:
                removed_names = [name for name in answer.samples if name in MOTORS]
            if "thrust_linear" in names and not is_identifiable(
                answer.posterior.error["thrust_linear"], plausible["thrust_linear"]
            ):
                removed_names.append("thrust_linear")
            removed_ranges = {name: plausible[name] for name in removed_names}
            return _without(problem, settings, model, answer, removed_ranges)
    samples = signals.motor_samples(problem.generator)
    middle = {name: np.float32(np.median(draws)) for name, draws in samples.items()}
    # The lag is that of both ways where nothing tells their ratio.
    drone = replace(start, **{SLOWING_DOWN: np.float32(1.0), **middle})
    rest = tuple(name for name in names if name not in DELAYS)
    again = _ask_sensor(problem, settings, model, rest, {}, drone, samples)
    usual = known.usual_latency
    return again if usual is None else replace_(again, unidentifiable={"latency": usual})


def _without(
    problem: Problem,
    settings: Likelihood,
    model: SensorErrors,
    answer: Answer,
    removed_ranges: Ranges,
) -> Answer:
    """Leaves parameters out but those surely needed, and fits the others again.

    Thrust hovers with what is left.
    """
    if removed_ranges:
        needed = answer.surely_needed(removed_ranges, problem.start)
        removed_ranges = {name: span for name, span in removed_ranges.items() if name not in needed}
    if not removed_ranges:
        return answer
    less = answer.without(removed_ranges, problem.start, problem.generator)
    names = tuple(name for name in answer.best.box.names if name not in removed_ranges)
    if not names:
        return less
    known = {name: draws for name, draws in less.samples.items() if name not in names}
    again = _ask_sensor(problem, settings, model, names, {}, less.best.drone, known)
    gains = tuple(
        replace_(gain, is_in_model=False, reason="not identifiable")
        if gain.is_in_model and removed_ranges.keys() & set(FORCE_GROUPS[gain.group])
        else gain
        for gain in answer.gains
    )
    return replace_(again, unidentifiable=less.unidentifiable, gains=gains)


def _ask_sensor(
    problem: Problem,
    settings: Likelihood,
    model: SensorErrors,
    names: tuple[str, ...],
    groups: Mapping[str, Sequence[str]],
    start: Parameters,
    known: Mapping[str, Float[np.ndarray, "N"]] | None = None,
) -> Answer:
    """What a sensor tells of some parameters, given samples of others."""
    question = Question(
        model,
        names,
        start,
        parts=model.parts() if groups else None,
        groups=groups,
        others=partial(Others.from_samples, known or {}),
        ways=partial(other_ways.ways_of_sensor, problem.flights, model),
        doubt=partial(other_ways.doubt_of_sensor, problem.flights),
        at_least_laplace=True,
    )
    return answer_question(problem, settings, question)


def _plausible(
    problem: Problem, names: tuple[str, ...], priors: Mapping[str, tuple[float, float]]
) -> dict[str, tuple[float, float]]:
    """Plausible range of each parameter: of a prior the uniform one of the same variance."""
    limits = problem.box(names).limits
    answer = prior_ranges(problem.start, limits)
    for name in answer.keys() & priors.keys():
        (mean, deviation), (low, high) = priors[name], limits[name]
        reach = np.sqrt(3.0) * deviation
        answer[name] = max(low, float(mean - reach)), min(high, float(mean + reach))
    return answer


def _unchanged(problem: Problem, force: Answer) -> tuple[Ranges, Ranges]:
    """Returns what the accelerometer shows no better than before, although it shows others.

    Apart from the ranges of what keeps the start's value come those of delays, of which a latency
    keeps the value and samples that belong to the lag.
    """
    names = tuple(
        name
        for name in force.samples
        if name not in (HOVERING, LAG) and name not in force.unidentifiable
    )
    if not names:
        return {}, {}
    added = {name for group in FORCE_GROUPS.values() for name in group}
    plausible = _plausible(problem, names, _force_priors(problem))
    left_out, delays = {}, {}
    for name in names:
        share = 1.0 if name in added else VARIANCE_SHARE
        if is_identifiable(float(np.std(force.samples[name])), plausible[name], share):
            continue
        if name in DELAYS:
            low, high = np.quantile(force.samples[name], [0.025, 0.975])
            delays[name] = float(low), float(high)
        else:
            left_out[name] = plausible[name]
    return left_out, delays


def _force_priors(problem: Problem) -> dict[str, tuple[float, float]]:
    """Mean and standard deviation of what is known of the force beforehand."""
    start = problem.start
    shape = SHAPE if problem.by_battery_law else SHAPE_OF_PWM
    return {
        "thrust_linear": (float(start.thrust_linear), shape),
        "drag_z": (float(component(start, "drag_z")), CLIMB_DRAG),
    }


def _lag_is_identifiable(answer: Answer, plausible: Ranges) -> bool:
    """Whether lag and latency together are told, and neither lies at a search bound."""
    if np.isinf([answer.posterior.error.get(name, 0.0) for name in DELAYS]).any():
        return False
    samples = sum(answer.samples[name] for name in DELAYS if name in answer.samples)
    return is_identifiable(
        float(np.std(samples)), plausible.get(DELAYS[0], plausible.get(DELAYS[1], (0, 0)))
    )


def _torque(
    problem: Problem,
    settings: Likelihood,
    names: tuple[str, ...],
    force: Answer | None,
    signals: Measured,
    limit: float,
) -> Answer | None:
    """What the gyro tells, given what the accelerometer tells."""
    if not names:
        return None
    known, drone = ({}, problem.start) if force is None else (force.samples, force.best.drone)
    model = GyroErrors.of(problem.flights, None, limit)
    groups = TORQUE_GROUPS if problem.over is None else {}

    def ask(inertia: Samples) -> tuple[Answer, Ranges]:
        other_names = tuple(name for name in names if name not in inertia)
        medians = {name: np.float32(np.median(samples)) for name, samples in inertia.items()}
        first, draws = replace(drone, **medians), {**known, **inertia}
        answer = _ask_sensor(problem, settings, model, other_names, groups, first, draws)
        plausible, error = _plausible(problem, other_names, {}), answer.posterior.error
        removed_ranges = {
            name: ends for name, ends in plausible.items() if not is_identifiable(error[name], ends)
        }
        return answer, removed_ranges

    answer, removed_ranges = ask({})
    narrower = _narrower(signals.inertia, answer)
    if narrower:
        answer, removed_ranges = ask(narrower)
    # Measured speeds pass over what the loop would tell.
    needs_loop = bool(removed_ranges) and not signals.inertia and problem.over is None
    loop = {}
    if needs_loop and signals.motors is not None:
        loop = inertia_of_loop(problem.flights, signals.motors, known, drone, problem.generator)
    if inertia := {name: samples for name, samples in loop.items() if name in removed_ranges}:
        answer, removed_ranges = ask(inertia)
    return answer.without(removed_ranges, problem.start, problem.generator)


def _narrower(inertia: Samples, answer: Answer) -> Samples:
    """Returns inertia by speeds, if it is known better than the gyro's likelihood has it."""
    errors = answer.posterior.error

    def share(name: str) -> float:
        return errors[name] / float(component(answer.best.drone, name))

    known = [name for name in inertia if name in errors]
    by_gyro = sum(share(name) for name in known)
    by_speeds = sum(float(np.std(np.log(inertia[name]))) for name in known)
    return inertia if by_speeds < by_gyro or len(known) < len(inertia) else {}
