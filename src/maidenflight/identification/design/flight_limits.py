"""How far simulated flights went, and what no manoeuvre of a plan may exceed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from maidenflight.flights.flight_plan import Extremes
from maidenflight.flying.rows import Rows

MARGIN = 0.2
"""Distance from walls, floor and ceiling [m]; chosen, as a radio flight's from its fence
(integrations/radio/session.py)."""
LOWEST = 0.3
"""Least height of the flight [m], likewise of a radio flight (integrations/radio/session.py). The
ground adds 0.4 % to a Crazyflie's thrust there, and 3 % to that of propellers of 5 inches."""


@dataclass(frozen=True)
class FlightLimits:
    """What no manoeuvre may exceed on any simulated drone."""

    tilt: float = np.radians(35.0)
    """[rad]; the firmware's PID asks for 22 deg a axis at most."""
    calm: float = np.radians(10.0)
    """Tilt of a hover beyond which the PID is near a limit cycle [rad]."""
    speed: float = 1.5
    """[m/s]."""
    astray: float = 0.45
    """From the set-point [m]; a radio flight is broken off at 0.6 m."""
    sunk: float = 0.3
    """Below the set-point [m]; a radio flight is broken off at 0.35 m."""
    at_limits: float = 0.05
    """Share of commands that are 0 or full."""

    def excess(self, extremes: Extremes, room: tuple[float, float, float]) -> str:
        """Returns what of a flight exceeds this or leaves the room; empty if nothing does."""
        sides = (
            (extremes.lateral_x > room[0] / 2 - MARGIN, "room along x"),
            (extremes.lateral_y > room[1] / 2 - MARGIN, "room along y"),
            (extremes.highest > room[2] - MARGIN, "ceiling"),
            (extremes.lowest < LOWEST, "floor"),
            (extremes.tilt > self.tilt, "tilt"),
            (extremes.speed > self.speed, "speed"),
            (extremes.astray > self.astray, "distance from the set-point"),
            (extremes.sunk > self.sunk, "distance below the set-point"),
            (extremes.at_limits > self.at_limits, "motors at their limits"),
        )
        return next((quantity for exceeds, quantity in sides if exceeds), "")

    def unrest(self, hover: Extremes, room: tuple[float, float, float]) -> str:
        """Returns what of a hover exceeds this or what a well-controlled drone does."""
        return self.excess(hover, room) or ("tilt of hover" if hover.tilt > self.calm else "")


def extremes_of(rows: Rows) -> Extremes:
    """Returns how far a flight went."""
    true = np.asarray(rows.true_position, float)
    away = np.asarray(rows.true_setpoint, float) - true
    upright = np.cos(rows.true_attitude[:, 0]) * np.cos(rows.true_attitude[:, 1])
    command = np.asarray(rows.ratio)
    return Extremes(
        lateral_x=_largest(np.abs(true[:, 0])),
        lateral_y=_largest(np.abs(true[:, 1])),
        lowest=-_largest(-true[:, 2]),
        highest=_largest(true[:, 2]),
        tilt=_largest(np.arccos(np.clip(upright, -1.0, 1.0))),
        speed=_largest(np.linalg.norm(rows.true_velocity, axis=1)),
        astray=_largest(np.linalg.norm(away, axis=1)),
        sunk=_largest(away[:, 2]),
        at_limits=float(np.mean((command <= 0.0) | (command >= 1.0))),
    )


def _largest(values: Float[np.ndarray, "N"]) -> float:
    """The largest; a large number where a flight left the numbers."""
    worst = float(np.max(values)) if np.isfinite(values).all() else 1e6
    return min(worst, 1e6)


def worst_of(several: Sequence[Extremes]) -> Extremes:
    """Returns the extremes of several flights together."""
    rows = np.array([[getattr(extremes, name) for name in _NAMES] for extremes in several])
    lows = {"lowest": rows[:, _NAMES.index("lowest")].min()}
    highs = dict(zip(_NAMES, rows.max(axis=0), strict=True))
    return Extremes(**{name: float(value) for name, value in (highs | lows).items()})


_NAMES = list(Extremes.__dataclass_fields__)
