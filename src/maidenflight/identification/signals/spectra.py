"""Spectra of commands and of what follows them, over stretches of flight."""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Complex, Float, Int

WINDOW = 4.0
"""Length of a stretch that is transformed, with Hann's window and half overlap [s]: 0.7 and 1.4
times as long, NanoBench's lag moves by 0.6 of half its interval, other drones' less
(paper/identification/constants.py; against measured speeds `truth_board.py --lag`)."""
LOWEST, HIGHEST = 1.5, 15.0
"""Frequencies that count [Hz]: below, position and speed are controlled; above is vibration. 0.7
times as high INDIflight's inertia moves by 1.8 of half its interval; over the whole band an optimum
is unstable (paper/identification/constants.py, paper/notes/identification.md#attempts)."""
SLOW = 6.0
"""Frequency up to which a command that is sampled must be clear of what its samples fold [Hz];
harmless within a factor of 1.4 (paper/identification/constants.py)."""
BANDS = 8
"""Parts of these frequencies in which set-points and disturbances have sizes of their own: with 6
NanoBench's inertia moves by 1.2 of half its interval, with 11 payload's by 0.4
(paper/identification/constants.py)."""


class Spectra(NamedTuple):
    """Sums over stretches of the squares and products of a command and the motion, F lines."""

    s: Complex[np.ndarray, "F"]
    """Imaginary frequency [rad/s]."""
    drive: Float[np.ndarray, "F"]
    """Of the command's square, in units in which both signals are alike."""
    motion: Float[np.ndarray, "F"]
    """Of the motion's square."""
    cross: Complex[np.ndarray, "F"]
    """Of the motion with the command."""
    band: Int[np.ndarray, "F"]
    """Number of the band of each line."""
    averages: float
    """Independent stretches in these sums."""
    clear: float
    """Times by which the command is stronger than near half the log's rate, up to `SLOW`."""
    scale: float
    """Motion of that unit of the command, over the command."""

    def means(self, power: Float[np.ndarray, "F"]) -> Float[np.ndarray, "B"]:
        """Returns the mean of a power in each band."""
        return np.bincount(self.band, power) / np.bincount(self.band)

    @property
    def coherence(self) -> float:
        """Mean squared coherence of both signals in the bands; a command read late is no noise."""
        cross = self.cross * np.exp(self.s * 0.03)
        shared = self.means(np.real(cross)) ** 2 + self.means(np.imag(cross)) ** 2
        return float(np.mean(shared / (self.means(self.drive) * self.means(self.motion) + 1e-30)))


def bands(frequencies: Float[np.ndarray, "F"]) -> Int[np.ndarray, "F"]:
    """Returns the number of each frequency's band of `BANDS`; those without a line have none."""
    edges = np.geomspace(0.999 * LOWEST, 1.001 * HIGHEST, BANDS + 1)
    return np.unique(np.digitize(frequencies, edges), return_inverse=True)[1]


def transform(
    signals: Float[np.ndarray, "N C"], period: float, lowest: float, highest: float
) -> tuple[Float[np.ndarray, "F"], Complex[np.ndarray, "C S F"]]:
    """Returns frequencies [Hz] and transforms over stretches of `WINDOW` that overlap by half.

    Trends of a stretch are taken out.

    Args:
        signals: of equally many rows.
        period: of a row [s].
        lowest: frequency [Hz].
        highest: likewise.
    """
    rows = min(round(WINDOW / period), len(signals))
    frequencies = np.fft.rfftfreq(rows, period)
    chosen = (frequencies >= lowest) & (frequencies <= highest)
    count = int(np.ceil((len(signals) - rows) / (rows / 2))) + 1
    begins = np.unique(np.round(np.linspace(0, len(signals) - rows, count)).astype(int))
    pieces = np.stack([signals[begin : begin + rows].T for begin in begins], axis=1)
    pieces = pieces - pieces.mean(axis=2, keepdims=True)
    # A straight line less, by its closed form: a general regression took half of all this.
    line = np.arange(rows) - (rows - 1) / 2
    pieces -= (pieces @ line / (line @ line))[..., None] * line
    window = scipy.signal.windows.hann(rows, sym=False)
    return frequencies[chosen], np.fft.rfft(pieces * window)[..., chosen]


def spectra(
    drive: Float[np.ndarray, "N c"],
    motion: Float[np.ndarray, "N c"],
    period: float,
    *,
    zero_order_hold: bool,
    differentiate: bool,
) -> Spectra:
    """Returns the spectra of commands and of what follows them, sums over c such pairs.

    Args:
        drive: the commands.
        motion: what follows each.
        period: of a row [s].
        zero_order_hold: whether a command acts until the next row, half a row later in the mean.
        differentiate: whether the motion's derivative follows the command.
    """
    every, lines = transform(drive, period, LOWEST, np.inf)
    frequencies, u = every[every <= HIGHEST], lines[..., every <= HIGHEST]
    s = 2j * np.pi * frequencies
    u = u * (np.exp(-s * period / 2) if zero_order_hold else 1.0)
    y = transform(motion, period, LOWEST, HIGHEST)[1] * (s if differentiate else 1.0)
    scale = np.sqrt(np.mean(np.abs(y) ** 2) / max(float(np.mean(np.abs(u) ** 2)), 1e-30))
    u = u * scale
    band = bands(frequencies)
    drives, moves = (np.sum(np.abs(signal) ** 2, axis=(0, 1)) for signal in (u, y))
    averages = drive.shape[1] * len(drive) / min(round(WINDOW / period), len(drive))
    fast = lines[..., every >= 0.35 / period]
    noise = np.mean(np.abs(fast) ** 2) * scale**2 * u.shape[0] * u.shape[1] + 1e-30
    slow = np.bincount(band, drives / noise)[: band[frequencies < SLOW][-1]]
    clear = slow / np.bincount(band)[: len(slow)]
    cross = np.sum(y * u.conj(), axis=(0, 1))
    return Spectra(s, drives, moves, cross, band, averages, float(clear.min()), float(scale))
