"""What identification finds: every parameter with its interval, and the drones that the flights
leave possible.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
import polars

from maidenflight import parameters
from maidenflight.errors import InputError
from maidenflight.flights.log import Flight
from maidenflight.flights.windows import BLOCK
from maidenflight.identification import posterior
from maidenflight.identification.box import Box
from maidenflight.identification.selection import Step
from maidenflight.inputs import StrPath
from maidenflight.parameters import COMPONENTS, QUANTITIES, Parameters, replace
from maidenflight.simulator.randomization import Ensemble

_FEWEST_BLOCKS = 6
"""Stretches of flight below which redrawing them says little."""
SAVED = 200
"""Drones of the posterior that a TOML file holds."""


@dataclass(frozen=True)
class Estimate:
    """One identified parameter, in its SI unit."""

    value: float
    interval: tuple[float, float]
    """95 % interval, from how stretches of flight differ."""
    trials: tuple[float, ...]
    """Best value of each trial of the optimiser; their spread tells of the optimiser, not of the
    parameter."""
    spread: float
    """Standard deviation between stretches of flight: how much the drone itself, or what the model
    lacks, varies."""
    valley: tuple[float, float] | None
    """How far the parameter can go, the others following, until the objective is 1 % above its
    best; only where that is the paper's."""

    @property
    def trial_mean(self) -> float:
        """Mean over the trials, as in the paper's table."""
        return float(np.mean(self.trials))

    @property
    def trial_deviation(self) -> float:
        """Standard deviation over the trials, as in the paper's table."""
        return float(np.std(self.trials))


@dataclass(frozen=True)
class Source:
    """The flights that an identification rests on."""

    flights: int
    """How many; stretches of one count as one."""
    seconds: float
    """Flight that was used [s]."""
    simulated: bool
    """Whether any of it was."""
    commands: str
    """What logged commands stood for: `held`, `sampled` or `held and sampled`; see
    `Flight.held`."""
    full: float
    """Counts of a Crazyflie's firmware that u = 1 stands for; see `Flight.full`."""


def source_of(flights: Sequence[Flight]) -> Source:
    """What is to be remembered of flights.

    Raises:
        InputError: u = 1 stands for different thrusts in them.
    """
    kinds = {flight.full: flight.name for flight in flights}
    if len(kinds) > 1:
        told = ", ".join(f"{full:g} in {name}" for full, name in sorted(kinds.items()))
        raise InputError(
            "flights in which a command of 1 stands for different counts of the firmware "
            f"({told}); identify from one kind."
        )
    return Source(
        flights=len({flight.name for flight in flights}),
        seconds=round(sum(flight.duration for flight in flights), 2),
        simulated=any(flight.simulated for flight in flights),
        commands=" and ".join(sorted({"held" if flight.held else "sampled" for flight in flights})),
        full=next(iter(kinds)),
    )


@dataclass(frozen=True)
class Identification:
    """What flights tell of a drone."""

    parameters: Parameters
    """The start, with the identified values in place."""
    estimates: Mapping[str, Estimate]
    kind: str
    """Which of `OBJECTIVES` was optimised."""
    objective: float
    """`replay`: mean loss of a window at the optimum. `likelihood`: minus the log likelihood of a
    row [nats]."""
    start_objective: float
    """The same at the start."""
    windows: int
    source: Source
    """What it rests on."""
    evaluations: int
    seconds: float
    history: polars.DataFrame
    """One row an evaluation: trial (0: the bootstrap's), values, objective."""
    draws: Mapping[str, np.ndarray]
    """Drones that the flights leave possible, by parameter; an entry of each belongs together."""
    bought: tuple[Step, ...]
    """What each group of parameters bought, where the flights chose them."""
    noise: Mapping[str, float]
    """Noise found in the flights, as fields of `parameters`; empty where it was not sought."""
    notes: tuple[str, ...]
    """What the user should know of the result."""

    def __str__(self) -> str:
        """A line a parameter, SI units: value, 95 % interval, spread between stretches of
        flight.
        """
        rows = [
            f"{self.kind} of {self.source.flights} flights, {self.source.seconds:.0f} s; SI "
            "units: value, 95 % interval, between stretches"
        ]
        for name, estimate in self.estimates.items():
            low, high = estimate.interval
            rows.append(
                f"{name:24}{estimate.value:12.4g}  [{low:.4g}, {high:.4g}]  {estimate.spread:.2g}"
            )
        return "\n".join([*rows, *(f"note: {note}" for note in self.notes)])

    def write(self, path: StrPath, record: Mapping[str, Any] | None = None) -> Path:
        """Writes the drone as a TOML file, with intervals and posterior, as `maidenflight identify`
        does.

        Args:
            path: the file.
            record: how it was made; see `results.record`.

        Raises:
            WriteError: the file cannot be written.
        """
        tables = {
            "identification": self.to_table(),
            "posterior": self.posterior_table(),
            "record": dict(record or {}),
        }
        return parameters.write(path, self.parameters, tables)

    @property
    def ensemble(self) -> Ensemble:
        """The drones that the flights leave possible, to randomize over as the flights are
        unsure.
        """
        count = len(next(iter(self.draws.values())))
        stacked = jax.tree.map(
            lambda leaf: np.broadcast_to(leaf, (count, *np.shape(leaf))), self.parameters
        )
        return Ensemble(
            replace(
                stacked, **{name: values.astype(np.float32) for name, values in self.draws.items()}
            )
        )

    def to_table(self) -> dict[str, Any]:
        """The `[identification]` table of a drone's TOML file: nothing in it depends on how long
        the work took.
        """
        table: dict[str, Any] = {
            "kind": self.kind,
            "objective": round(self.objective, 6),
            "windows": self.windows,
            "evaluations": self.evaluations,
            **dataclasses.asdict(self.source),
        }
        for name, estimate in self.estimates.items():
            table[name] = {
                "value": _short(estimate.value),
                "interval": [_short(side) for side in estimate.interval],
                "trial_mean": _short(estimate.trial_mean),
                "trial_deviation": _short(estimate.trial_deviation),
                "spread": _short(estimate.spread),
            }
            if estimate.valley is not None:
                table[name]["valley"] = [_short(side) for side in estimate.valley]
        if self.bought:
            table["bought"] = [
                {**dataclasses.asdict(step), "gain": _short(step.gain), "error": _short(step.error)}
                for step in self.bought
            ]
        return table

    def posterior_table(self) -> dict[str, Any]:
        """The `[posterior]` table of a drone's TOML file: `names`, and `draws` of their values, SI
        units.
        """
        stacked = np.stack(list(self.draws.values()), axis=1)
        return {
            "names": list(self.draws),
            "draws": [[_short(value) for value in row] for row in stacked[:SAVED]],
        }


def _short(value: float) -> float:
    return float(f"{value:.6g}")


def estimates_of(
    box: Box,
    optimum: np.ndarray,
    optima: np.ndarray,
    interval: tuple[np.ndarray, np.ndarray],
    spread: np.ndarray,
    valley: tuple[np.ndarray, np.ndarray] | None = None,
) -> dict[str, Estimate]:
    """Estimates from points of the box's unit cube: the optimum, that of each trial, the ends of
    the interval; the spread and the valley are in the parameters' units.
    """
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


def evaluations_table(
    box: Box,
    runs: Sequence[tuple[np.ndarray, np.ndarray]],
    drawn: posterior.Bootstrap | None = None,
) -> polars.DataFrame:
    """A row for each evaluation: the trial, from 1 on (0: the bootstrap's), values, objective."""
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


def doubts(noise: Mapping[str, float], flights: Sequence[Flight]) -> list[str]:
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


def notes_on(box: Box, optimum: np.ndarray, blocks: int) -> list[str]:
    """What makes intervals too narrow, or values depend on the search's bounds."""
    notes = []
    if blocks < _FEWEST_BLOCKS:
        notes.append(
            f"each interval rests on {blocks} stretches of flight and is too narrow; record at "
            f"least {_FEWEST_BLOCKS * BLOCK:.0f} s."
        )
    for name, place, low, high in zip(box.names, optimum, box.lower, box.upper, strict=True):
        quantity = QUANTITIES[COMPONENTS[name][0]]
        side = low if place < 0.5 else high
        physical = side in (quantity.lower, quantity.upper)
        if (place < 0.01 or place > 0.99) and not physical:
            notes.append(
                f"{name} lies at its search bound {side:g} {quantity.unit}; widen it: "
                f"--bounds {name}=LOWER,UPPER."
            )
    return notes
