"""Readings of rotor speeds that no rotor can have had, between sound ones.

Telemetry of speed controllers loses packets and now and then garbles one: IDSIA's NanoDrone reads
3,000,000 and 6,000,000 1/min among 99,000. A log is used whole where few are wrong.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import median_filter

from maidenflight.flights.log import Flight

_ROWS = 5
"""Rows whose median a reading is compared with: a rotor that speeds up passes."""
_LEAP = 0.5
"""Share of the flight's fastest hundredth by which a sound reading may differ from that median. In
two rows a rotor does not turn half as fast again and back."""
_LONGEST_S = 0.1
"""Gap over which readings are interpolated [s]: a few lags of a motor."""


def mend_rotor_speeds(flight: Flight) -> tuple[Flight, list[str]]:
    """Returns a flight whose wrong and missing readings are interpolated, and a note on them.

    What lasts longer than `_LONGEST_S` is left as it is.
    """
    if flight.rotor_speed is None:
        return flight, []
    speeds = flight.rotor_speed.astype(float)
    wrong = np.stack([_wrong(column) for column in speeds.T], axis=1)
    most = max(1, round(_LONGEST_S / flight.period)) if flight.period > 0 else 1
    mended = [_interpolated(*columns, most) for columns in zip(speeds.T, wrong.T, strict=True)]
    changed = np.stack(mended, axis=1)
    count = int((wrong & np.isfinite(changed)).any(axis=1).sum())
    if not count:
        return flight, []
    note = (
        f"{flight.name}: rotor speeds of {count} rows are impossible or missing, and interpolated "
        f"(first: row {int(wrong.any(axis=1).argmax()) + 1})"
    )
    return replace(flight, rotor_speed=changed.astype(np.float32)), [note]


def _wrong(speed: Float[np.ndarray, "N"]) -> Bool[np.ndarray, "N"]:
    unknown = ~np.isfinite(speed)
    if unknown.all():
        return unknown
    filled = np.interp(np.arange(len(speed)), np.flatnonzero(~unknown), speed[~unknown])
    largest = _LEAP * float(np.quantile(np.abs(filled), 0.99))
    return unknown | (np.abs(filled - median_filter(filled, _ROWS, mode="nearest")) > largest)


def _interpolated(
    speed: Float[np.ndarray, "N"], wrong: Bool[np.ndarray, "N"], most: int
) -> Float[np.ndarray, "N"]:
    """Speeds with lines over gaps of at most so many rows, and NaN in longer ones."""
    sound, rows = np.flatnonzero(~wrong), np.arange(len(speed))
    if len(sound) < 2:
        return np.where(wrong, np.nan, speed)
    after = np.searchsorted(sound, rows).clip(1, len(sound) - 1)
    short = sound[after] - sound[after - 1] <= most + 1
    inside = (rows > sound[0]) & (rows < sound[-1])
    filled = np.where(short & inside, np.interp(rows, sound, speed[sound]), np.nan)
    return np.where(wrong, filled, speed)
