"""Finding xi from flights: point, interval and the valley between are three answers to one question."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
import polars
from jaxtyping import Array

from maidenflight.errors import InputError
from maidenflight.flights.log import Flight
from maidenflight.flights.windows import BLOCK, HISTORY, windows
from maidenflight.identification import bayesian, gradient, posterior
from maidenflight.identification.bayesian import PAPER_BOUNDS, Box
from maidenflight.identification.objective import DISCOUNT, NormalEquations, Objective
from maidenflight.parameters import QUANTITIES, Parameters, check, crazyflie, replace
from maidenflight.simulator.randomization import Ensemble

METHODS = ("gradient", "bayesian")
"""Optimisers of the objective. The first is the default: it finds the same optimum in a tenth of the time or less."""
_FEWEST_BLOCKS = 6
"""Stretches of flight below which redrawing them says little."""


@dataclass(frozen=True)
class Estimate:
    """One identified parameter, in its SI unit."""

    value: float
    interval: tuple[float, float]
    """95 % bootstrap interval over stretches of flight."""
    trials: tuple[float, ...]
    """Best value of each trial of the optimiser; their spread tells of the optimiser, not of the parameter."""

    @property
    def trial_mean(self) -> float:
        """Mean over the trials, as in the paper's table."""
        return float(np.mean(self.trials))

    @property
    def trial_deviation(self) -> float:
        """Standard deviation over the trials, as in the paper's table."""
        return float(np.std(self.trials))


@dataclass(frozen=True)
class Identification:
    """What flights tell of a drone."""

    parameters: Parameters
    """The start, with the identified values in place."""
    estimates: Mapping[str, Estimate]
    objective: float
    """Mean loss of a window at the optimum."""
    start_objective: float
    """The same at the start."""
    windows: int
    evaluations: int
    seconds: float
    history: polars.DataFrame
    """One row an evaluation: trial (0: the bootstrap's), values, objective."""
    draws: Mapping[str, np.ndarray]
    """Optima of the redrawn data, by parameter; an entry of each belongs together."""
    notes: tuple[str, ...]
    """What the user should know of the result."""

    @property
    def ensemble(self) -> Ensemble:
        """The drones that the redrawn data speak for, to randomize over as the flights are unsure."""
        count = len(next(iter(self.draws.values())))
        stacked = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (count, *np.shape(leaf))), self.parameters)
        return Ensemble(replace(stacked, **{name: values.astype(np.float32) for name, values in self.draws.items()}))

    def to_table(self) -> dict[str, Any]:
        """The `[identification]` table of a drone's TOML file: nothing in it depends on how long the work took."""
        table: dict[str, Any] = {
            "objective": round(self.objective, 6),
            "windows": self.windows,
            "evaluations": self.evaluations,
        }
        for name, estimate in self.estimates.items():
            table[name] = {
                "value": round(estimate.value, 9),
                "interval": [round(side, 9) for side in estimate.interval],
                "trial_mean": round(estimate.trial_mean, 9),
                "trial_deviation": round(estimate.trial_deviation, 9),
            }
        return table


def identify(
    flights: Iterable[Flight],
    over: Sequence[str] = ("thrust_to_weight", "motor_time_constant", "latency"),
    key: Array | None = None,
    *,
    start: Parameters | None = None,
    length: int = 30,
    history: int = HISTORY,
    evaluations: int = 60,
    trials: int = 3,
    bounds: Mapping[str, tuple[float, float]] = PAPER_BOUNDS,
    discount: float = DISCOUNT,
    method: str = METHODS[0],
    on_evaluation: Callable[[int, int], None] | None = None,
) -> Identification:
    """Identifies parameters from flights by optimisation of the paper's objective.

    Args:
        flights: checked flights of one rate.
        over: fields of `Parameters` to identify.
        key: random key; `jax.random.key(0)` unless given.
        start: the drone whose other parameters are kept; the paper's Crazyflie unless given.
        length: T, rows of a window.
        history: rows of commands before a window, from which its motors' speed is inferred.
        evaluations: most evaluations of the objective, a trial. Bayesian optimisation spends them all, the paper 250; the gradient
            method stops by itself after two to six.
        trials: repetitions of the optimiser, each from a start of its own.
        bounds: search bounds by name, SI units.
        discount: delta.
        method: "gradient", which follows derivatives through the simulator, or "bayesian", as the paper did.
        on_evaluation: called with (evaluations done, evaluations planned).

    Returns:
        The best point found in any trial, its interval, and how it was found. Cost grows linearly with the windows.

    Raises:
        InputError: an unknown or unbounded parameter, an unknown method, or too little flight.
    """
    began = time.perf_counter()
    flights = list(flights)
    start = crazyflie() if start is None else start
    box = _box(over, bounds)
    if method not in METHODS:
        raise InputError(f"unknown method {method!r} of identification; known are {', '.join(METHODS)}.")
    cut = windows(flights, length, history=history)
    objective = Objective(cut, flights[0].period, discount)
    seed = jax.random.bits(jax.random.key(0) if key is None else key, (2,))
    generator = np.random.default_rng(np.asarray(seed).tolist())
    planned = trials * evaluations + 3 * posterior.DESIGN
    done = 0

    def count() -> None:
        nonlocal done
        done += 1
        if on_evaluation is not None:
            on_evaluation(done, planned)

    def at(unit: np.ndarray) -> Parameters:
        values = box.values(unit)
        return replace(start, **{name: np.float32(value) for name, value in zip(box.names, values, strict=True)})

    def loss(unit: np.ndarray) -> float:
        return objective(at(unit))

    def equations(unit: np.ndarray, few: bool) -> NormalEquations:
        every = max(1, objective.size // gradient.PILOT) if few else 1
        return gradient.in_unit_cube(objective.normal_equations(at(unit), box.names, every), box, unit)

    runs = []
    for _ in range(trials):
        if method == "gradient":
            runs.append(gradient.minimise(loss, equations, len(box.names), evaluations, generator, count))
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
        estimates=_estimates(box, optimum, optima, drawn),
        objective=float(losses.min()),
        start_objective=objective(start),
        windows=objective.size,
        evaluations=len(losses),
        seconds=time.perf_counter() - began,
        history=_history(box, runs, drawn),
        draws=dict(zip(box.names, box.values(drawn.optima).T, strict=True)),
        notes=tuple(_notes(box, optimum, objective.blocks)),
    )


def _box(over: Sequence[str], bounds: Mapping[str, tuple[float, float]]) -> Box:
    for name in over:
        if name not in QUANTITIES:
            raise InputError(f"unknown parameter {name!r} to identify; known are {', '.join(QUANTITIES)}.")
        if name not in bounds:
            raise InputError(f"no search bounds for {name}; give them, as in --bounds {name}=LOWER,UPPER.")
        low, high = bounds[name]
        if not (QUANTITIES[name].lower <= low < high <= QUANTITIES[name].upper) or QUANTITIES[name].size != 1:
            raise InputError(
                f"bounds of {name} = [{low:g}, {high:g}]; expected a rising pair within [{QUANTITIES[name].lower:g},"
                f" {QUANTITIES[name].upper:g}] {QUANTITIES[name].unit} of a single number."
            )
    if not over or len(set(over)) != len(over):
        raise InputError("name each parameter to identify once, and at least one.")
    return Box(tuple(over), tuple(bounds[name][0] for name in over), tuple(bounds[name][1] for name in over))


def _estimates(box: Box, optimum: np.ndarray, optima: np.ndarray, drawn: posterior.Bootstrap) -> dict[str, Estimate]:
    low, high = drawn.interval()
    value, low, high = (box.values(unit) for unit in (optimum, np.minimum(low, optimum), np.maximum(high, optimum)))
    trials = box.values(optima)
    return {
        name: Estimate(float(value[i]), (float(low[i]), float(high[i])), tuple(map(float, trials[:, i])))
        for i, name in enumerate(box.names)
    }


def _history(box: Box, runs: list[tuple[np.ndarray, np.ndarray]], drawn: posterior.Bootstrap) -> polars.DataFrame:
    parts = []
    for trial, (points, losses) in enumerate([*runs, (drawn.points, drawn.losses)], 1):
        columns = dict(zip(box.names, box.values(points).T, strict=True))
        number = 0 if trial > len(runs) else trial
        parts.append(polars.DataFrame({"trial": np.full(len(losses), number), **columns, "objective": losses}))
    return polars.concat(parts)


def _notes(box: Box, optimum: np.ndarray, blocks: int) -> list[str]:
    notes = []
    if blocks < _FEWEST_BLOCKS:
        notes.append(
            f"each interval rests on {blocks} stretches of flight and is too narrow; record at least {_FEWEST_BLOCKS * BLOCK:.0f} s."
        )
    for name, place, low, high in zip(box.names, optimum, box.lower, box.upper, strict=True):
        if place < 0.01 or place > 0.99:
            side = low if place < 0.5 else high
            notes.append(f"{name} lies at its search bound {side:g} {QUANTITIES[name].unit}; widen it: --bounds {name}=LOWER,UPPER.")
    return notes
