"""Inertia by measured rotor speeds, whose squares carry and turn the drone.

Specific force along z gives thrust by squared speed, body rates what differences of thrust turn;
neither the motors' lag nor the curve of thrust over command has a part in it. Speeds are read late,
seldom and with noise, which makes the gain of a regression on them too small; commands do not know
of that noise and are the instrument: the gain is the spectrum of acceleration and command over that
of torque and command, for each band of frequency by itself. Bands in which other torques turn the
drone, of the air and of a controller's answers to it, count by how coherent they are.

Source: Bendat and Piersol 2010, Random data, sec. 6.1.4 (bias of frequency responses) and 9.2.4
(random error); Söderström and Stoica 1989, System identification, ch. 8 (instruments); Birge 1932,
The calculation of errors by the method of least squares (disagreement of estimates).
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from maidenflight.flights.checkup.in_flight import BLOCK_S
from maidenflight.flights.log import Flight, by_log
from maidenflight.identification.signals.flight_signals import force_along_z, means
from maidenflight.identification.signals.motor_response import (
    LIKE,
    OWN,
    SHORTEST,
    is_clear,
    random_effects,
)
from maidenflight.identification.signals.spectra import (
    HIGHEST,
    LOWEST,
    WINDOW,
    bands,
    transform,
)
from maidenflight.identification.unknowns import INERTIA
from maidenflight.parameters import Parameters, levers

DELAYS = 5e-4 * np.arange(-10, 51)
"""Delays of body rates behind the speeds that are tried, for each file anew [s]: streams that a
computer joined differ by 13 ms in their clocks (IDSIA's NanoDrone). Harmless within a factor of 1.4
(paper/identification/constants.py)."""
_TORQUE = 0.07
"""Standard error of the rotors' torque, a share: planted drones that are thrown leave 9 % and more
(paper/notes/identification.md)."""


class _Products(NamedTuple):
    """Products of transforms by line: t the speeds' torque, u the commands', y the motion."""

    frequency: Float[np.ndarray, "F"]
    """[Hz]."""
    averages: Float[np.ndarray, "F"]
    yt: Complex[np.ndarray, "F"]
    tu: Complex[np.ndarray, "F"]
    yu: Complex[np.ndarray, "F"]
    tt: Float[np.ndarray, "F"]
    uu: Float[np.ndarray, "F"]
    yy: Float[np.ndarray, "F"]


def inertia_of_speeds(
    flights: Sequence[Flight], drone: Parameters, draws: int, generator: np.random.Generator
) -> dict[str, Float[np.ndarray, "N"]]:
    """Returns samples of inertia about x and y [kg m2]; none of an axis that is not clear.

    Args:
        flights: checked flights; those without rotor speeds do not count.
        drone: its mass and levers.
        draws: samples.
        generator: random numbers.
    """
    logs = by_log(flight for flight in flights if flight.rotor_speed is not None).values()
    logs = [parts for parts in logs if max(part.duration for part in parts) >= SHORTEST]
    inertia = {}
    for axis, name in enumerate(INERTIA):
        estimates = [estimate for parts in logs if (estimate := _log_inertia(parts, drone, axis))]
        if not estimates:
            continue
        values, errors, left = np.array(estimates).T
        mean, error = random_effects(values, errors**2 + np.minimum(left, OWN) ** 2)
        # What speeds leave unexplained bounds what the model's errors can do.
        error = float(np.hypot(error, min(np.hypot(LIKE, _TORQUE), left.mean())))
        inertia[name] = np.exp(mean + error * generator.standard_normal(draws))
    return {name: samples for name, samples in inertia.items() if is_clear(samples)}


def _log_inertia(
    parts: Iterable[Flight], drone: Parameters, axis: int
) -> tuple[float, float, float] | None:
    """Returns the logarithm of the inertia [kg m2] and its error by the pieces of one log.

    Last the root of the share of the motion that speeds leave unexplained. None where nothing
    follows.
    """
    pieces = [_products(part, drone, axis) for part in parts if part.duration >= WINDOW / 2]
    products = _Products(*(np.concatenate(some) for some in zip(*pieces, strict=True)))
    band, s = bands(products.frequency), 2j * np.pi * products.frequency

    def sums(values: np.ndarray) -> Float[np.ndarray, "B"]:
        return np.bincount(band, np.real(values))

    late = np.exp(np.multiply.outer(DELAYS, s))
    motion, torque, count = sums(products.yy), sums(products.tt), sums(products.averages)
    if min(motion.min(), torque.min(), products.uu.min()) <= 0.0:
        return None
    shares = np.stack([sums(products.yt * delay) for delay in late])
    shared = np.clip(np.sign(shares) * shares**2 / (torque * motion), 1e-9, 1 - 1e-9)
    best = int(np.argmax(-np.log(1 - shared) @ count))
    pushed = sums(np.abs(products.tu) ** 2)
    turned = sums(products.yu * late[best] * np.conj(products.tu))
    # Of what both share with the commands: how much of the motion the instrument tells.
    explained = turned**2 / pushed / np.maximum(sums(np.abs(products.yu) ** 2), 1e-30)
    explained = explained * sums(np.abs(products.yu) ** 2 / products.uu) / motion
    turns = turned > 0.0
    if not turns.any():
        return None
    coherence, explained, count = (
        values[turns] for values in (shared[best], np.minimum(explained, shared[best]), count)
    )
    gains = np.log(turned[turns] / pushed[turns])
    # A gain is too small by the coherence at most.
    variances = (1 - explained) / (2 * count * explained) + np.log(coherence) ** 2 / 12
    weights = 1 / variances
    mean = float(weights @ gains / weights.sum())
    scatter = float(weights @ (gains - mean) ** 2) / max(1, len(gains) - 1)
    left = np.sqrt(1 - float(weights @ coherence / weights.sum()))
    return -mean, float(np.sqrt(max(1.0, scatter) / weights.sum())), float(left)


def _products(flight: Flight, drone: Parameters, axis: int) -> _Products:
    squares = np.asarray(flight.rotor_speed, float) ** 2
    pushes = np.column_stack([force_along_z(flight), squares.sum(axis=1)])
    # Their median passes over hands that throw or catch, falls and landings.
    force, square = means(pushes, round(BLOCK_S / flight.period)).T
    thrust = float(drone.mass) * np.median(force / np.maximum(square, 1e-9))
    lever = levers(drone)[:, axis]
    signals = [
        thrust * squares @ lever,
        flight.command.astype(float) @ lever,
        flight.body_rates[:, axis].astype(float),
    ]
    columns = np.stack(signals, axis=1)
    frequency, (t, u, y) = transform(columns, flight.period, LOWEST, HIGHEST)
    y = y * 2j * np.pi * frequency
    averages = len(flight) / min(round(WINDOW / flight.period), len(flight))

    def product(signal: np.ndarray, other: np.ndarray) -> np.ndarray:
        return averages * np.mean(signal * other.conj(), axis=0)

    crosses = product(y, t), product(t, u), product(y, u)
    powers = (np.real(product(signal, signal)) for signal in (t, u, y))
    return _Products(frequency, np.full(len(frequency), averages), *crosses, *powers)
