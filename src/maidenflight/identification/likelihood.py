"""Identification by maximum likelihood of one-step errors, which feedback does not bias.

`Likelihood` holds its settings, `identified` finds the drone and the noise of its sensors and
motors.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from dataclasses import replace as replace_
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from maidenflight.flights.log import Flight
from maidenflight.flights.windows import LEAD_IN, SHORTEST_LEAD_IN, windows
from maidenflight.identification import one_step, posterior, selection
from maidenflight.identification.box import Box, search_box
from maidenflight.identification.drone_file import GroupGain
from maidenflight.identification.estimates import (
    Identification,
    doubts,
    estimates_of,
    evaluations_table,
    notes_on,
)
from maidenflight.identification.gauss_newton import (
    INSIDE,
    NormalEquations,
    Rules,
    descend,
    in_unit_cube,
    inside,
)
from maidenflight.identification.motor_response import (
    Look,
    MotorResponse,
    cross_spectrum,
    motor_response,
    sharp,
    stride,
)
from maidenflight.identification.noise_levels import noise_levels
from maidenflight.identification.one_step import OneStep
from maidenflight.identification.problem import Problem, must_be_positive
from maidenflight.parameters import Parameters, check, component, replace

_CLOSE = 0.02
"""Gain of the log likelihood of all flights [nats] below which a step is the last; a fifth of a
standard error changes it by as much."""


HOVERING = "thrust_to_weight"
"""The parameter that is found by its moment: mean thrust carries the weight and what accelerates
the drone. A likelihood of one row ahead hardly weighs what lasts."""
_NEXT_FLIGHT = 6
"""Segments of the flight that intervals are to hold: 30 s."""


@dataclass(frozen=True)
class Likelihood:
    """Settings of identification by likelihood."""

    trials: int = 2
    """Repetitions of the optimiser. The first begins at the start, the others at random."""
    evaluations: int = 60
    """Most evaluations of the likelihood in a trial; it stops by itself after two to six."""
    lead_in: int = LEAD_IN
    """Rows of commands before a window, from which its motors' speed is inferred."""
    physics_step: float = 0.001
    """Nominal physics step [s] of the last steps of the optimiser. At 5 ms a command that arrives
    within a step is resolved so coarsely that the lag comes out 1 ms short."""
    coarse_physics_step: float = 0.002
    """Nominal physics step [s] before that. The latency is then still 0.1 ms off, as much as two
    minutes of flight leave open."""
    pilot_windows: int = 128
    """Windows on which a random start comes near the optimum."""

    def __post_init__(self) -> None:
        """Refuses what makes no sense."""
        must_be_positive(self)


class _Fit(NamedTuple):
    """The end of one trial."""

    drone: Parameters
    box: Box
    optimum: Float[np.ndarray, "d"]
    """In the box's unit cube, as are the points."""
    points: Float[np.ndarray, "n d"]
    """Points evaluated on the last objective."""
    values: Float[np.ndarray, "n"]
    """Minus the mean log likelihood of a row there."""


def bounds(start: Parameters) -> dict[str, tuple[float, float]]:
    """Physical search bounds about a drone, by component.

    Torques in units of its weight times its arm.
    """
    torque = float(start.mass * start.gravity * start.arm_length)
    around = {
        name: float(component(start, name)) for name in ("inertia_x", "inertia_y", "inertia_z")
    }
    return {
        "thrust_to_weight": (1.01, 8.0),
        "motor_time_constant": (0.003, 0.5),
        "latency": (0.0, 0.05),
        "spin_down_ratio": (0.2, 5.0),
        "motor_coasting": (0.0, 0.5),
        "torque_to_thrust": (0.0, 0.1),
        "rotor_momentum": (0.0, 0.1 * torque),
        "flapping_moment": (-0.1 * torque, 0.2 * torque),
        "rotational_damping": (0.0, 0.05 * torque),
        "thrust_linear": (0.0, 1.0),
        **{f"torque_bias_{axis}": (-0.2 * torque, 0.2 * torque) for axis in "xyz"},
        **{f"drag_{axis}": (0.0, 3.0) for axis in "xyz"},
        **{name: (0.3 * value, 3.0 * value) for name, value in around.items()},
    }


def identified(problem: Problem, settings: Likelihood) -> Identification:
    """Finds the drone and the noise under which the flights are most likely.

    Raises:
        InputError: too little flight, or a parameter that cannot be searched.
    """
    if problem.over is not None:
        _box(problem, problem.over)
    motors = _motors(problem)
    if motors:
        problem = replace_(problem, flights=[sharp(flight) for flight in problem.flights])
    flights, start = problem.flights, problem.start
    coarse = _objective(flights, settings, settings.coarse_physics_step)
    fine = _objective(flights, settings, settings.physics_step)
    pilot = _objective(flights, settings, settings.coarse_physics_step, _every(coarse, settings))
    over, first, gains = problem.over, start, []
    if over is None:
        over, first, gains = _chosen(problem, settings, motors)
    seen = _seen(motors, over)
    found = [_fit(problem, settings, [coarse], over, first, seen)]
    for _ in range(settings.trials - 1):
        found.append(_fit(problem, settings, [pilot, coarse], over, start, seen, at_random=True))
    best = int(np.argmin([one.values.min() for one in found]))
    found[best] = _fit(problem, settings, [fine], over, found[best].drone, seen)
    drone, box, optimum, _, values = found[best]
    samples, deviation = _posterior(fine, found[best], seen, problem.generator)
    noise = noise_levels(fine.mean_products(drone), drone, stride(flights[0]) * flights[0].period)
    drone = replace(drone, **{name: np.float32(value) for name, value in noise.items()})
    optima = np.array([one.points[int(np.argmin(one.values))] for one in found])
    return Identification(
        parameters=check(drone, "identified parameters"),
        estimates=estimates_of(box, optimum, optima, posterior.interval(samples), deviation),
        objective="likelihood",
        value=float(values.min()),
        start_value=fine(start),
        source=problem.source,
        windows=int(fine.rows) // (one_step.LENGTH - one_step.ORDER),
        evaluations=sum(len(one.values) for one in found),
        seconds=0.0,
        search=evaluations_table(box, [(one.points, one.values) for one in found]),
        posterior=dict(zip(box.names, box.values(samples).T, strict=True)),
        gains=tuple(gains),
        noise=noise,
        notes=(
            *notes_on(box, optimum, fine.segments),
            *doubts(noise, flights),
            *_lag_notes(motors, flights, dict(zip(box.names, box.values(samples).T, strict=True))),
        ),
    )


def _motors(problem: Problem) -> MotorResponse | None:
    """What logs show of the motors' lag, if it is asked for."""
    asked = selection.FIRST if problem.over is None else problem.over
    if not {"motor_time_constant", "latency"} <= set(asked):
        return None
    return motor_response(problem.flights, problem.generator)


def _seen(motors: MotorResponse | None, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Samples of the parameters that are not searched for but seen, those of thrust apart."""
    if motors is None or not {"motor_time_constant", "latency"} <= set(names):
        return {}
    return {"motor_time_constant": motors.lag, "latency": motors.latency}


def _lag_notes(
    motors: MotorResponse | None, flights: Sequence[Flight], draws: Mapping[str, np.ndarray]
) -> list[str]:
    """Independent looks at the motors' lag, and where they disagree."""
    if not {"motor_time_constant", "latency"} <= set(draws):
        return []
    low, value, high = np.quantile(
        draws["motor_time_constant"] + draws["latency"], [0.025, 0.5, 0.975]
    )
    looks = [
        *(motors.looks if motors else ()),
        *cross_spectrum(flights),
        Look("taken" if motors else "likelihood", float(value), (float(low), float(high))),
    ]
    shown = ", ".join(
        f"{look.signal} {1e3 * look.value:.0f} [{1e3 * look.interval[0]:.0f},"
        f" {1e3 * look.interval[1]:.0f}]"
        for look in looks
    )
    apart = [
        f"{one.signal} and {other.signal}"
        for number, one in enumerate(looks)
        for other in looks[number + 1 :]
        if one.interval[1] < other.interval[0] or other.interval[1] < one.interval[0]
    ]
    notes = [f"motor lag and latency together, in ms with 95 % interval: {shown}"]
    if apart:
        notes.append(f"these disagree about the motors' lag: {'; '.join(apart)}")
    return [*notes, *(motors.notes if motors else ())]


def _chosen(
    problem: Problem, settings: Likelihood, motors: MotorResponse | None
) -> tuple[tuple[str, ...], Parameters, list[GroupGain]]:
    """The parameters that predict held-out flights better, and the best drone of the others."""
    fitted, judged = _split(problem.flights)
    training, held_out = (
        _objective(part, settings, settings.coarse_physics_step) for part in (fitted, judged)
    )
    sample = _objective(fitted, settings, settings.coarse_physics_step, _every(training, settings))
    seen = _seen(motors, selection.FIRST)

    def roughly(names: Sequence[str], first: Parameters) -> Parameters:
        return _fit(
            problem, settings, [sample, training], names, first, seen, close=selection.ROUGH
        ).drone

    return selection.choose(
        training,
        held_out,
        roughly,
        problem.start,
        on_group=problem.on_group,
        sample=sample,
        **({"groups": selection.WITH_KNOWN_LAG} if motors else {}),
    )


def _fit(
    problem: Problem,
    settings: Likelihood,
    objectives: Sequence[OneStep],
    names: Sequence[str],
    first: Parameters,
    seen: Mapping[str, np.ndarray],
    *,
    at_random: bool = False,
    close: float = 0.0,
) -> _Fit:
    """Maximises one likelihood after another.

    Each until a step gains less than `_CLOSE` in all, or than `close` a row. Parameters that are
    `seen` have the median of their samples; thrust is what hovering takes.
    """
    box = _box(problem, names)
    drone = replace(
        first, **{name: np.float32(np.median(seen[name])) for name in names if name in seen}
    )
    free = tuple(name for name in names if name not in seen and name != HOVERING)
    inner = _box(problem, free) if free else None
    if inner and at_random:
        drone = inner.drone(drone, problem.generator.random(len(free)))
    points, values = np.empty((0, len(names))), np.empty(0)
    for target in objectives:
        small = max(close, _CLOSE / target.rows)
        rules = Rules(1, settings.evaluations - 1, small_gain=small, easing=8.0, firmness=2.0)
        if inner:
            drones, values = _descended(problem, target, rules, inner, box, drone)
            drone = drones[int(np.argmin(values))]
        else:
            drone = _carried(target, drone, box)
            drones, values = [drone], np.array([target(drone)])
            problem.evaluated(0)
        points = np.array([_unit(box, one) for one in drones])
    return _Fit(drone, box, _unit(box, drone), points, values)


def _unit(box: Box, drone: Parameters) -> Float[np.ndarray, "d"]:
    """Where a drone lies in a box."""
    return np.clip(
        box.unit(np.array([float(component(drone, name)) for name in box.names])), 0.0, 1.0
    )


def _carried(target: OneStep, drone: Parameters, box: Box) -> Parameters:
    """The drone with the thrust that hovering takes, if it is sought."""
    if HOVERING not in box.names:
        return drone
    place = box.names.index(HOVERING)
    value = np.clip(target.carrying(drone), box.lower[place], box.upper[place])
    return replace(drone, thrust_to_weight=np.float32(value))


def _descended(
    problem: Problem,
    target: OneStep,
    rules: Rules,
    inner: Box,
    box: Box,
    first: Parameters,
) -> tuple[list[Parameters], Float[np.ndarray, "n"]]:
    """Drones evaluated from one on, and their values.

    Thrust follows the parameters of the inner box so that the mean vertical error stays zero, and
    so do the derivatives.
    """
    drones, values = [], []
    followed = HOVERING in box.names

    def equations(unit: np.ndarray) -> NormalEquations:
        problem.evaluated(0)
        drone = inner.drone(drones[int(np.argmin(values))] if drones else first, unit)
        drone = _carried(target, drone, box)
        names = (*inner.names, HOVERING) if followed else inner.names
        found = target.normal_equations(drone, names)
        if followed:
            climbs = target.climbs(drone, names)
            along = np.concatenate([np.eye(len(names) - 1), -climbs[None, :-1] / climbs[-1]])
            found = NormalEquations(
                found.loss,
                along.T @ found.gradient,
                along.T @ found.curvature @ along,
                along.T @ found.majorant @ along,
            )
        drones.append(drone)
        values.append(found.loss)
        return in_unit_cube(found, inner, unit)

    point = inner.unit(np.array([float(component(first, name)) for name in inner.names]))
    descend(equations, np.clip(point, INSIDE, 1 - INSIDE), rules, inside, damping=0.0)
    return drones, np.array(values)


def _posterior(
    target: OneStep, fit: _Fit, seen: Mapping[str, np.ndarray], generator: np.random.Generator
) -> tuple[Float[np.ndarray, "N d"], Float[np.ndarray, "d"]]:
    """Samples of the posterior in the unit cube, and the spread between segments in SI units.

    Laplace's approximation with the sandwich covariance, given the parameters that are seen; these
    have samples of their own, which the others follow. Of the spread so much is added that the
    interval holds what another flight of `_NEXT_FLIGHT` segments will show.
    """
    names, box, count = fit.box.names, fit.box, posterior.RESAMPLES
    _, scores, curvatures = target.derivatives(fit.drone, names)
    slope = box.slope(fit.optimum)
    spread = posterior.between_segment_sd(scores * target.rows, curvatures * target.rows)
    others = [place for place, name in enumerate(names) if name != HOVERING]
    along, noise = np.eye(len(names))[:, others], np.zeros((count, 1))
    if HOVERING in names:
        place = names.index(HOVERING)
        climbs = target.climbs(fit.drone, names) * slope
        along[place] = -climbs[others] / climbs[place]
        spread[place] = float(np.std(target.hovering(fit.drone)[1]))
        error = spread[place] * np.sqrt(1 / target.segments + 1 / _NEXT_FLIGHT)
        noise = generator.normal(0.0, error / slope[place], (count, 1))
    curvature = curvatures.sum(axis=0) * np.outer(slope, slope)
    reduced = along.T @ curvature @ along
    known = np.array([names[place] in seen for place in others], bool)
    moves = np.zeros((count, len(others)))
    for number, place in enumerate(others):
        if known[number]:
            samples = _resized(box, place, seen[names[place]], generator)
            moves[:, number] = samples - fit.optimum[place]
            spread[place] = 0.0
    if others and not known.all():
        inner = reduced[np.ix_(~known, ~known)]
        covariance = posterior.sandwich(((scores * slope) @ along)[:, ~known], inner)
        between = (spread / slope)[others][~known]
        covariance += np.diag(between**2 / _NEXT_FLIGHT)
        free = generator.multivariate_normal(np.zeros(len(inner)), covariance, count, method="eigh")
        follow = posterior.inverse(inner)
        free -= moves[:, known] @ (follow @ reduced[np.ix_(~known, known)]).T
        if HOVERING in names:
            pulls = (along.T @ curvature[:, [names.index(HOVERING)]])[~known]
            free -= noise @ (follow @ pulls).T
        moves[:, ~known] += free
    draws = fit.optimum + moves @ along.T
    if HOVERING in names:
        draws[:, names.index(HOVERING)] += noise[:, 0]
    return np.clip(draws, 0.0, 1.0), spread


def _resized(
    box: Box, place: int, samples: np.ndarray, generator: np.random.Generator
) -> Float[np.ndarray, "N"]:
    """Samples of one parameter in the box's unit cube, as many as the posterior has."""
    chosen = (
        samples
        if len(samples) == posterior.RESAMPLES
        else generator.choice(samples, posterior.RESAMPLES)
    )
    unit = box.unit(np.tile(chosen[:, None], (1, len(box.names))))
    return unit[:, place]


def log_likelihood(
    flights: Sequence[Flight], drone: Parameters, settings: Likelihood | None = None
) -> float:
    """Mean log likelihood of a row [nats] of flights under a drone and the best noise model.

    Args:
        flights: checked flights of one rate.
        drone: the drone; its noise does not count.
        settings: uses `lead_in` and `physics_step`; `Likelihood()` unless given.

    Raises:
        InputError: too little flight.
    """
    settings = Likelihood() if settings is None else settings
    return -_objective(flights, settings, settings.physics_step)(drone)


def _box(problem: Problem, names: Sequence[str]) -> Box:
    return search_box(names, {**bounds(problem.start), **problem.bounds})


def _every(objective: OneStep, settings: Likelihood) -> int:
    """Windows from one of the pilot's to the next."""
    return max(1, objective.size // settings.pilot_windows)


def _objective(
    flights: Sequence[Flight], settings: Likelihood, step: float, every: int = 1
) -> OneStep:
    """The objective on each `every`-th window, in physics steps of about `step` seconds."""
    rows, period = stride(flights[0]), flights[0].period
    cut = windows(
        flights,
        one_step.LENGTH,
        every=one_step.LENGTH,
        lead_in=settings.lead_in,
        stride=rows,
    )
    return OneStep(
        type(cut)(*(array[::every] for array in cut)), period, max(1, round(period / step)), rows
    )


def _split(flights: Sequence[Flight]) -> tuple[list[Flight], list[Flight]]:
    """Flights to fit and, every third of them, to judge by.

    The longest is cut in three where there are fewer than three.

    Segments of one flight stay together, unless there are fewer than three flights.
    """
    long_enough = [
        flight
        for flight in flights
        if len(flight)
        > one_step.LENGTH * stride(flight)
        + max((SHORTEST_LEAD_IN + 1) * stride(flight), flight.lead)
    ]
    whole: list[list[Flight]] = []
    for flight in long_enough:
        before = whole[-1][-1] if whole else None
        if before and flight.lead and before.lead and before.name == flight.name:
            whole[-1].append(flight)
        else:
            whole.append([flight])
    if len(whole) < selection.HELD_OUT:
        whole = [[flight] for flight in long_enough]
    if len(whole) < selection.HELD_OUT:
        whole = []
        for flight in flights:
            ends = [len(flight) * part // 3 for part in range(4)]
            for first, end in zip(ends[:-1], ends[1:], strict=True):
                whole.append([flight.part(first, end)])
    judged = whole[selection.HELD_OUT - 1 :: selection.HELD_OUT]
    fitted = [
        parts
        for number, parts in enumerate(whole)
        if number % selection.HELD_OUT != selection.HELD_OUT - 1
    ]
    return [part for parts in fitted for part in parts], [
        part for parts in judged for part in parts
    ]
