"""What identification finds, and how its result is put together.

`Identification` holds parameters with their intervals, posterior samples and the noise.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import polars

from maidenflight.errors import InputError
from maidenflight.flights.checkup.result import LogWarning
from maidenflight.flights.log import SUBSAMPLED, ZERO_ORDER_HOLD, Flight
from maidenflight.flights.windows import SEGMENT_SECONDS
from maidenflight.identification.drone_file import (
    Advice,
    DroneFile,
    Estimate,
    GroupGain,
    Search,
    Source,
)
from maidenflight.identification.outcome.bounds import at_bounds, cut_off
from maidenflight.identification.outcome.plausible import NEXT_FLIGHT, ExpectedInterval
from maidenflight.identification.posterior import Posterior
from maidenflight.identification.signals.flight_signals import is_zero_order_hold
from maidenflight.identification.uncertainty import Bootstrap, Evidence
from maidenflight.identification.unknowns import Box
from maidenflight.inputs import StrPath
from maidenflight.parameters import Parameters
from maidenflight.registry import PLOTS
from maidenflight.simulator.randomization import Ensemble

_FITTED = "identification"
"""Kind of warnings that its notes are."""
USUAL_PERIOD = 0.0125
"""Time between two rows beyond which samples of a PID's commands say little of lag and inertia [s];
paper/notes/identification.md has figures."""
SURE_NATS, SURE_LOSS = 0.05, 0.05
"""Log likelihood of a row [nats], and share of a replay's loss, by which a drone is surely
worse: changes notes alone (paper/identification/constants.py)."""
MAX_MOTOR_NOISE = 0.08
"""Noise of motors beyond which it is not theirs, as a share of full thrust: real Crazyflies have
0.03 to 0.04. Changes a note alone (paper/identification/constants.py)."""


def source_of(flights: Sequence[Flight]) -> Source:
    """Returns what is recorded of flights.

    Raises:
        InputError: u = 1 stands for different thrusts in them.
    """
    kinds = {flight.full_scale_counts: flight.name for flight in flights}
    if len(kinds) > 1:
        differ = ", ".join(f"{counts:g} in {name}" for counts, name in sorted(kinds.items()))
        raise InputError(
            "flights in which a command of 1 stands for different counts of the firmware "
            f"({differ}); identify from one kind."
        )
    kinds_of_commands = {
        ZERO_ORDER_HOLD if flight.zero_order_hold else SUBSAMPLED for flight in flights
    }
    return Source(
        flights=len({flight.name for flight in flights}),
        seconds=round(sum(flight.duration for flight in flights), 2),
        simulated=any(flight.simulated for flight in flights),
        commands=kinds_of_commands.pop() if len(kinds_of_commands) == 1 else "mixed",
        full_scale_counts=next(iter(kinds)),
    )


@dataclass(frozen=True)
class Identification:
    """A drone identified from flights."""

    parameters: Parameters
    """The start, with the identified values in place."""
    estimates: Mapping[str, Estimate]
    """The identified parameters, by name."""
    objective: str
    """What was optimised, `likelihood` or `replay`."""
    value: float
    """Of the objective at the optimum: minus the mean log likelihood of a row [nats], or the mean
    loss of a window of a replay."""
    start_value: float
    """The same at the start."""
    windows: int
    """Windows that the flights were cut into."""
    source: Source
    """The flights."""
    evaluations: int
    """Evaluations of the objective."""
    search: polars.DataFrame
    """One row an evaluation: trial (0: the bootstrap's), values, objective."""
    posterior: Posterior
    """Joint samples of the parameters."""
    notes: tuple[str, ...]
    """What makes the result doubtful, for the user."""
    unidentified: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Plausible range of each parameter that the flights cannot tell, by name: it keeps the
    start's value, and posterior samples are anywhere in the range."""
    expected: Mapping[str, ExpectedInterval] = field(default_factory=dict)
    """What the flights could tell, before anything was fitted; nothing of a replay."""
    gains: tuple[GroupGain, ...] = ()
    """Log-likelihood gain of each group of parameters, where the flights chose them."""
    noise: Mapping[str, float] = field(default_factory=dict)
    """Noise found in the flights, as fields of `parameters`; none of a replay."""
    seconds: float = 0.0
    """Wall time [s]."""
    advice: tuple[Advice, ...] = ()
    """What makes intervals narrower."""
    warnings: tuple[LogWarning, ...] = ()
    """What makes the flights doubtful."""
    evidence: tuple[Evidence, ...] = ()
    """What each signal says by itself of each parameter, and of motor lag and latency together."""

    def __str__(self) -> str:
        """A line for each parameter, SI units: value, 95 % interval, SD between flights."""
        rows = [
            f"{self.objective} of {self.source.flights} flights, {self.source.seconds:.0f} s; SI "
            "units: value, 95 % interval, SD between flights"
        ]
        for name, estimate in self.estimates.items():
            low, high = estimate.interval
            rows.append(
                f"{name:24}{estimate.value:12.4g}  [{low:.4g}, {high:.4g}]  "
                f"{estimate.between_sd:.2g}"
            )
        for name, (low, high) in self.unidentified.items():
            rows.append(f"{name:24} not identifiable  [{low:.4g}, {high:.4g}] is plausible")
        remarks = [f"warning: {warning}" for warning in self.warnings]
        return "\n".join([*rows, *remarks, *(f"note: {note}" for note in self.notes)])

    __repr__ = __str__

    def plot(self) -> Any:
        """Returns a picture of the estimates and their intervals, which a notebook shows."""
        return PLOTS["identification"](self)

    def drone_file(self, record: Mapping[str, Any] | None = None) -> DroneFile:
        """Returns the drone file of the result; nothing in it depends on how long the work took.

        Args:
            record: how it was made; see `results.record`.
        """
        return DroneFile(
            self.parameters,
            self.estimates,
            self.posterior,
            self.source,
            Search(self.objective, self.value, self.windows, self.evaluations),
            self.gains,
            self.unidentified,
            record or {},
            advice=self.advice,
            warnings=(*self.warnings, *(LogWarning(_FITTED, "", note) for note in self.notes)),
        )

    def write(self, path: StrPath, record: Mapping[str, Any] | None = None) -> Path:
        """Writes the drone file, as `maidenflight identify` does.

        Args:
            path: the file.
            record: how it was made; see `results.record`.

        Raises:
            WriteError: the file cannot be written.
        """
        return self.drone_file(record).write(path)

    @property
    def ensemble(self) -> Ensemble:
        """The posterior samples as drones to train over."""
        return self.posterior.ensemble(self.parameters)


def estimates_of(
    box: Box,
    optimum: np.ndarray,
    optima: np.ndarray,
    interval: tuple[np.ndarray, np.ndarray],
    between_sd: np.ndarray,
    valley: tuple[np.ndarray, np.ndarray] | None = None,
) -> dict[str, Estimate]:
    """Estimates from points of the box's unit cube.

    Args:
        box: the search box.
        optimum: the best point.
        optima: the best point of each trial.
        interval: its ends.
        between_sd: in the parameters' units.
        valley: its ends, in the parameters' units.
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
            between_sd=float(between_sd[i]),
            valley=None if valley is None else (float(valley[0][i]), float(valley[1][i])),
            bounds=(box.lower[i], box.upper[i]),
        )
        for i, name in enumerate(box.names)
    }


def evaluations_table(
    box: Box,
    runs: Sequence[tuple[np.ndarray, np.ndarray]],
    drawn: Bootstrap | None = None,
) -> polars.DataFrame:
    """Returns a row for each evaluation.

    The trial, from 1 on (0: the bootstrap's), values, objective.
    """
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


def note_worse_than_start(value: float, start_value: float, objective: str) -> list[str]:
    """Returns a note where the identified drone explains its own flights worse than the start.

    Args:
        value: of the objective, less is better; see `Identification.value`.
        start_value: that of the start.
        objective: `likelihood` or `replay`.
    """
    least = SURE_NATS if objective == "likelihood" else SURE_LOSS * abs(start_value)
    if not value > start_value + least:
        return []
    return [
        f"the identified drone explains these flights worse than the start: {objective} "
        f"{-value:.4g}, that of the start {-start_value:.4g}, more is better. Signals contradict "
        "one another: look at maidenflight log (signs, order of motors, yaw, clocks), and do not "
        "train on it."
    ]


def note_doubts(noise: Mapping[str, float], flights: Sequence[Flight]) -> list[str]:
    """Returns what makes the result doubtful although its intervals are narrow."""
    if is_zero_order_hold(flights):
        return []
    notes, period = [], flights[0].period
    if period > USUAL_PERIOD:
        notes.append(
            f"rows are {1e3 * period:.3g} ms apart: the lag may be a tenth too short with an "
            "accelerometer, and nearly twice too long without; log at 100 Hz or faster."
        )
    noise_level = noise.get("actuator_noise", 0.0)
    if noise_level >= MAX_MOTOR_NOISE:
        notes.append(
            f"motors seem to differ from their commands by {noise_level:.2f} of full thrust, "
            "too much for motors: the log's commands are samples of a faster loop, so that lag and "
            "inertia cannot be trusted. Fly a policy at the log's rate, or record with more "
            "excitation."
        )
    return notes


def note_gains_lost(gains: Sequence[GroupGain]) -> list[str]:
    """Returns what is said of groups without which held-out flights are surely less likely."""
    return [
        f"{gain.group} is left out of the model although it gains {gain.log_likelihood_gain:.2g} "
        f"nats a row: {gain.reason}. It stands for something that the model lacks: look at "
        "maidenflight log (units, order of motors, mass, --commands), or widen --bounds"
        for gain in gains
        if not gain.is_in_model
        and gain.log_likelihood_gain > SURE_NATS
        and gain.reason is not None
        and "search bound" in gain.reason
    ]


def notes_on(estimates: Mapping[str, Estimate], segments: int, by_law: bool) -> list[str]:
    """Returns what makes intervals too narrow.

    Args:
        estimates: by name.
        segments: of flight.
        by_law: whether a battery law gave the flights' thrust.
    """
    notes = []
    if segments < NEXT_FLIGHT:
        notes.append(
            f"each interval rests on {segments} segments of flight and is too narrow; record at "
            f"least {NEXT_FLIGHT * SEGMENT_SECONDS:.0f} s."
        )
    sentences = (at_bounds(estimates, by_law) | cut_off(estimates, by_law)).values()
    return [*notes, *(f"{sentence}." for sentence in sentences)]
