"""Speed command beyond which thrust no longer follows a curve: motors at their limit, or a sag.

Specific force is regressed on the mean of lagged speed commands and of their squares, on the steps
whose commands stay below a limit. Where a curve over more commands differs from that below the
limit and explains the steps there worse, the motors saturate beyond it.
"""

from collections.abc import Sequence

import numpy as np
import scipy
from jaxtyping import Bool, Float
from scipy.ndimage import maximum_filter1d

from maidenflight.flights.checkup.relations import block_mean
from maidenflight.flights.log import Flight
from maidenflight.identification.signals.flight_signals import STEP, stride

LIMITS = (np.inf, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4)
"""Speed commands beyond which motors may saturate."""
MEMORY = 0.5
"""Time for which a command beyond the limit acts: lag, filters, and memory of the noise [s]."""
_FEWEST, _LEAST_SHARE = 200, 0.5
"""Steps, and share of all, that must stay below a limit."""
_OTHER, _SURE = 0.1, 3.0
"""Difference of thrust, a share, and standard errors of what it explains, of another curve."""


def beyond(command: Float[np.ndarray, "N"], limit: float, period: float) -> Bool[np.ndarray, "N"]:
    """Returns rows that a command beyond the limit acts on.

    Args:
        command: speed, mean of four motors.
        limit: of `LIMITS`.
        period: of a row [s].
    """
    return np.asarray(_recent_peak(command, _memory_rows(period)) > limit)


def _memory_rows(period: float) -> int:
    """Returns the rows of `MEMORY`."""
    return max(1, round(MEMORY / period))


def _recent_peak(command: Float[np.ndarray, "N"], rows: int) -> Float[np.ndarray, "N"]:
    """Returns the greatest of a command over so many rows, in a window that ends at each row."""
    values = np.asarray(command, float)
    return np.asarray(maximum_filter1d(values, rows, axis=0, origin=(rows - 1) // 2))


def saturation(flights: Sequence[Flight], lag: float) -> float:
    """Returns the limit of `LIMITS` beyond which thrust follows another curve; infinite if none.

    Args:
        flights: checked flights of one rate.
        lag: of the motors, about [s].
    """
    parts = [_regressors(one, lag) for one in flights if one.accelerometer is not None]
    parts = [one for one in parts if len(one)]
    if not parts:
        return np.inf
    signals = np.concatenate(parts)
    count = len(signals)
    fits = []
    for limit in LIMITS:
        used = signals[:, 3] <= limit
        if used.sum() < max(_FEWEST, _LEAST_SHARE * count):
            break
        curve = np.linalg.lstsq(signals[used, :2], signals[used, 2], rcond=None)[0]
        fits.append((limit, used, curve))
    for place, (limit, _, curve) in enumerate(fits):
        if not any(_differs(signals[used], curve, other) for _, used, other in fits[place + 1 :]):
            return float(limit)
    return np.inf


def note_saturation(limit: float) -> list[str]:
    """Returns a note on thrust that saturates, if it does."""
    if np.isinf(limit):
        return []
    return [
        f"thrust no longer follows the commands where their mean exceeds u = {limit**2:.2f} "
        "(motors at their limit, or a sagging battery): parameters are of what lies below, and "
        "full thrust is less than thrust_to_weight says. Keep policies below."
    ]


def _regressors(flight: Flight, lag: float) -> Float[np.ndarray, "M 4"]:
    """Speed, its square, specific force along z, and the greatest command of late, by step."""
    decay = np.exp(-flight.period / max(lag, 1e-3))
    command, start = flight.speed_command, decay * flight.speed_command[:1]
    speed = scipy.signal.lfilter([1 - decay], [1.0, -decay], command, axis=0, zi=start)[0]
    late = round(flight.accelerometer_delay / flight.period)
    force = np.asarray(flight.accelerometer, float)[:, 2]
    rows = _memory_rows(flight.period)
    most = _recent_peak(command.mean(axis=1), rows)
    columns = [speed.mean(axis=1), (speed**2).mean(axis=1)]
    # A slow filter acts on what is compared with it too.
    smooth = max(1, round(2 * flight.accelerometer_delay / flight.period))
    weights = np.ones(smooth) / smooth
    columns[:2] = [scipy.signal.lfilter(weights, [1.0], column) for column in columns[:2]]
    shift = max(0, late - smooth // 2)
    table = np.column_stack([*columns[:2], np.roll(force, -shift), most])
    return block_mean(table[rows : len(table) - shift], stride(flight))


def _differs(
    signals: Float[np.ndarray, "M 4"], curve: Float[np.ndarray, "2"], other: Float[np.ndarray, "2"]
) -> bool:
    """Tests whether a curve explains steps worse than their own, and gives another thrust."""
    mine, theirs = (signals[:, :2] @ one for one in (curve, other))
    size = np.quantile(signals[:, 0], [0.1, 0.9])
    ends = np.stack([size, size**2], axis=1)
    gap = np.abs(ends @ curve - ends @ other) / np.maximum(np.abs(ends @ other), 1.0)
    loss = (signals[:, 2] - mine) ** 2 - (signals[:, 2] - theirs) ** 2
    blocks = block_mean(loss[:, None], round(1.0 / STEP))[:, 0]
    error = float(blocks.std()) / np.sqrt(max(len(blocks), 1))
    return bool(gap.max() > _OTHER and blocks.mean() > _SURE * max(error, 1e-12))
