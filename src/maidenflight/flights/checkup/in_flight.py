"""Whether a log is of a flight: its commands belong to its motion, and its weight hangs on them.

**Coherence.** Commands of a flight under feedback turn the drone and answer its turns, so that the
torques that they stand for and the body rates are coherent at any phase, however calm the flight
is. What chance makes of that the same commands show against other times of the flight: 25 and more
standard deviations less than their own time in 103 sound logs of 6 s and more.

**Force.** In flight more throttle is more specific force: 1 % for 0.15 to 1.4 % in 141 sound logs.
On a bench, or held, or without propellers, it stays gravity.

Source: Bendat and Piersol 2010, Random data, sec. 6.1 (coherence); benchmarks/checkup.py.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from maidenflight.flights.checkup.relations import block_mean
from maidenflight.flights.checkup.response import QUICK, transforms
from maidenflight.flights.checkup.result import FAILS, PASSES, CheckResult, unknown
from maidenflight.flights.log import GRAVITY, TORQUES, Flight

FLIGHT = "flight"
CHANCE = 4.0
"""Standard deviations of chance below which commands and motion are not coherent; measured, sound
logs have 25 and more (benchmarks/checkup.py)."""
LEAST_COHERENCE = 0.25
"""What chance may reach for a test to tell; measured, 0.34 and more in sound logs."""
_FEWEST = 8
"""Segments from which chance is known; chosen."""
_SHIFTS = 40
"""Other times that are tried, at most; chosen for speed."""
BLOCK_S, _BLOCKS = 0.5, 8
"""Time over which force and throttle are averaged [s], and changes that tell; chosen."""
_RESPONSE_S = 0.06
"""Time by which the force is behind the throttle, about [s]."""
_FOLLOWS = 0.15
"""Change of force by that of throttle, as shares, that flights exceed with 3 errors; measured,
0.33 and more in sound logs."""


class Coherence(NamedTuple):
    """How commands and body rates belong together."""

    own: float
    """Mean coherence of roll and pitch rate with the torques of the motors, in their best order."""
    chance: float
    """What chance makes of it."""
    error: float
    """Standard deviation of that."""

    @property
    def is_there(self) -> bool:
        """Whether commands belong to the motion."""
        return self.own > self.chance + CHANCE * self.error

    @property
    def has_power(self) -> bool:
        """Whether it would show if they did."""
        return self.chance + CHANCE * self.error < LEAST_COHERENCE


def measure_coherence(pieces: Sequence[Flight]) -> Coherence | None:
    """Measures how commands and body rates belong together; None of too short a flight."""
    signals = transforms(pieces, QUICK)
    if len(signals) < _FEWEST:
        return None
    rates, torques = signals[:, :, :2], signals[:, :, 4:] @ TORQUES
    size = np.einsum("kfi,kfi->fi", torques, torques.conj()).real[:, :, None]
    size = size * np.einsum("kfj,kfj->fj", rates, rates.conj()).real[:, None, :]

    def coherence(shift: int) -> float:
        product = np.einsum("kfi,kfj->fij", torques.conj(), np.roll(rates, shift, axis=0))
        each = (np.abs(product) ** 2 / np.maximum(size, 1e-30)).mean(axis=0)
        # Each of roll and pitch may follow any of three patterns: another order of the motors.
        return max(each[i, 0] + each[j, 1] for i in range(3) for j in range(3) if i != j) / 2

    shifts = range(2, len(signals) - 1, max(1, len(signals) // _SHIFTS))
    others = np.array([coherence(shift) for shift in shifts])
    chance = float(np.median(others))
    # Commands of another time of the same flight meet their own among the others.
    error = 1.4826 * float(np.median(np.abs(others - chance)))
    return Coherence(coherence(0), chance, max(error, 0.1 * chance))


def belongs(pieces: Sequence[Flight]) -> tuple[bool | None, str]:
    """Says whether commands belong to the motion, None where that cannot be told, and how much."""
    relation = measure_coherence(pieces)
    if relation is None:
        return None, "the flight is too short to tell"
    text = f"coherence {relation.own:.2f}, by chance {relation.chance:.2f} +- {relation.error:.2f}"
    return (True if relation.is_there else False if relation.has_power else None), text


def check_flight(pieces: Sequence[Flight]) -> CheckResult:
    """Checks that the specific force changes as the throttle does."""
    loads = [(piece, load) for piece in pieces if (load := load_factor(piece)) is not None]
    each = [
        changes(piece.mean_command.mean(axis=1, dtype=np.float64), load, piece.period)
        for piece, load in loads
    ]
    if sum(len(throttle) for throttle, _ in each) < _BLOCKS:
        return unknown(FLIGHT, "too short, or no sensor shows how hard the motors push")
    share, error = elasticity(each)
    text = f"1 % more throttle changes the specific force by {share:.2f} % +- {error:.2f} %"
    threshold = f"{_FOLLOWS:g} % or more"
    if abs(share) + 3 * error > _FOLLOWS:
        is_clear = share - 3 * error > 0
        return (
            CheckResult(FLIGHT, PASSES, text, share, threshold)
            if is_clear
            else unknown(FLIGHT, text, share)
        )
    cause = (
        f"{text}; expected {threshold}. This is no flight: propellers are off, or the drone stood "
        "or was held."
    )
    return CheckResult(FLIGHT, FAILS, cause, share, threshold, "Leave it out.")


Changes = tuple[Float[np.ndarray, "B"], Float[np.ndarray, "B"]]
"""Of throttle and of force, from block to block, as shares of their means."""


def elasticity(each: Sequence[Changes]) -> tuple[float, float]:
    """Measures by which share force changes with throttle, and its standard error."""
    throttle, force = (np.concatenate(side) for side in zip(*each, strict=True))
    power = max(float(throttle @ throttle), 1e-12)
    share = float(throttle @ force) / power
    left = force - share * throttle
    return share, float(np.sqrt(left @ left / max(len(force) - 1, 1) / power))


def changes(
    throttle: Float[np.ndarray, "N"], force: Float[np.ndarray, "N"], period: float
) -> Changes:
    """Returns changes of throttle and force between blocks of rows."""
    signals = np.stack([throttle, force], axis=1).astype(float)
    blocks = block_mean(signals, max(1, round(BLOCK_S / period)))
    blocks = blocks[np.isfinite(blocks).all(axis=1)]
    if len(blocks) < 2:
        return np.zeros(0), np.zeros(0)
    change = np.diff(blocks / np.maximum(np.abs(blocks.mean(axis=0)), 1e-6), axis=0)
    return change[:, 0], change[:, 1]


def load_factor(piece: Flight) -> Float[np.ndarray, "N"] | None:
    """Measures specific force along z in g, by accelerometer or by velocity and tilt."""
    if piece.accelerometer is not None:
        return piece.accelerometer[:, 2].astype(float) / GRAVITY
    if not piece.has_state or len(piece) < 3:
        return None
    level = np.cos(piece.attitude[:, 0].astype(float)) * np.cos(piece.attitude[:, 1].astype(float))
    climb = np.gradient(piece.velocity[:, 2].astype(float), piece.period)
    return (1 + climb / GRAVITY) / np.maximum(level, 0.3)


def thrust_per_command(pieces: Sequence[Flight]) -> Float[np.ndarray, "B"]:
    """Measures the logarithm of thrust per command in blocks of `BLOCK_S`."""
    ratios = [np.zeros(0)]
    for piece in pieces:
        rows = max(1, round(BLOCK_S / piece.period))
        load = load_factor(piece)
        if load is None or len(piece) < rows:
            continue
        late = min(max(1, round(_RESPONSE_S / piece.period)), len(piece) - 1)
        command = piece.mean_command.mean(axis=1, dtype=np.float64)
        command = np.concatenate([np.repeat(command[:1], late), command[:-late]])
        loads, commands = block_mean(np.column_stack([load, command]), rows).T
        ratios.append(np.log(np.maximum(loads, 0.05) / np.maximum(commands, 0.01)))
    return np.concatenate(ratios)
