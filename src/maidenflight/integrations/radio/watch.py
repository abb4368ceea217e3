"""What must hold before a flight and during it, and what happens where it does not.

Distances, tilts and speeds are of the drone's own estimate, which is all that a program on the
ground has.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from maidenflight.integrations.radio.blocks import (
    ARMED,
    AUTO_ARMED,
    CAN_BE_ARMED,
    CAN_FLY,
    CRASHED,
    ENABLE,
    LOCKED,
    TUMBLED,
    Reading,
)

Vector = tuple[float, float, float]

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


class Seen(NamedTuple):
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
    """How often somebody asked to stop."""


class Trip(NamedTuple):
    """Why a flight is broken off."""

    reason: str
    cut: bool
    """Whether the motors stop at once; else the drone lands."""


class Guard(NamedTuple):
    """One reason to break off."""

    says: Callable[[Seen, Limits], str]
    """The reason where there is one, else nothing."""
    patience: float = 0.0
    """How long it must last [s]."""
    cut: bool = False


def _not_finite(seen: Seen, limits: Limits) -> str:
    return "" if seen.reading.finite else "the estimate is not a number"


def _upside_down(seen: Seen, limits: Limits) -> str:
    names = {TUMBLED: "tumbled", CRASHED: "crashed", LOCKED: "locked"}
    told = [name for bit, name in names.items() if seen.reading.supervisor & bit]
    return f"the firmware says: {', '.join(told)}" if told else ""


def _steep(seen: Seen, limits: Limits) -> str:
    tilt = np.degrees(seen.reading.tilt)
    return f"tilt of {tilt:.0f} deg" if tilt > limits.steepest else ""


def _disarmed(seen: Seen, limits: Limits) -> str:
    return (
        "" if seen.reading.supervisor & (ARMED | AUTO_ARMED) else "the firmware has disarmed itself"
    )


def _stopped(seen: Seen, limits: Limits) -> str:
    return "" if any(seen.reading.motors) else "the firmware has stopped the motors"


def _silent(seen: Seen, limits: Limits) -> str:
    silence = seen.now - seen.reading.received
    return f"no rows for {limits.silence:g} s" if silence > limits.silence else ""


def _empty(seen: Seen, limits: Limits) -> str:
    return f"battery at {seen.reading.battery:.2f} V" if seen.reading.battery < limits.empty else ""


def _astray(seen: Seen, limits: Limits) -> str:
    distance = float(np.linalg.norm(np.subtract(seen.reading.position, seen.setpoint)))
    return f"{distance:.2f} m from the set-point" if distance > limits.farthest else ""


def _sunk(seen: Seen, limits: Limits) -> str:
    below = seen.setpoint[2] - seen.reading.position[2]
    return f"{below:.2f} m below the set-point" if below > limits.lowest else ""


def _outside(seen: Seen, limits: Limits) -> str:
    x, y, z = np.subtract(seen.reading.position, (*seen.home[:2], 0.0))
    if max(abs(x), abs(y)) > limits.fence:
        return f"{max(abs(x), abs(y)):.2f} m from the place of take-off"
    return f"at a height of {z:.2f} m" if z > limits.ceiling else ""


GUARDS = (
    Guard(lambda seen, limits: "stopped at once by hand" if seen.stops > 1 else "", cut=True),
    Guard(_upside_down, patience=0.05, cut=True),
    Guard(_steep, patience=0.05, cut=True),
    Guard(_not_finite, patience=0.1, cut=True),
    Guard(_disarmed, patience=0.1, cut=True),
    Guard(_stopped, patience=0.5, cut=True),
    Guard(lambda seen, limits: "stopped by hand" if seen.stops else ""),
    Guard(lambda seen, limits: f"link lost: {seen.lost}" if seen.lost else ""),
    Guard(lambda seen, limits: f"rows cannot be written: {seen.broken}" if seen.broken else ""),
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

    def trip(self, seen: Seen) -> Trip | None:
        """The first guard whose reason has lasted long enough."""
        for number, guard in enumerate(self.guards):
            reason = guard.says(seen, self.limits)
            if not reason:
                self._since.pop(number, None)
            elif seen.now - self._since.setdefault(number, seen.now) >= guard.patience:
                return Trip(reason, guard.cut)
        return None


class Standing(NamedTuple):
    """What is known of a drone on the ground."""

    reading: Reading
    decks: tuple[str, ...]
    """Of `DECKS`, those that are mounted."""
    variance: tuple[Vector, ...]
    """Of the estimated position [m2], some time's readings."""
    policy: bool
    """Whether a controller on board with our parameters answers."""
    looks_ahead: bool = False
    """Whether its policy sees the reference ahead of time."""


def objections(standing: Standing, limits: Limits, needs_policy: bool) -> list[str]:
    """Why the drone must not take off, each with what to do; empty if it may."""
    reading, said = standing.reading, []
    for bit, what in ((LOCKED, "locked"), (CRASHED, "crashed"), (TUMBLED, "tumbled")):
        if reading.supervisor & bit:
            said.append(f"the firmware says that it has {what}; put it level, switch it off and on")
    if reading.battery < limits.full:
        said.append(f"battery at {reading.battery:.2f} V, {limits.full:g} V are needed; charge it")
    if not standing.decks:
        said.append(
            "no deck that tells the position; mount a Flow deck v2 and switch the drone off and on"
        )
    if not reading.finite:
        said.append("the estimate is not a number; switch the drone off and on")
    elif np.degrees(reading.tilt) > limits.level:
        said.append(
            f"tilted by {np.degrees(reading.tilt):.0f} deg; put it level and switch it off and on"
        )
    elif not settled(standing.variance):
        said.append(
            "the estimator does not settle; put the drone onto a well-lit floor with a pattern "
            "and leave it alone"
        )
    if not reading.supervisor & (CAN_BE_ARMED | ARMED | AUTO_ARMED | CAN_FLY):
        said.append("the firmware refuses to be armed; its console (cfclient) tells why")
    if reading.policy:
        said.append(
            f"the policy on board is on and does not obey {ENABLE} = 0; switch the drone off and on"
        )
    if needs_policy and not standing.policy:
        said.append("no policy on board; build the exported app and flash it")
    elif needs_policy and standing.looks_ahead:
        said.append(
            "the policy on board looks ahead, but set-points by radio tell no more than where the "
            "drone shall be now; flash one trained without --look-ahead, or fly mf.task 0 or 1"
        )
    return said


def settled(variance: Sequence[Vector], change: float = 0.001, fewest: int = 10) -> bool:
    """Whether the estimator's variance has come to rest.

    Source: cflib 0.1.34, utils/reset_estimator.py.
    """
    last = np.array(variance[-fewest:])
    return (
        len(last) >= fewest
        and bool(np.isfinite(last).all())
        and float(np.ptp(last, axis=0).max()) < change
    )
