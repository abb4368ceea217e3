"""Signals that are logged each at a rate and times of its own, and rows made of them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

LONGEST_GAP = 5.0
"""Steps of a signal between two of its samples beyond which it is unknown there."""


LEFT_UP = np.array([1.0, -1.0, -1.0])
"""Signs that turn forward, right, down into our forward, left, up."""


class Stream(NamedTuple):
    """A signal of K numbers: M samples in the order of their times, which differ."""

    time: Float[np.ndarray, "M"]
    """[s]."""
    values: Float[np.ndarray, "M K"]

    @property
    def step(self) -> float:
        """The typical time between two samples [s]; NaN of fewer than two."""
        return float(np.median(np.diff(self.time))) if len(self.time) > 1 else float("nan")

    @property
    def rate(self) -> float:
        """[Hz]; 0 of fewer than two samples."""
        return 1.0 / self.step if len(self.time) > 1 else 0.0

    def part(self, rows: np.ndarray) -> "Stream":
        """Returns some of the samples, by a mask."""
        return Stream(self.time[rows], self.values[rows])


def stream(time: Float[np.ndarray, "M"], values: np.ndarray) -> Stream:
    """Returns a signal of samples in any order; of those with one time the first.

    Args:
        time: of each sample [s]; those that are not finite are left out.
        values: (M, K), or (M,) of one number.
    """
    values = np.asarray(values, float)
    values = values[:, None] if values.ndim == 1 else values
    is_finite = np.isfinite(time)
    rows, first = np.unique(np.asarray(time, float)[is_finite], return_index=True)
    return Stream(rows, values[is_finite][first])


def _near(at: Float[np.ndarray, "N"], signal: Stream) -> np.ndarray:
    """Whether a time lies between two samples that are not far apart."""
    after = np.clip(np.searchsorted(signal.time, at, side="left"), 0, len(signal.time) - 1)
    before = np.clip(np.searchsorted(signal.time, at, side="right") - 1, 0, None)
    gap = signal.time[after] - signal.time[before]
    inside = (at >= signal.time[0]) & (at <= signal.time[-1])
    return inside & (gap <= LONGEST_GAP * signal.step)


def between(at: Float[np.ndarray, "N"], signal: Stream) -> Float[np.ndarray, "N K"]:
    """Interpolates a signal linearly at some times; NaN in gaps and outside."""
    if len(signal.time) < 2:
        return np.full((len(at), signal.values.shape[1]), np.nan)
    values = np.stack([np.interp(at, signal.time, row) for row in signal.values.T], axis=1)
    values[~_near(at, signal)] = np.nan
    return values


def hold_last(at: Float[np.ndarray, "N"], signal: Stream) -> Float[np.ndarray, "N K"]:
    """Returns the last sample at or before given times, however old; NaN before the first."""
    if not len(signal.time):
        return np.full((len(at), signal.values.shape[1]), np.nan)
    before = np.searchsorted(signal.time, at, side="right") - 1
    return np.where((before >= 0)[:, None], signal.values[np.maximum(before, 0)], np.nan)


def mean_until_next(at: Float[np.ndarray, "N"], signal: Stream) -> Float[np.ndarray, "N K"]:
    """Returns the mean of a signal that holds each sample, from each time to the next.

    NaN as `between`. The integral of such a signal is linear between its samples, so that the mean
    is exact. After the last time comes a step as long as the one before.
    """
    if len(signal.time) < 2 or len(at) < 2:
        return np.full((len(at), signal.values.shape[1]), np.nan)
    step = np.diff(signal.time)[:, None]
    summed = np.cumsum(signal.values[:-1] * step, axis=0)
    integral = np.concatenate([np.zeros((1, summed.shape[1])), summed])
    steps = np.diff(at)
    usual = np.median(steps)
    # After a gap of the rows it is the mean over a usual step, not over the gap.
    ends = at + np.minimum(np.append(steps, usual), 1.5 * usual)
    ends = np.minimum(ends, signal.time[-1])
    first, last = (
        np.stack([np.interp(instants, signal.time, row) for row in integral.T], axis=1)
        for instants in (at, ends)
    )
    width = (ends - at)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (last - first) / width
    is_known = _near(at, signal)[:, None] & (width > 0)
    return np.where(is_known, mean, np.nan)


def period(time: Float[np.ndarray, "N"]) -> float:
    """Returns the step of most rows [s], to 0.1 ms where that is within 0.2 %, else to 1 us.

    Stamps in whole ms are averaged over the steps near their median. 0.01 of a single row.
    """
    steps = np.diff(time[np.isfinite(time)])
    if len(steps) == 0:
        return 0.01
    middle = np.median(steps)
    near = steps[np.abs(steps - middle) <= abs(middle) / 2]
    mean = np.mean(near) if len(near) else middle
    return float(np.round(mean, 4 if abs(np.round(mean, 4) - mean) <= 2e-3 * abs(mean) else 6))
