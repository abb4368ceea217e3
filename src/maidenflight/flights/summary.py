"""What logs hold: signals, rates, and how much a flight moves the drone."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from maidenflight.flights.log import SUBSAMPLED, ZERO_ORDER_HOLD, Flight, by_log
from maidenflight.simulator.physics.geometry import TORQUES

CALM = 0.02
"""Spread of the motors' differences [-] below which a flight is calm: inertia, lag and latency show
in what commands change. Hovers of real Crazyflies have 0.010 to 0.015, slow flights up to 0.03."""


@dataclass(frozen=True)
class Summary:
    """What one log holds, of the pieces that can be used."""

    name: str
    pieces: int
    seconds: float
    """Of all pieces [s]."""
    rate: float
    """Rows a second [Hz]."""
    signals: tuple[str, ...]
    """What was measured: fields of `Flight`, those that hold numbers."""
    commands: str
    """What a command stands for, `log.ZERO_ORDER_HOLD` or `log.SUBSAMPLED`."""
    simulated: str
    """The virtual drone that flew; empty for a real flight."""
    battery: tuple[float, float] | None
    """Lowest and highest voltage [V]; None where it is not known."""
    speed: float | None
    """Root mean square of the velocity [m/s]; None without a velocity."""
    tilt: float | None
    """Largest tilt [rad]; None without an attitude."""
    body_rates: float
    """Root mean square of the body rates about x and y [rad/s]."""
    command: float
    """Mean thrust command u [-]."""
    thrust_spread: float
    """Standard deviation of the mean of the four commands [-]."""
    torque_spread: float
    """Standard deviation of what rolls and pitches the drone, a quarter of the commands' signed
    sum, the larger of both [-]."""

    @property
    def is_calm(self) -> bool:
        """Whether the motors differ little, so that another flight would tell more of them."""
        return self.torque_spread < CALM


def summaries(flights: Iterable[Flight]) -> tuple[Summary, ...]:
    """Returns a summary of each log, in the order of the flights.

    Args:
        flights: checked pieces of flights; those of one name are of one log.
    """
    return tuple(_summary(name, pieces) for name, pieces in by_log(flights).items())


def _summary(name: str, pieces: list[Flight]) -> Summary:
    first = pieces[0]

    def joined(field: str) -> np.ndarray:
        return np.concatenate([np.asarray(getattr(piece, field), float) for piece in pieces])

    signals = tuple(
        field
        for field in first.arrays
        if field not in ("command", "true_position") and np.isfinite(joined(field)).any()
    )
    command, attitude, volts = joined("command"), joined("attitude"), joined("battery")
    level = np.cos(attitude[:, 0]) * np.cos(attitude[:, 1])
    turning = command @ TORQUES[:, :2] / 4
    return Summary(
        name=name,
        pieces=len(pieces),
        seconds=sum(piece.duration for piece in pieces),
        rate=1 / first.period,
        signals=signals,
        commands=ZERO_ORDER_HOLD if first.zero_order_hold else SUBSAMPLED,
        simulated=first.simulated,
        battery=(float(np.nanmin(volts)), float(np.nanmax(volts)))
        if "battery" in signals
        else None,
        speed=_size(joined("velocity")) if "velocity" in signals else None,
        tilt=float(np.arccos(np.clip(np.nanmin(level), -1.0, 1.0)))
        if "attitude" in signals
        else None,
        body_rates=_size(joined("body_rates")[:, :2]),
        command=float(command.mean()),
        thrust_spread=float(command.mean(axis=1).std()),
        torque_spread=float(turning.std(axis=0).max()),
    )


def _size(vectors: np.ndarray) -> float:
    """Root mean square of their lengths."""
    return float(np.sqrt(np.nanmean(np.sum(vectors**2, axis=1))))
