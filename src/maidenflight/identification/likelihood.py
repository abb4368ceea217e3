"""Identification by maximum likelihood of one-step errors, which feedback does not bias.

`Likelihood` holds its settings, `identified` finds the drone and the noise of its sensors and
motors.
"""

from collections.abc import Sequence
from dataclasses import dataclass
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
from maidenflight.identification.noise_levels import noise_levels
from maidenflight.identification.one_step import OneStep
from maidenflight.identification.problem import Problem, must_be_positive
from maidenflight.parameters import Parameters, check, component, replace

_CLOSE = 0.02
"""Gain of the log likelihood of all flights [nats] below which a step is the last; a fifth of a
standard error changes it by as much."""


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
    flights, start = problem.flights, problem.start
    if problem.over is not None:
        _box(problem, problem.over)
    coarse = _objective(flights, settings, settings.coarse_physics_step)
    fine = _objective(flights, settings, settings.physics_step)
    pilot = _objective(flights, settings, settings.coarse_physics_step, _every(coarse, settings))
    over, first, gains = problem.over, start, []
    if over is None:
        over, first, gains = _chosen(problem, settings)
    found = [_fit(problem, settings, [coarse], over, first)]
    for _ in range(settings.trials - 1):
        found.append(_fit(problem, settings, [pilot, coarse], over, start, at_random=True))
    best = int(np.argmin([one.values.min() for one in found]))
    found[best] = _fit(problem, settings, [fine], over, found[best].drone)
    drone, box, optimum, _, values = found[best]
    scores, curvatures = fine.derivatives(drone, box.names)[1:]
    samples = _posterior(found[best], scores, curvatures, problem.generator)
    noise = noise_levels(fine.mean_products(drone), drone, flights[0].period)
    drone = replace(drone, **{name: np.float32(value) for name, value in noise.items()})
    deviation = posterior.between_segment_sd(scores * fine.rows, curvatures * fine.rows)
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
        notes=(*notes_on(box, optimum, fine.segments), *doubts(noise, flights)),
    )


def _chosen(
    problem: Problem, settings: Likelihood
) -> tuple[tuple[str, ...], Parameters, list[GroupGain]]:
    """The parameters that predict held-out flights better, and the best drone of the others."""
    fitted, judged = _split(problem.flights)
    training, held_out = (
        _objective(part, settings, settings.coarse_physics_step) for part in (fitted, judged)
    )
    sample = _objective(fitted, settings, settings.coarse_physics_step, _every(training, settings))

    def roughly(names: Sequence[str], first: Parameters) -> Parameters:
        return _fit(
            problem, settings, [sample, training], names, first, close=selection.ROUGH
        ).drone

    return selection.choose(
        training, held_out, roughly, problem.start, on_group=problem.on_group, sample=sample
    )


def _fit(
    problem: Problem,
    settings: Likelihood,
    objectives: Sequence[OneStep],
    names: Sequence[str],
    first: Parameters,
    *,
    at_random: bool = False,
    close: float = 0.0,
) -> _Fit:
    """Maximises one likelihood after another.

    Each until a step gains less than `_CLOSE` in all, or than `close` a row.
    """
    box = _box(problem, names)
    point = box.unit(np.array([float(component(first, name)) for name in box.names]))
    point = (
        problem.generator.random(len(point)) if at_random else np.clip(point, INSIDE, 1 - INSIDE)
    )
    points, values = np.empty((0, len(point))), np.empty(0)
    for target in objectives:
        small = max(close, _CLOSE / target.rows)
        rules = Rules(1, settings.evaluations - 1, small_gain=small, easing=8.0, firmness=2.0)
        points, values = _descended(problem, target, rules, box, first, point)
        point = points[int(np.argmin(values))]
    return _Fit(box.drone(first, point), box, point, points, values)


def _descended(
    problem: Problem,
    target: OneStep,
    rules: Rules,
    box: Box,
    first: Parameters,
    point: Float[np.ndarray, "d"],
) -> tuple[Float[np.ndarray, "n d"], Float[np.ndarray, "n"]]:
    """Points evaluated from one on, and their values."""
    points, values = [], []

    def equations(unit: np.ndarray) -> NormalEquations:
        problem.evaluated(0)
        found = target.normal_equations(box.drone(first, unit), box.names)
        points.append(unit)
        values.append(found.loss)
        return in_unit_cube(found, box, unit)

    descend(equations, point, rules, inside, damping=0.0)
    return np.array(points), np.array(values)


def _posterior(
    fit: _Fit,
    scores: Float[np.ndarray, "S d"],
    curvatures: Float[np.ndarray, "S d d"],
    generator: np.random.Generator,
) -> Float[np.ndarray, "N d"]:
    """Posterior samples in the unit cube: a normal distribution with the sandwich covariance."""
    slope = fit.box.slope(fit.optimum)
    covariance = posterior.sandwich(scores * slope, curvatures.sum(axis=0) * np.outer(slope, slope))
    return np.clip(
        generator.multivariate_normal(fit.optimum, covariance, posterior.RESAMPLES, method="eigh"),
        0.0,
        1.0,
    )


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
    cut = windows(flights, one_step.LENGTH, every=one_step.LENGTH, lead_in=settings.lead_in)
    period = flights[0].period
    return OneStep(
        type(cut)(*(array[::every] for array in cut)), period, max(1, round(period / step))
    )


def _split(flights: Sequence[Flight]) -> tuple[list[Flight], list[Flight]]:
    """Flights to fit and, every third of them, to judge by.

    The longest is cut in three where there are fewer than three.

    Segments of one flight stay together, unless there are fewer than three flights.
    """
    long_enough = [
        flight
        for flight in flights
        if len(flight) > one_step.LENGTH + max(SHORTEST_LEAD_IN + 1, flight.lead)
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
