"""Finding xi from flights: point, interval and the valley between are three answers to one
question.

There are two objectives. `likelihood` looks one row ahead and models what it cannot foresee;
feedback does not bias it, and it finds the noise too. `replay` is the paper's: it looks many rows
ahead open loop.
"""

import dataclasses
import time
from collections.abc import Callable, Iterable, Mapping, Sequence

import jax
import numpy as np
import polars
from jaxtyping import Array

from maidenflight.errors import InputError
from maidenflight.flights.log import Flight
from maidenflight.flights.windows import BLOCK, HISTORY, windows
from maidenflight.identification import bayesian, gradient, likelihood, one_step, posterior
from maidenflight.identification.bayesian import PAPER_BOUNDS, Box
from maidenflight.identification.estimates import Estimate, Identification, Source, source_of
from maidenflight.identification.objective import DISCOUNT, NormalEquations, Objective
from maidenflight.identification.selection import FIRST, Step
from maidenflight.parameters import (
    COMPONENTS,
    QUANTITIES,
    Parameters,
    Quantity,
    check,
    crazyflie,
    replace,
)

OBJECTIVES = ("likelihood", "replay")
"""What makes one drone better than another; the paper's is `replay`."""
AUTO = "auto"
"""Instead of parameters' names: let the flights choose them."""
METHODS = ("gradient", "bayesian")
"""Optimisers of the objective. The first is the default: it finds the same optimum in a tenth of
the time or less."""

_FEWEST_BLOCKS = 6
"""Stretches of flight below which redrawing them says little."""


def identify(
    flights: Iterable[Flight],
    over: Sequence[str] | str | None = None,
    key: Array | None = None,
    *,
    objective: str = OBJECTIVES[0],
    start: Parameters | None = None,
    length: int = 30,
    history: int = HISTORY,
    evaluations: int = 60,
    trials: int = 2,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    discount: float = DISCOUNT,
    method: str = METHODS[0],
    on_evaluation: Callable[[int, int], None] | None = None,
    on_step: Callable[[Step], None] | None = None,
) -> Identification:
    """Identifies parameters from flights.

    Args:
        flights: checked flights of one rate. All of them are held in memory; of many hours, give
            what `sampling.sampled` keeps.
        over: names of `parameters.COMPONENTS` to identify, or `AUTO`: those that predict flights
            held out better (likelihood only). `AUTO` unless given; for a replay the paper's three.
        key: random key; `jax.random.key(0)` unless given.
        objective: `likelihood` or `replay`, the paper's.
        start: the drone whose other parameters are kept; the paper's Crazyflie unless given.
        length: T, rows of a window that is replayed.
        history: rows of commands before a window, from which its motors' speed is inferred.
        evaluations: most evaluations of the objective, a trial. Bayesian optimisation spends them
            all, the paper 250; the gradient method stops by itself after two to six.
        trials: repetitions of the optimiser, each from a start of its own; the paper made three.
        bounds: search bounds by name, SI units; the paper's for `replay` and physical ones for
            `likelihood` unless given.
        discount: delta of the replay.
        method: of the replay: "gradient", which follows derivatives through the simulator, or
            "bayesian", as the paper did.
        on_evaluation: called with (evaluations done, evaluations planned); 0 planned where that is
            not known, as for a likelihood.
        on_step: called with what each group of parameters bought.

    Returns:
        The best point found in any trial, its interval, and how it was found. Cost grows linearly
        with the windows.

    Raises:
        InputError: an unknown or unbounded parameter, an unknown method, or too little flight.
    """
    began = time.perf_counter()
    flights = list(flights)
    start = crazyflie() if start is None else start
    if objective not in OBJECTIVES:
        raise InputError(
            f"unknown objective {objective!r} of identification; known are {', '.join(OBJECTIVES)}."
        )
    if method not in METHODS:
        raise InputError(
            f"unknown method {method!r} of identification; known are {', '.join(METHODS)}."
        )
    if over is None:
        over = AUTO if objective == "likelihood" else FIRST
    if over == AUTO and objective == "replay":
        raise InputError(
            "parameters are chosen by likelihood only: a replay rewards whatever damps. Use "
            "objective likelihood, or name them."
        )
    if over != AUTO and isinstance(over, str):
        over = [over]
    if not flights:
        raise InputError("no flights to identify from; give at least one.")
    source = source_of(flights)
    seed = jax.random.bits(jax.random.key(0) if key is None else key, (2,))
    generator = np.random.default_rng(np.asarray(seed).tolist())
    if objective == "likelihood":
        found = _by_likelihood(
            flights,
            source,
            over,
            start,
            history,
            evaluations,
            trials,
            bounds or {},
            generator,
            on_evaluation,
            on_step,
        )
    else:
        found = _by_replay(
            flights,
            source,
            over,
            start,
            length,
            history,
            evaluations,
            trials,
            bounds or {},
            discount,
            method,
            generator,
            on_evaluation,
        )
    return dataclasses.replace(found, seconds=time.perf_counter() - began)


def _by_likelihood(
    flights: Sequence[Flight],
    source: Source,
    over: Sequence[str],
    start: Parameters,
    history: int,
    evaluations: int,
    trials: int,
    bounds: Mapping[str, tuple[float, float]],
    generator: np.random.Generator,
    on_evaluation: Callable[[int, int], None] | None,
    on_step: Callable[[Step], None] | None,
) -> Identification:
    searched = {**likelihood.bounds(start), **bounds}
    names = () if over == AUTO else _box(over, searched).names
    done = 0

    def count() -> None:
        nonlocal done
        done += 1
        if on_evaluation is not None:
            on_evaluation(done, 0)

    found = likelihood.maximise(
        flights,
        lambda some: _box(some, searched),
        names,
        start,
        history,
        evaluations,
        trials,
        generator,
        count,
        on_step,
    )
    box = found.box
    optima = np.array([points[int(np.argmin(values))] for points, values in found.runs])
    return Identification(
        parameters=check(found.drone, "identified parameters"),
        estimates=_estimates(
            box, found.optimum, optima, posterior.interval(found.draws), found.spread, None
        ),
        kind="likelihood",
        objective=found.value,
        start_objective=found.start_value,
        source=source,
        windows=found.rows // (one_step.LENGTH - one_step.ORDER),
        evaluations=sum(len(values) for _, values in found.runs),
        seconds=0.0,
        history=_history(box, found.runs, None),
        draws=dict(zip(box.names, box.values(found.draws).T, strict=True)),
        bought=found.bought,
        noise=found.noise,
        notes=(*_notes(box, found.optimum, found.stretches), *_doubts(found.noise, flights)),
    )


def _by_replay(
    flights: Sequence[Flight],
    source: Source,
    over: Sequence[str],
    start: Parameters,
    length: int,
    history: int,
    evaluations: int,
    trials: int,
    bounds: Mapping[str, tuple[float, float]],
    discount: float,
    method: str,
    generator: np.random.Generator,
    on_evaluation: Callable[[int, int], None] | None,
) -> Identification:
    box = _box(over, {**PAPER_BOUNDS, **bounds})
    cut = windows(flights, length, history=history)
    objective = Objective(cut, flights[0].period, discount)
    planned = trials * evaluations + 3 * posterior.design_points(len(box.names))
    done = 0

    def count() -> None:
        nonlocal done
        done += 1
        if on_evaluation is not None:
            on_evaluation(done, planned)

    def at(unit: np.ndarray) -> Parameters:
        values = box.values(unit)
        return replace(
            start,
            **{name: np.float32(value) for name, value in zip(box.names, values, strict=True)},
        )

    def loss(unit: np.ndarray) -> float:
        return objective(at(unit))

    def equations(unit: np.ndarray, every: int) -> NormalEquations:
        return gradient.in_unit_cube(
            objective.normal_equations(at(unit), box.names, every), box, unit
        )

    runs, kinks = [], gradient.kinks(box, float(objective.time_step))
    for _ in range(trials):
        if method == "gradient":
            runs.append(
                gradient.minimise(
                    loss, equations, objective.size, kinks, evaluations, generator, count
                )
            )
            planned -= evaluations - len(runs[-1][1])
        else:
            runs.append(bayesian.minimise(loss, len(box.names), evaluations, generator, count))
    optima = np.array([points[int(np.argmin(values))] for points, values in runs])
    best = min(runs, key=lambda run: run[1].min())
    lowest = best[0][int(np.argmin(best[1]))]
    drawn = posterior.bootstrap(
        lambda unit: objective.per_block(at(unit)),
        objective.windows_per_block,
        lowest,
        np.full(len(box.names), 0.08),
        (np.zeros(len(box.names)), np.ones(len(box.names))),
        generator,
        count,
    )
    points = np.concatenate([*(run[0] for run in runs), drawn.points])
    losses = np.concatenate([*(run[1] for run in runs), drawn.losses])
    optimum = points[int(np.argmin(losses))]
    found = check(at(optimum), "identified parameters")
    return Identification(
        parameters=found,
        estimates=_estimates(
            box,
            optimum,
            optima,
            drawn.interval(),
            _spread(box, drawn),
            _valley(box, optimum, objective, found),
        ),
        kind="replay",
        objective=float(losses.min()),
        start_objective=objective(start),
        source=source,
        windows=objective.size,
        evaluations=len(losses),
        seconds=0.0,
        history=_history(box, runs, drawn),
        draws=dict(zip(box.names, box.values(drawn.optima).T, strict=True)),
        bought=(),
        noise={},
        notes=tuple(_notes(box, optimum, objective.blocks)),
    )


def _quantity(name: str) -> Quantity:
    return QUANTITIES[COMPONENTS[name][0]]


def _box(over: Sequence[str], bounds: Mapping[str, tuple[float, float]]) -> Box:
    for name in over:
        if name not in COMPONENTS:
            raise InputError(
                f"unknown parameter {name!r} to identify; known are {', '.join(COMPONENTS)}."
            )
        if name not in bounds:
            raise InputError(
                f"no search bounds for {name}; give them, as in --bounds {name}=LOWER,UPPER."
            )
        low, high = bounds[name]
        quantity = _quantity(name)
        if not quantity.lower <= low < high <= quantity.upper:
            raise InputError(
                f"bounds of {name} = [{low:g}, {high:g}]; expected a rising pair within "
                f"[{quantity.lower:g}, {quantity.upper:g}]"
                f" {quantity.unit}."
            )
    if not over or len(set(over)) != len(over):
        raise InputError("name each parameter to identify once, and at least one.")
    return Box(
        tuple(over),
        tuple(bounds[name][0] for name in over),
        tuple(bounds[name][1] for name in over),
    )


def _estimates(
    box: Box,
    optimum: np.ndarray,
    optima: np.ndarray,
    interval: tuple[np.ndarray, np.ndarray],
    spread: np.ndarray,
    valley: tuple[np.ndarray, np.ndarray] | None,
) -> dict[str, Estimate]:
    low, high = interval
    value, low, high = (
        box.values(unit) for unit in (optimum, np.minimum(low, optimum), np.maximum(high, optimum))
    )
    trials = box.values(optima)
    return {
        name: Estimate(
            value=float(value[i]),
            interval=(float(low[i]), float(high[i])),
            trials=tuple(map(float, trials[:, i])),
            spread=float(spread[i]),
            valley=None if valley is None else (float(valley[0][i]), float(valley[1][i])),
        )
        for i, name in enumerate(box.names)
    }


def _spread(box: Box, drawn: posterior.Bootstrap) -> np.ndarray:
    """Standard deviation between the optima of single stretches, from their quartiles, which
    outliers do not move.
    """
    quartiles = np.quantile(box.values(drawn.stretches), [0.25, 0.75], axis=0)
    return (quartiles[1] - quartiles[0]) / 1.349


def _valley(
    box: Box, optimum: np.ndarray, objective: Objective, drone: Parameters
) -> tuple[np.ndarray, np.ndarray]:
    """How far each parameter can go in a quadratic model of the objective until that is 1 % above
    its best.
    """
    equations = gradient.in_unit_cube(objective.normal_equations(drone, box.names), box, optimum)
    values, vectors = np.linalg.eigh(equations.curvature)
    inverse = (vectors / np.maximum(values, 1e-6 * values.max())) @ vectors.T
    reach = np.sqrt(2 * 0.01 * equations.loss * np.diag(inverse))
    return box.values(np.clip(optimum - reach, 0.0, 1.0)), box.values(
        np.clip(optimum + reach, 0.0, 1.0)
    )


def _history(
    box: Box, runs: list[tuple[np.ndarray, np.ndarray]], drawn: posterior.Bootstrap | None
) -> polars.DataFrame:
    parts = []
    everything = list(runs) if drawn is None else [*runs, (drawn.points, drawn.losses)]
    for trial, (points, losses) in enumerate(everything, 1):
        columns: dict[str, np.ndarray] = dict(zip(box.names, box.values(points).T, strict=True))
        number = 0 if trial > len(runs) else trial
        parts.append(
            polars.DataFrame(
                {"trial": np.full(len(losses), number), **columns, "objective": losses}
            )
        )
    return polars.concat(parts)


RESTLESS = 0.08
"""Noise of motors beyond which it is not theirs: real Crazyflies have 0.03 to 0.04 of full
thrust."""


def _doubts(noise: Mapping[str, float], flights: Sequence[Flight]) -> list[str]:
    """What makes the result doubtful although its intervals are narrow."""
    found = noise.get("actuator_noise", 0.0)
    if found < RESTLESS or all(flight.held for flight in flights):
        return []
    return [
        f"motors seem to differ from their commands by {found:.2f} of full thrust, too much for "
        "motors: the log's commands are samples of a"
        " faster loop, so that lag and inertia cannot be trusted. Fly a policy at the log's rate, "
        "or record with more excitation."
    ]


def _notes(box: Box, optimum: np.ndarray, blocks: int) -> list[str]:
    notes = []
    if blocks < _FEWEST_BLOCKS:
        notes.append(
            f"each interval rests on {blocks} stretches of flight and is too narrow; record at "
            f"least {_FEWEST_BLOCKS * BLOCK:.0f} s."
        )
    for name, place, low, high in zip(box.names, optimum, box.lower, box.upper, strict=True):
        side = low if place < 0.5 else high
        physical = side in (_quantity(name).lower, _quantity(name).upper)
        if (place < 0.01 or place > 0.99) and not physical:
            notes.append(
                f"{name} lies at its search bound {side:g} {_quantity(name).unit}; widen it: "
                f"--bounds {name}=LOWER,UPPER."
            )
    return notes
