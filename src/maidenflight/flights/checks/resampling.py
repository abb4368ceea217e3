"""Even rows of logs that lost some or whose clock jitters.

`bridged` fills in the few rows that a busy micro-SD card costs a log of 500 Hz: in 15 ms the motors
go a fifth of the way to a new command. `resampled` puts a log whose steps are often uneven on even
ones. Without them a flight would be cut into pieces too short to be used.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from maidenflight.flights.log import Flight

MAX_GAP_S = 0.015
"""Step of time that is bridged [s]; longer ones cut the flight."""
MAX_FILLED = 0.2
"""Share of rows that may have to be filled in."""
MAX_UNEVEN = 0.02
"""Share of uneven steps between rows above which a log is resampled."""
MAX_GAP_ROWS = 4
"""Rows in succession that resampling fills in."""


def bridged(
    flight: Flight, time: Float[np.ndarray, "N"]
) -> tuple[Flight, Float[np.ndarray, "N"], list[str]]:
    """Puts rows in where a step of time is longer than the period, but not longer than `MAX_GAP_S`.

    Signals follow straight lines, commands hold.

    Args:
        flight: as read.
        time: of its rows [s].

    Returns:
        Flight, time, and a note where rows were put in.
    """
    if not np.isfinite(time).all() or not 0 < flight.period < MAX_GAP_S:
        return flight, time, []
    step = np.diff(time)
    lost = (step > 1.5 * flight.period) & (step <= MAX_GAP_S)
    missing = np.where(lost, np.maximum(np.round(step / flight.period).astype(int) - 1, 0), 0)
    if not missing.any() or missing.sum() > MAX_FILLED * len(time):
        return flight, time, []
    rows = np.arange(len(time))
    places = rows + np.concatenate([[0], np.cumsum(missing)])
    grid = np.interp(np.arange(places[-1] + 1), places, rows)
    arrays = {group: _along(values, grid, group) for group, values in flight.arrays.items()}
    note = (
        f"{flight.name}: {missing.sum()} lost rows filled in, no gap of them longer than "
        f"{MAX_GAP_S:g} s"
    )
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


def resampled(
    flight: Flight, time: Float[np.ndarray, "N"]
) -> tuple[Flight, Float[np.ndarray, "M"], list[str]]:
    """Returns flight at even steps if its rows jitter or some are missing, and a note that says so.

    Signals are interpolated linearly; commands constant until the next row and set-points keep
    their last value. A gap of more than `MAX_GAP_ROWS` rows stays a gap. A log whose steps are even
    but
    for a few, or mostly uneven, or whose time does not increase, is returned as it is.

    Args:
        flight: as read.
        time: time of each row [s].
    """
    if len(time) < 3 or not np.isfinite(time).all():
        return flight, time, []
    step = np.diff(time)
    if step.min() <= 0:
        return flight, time, []
    uneven = np.abs(step - flight.period) > flight.period / 2
    if not MAX_UNEVEN < uneven.mean() < 0.5:
        return flight, time, []
    ends = [0, *(np.flatnonzero(step > (MAX_GAP_ROWS + 0.5) * flight.period) + 1), len(time)]
    grids = [
        np.arange(float(time[first]), float(time[last - 1]) + 1e-9, flight.period)
        for first, last in pairwise(ends)
    ]
    grid = np.concatenate(grids)
    before = np.clip(np.searchsorted(time, grid + 1e-9, side="right") - 1, 0, len(time) - 1)
    arrays = {
        group: getattr(flight, group)[before]
        for group in ("setpoint", *(("command",) if flight.zero_order_hold else ()))
    }
    for group, logged in flight.arrays.items():
        if group not in arrays:
            values = logged.astype(np.float64)
            values = np.unwrap(values, axis=0) if group == "attitude" else values
            flat = values.reshape(len(time), -1).T
            even = np.stack([np.interp(grid, time, row) for row in flat], axis=1)
            arrays[group] = even.reshape(len(grid), *values.shape[1:]).astype(np.float32)
    note = (
        f"{flight.name}: {int(uneven.sum())} of {len(step)} steps are uneven (rows late or "
        f"missing); resampled to {1 / flight.period:.4g} Hz"
    )
    return replace(flight, **arrays), grid, [note]
