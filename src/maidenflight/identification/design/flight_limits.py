"""`FlightLimits`: what no manoeuvre of a plan may exceed."""

from dataclasses import dataclass

import numpy as np

from maidenflight.flights.flight_plan import Extremes

MARGIN = 0.2
"""Distance from walls, floor and ceiling [m]."""
LOWEST = 0.3
"""Least height of the flight [m]: ground effect, and what a radio flight is allowed."""


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

    def excess(self, extremes_of: Extremes, room: tuple[float, float, float]) -> str:
        """Returns what of a flight exceeds this or leaves the room; empty if nothing does."""
        sides = (
            (extremes_of.lateral_x > room[0] / 2 - MARGIN, "room along x"),
            (extremes_of.lateral_y > room[1] / 2 - MARGIN, "room along y"),
            (extremes_of.highest > room[2] - MARGIN, "ceiling"),
            (extremes_of.lowest < LOWEST, "floor"),
            (extremes_of.tilt > self.tilt, "tilt"),
            (extremes_of.speed > self.speed, "speed"),
            (extremes_of.astray > self.astray, "distance from the set-point"),
            (extremes_of.sunk > self.sunk, "distance below the set-point"),
            (extremes_of.at_limits > self.at_limits, "motors at their limits"),
        )
        return next((quantity for exceeds, quantity in sides if exceeds), "")

    def unrest(self, hover: Extremes, room: tuple[float, float, float]) -> str:
        """Returns what of a hover exceeds this or what a well-controlled drone does."""
        return self.excess(hover, room) or ("tilt of hover" if hover.tilt > self.calm else "")
