"""Rows that a fast log lost, filled in where hardly anything can have happened meanwhile.

A micro-SD card that is busy costs a log of 500 Hz some rows now and then. Cut there, a flight falls into
pieces too short to be used; in 15 ms the motors go a fifth of the way to a new command.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from maidenflight.flights.log import Flight

LONGEST = 0.015
"""Step of time that is bridged [s]; longer ones cut the flight."""
MOST = 0.2
"""Share of rows that may have to be filled in."""


def bridged(
    flight: Flight, time: Float[np.ndarray, "N"]
) -> tuple[Flight, Float[np.ndarray, "N"], list[str]]:
    """Puts rows in where a step of time is longer than the period, but not longer than `LONGEST`.

    Signals follow straight lines, commands hold.

    Args:
        flight: as read.
        time: of its rows [s].

    Returns:
        Flight, time, and a note where rows were put in.
    """
    if not np.isfinite(time).all() or not 0 < flight.period < LONGEST:
        return flight, time, []
    step = np.diff(time)
    lost = (step > 1.5 * flight.period) & (step <= LONGEST)
    missing = np.where(lost, np.maximum(np.round(step / flight.period).astype(int) - 1, 0), 0)
    if not missing.any() or missing.sum() > MOST * len(time):
        return flight, time, []
    rows = np.arange(len(time))
    places = rows + np.concatenate([[0], np.cumsum(missing)])
    grid = np.interp(np.arange(places[-1] + 1), places, rows)
    arrays = {group: _along(values, grid, group) for group, values in flight.arrays.items()}
    note = f"{flight.name}: {missing.sum()} lost rows filled in, no gap of them longer than {LONGEST:g} s"
    return replace(flight, **arrays), np.interp(grid, rows, time), [note]


def _along(values: np.ndarray, grid: Float[np.ndarray, "M"], group: str) -> np.ndarray:
    """Rows at fractional places."""
    before = np.floor(grid).astype(int)
    if group in ("command", "battery", "setpoint"):
        return values[before]
    after = np.minimum(before + 1, len(values) - 1)
    share = (grid - before)[:, None].astype(np.float32)
    change = values[after] - values[before]
    if group == "attitude":
        change = (change + np.float32(np.pi)) % np.float32(2 * np.pi) - np.float32(np.pi)
    return (values[before] + share * change).astype(np.float32)
