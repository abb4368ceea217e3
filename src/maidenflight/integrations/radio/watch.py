"""What must hold during a flight, and what happens where it does not.

Distances, tilts and speeds are of the drone's own estimate, which is all that a program on the
ground has.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from maidenflight.integrations.radio.blocks import ARMED, AUTO_ARMED, FAULTS, Reading

Vector = tuple[float, float, float]
Motion = tuple[Vector, Vector]
"""Velocity [m/s] and acceleration [m/s2] of a set-point."""

DECKS = ("deck.bcFlow2", "deck.bcFlow", "deck.bcLighthouse4", "deck.bcLoco", "deck.bcDWM1000")
"""Parameters that are 1 where a deck is mounted that tells the position."""


@dataclass(frozen=True)
class Limits:
    """Where a flight is broken off."""

    full: float = 3.7
    """Battery at rest [V] below which no flight begins."""
    empty: float = 3.0
    """Battery in flight [V] below which the drone lands."""
    farthest: float = 0.6
    """Distance from the set-point [m]; the firmware's PID is up to 0.25 m behind the paper's
    circle."""
    lowest: float = 0.35
    """Distance below the set-point [m]: the drone does not rise, or sinks."""
    fence: float = 1.5
    """Distance from the place of take-off, in x and in y [m]."""
    ceiling: float = 1.8
    """Height [m]."""
    steepest: float = 60.0
    """Tilt [deg] beyond which no controller will catch it."""
    level: float = 10.0
    """Tilt [deg] on the ground beyond which no flight begins."""
    silence: float = 0.5
    """Time without a row [s]; the firmware levels the drone after as long without a set-point."""


class FlightStatus(NamedTuple):
    """What guards judge."""

    now: float
    """[s]."""
    reading: Reading
    setpoint: Vector
    """[m]."""
    home: Vector
    """Where the drone took off [m]."""
    lost: str
    """Why the link is down; empty while it is up."""
    broken: str
    """Why rows can no longer be written; empty while they can."""
    stops: int
    """Number of requests to stop."""


class Trip(NamedTuple):
    """Why a flight is broken off."""

    reason: str
    cut: bool
    """Whether the motors stop at once; else the drone lands."""


class Guard(NamedTuple):
    """One reason to break off."""

    says: Callable[[FlightStatus, Limits], str]
    """The reason where there is one, else nothing."""
    patience: float = 0.0
    """How long it must last [s]."""
    cut: bool = False


def _not_finite(status: FlightStatus, limits: Limits) -> str:
    return "" if status.reading.finite else "the estimate is not a number"


def _upside_down(status: FlightStatus, limits: Limits) -> str:
    conditions = [name for bit, name in FAULTS.items() if status.reading.supervisor & bit]
    return f"the firmware says: {', '.join(conditions)}" if conditions else ""


def _steep(status: FlightStatus, limits: Limits) -> str:
    tilt = np.degrees(status.reading.tilt)
    return f"tilt of {tilt:.0f} deg" if tilt > limits.steepest else ""


def _disarmed(status: FlightStatus, limits: Limits) -> str:
    is_armed = status.reading.supervisor & (ARMED | AUTO_ARMED)
    return "" if is_armed else "the firmware has disarmed itself"


def _stopped(status: FlightStatus, limits: Limits) -> str:
    return "" if any(status.reading.motors) else "the firmware has stopped the motors"


def _silent(status: FlightStatus, limits: Limits) -> str:
    silence = status.now - status.reading.received
    return f"no rows for {limits.silence:g} s" if silence > limits.silence else ""


def _empty(status: FlightStatus, limits: Limits) -> str:
    volts = status.reading.battery
    return f"battery at {volts:.2f} V" if volts < limits.empty else ""


def _astray(status: FlightStatus, limits: Limits) -> str:
    distance = float(np.linalg.norm(np.subtract(status.reading.position, status.setpoint)))
    return f"{distance:.2f} m from the set-point" if distance > limits.farthest else ""


def _sunk(status: FlightStatus, limits: Limits) -> str:
    below = status.setpoint[2] - status.reading.position[2]
    return f"{below:.2f} m below the set-point" if below > limits.lowest else ""


def _outside(status: FlightStatus, limits: Limits) -> str:
    x, y, z = np.subtract(status.reading.position, (*status.home[:2], 0.0))
    if max(abs(x), abs(y)) > limits.fence:
        return f"{max(abs(x), abs(y)):.2f} m from the place of take-off"
    return f"at a height of {z:.2f} m" if z > limits.ceiling else ""


GUARDS = (
    Guard(lambda status, limits: "stopped at once by hand" if status.stops > 1 else "", cut=True),
    Guard(_upside_down, patience=0.05, cut=True),
    Guard(_steep, patience=0.05, cut=True),
    Guard(_not_finite, patience=0.1, cut=True),
    Guard(_disarmed, patience=0.1, cut=True),
    Guard(_stopped, patience=0.5, cut=True),
    Guard(lambda status, limits: "stopped by hand" if status.stops else ""),
    Guard(lambda status, limits: f"link lost: {status.lost}" if status.lost else ""),
    Guard(
        lambda status, limits: f"rows cannot be written: {status.broken}" if status.broken else ""
    ),
    Guard(_silent),
    Guard(_empty, patience=0.5),
    Guard(_outside, patience=0.1),
    Guard(_astray, patience=0.2),
    Guard(_sunk, patience=0.5),
)
"""In flight, the gravest first."""


@dataclass
class Watch:
    """Keeps how long each guard's reason has lasted."""

    limits: Limits
    guards: Sequence[Guard] = GUARDS
    _since: dict[int, float] = field(default_factory=dict)

    def trip(self, status: FlightStatus) -> Trip | None:
        """Returns the first guard whose reason has lasted long enough."""
        for number, guard in enumerate(self.guards):
            reason = guard.says(status, self.limits)
            if not reason:
                self._since.pop(number, None)
            elif status.now - self._since.setdefault(number, status.now) >= guard.patience:
                return Trip(reason, guard.cut)
        return None
