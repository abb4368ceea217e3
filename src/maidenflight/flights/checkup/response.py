"""How a drone answers its commands: cross spectra of motors, gyro and accelerometer, and how late.

Angular acceleration about an axis and specific force along z follow the motors' thrusts through a
first-order lag and a delay. Spectra hold all that any order of the motors, lag and delay asks for,
so that hundreds of them cost little. Frequencies count by the root of their power: all alike they
would be the noise's, by their power a single oscillation's.

No motion begins before its command. Motors, the gyro's filter and a feedback all make the answer
later: measured, by 1 to 28 ms in 116 sound logs, with standard errors below 7 ms.

Source: measured on 93 logs of ten sources; paper/notes/checkup.md has the figures.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from maidenflight.flights.checkup.relations import block_mean
from maidenflight.flights.checkup.result import FAILS, PASSES, WARNS, CheckResult, unknown
from maidenflight.flights.log import TORQUES, Flight

LAGS_S = np.array([0.012, 0.02, 0.03, 0.045, 0.065, 0.09, 0.13])
"""Time constants of motors that are tried [s]."""
DELAYS_S = np.round(np.arange(-0.15, 0.2501, 0.01), 3)
"""Delays behind the commands that are tried [s]."""
FORCE = 3
"""Channel of the specific force along z, by definition; 0, 1 and 2 are angular acceleration."""
FORCE_BELOW_HZ = 8.0
"""Above it a load on a cable and vibration make the force [Hz]; below it all counts by power."""
FEWEST = 3.5
"""Segments of flight from which that is judged."""
_RATE_HZ = 200.0
_FINE_LAGS_S, _FINE_DELAYS_S = np.geomspace(0.008, 0.2, 24), np.arange(-0.06, 0.1001, 0.002)
"""Lags and delays that are tried for one order of the motors [s]."""
_PARTS = 8
"""Parts of a flight of which each is left out once; chosen."""


class Band(NamedTuple):
    """Frequencies that are looked at."""

    low: float
    """[Hz]."""
    high: float
    """[Hz]."""
    segment: float
    """Time of a segment [s]."""
    shortest: float
    """That of a shorter piece that is still taken [s]."""
    exponent: float
    """Of the power by which frequencies count; 1 is that of a plain correlation."""


QUICK = Band(1.0, 15.0, 1.28, 0.6, 0.5)
"""In which commands explain the motion of drones of 30 g to 1 kg."""
SLOW = Band(0.35, 1.7, 2.56, 2.5, 1.0)
"""In which very smooth flights move, whose quick part is noise."""


class Spectra(NamedTuple):
    """Cross spectra of pieces of one flight at F frequencies, summed over segments."""

    frequency: Float[np.ndarray, "F"]
    channels: Float[np.ndarray, "F 4"]
    """Power of each channel."""
    commands: Complex[np.ndarray, "F 4 4"]
    across: Complex[np.ndarray, "F 4 4"]
    """Of motor i, conjugate, and channel j."""
    segments: float
    """How many independent ones."""
    band: Band

    def weight(self, channel: int) -> Float[np.ndarray, "F"]:
        """Returns how much frequencies count in a channel."""
        if channel == FORCE:
            return (self.frequency < FORCE_BELOW_HZ).astype(float)
        return _weight(self.channels[:, channel], self.band)


def _weight(power: Float[np.ndarray, "F"], band: Band) -> Float[np.ndarray, "F"]:
    """Returns how much frequencies of a signal count, by its power."""
    own = np.maximum(power, 1e-30)
    smooth = np.convolve(np.pad(own, 2, "edge"), np.ones(5) / 5, "valid")
    return np.maximum(smooth, 1e-9 * smooth.max()) ** (band.exponent - 1)


class Responses(NamedTuple):
    """What each lag and delay explain, of thrust commands and four channels."""

    products: Float[np.ndarray, "4 T D 4"]
    """By channel, lag, delay and motor."""
    power: Float[np.ndarray, "4 T 4 4"]
    """Of commands behind each lag, by channel's weights."""
    channels: Float[np.ndarray, "4"]
    segments: float

    def correlation(
        self, channel: int, pattern: Float[np.ndarray, "4"]
    ) -> Float[np.ndarray, "T D"]:
        """Returns how a channel correlates with a sum of motors, by lag and delay."""
        power = np.einsum("u,tuv,v->t", pattern, self.power[channel], pattern)
        size = np.sqrt(np.maximum(power * self.channels[channel], 1e-30))
        return self.products[channel] @ pattern / size[:, None]


class Fit(NamedTuple):
    """Which order of the motors roll and pitch follow best."""

    order: tuple[int, ...]
    score: float
    """Correlations of roll and pitch, summed."""
    lag: float
    """[s]."""
    delay: float
    """[s]."""


def place_of_largest(scores: Float[np.ndarray, "T D"]) -> tuple[int, int]:
    """Returns where the largest score is, by lag and delay."""
    lag, delay = np.unravel_index(int(np.argmax(scores)), scores.shape)
    return int(lag), int(delay)


def spectra(pieces: Sequence[Flight], band: Band = QUICK, speeds: bool = False) -> Spectra | None:
    """Sums cross spectra over half-overlapping segments; None where pieces are too short.

    Args:
        pieces: of one flight.
        band: frequencies to look at.
        speeds: take the squares of measured rotor speeds instead of commands.
    """
    total, segments, frequency = None, 0.0, np.zeros(0)
    for frequency, transform, late in _transforms(pieces, band, speeds):
        turn = 2j * np.pi * frequency[:, None]
        transform[:, :3] *= turn
        transform[:, 4:] *= np.exp(-turn * late)
        product = transform[:, :, None].conj() * transform[:, None, :]
        total = product if total is None else total + product
        segments += 0.5
    if total is None or len(frequency) < 4:
        return None
    channels = np.einsum("fii->fi", total[:, :4, :4]).real
    return Spectra(frequency, channels, total[:, 4:, 4:], total[:, 4:, :4], segments, band)


def transforms(pieces: Sequence[Flight], band: Band) -> Complex[np.ndarray, "S F 8"]:
    """Returns spectra of each segment: body rates, force along z, four thrusts."""
    each = [transform for _, transform, _ in _transforms(pieces, band, False)]
    return np.array(each) if each else np.zeros((0, 0, 8), complex)


def _transforms(
    pieces: Sequence[Flight], band: Band, speeds: bool
) -> Iterator[tuple[Float[np.ndarray, "F"], Complex[np.ndarray, "F 8"], float]]:
    """Yields frequencies and spectra of each segment, and how late the thrusts' rows are [s]."""
    length = 0
    for piece in sorted(pieces, key=len, reverse=True):
        rows = max(1, round(1 / _RATE_HZ / piece.period))
        step = piece.period * rows
        signals, late = _signals(piece, rows, speeds)
        count = min(round(band.segment / step), len(signals))
        if count * step < band.shortest or length not in (0, count):
            continue
        length = count
        frequency = np.fft.rfftfreq(count, step)
        inside = (frequency >= band.low) & (frequency <= min(band.high, 0.4 / step))
        for part in _segments(signals, count):
            yield frequency[inside], np.fft.rfft(part, axis=0)[inside], late


def _signals(piece: Flight, rows: int, speeds: bool) -> tuple[Float[np.ndarray, "M 8"], float]:
    """Returns body rates, force along z and thrusts, and how late the thrusts' rows are [s]."""
    force = np.zeros((len(piece), 1))
    if piece.accelerometer is not None:
        force = piece.accelerometer[:, 2:].astype(float)
    thrusts, late = piece.mean_command, piece.period / 2
    if speeds and piece.rotor_speed is not None:
        thrusts, late = piece.rotor_speed.astype(float) ** 2, 0.0
    columns = [piece.body_rates.astype(float), force, thrusts]
    return block_mean(np.concatenate(columns, axis=1), rows), late


def _segments(signals: Float[np.ndarray, "M 8"], count: int) -> list[Float[np.ndarray, "n 8"]]:
    """Returns windowed segments without their mean and trend."""
    window = np.hanning(count)[:, None]
    line = np.linspace(-1.0, 1.0, count)[:, None]
    parts = []
    for start in range(0, len(signals) - count + 1, max(count // 2, 1)):
        part = signals[start : start + count]
        part = part - part.mean(axis=0)
        parts.append((part - line * (line * part).sum(axis=0) / (line**2).sum()) * window)
    return parts


def gain_error(pieces: Sequence[Flight], lag: float, delay: float) -> float:
    """Estimates the standard error of the answer of the force to all motors, as a share of it.

    From how segments of the flight differ.

    Args:
        pieces: of one flight, with an accelerometer.
        lag: of the motors [s].
        delay: behind the commands [s].

    Source: Cochran 1977, Sampling techniques, sec. 6.4 (ratio of two means).
    """
    products, power = [], []
    for frequency, transform, late in _transforms(pieces, QUICK, False):
        below = frequency < FORCE_BELOW_HZ
        turn = 2j * np.pi * frequency[below]
        behind = np.exp(-turn * (late + delay)) / (1 + turn * lag)
        thrust = behind * transform[below, 4:].sum(axis=1)
        products.append((thrust.conj() * transform[below, FORCE]).real.sum())
        power.append((np.abs(thrust) ** 2).sum())
    product, size = np.array(products), np.array(power)
    left = product - size * (product.sum() / size.sum())
    return float(np.sqrt(left @ left * len(left) / (len(left) - 1)) / abs(product.sum()))


def responses(motion: Spectra) -> Responses:
    """Evaluates all lags and delays."""
    turn = 2j * np.pi * motion.frequency
    lag = 1 / (1 + turn * LAGS_S[:, None])
    filters = lag[:, None] * np.exp(-turn * DELAYS_S[:, None])
    products, power, channels = [], [], []
    for channel in range(4):
        own, weight = motion.channels[:, channel], motion.weight(channel)
        across = motion.across[:, :, channel] * weight[:, None]
        products.append(np.einsum("tdf,fu->tdu", filters.conj(), across, optimize=True).real)
        shared = motion.commands * weight[:, None, None]
        power.append(np.einsum("tf,fuv->tuv", np.abs(lag) ** 2, shared, optimize=True).real)
        channels.append(float((own * weight).sum()))
    return Responses(np.array(products), np.array(power), np.array(channels), motion.segments)


class Delay(NamedTuple):
    """How late roll and pitch follow the torques of the commands."""

    value: float
    """[s]; less than zero where motion begins before its command."""
    error: float
    """Its standard error [s]."""


def measure_delay(pieces: Sequence[Flight]) -> Delay | None:
    """Measures how late roll and pitch follow the commands; None of too short a flight.

    Its error is that of a jackknife over parts of the flight.

    Source: Efron and Tibshirani 1993, An introduction to the bootstrap, sec. 11.5.
    """
    each, frequency = [], np.zeros(0)
    for frequency, transform, late in _transforms(pieces, QUICK, False):
        turn = 2j * np.pi * frequency[:, None]
        torque = transform[:, 4:] @ TORQUES[:, :2] * np.exp(-turn * late)
        motion = transform[:, :2] * turn
        each.append([np.abs(torque) ** 2, np.abs(motion) ** 2, torque.conj() * motion])
    if len(each) < _PARTS // 2:
        return None
    parts = np.array([sum(map(np.array, part)) for part in _in_parts(each)])
    whole = parts.sum(axis=0)
    weight = np.stack([_weight(power.real, QUICK) for power in whole[1].T], axis=1)
    others = np.array([_best_delay(frequency, (whole - part) * weight) for part in parts])
    scatter = ((others - others.mean()) ** 2).sum()
    error = float(np.sqrt(scatter * (len(others) - 1) / len(others)))
    return Delay(_best_delay(frequency, whole * weight), error)


def _in_parts(each: list[list[np.ndarray]]) -> Iterator[list[list[np.ndarray]]]:
    """Yields up to `_PARTS` parts of segments, one after another."""
    ends = np.unique(np.linspace(0, len(each), _PARTS + 1).astype(int))
    yield from (each[begin:end] for begin, end in pairwise(ends))


def _best_delay(frequency: Float[np.ndarray, "F"], sums: Complex[np.ndarray, "3 F 2"]) -> float:
    """Returns the delay at which both axes follow their torques best, at whatever lag [s].

    Args:
        frequency: [Hz].
        sums: power of torques and of motion, and their cross spectra.
    """
    turn = 2j * np.pi * frequency
    lag = 1 / (1 + turn * _FINE_LAGS_S[:, None])
    torque, motion, across = sums
    size = np.sqrt(np.maximum(np.abs(lag) ** 2 @ torque.real * motion.real.sum(axis=0), 1e-30))
    late = np.exp(turn * _FINE_DELAYS_S[:, None])
    answers = (across[:, None] * lag.conj().T[:, :, None]).reshape(len(turn), -1)
    products = (late @ answers).real.reshape(len(late), *size.shape)
    match = (products / size).sum(axis=2).max(axis=1)
    best = int(np.clip(np.argmax(match), 1, len(match) - 2))
    before, at, after = match[best - 1 : best + 2]
    bent = before - 2 * at + after
    inside = np.clip((before - after) / 2 / bent, -1.0, 1.0) if bent else 0.0
    return float(_FINE_DELAYS_S[best] + inside * (_FINE_DELAYS_S[1] - _FINE_DELAYS_S[0]))


DELAY = "command delay"
EARLIEST_S, LATEST_S = -0.015, 0.045
"""Delays of the drone's answer behind its commands beyond which other orders of the motors are not
looked for [s]."""
CAUSAL_S = -0.002
"""Delay below which, with two standard errors, motion begins before its command [s]; measured, 3
ms and more in sound logs (benchmarks/checkup.py)."""
LONGEST_S = 0.1
"""A longer one is no way to the motors but another clock, and refused [s]."""
USUAL_S = 0.012
"""The usual one [s]."""
LATE_GYRO_S = 0.04
"""By which the gyro may follow commands later than the accelerometer does [s]."""


def check_delay(
    pieces: Sequence[Flight], logged: Fit, answer: Responses, is_driven: bool
) -> CheckResult:
    """Checks when motion follows the commands.

    Args:
        pieces: of one flight.
        logged: how roll and pitch follow the motors in the order of the log.
        answer: what each lag and delay explain.
        is_driven: whether commands surely drive the motion.
    """
    late = 1e3 * logged.delay
    threshold = f"{1e3 * EARLIEST_S:.0f} .. {1e3 * LATEST_S:.0f} ms"
    if not is_driven:
        return unknown(DELAY, "too little shows when commands act", late)
    text = f"motion follows commands by {late:.0f} ms and a lag of {1e3 * logged.lag:.0f} ms"
    force = answer.correlation(FORCE, np.ones(4))
    lag, delay = place_of_largest(force)
    force_is_clear = float(force[lag, delay]) > 0.8 and answer.segments >= FEWEST
    difference = logged.lag + logged.delay - float(LAGS_S[lag] + DELAYS_S[delay])
    if force_is_clear and difference > LATE_GYRO_S:
        sentence = (
            f"{text}, the accelerometer {1e3 * difference:.0f} ms before the gyro: body rates are "
            f"late by about {1e3 * difference:.0f} ms."
        )
        remedy = "Shift them, or log them with less filtering."
        return CheckResult(DELAY, FAILS, sentence, late, threshold, remedy)
    if EARLIEST_S < logged.delay < LATEST_S:
        return _check_cause(pieces) or CheckResult(DELAY, PASSES, text, late, threshold)
    off = 1e3 * (logged.delay - USUAL_S)
    side = "early" if off > 0 else "late"
    sentence = (
        f"commands are {side} by about {abs(off):.0f} ms: {text}; expected {threshold}. They have "
        "another clock than gyro and accelerometer, or a long way to the motors."
    )
    # The force follows the same commands: it has to be off on the same side.
    felt = float(DELAYS_S[delay])
    alone = force_is_clear and (felt < LATEST_S / 2 if off > 0 else felt > 0.0)
    if alone:
        return unknown(DELAY, f"{text}, but the force along z by {1e3 * felt:.0f} ms", late)
    possible = EARLIEST_S < logged.delay < LONGEST_S
    verdict = WARNS if possible else FAILS
    return CheckResult(DELAY, verdict, sentence, late, threshold, "Shift them.")


def is_before(delay: Delay | None) -> bool:
    """Returns whether motion surely begins before its command."""
    return delay is not None and delay.value + 2 * delay.error < CAUSAL_S


def _check_cause(pieces: Sequence[Flight]) -> CheckResult | None:
    """Checks whether motion begins before its command; None where it does not, surely."""
    delay = measure_delay(pieces)
    if delay is None or not is_before(delay):
        return None
    late, error = 1e3 * delay.value, 1e3 * delay.error
    cause = (
        f"motion begins {-late:.1f} +- {error:.1f} ms before its commands, which none does: they "
        f"were logged late, as motion usually follows {1e3 * USUAL_S:.0f} ms after, by about "
        f"{1e3 * USUAL_S - late:.0f} ms."
    )
    remedy = "Log them with the gyro's clock, or shift them."
    return CheckResult(DELAY, WARNS, cause, late, f"{1e3 * CAUSAL_S:.0f} ms or more", remedy)
