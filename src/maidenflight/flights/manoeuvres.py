"""Manoeuvres about a point, as set-points of position and yaw each 10 ms.

Each begins and ends at the point. Set-points are what a position controller follows, simulated or
by radio; `motors` is excitation that only a simulated drone takes.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from maidenflight.errors import InputError

RATE = 100
"""Set-points a second [Hz]."""
LARGEST, SHORTEST, LONGEST = 1.5, 0.2, 10.0
"""Largest size, and shortest and longest period [s] that a manoeuvre may have."""
_FASTEST = 4.0
"""Last frequency of a chirp over its first."""

Wave = Callable[[Float[np.ndarray, "N"], float, np.random.Generator], Float[np.ndarray, "N 4"]]
"""(time [s], period [s], random numbers) to x, y, z, yaw in units of the size."""


def _along(*axes: int) -> Float[np.ndarray, "4"]:
    return np.isin(np.arange(4), axes).astype(float)


def _square(axis: int) -> Wave:
    """Up for half a period, down for the other, from rest at the middle."""
    return lambda time, period, _: np.outer(
        np.where((time / period) % 1.0 < 0.5, 1.0, -1.0), _along(axis)
    )


def _chirp(axis: int) -> Wave:
    """Makes a sine whose frequency grows, linearly in time, from 1 / period to four times that.

    Source: Ljung 1999, System identification: theory for the user, sec. 13.3 (chirp signals).
    """

    def wave(
        time: Float[np.ndarray, "N"], period: float, _: np.random.Generator
    ) -> Float[np.ndarray, "N 4"]:
        growth = (_FASTEST - 1) / (2 * max(float(time[-1]), period))
        return np.outer(np.sin(2 * np.pi / period * (time + growth * time**2)), _along(axis))

    return wave


def _circle(
    time: Float[np.ndarray, "N"], period: float, _: np.random.Generator
) -> Float[np.ndarray, "N 4"]:
    angle = 2 * np.pi * time / period
    zero = np.zeros_like(angle)
    return np.stack([np.cos(angle), np.sin(angle), zero, zero], axis=1)


def _random(*axes: int) -> Wave:
    """Makes random signs, drawn anew each half period for each axis by itself.

    Height moves by half of the size, yaw by two radians a metre.

    Source: Ljung 1999, sec. 13.3 (random binary signals).
    """

    def wave(
        time: Float[np.ndarray, "N"], period: float, generator: np.random.Generator
    ) -> Float[np.ndarray, "N 4"]:
        number = (2 * time / period + 1e-9).astype(int)
        signs = generator.choice([-1.0, 1.0], (number[-1] + 1, 4))
        return signs[number] * _along(*axes) * [1.0, 1.0, 0.5, 2.0]

    return wave


def _still(
    time: Float[np.ndarray, "N"], period: float, _: np.random.Generator
) -> Float[np.ndarray, "N 4"]:
    return np.zeros((len(time), 4))


HOVER, MOTORS = "hover", "motors"
KINDS: Mapping[str, Wave] = {
    HOVER: _still,
    "circle": _circle,
    "chirp_x": _chirp(0),
    "chirp_y": _chirp(1),
    "chirp_z": _chirp(2),
    "steps_x": _square(0),
    "steps_y": _square(1),
    "steps_z": _square(2),
    "steps_yaw": _square(3),
    "random": _random(0, 1, 2),
    "random_yaw": _random(0, 1, 2, 3),
    MOTORS: _still,
}
"""Shape of each kind of manoeuvre, by definition. Sizes are metres (amplitude or radius), of
`steps_yaw` radians, of `motors` the share of full thrust by which each motor's command changes."""


_STICKS: Mapping[str, str] = {
    HOVER: "hover",
    "circle": "circles",
    "x": "quick pitches to and fro",
    "y": "quick rolls to and fro",
    "z": "climb and sink with a fifth to four fifths of the throttle",
    "yaw": "yaw to and fro",
    "random": "short hard moves of all sticks but yaw",
    "random_yaw": "short hard moves of all sticks",
}
"""What a pilot flies instead of a kind, or of one that ends with it."""


@dataclass(frozen=True)
class Manoeuvre:
    """One way to fly about a point."""

    kind: str
    """Of `KINDS`."""
    size: float = 0.0
    """See `KINDS`."""
    period: float = 1.0
    """Of a wave; of a chirp at its beginning [s]."""

    @property
    def name(self) -> str:
        """What tables call it."""
        if self.kind == HOVER:
            return self.kind
        if self.kind == MOTORS:
            return f"{self.kind} {self.size:.2f}"
        unit = "rad" if self.kind == "steps_yaw" else "m"
        return f"{self.kind} {self.size:.2f} {unit}, {self.period:.1f} s"

    @property
    def by_setpoints(self) -> bool:
        """Whether a real drone that follows positions and yaw can fly it."""
        return self.kind != MOTORS

    @property
    def by_hand(self) -> str:
        """What a pilot flies instead; nothing where only a simulator can."""
        return _STICKS.get(self.kind, _STICKS.get(self.kind.rpartition("_")[2], ""))

    def setpoints(self, seconds: float, seed: int) -> Float[np.ndarray, "N 4"]:
        """Returns the position [m] relative to the point, and yaw [rad], each 10 ms."""
        time = np.arange(round(seconds * RATE)) / RATE
        return self.size * KINDS[self.kind](time, self.period, np.random.default_rng(seed))

    def checked(self, source: str) -> "Manoeuvre":
        """Returns the manoeuvre.

        Raises:
            InputError: no such kind, or size or period out of range.
        """
        sound = 0.0 <= self.size <= LARGEST and SHORTEST <= self.period <= LONGEST
        if not sound or self.kind not in KINDS:
            raise InputError(
                f"{source}: manoeuvre {self.kind[:40]!r} of size {self.size:g} and period "
                f"{self.period:g} s; expected one of {', '.join(KINDS)}, a size up to {LARGEST:g} "
                f"and a period of {SHORTEST:g} to {LONGEST:g} s. Plan again: maidenflight plan."
            )
        return self


def library(half_width: float, half_height: float, motors: bool) -> list[Manoeuvre]:
    """Manoeuvres that may be flown, calm ones first; a simulation tells which fit a room.

    Args:
        half_width: how far the set-point may go from the point, along x and y [m].
        half_height: how far up and down [m].
        motors: whether excitation of the motors is among them.
    """
    manoeuvres = [Manoeuvre(HOVER)]
    radii = (0.2, 0.3, 0.4, 0.6)
    manoeuvres += [Manoeuvre("circle", size, 3.0) for size in radii if size <= half_width]
    reach = {"x": half_width, "y": half_width, "z": half_height}
    for axis, most in reach.items():
        for size in (size for size in (0.1, 0.15, 0.2) if size <= most):
            manoeuvres.append(Manoeuvre(f"chirp_{axis}", size, 2.0))
            manoeuvres += [Manoeuvre(f"steps_{axis}", size, period) for period in (0.4, 0.6, 1.0)]
    manoeuvres += [
        Manoeuvre("steps_yaw", size, period) for size in (0.1, 0.2, 0.3) for period in (0.4, 0.8)
    ]
    for size in (size for size in (0.08, 0.15) if size <= min(half_width, 2 * half_height)):
        manoeuvres += [Manoeuvre(kind, size, 0.8) for kind in ("random", "random_yaw")]
    if motors:
        manoeuvres += [Manoeuvre(MOTORS, size) for size in (0.03, 0.06, 0.1)]
    return manoeuvres
