"""Test of measured rotor speeds: each has to follow its command, before it is believed.

Of logs with such a signal a third has one that follows neither commands nor motion: the reading was
broken. A signal that fails is passed over; the rest of the log is used.
"""

from collections.abc import Sequence

import numpy as np
import scipy
from jaxtyping import Float

from maidenflight.flights.checkup.columns import PLACES
from maidenflight.flights.checkup.motors import TORQUES
from maidenflight.flights.checkup.relations import block_mean
from maidenflight.flights.checkup.response import LAGS_S, responses, spectra
from maidenflight.flights.checkup.result import PASSES, WARNS, CheckResult, unknown
from maidenflight.flights.log import Flight

NAME = "rotor speeds"
FOLLOWS = 0.5
"""Correlation of a speed with its lagged command below which it does not follow it."""
MOTION = 0.6
"""Correlation of motion with speeds, by that with commands, below which they contradict it."""
STOPPED = 0.2
"""Share of rows with a command in which a rotor may read 0."""
_BAND_HZ = (0.3, 10.0)
_STEP_S = 0.01


def check_rotor_speeds(pieces: Sequence[Flight]) -> list[CheckResult]:
    """Checks measured rotor speeds of pieces of one flight, if there are any."""
    if pieces[0].rotor_speed is None:
        return []
    speed = np.concatenate([np.asarray(piece.rotor_speed) for piece in pieces])
    command = np.concatenate([piece.command for piece in pieces])
    on = command > 0.03
    with np.errstate(invalid="ignore"):
        stopped = ((speed <= 0.0) & on).sum(axis=0) / np.maximum(on.sum(axis=0), 1)
    silent = [rotor for rotor, share in zip(PLACES, stopped, strict=True) if share > STOPPED]
    if silent:
        rotors = "all four read" if len(silent) == 4 else f"{', '.join(silent)} reads"
        return [_pass_over(f"{rotors} 0 while commanded to turn", float(stopped.max()))]
    follows = _follow(pieces)
    if follows is None:
        return [unknown(NAME, "no piece lasts 4 s")]
    still = [
        rotor
        for rotor, values, commands in zip(PLACES, speed.T, command.T, strict=True)
        if values.std() < 1e-3 * max(abs(values.mean()), 1e-9) and commands.std() > 1e-3
    ]
    if still:
        return [_pass_over(f"{', '.join(still)} never changes while its command does", 0.0)]
    worst = int(np.argmin(follows))
    sentence = f"speeds follow their commands to {follows[worst]:.2f} and better"
    ratio = _motion_ratio(pieces)
    if follows[worst] < FOLLOWS or (ratio is not None and ratio < MOTION):
        motion = "" if ratio is None else f", and the motion to {ratio:.2f} of what commands do"
        reading = f"{PLACES[worst]} follows its command to {follows[worst]:.2f}{motion}"
        return [_pass_over(reading, float(follows[worst]))]
    return [CheckResult(NAME, PASSES, sentence, float(follows[worst]), f"{FOLLOWS:g} or more")]


def _pass_over(reading: str, statistic: float) -> CheckResult:
    sentence = f"measured rotor speeds are not believed and passed over: {reading}."
    return CheckResult(NAME, WARNS, sentence, statistic, f"{FOLLOWS:g} or more")


def _follow(pieces: Sequence[Flight]) -> Float[np.ndarray, "4"] | None:
    """Correlates each speed with its lagged command, at the lag that suits best."""
    sums = np.zeros((3, len(LAGS_S), 4))
    for piece in pieces:
        rows = max(1, round(_STEP_S / piece.period))
        step = rows * piece.period
        commanded = block_mean(piece.speed_command, rows)
        speed = block_mean(np.nan_to_num(np.asarray(piece.rotor_speed)), rows)
        if len(commanded) * step < 4.0:
            continue
        high = min(_BAND_HZ[1], 0.4 / step)
        band = scipy.signal.butter(2, (_BAND_HZ[0], high), "band", fs=1 / step, output="sos")
        speed = scipy.signal.sosfiltfilt(band, speed, axis=0)
        for index, lag in enumerate(LAGS_S):
            memory = np.exp(-step / lag)
            late = scipy.signal.sosfiltfilt(band, _lag(commanded, memory), axis=0)
            sums[0, index] += (late * speed).sum(axis=0)
            sums[1, index] += (late**2).sum(axis=0)
            sums[2, index] += (speed**2).sum(axis=0)
    if not sums.any():
        return None
    return (sums[0] / np.sqrt(np.maximum(sums[1] * sums[2], 1e-12))).max(axis=0)


def _lag(values: Float[np.ndarray, "M 4"], memory: float) -> Float[np.ndarray, "M 4"]:
    start = memory * values[:1]
    return scipy.signal.lfilter([1 - memory], [1.0, -memory], values, axis=0, zi=start)[0]


def _motion_ratio(pieces: Sequence[Flight]) -> float | None:
    """Compares how roll and pitch follow measured speeds with how they follow commands."""
    scores = []
    for speeds in (True, False):
        motion = spectra(pieces, speeds=speeds)
        if motion is None:
            return None
        answer = responses(motion)
        both = [answer.correlation(axis, TORQUES[:, axis]) for axis in (0, 1)]
        scores.append(float((both[0] + both[1]).max()))
    return scores[0] / max(scores[1], 1e-6) if scores[1] > 0.8 else None
