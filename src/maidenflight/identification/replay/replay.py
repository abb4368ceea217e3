"""Identification by replaying windows open loop, the paper's objective.

`identified` finds the drone.
"""

import numpy as np
from jaxtyping import Float

from maidenflight.flights.log import averaged
from maidenflight.flights.windows import windows
from maidenflight.identification import uncertainty
from maidenflight.identification.methods import Replay
from maidenflight.identification.outcome.estimates import (
    Identification,
    estimates_of,
    evaluations_table,
    notes_on,
)
from maidenflight.identification.outcome.problem import Problem
from maidenflight.identification.posterior import Posterior
from maidenflight.identification.replay.objective import Objective
from maidenflight.identification.search import gradient
from maidenflight.identification.search.gauss_newton import NormalEquations, in_unit_cube
from maidenflight.identification.signals.flight_signals import stride
from maidenflight.identification.unknowns import PAPER_BOUNDS, Box, search_box
from maidenflight.parameters import Parameters, check

_RADIUS = 0.08
"""Half width of the neighbourhood in which the bootstrap begins, as a share of the box: with 0.11
an end moves by 0.32 of half its interval, with 0.06 none (paper/identification/constants.py)."""


def identified(problem: Problem, settings: Replay) -> Identification:
    """Finds the drone whose replay of the flights comes closest.

    Raises:
        InputError: too little flight, or a parameter that cannot be searched.
    """
    over = tuple(PAPER_BOUNDS) if problem.over is None else problem.over
    box = search_box(over, {**PAPER_BOUNDS, **problem.bounds})
    d, start = len(box.names), problem.start
    flights = [averaged(flight, stride(flight)) for flight in problem.flights]
    window_set = windows(flights, settings.length, lead_in=settings.lead_in)
    objective = Objective(window_set, flights[0].period, settings.discount)
    runs = _searched(problem, settings, box, objective)
    planned = sum(len(losses) for _, losses in runs) + _drawn(box)
    optima = np.array([points[int(np.argmin(losses))] for points, losses in runs])
    best = int(np.argmin([losses.min() for _, losses in runs]))
    bootstrap = uncertainty.bootstrap(
        lambda unit: objective.per_segment(box.drone(start, unit)),
        objective.windows_per_segment,
        optima[best],
        np.full(d, _RADIUS),
        (np.zeros(d), np.ones(d)),
        problem.generator,
        lambda: problem.reporter.evaluated(planned),
    )
    everything = [*runs, (bootstrap.points, bootstrap.losses)]
    points, losses = (np.concatenate(parts) for parts in zip(*everything, strict=True))
    optimum = points[int(np.argmin(losses))]
    drone = check(box.drone(start, optimum), "identified parameters")
    valley = _valley(box, optimum, objective, drone)
    estimates = estimates_of(
        box, optimum, optima, bootstrap.interval(), _between_segment_sd(box, bootstrap), valley
    )
    return Identification(
        parameters=drone,
        estimates=estimates,
        objective="replay",
        value=float(losses.min()),
        start_value=objective(start),
        source=problem.source,
        windows=objective.size,
        evaluations=len(losses),
        search=evaluations_table(box, runs, bootstrap),
        posterior=Posterior(dict(zip(box.names, box.values(bootstrap.optima).T, strict=True))),
        notes=tuple(notes_on(estimates, objective.segments, problem.by_battery_law)),
    )


Run = tuple[Float[np.ndarray, "n d"], Float[np.ndarray, "n"]]
"""Points evaluated in one trial, in the unit cube, and their losses."""


def _searched(problem: Problem, settings: Replay, box: Box, objective: Objective) -> list[Run]:
    """Every trial of the optimiser."""

    def at(unit: np.ndarray) -> Parameters:
        return box.drone(problem.start, unit)

    def loss(unit: np.ndarray) -> float:
        return objective(at(unit))

    def equations(unit: np.ndarray, every: int) -> NormalEquations:
        return in_unit_cube(objective.normal_equations(at(unit), box.names, every), box, unit)

    kinks, most = gradient.kinks(box, objective.period), settings.evaluations
    runs: list[Run] = []
    for trial in range(settings.trials):
        planned = sum(len(losses) for _, losses in runs)
        planned += (settings.trials - trial) * most + _drawn(box)

        def evaluated(planned: int = planned) -> None:
            problem.reporter.evaluated(planned)

        if settings.method == "gradient":
            run = gradient.minimise(
                loss, equations, objective.size, kinks, most, problem.generator, evaluated
            )
        else:
            # scikit-learn, only where needed.
            from maidenflight.identification.search import bayesian

            run = bayesian.minimise(loss, len(box.names), most, problem.generator, evaluated)
        runs.append(run)
    return runs


def _drawn(box: Box) -> int:
    """Evaluations of the bootstrap."""
    return 3 * uncertainty.design_points(len(box.names))


def _between_segment_sd(box: Box, bootstrap: uncertainty.Bootstrap) -> np.ndarray:
    """Standard deviation between the optima of single segments, from their quartiles (robust)."""
    quartiles = np.quantile(box.values(bootstrap.separate), [0.25, 0.75], axis=0)
    return (quartiles[1] - quartiles[0]) / 1.349


def _valley(
    box: Box, optimum: np.ndarray, objective: Objective, drone: Parameters
) -> tuple[np.ndarray, np.ndarray]:
    """Values of each parameter up to which a quadratic objective is at most 1 % above its best."""
    equations = in_unit_cube(objective.normal_equations(drone, box.names), box, optimum)
    values, vectors = np.linalg.eigh(equations.curvature)
    inverse = (vectors / np.maximum(values, 1e-6 * values.max())) @ vectors.T
    reach = np.sqrt(2 * 0.01 * equations.loss * np.diag(inverse))
    return box.values(np.clip(optimum - reach, 0.0, 1.0)), box.values(
        np.clip(optimum + reach, 0.0, 1.0)
    )
