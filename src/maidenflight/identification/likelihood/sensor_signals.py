"""What a sensor measured and what the rotors did, in segments of flight.

Segments last about 5 s, and all have as many steps as the longest could; `used` says which count.
Each begins with flight before it, from which its rotors' speeds follow.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import numpy as np
import scipy
from jax import lax
from jaxtyping import Array, Bool, Float

from maidenflight.errors import InputError
from maidenflight.flights.log import Flight
from maidenflight.flights.windows import SEGMENT_SECONDS, must_have_one_rate
from maidenflight.identification.likelihood.one_step import CHUNK
from maidenflight.identification.likelihood.selection import HELD_OUT
from maidenflight.identification.replay.open_loop import PHYSICS_STEP
from maidenflight.identification.signals.flight_signals import (
    delay_command,
    force_along_z,
    gyro,
    means,
)
from maidenflight.identification.signals.spectra import HIGHEST
from maidenflight.identification.signals.thrust_law import MEMORY, beyond
from maidenflight.parameters import Parameters
from maidenflight.parameters import replace as with_values
from maidenflight.simulator.physics import dynamics

SLOW_FILTER = np.sqrt(2.0) / (2.0 * np.pi * HIGHEST)
"""Delay of a filter [s] whose cut-off is the highest frequency that counts: of slower ones the
shape counts too."""
LEAD_IN = 1.0
"""Flight before a segment from which its rotors' speeds follow [s]."""
SHORTEST = 0.25
"""Time that a piece must last after the first `MEMORY`, in which speeds are not known [s];
harmless within a factor of 1.4 (paper/identification/constants.py)."""
CLIMB_MEMORY = 3.0
"""Time over which the specific force is integrated to the climb [s], whose offset is forgotten:
harmless within a factor of 1.4 (paper/identification/constants.py)."""


class Sensor(NamedTuple):
    """What is looked at, and in which steps."""

    step: float
    """Time over which means are taken [s]."""
    measured: Callable[[Flight, int, float], Float[np.ndarray, "M C"]]
    """What a flight's C signals are in steps of so many rows, which last so long [s]."""


def mean_force(flight: Flight, rows: int, step: float) -> Float[np.ndarray, "M 1"]:
    """Returns the specific force along z [m/s2], means over steps of some rows."""
    if is_slow(flight):
        flight = replace(flight, accelerometer_delay=0.0)
    return means(force_along_z(flight)[:, None], rows)


def is_slow(flight: Flight) -> bool:
    """Tests whether the accelerometer's filter does more than delay what the motors do."""
    return flight.accelerometer_delay > SLOW_FILTER


def low_pass(values: Float[np.ndarray, "M S"], delay: float, step: float) -> np.ndarray:
    """Filters as a Butterworth filter of second order that is late by so much [s].

    Its delay at low frequencies, sqrt(2) over the cut-off [rad/s], is kept by the bilinear map.
    """
    rate = np.sqrt(2.0) / delay
    analog = [rate**2], [1.0, np.sqrt(2.0) * rate, rate**2]
    above, below = scipy.signal.bilinear(*analog, fs=1 / step)
    state = scipy.signal.lfilter_zi(above, below)[:, None] * values[:1]
    return np.asarray(scipy.signal.lfilter(above, below, values, axis=0, zi=state)[0])


def angular_acceleration(flight: Flight, rows: int, step: float) -> Float[np.ndarray, "M 3"]:
    """Returns the angular acceleration [rad/s2], means over steps of some rows."""
    return np.diff(gyro(flight)[::rows], axis=0) / step


class Rotors(NamedTuple):
    """Speeds nu of the rotors in M steps of S segments."""

    mean: Float[np.ndarray, "M S 4"]
    square: Float[np.ndarray, "M S 4"]
    """Mean of the squares."""
    change: Float[np.ndarray, "M S 4"]
    """From the beginning of the step to its end."""


@dataclass(frozen=True)
class Signals:
    """S segments of flight in M steps of R rows."""

    command: Float[np.ndarray, "M*R S 4"]
    """sqrt(u), constant until the next row."""
    measured: Float[np.ndarray, "M S C"]
    """The sensor's signals, means over a step."""
    body_rates: Float[np.ndarray, "M S 3"]
    """[rad/s], likewise."""
    climb: Float[np.ndarray, "M S"]
    """Velocity along z [m/s], as far as the accelerometer tells; zero without one."""
    used: Bool[np.ndarray, "M S"]
    """Steps that count."""
    flights: tuple[str, ...]
    """Name of the flight that each segment is of."""
    period: float
    """Of a row [s]."""
    rows: int
    """R."""
    filter_delay: float = 0.0
    """Delay of the accelerometer's filter that is left in what was measured [s]."""
    limit: float = np.inf
    """Mean speed command of four motors beyond which steps do not count."""

    @property
    def step(self) -> float:
        """Of R rows [s]."""
        return self.rows * self.period

    def some(self, segments: Bool[np.ndarray, "S"]) -> "Signals":
        """Returns some of the segments."""
        return replace(
            self,
            command=self.command[:, segments],
            measured=self.measured[:, segments],
            body_rates=self.body_rates[:, segments],
            climb=self.climb[:, segments],
            used=self.used[:, segments],
            flights=tuple(np.array(self.flights)[segments].tolist()),
        )

    def parted(self) -> "tuple[Signals, Signals] | None":
        """Segments to fit and others to judge by; None of fewer than three.

        Every third flight is to judge by, or segment where there are fewer than three flights.
        """
        if len(self.flights) < HELD_OUT:
            return None
        names = list(dict.fromkeys(self.flights))
        if len(names) < HELD_OUT:
            is_held_out = np.arange(len(self.flights)) % HELD_OUT == HELD_OUT - 1
        else:
            is_held_out = np.isin(self.flights, names[HELD_OUT - 1 :: HELD_OUT])
        return self.some(~is_held_out), self.some(is_held_out)

    def rotors(self, drone: Parameters) -> Rotors:
        """Returns what the rotors of a drone did, by the simulator's motors."""
        substeps = max(1, int(np.ceil(self.period / PHYSICS_STEP - 1e-6)))
        count = self.command.shape[1]
        commands = delay_command(self.command, float(drone.latency) / self.period).astype(
            np.float32
        )
        commands = np.pad(commands, ((0, 0), (0, -count % CHUNK), (0, 0)))
        commands = commands.reshape(-1, self.rows, *commands.shape[1:])
        drone = with_values(drone, time_step=np.float32(self.period / substeps))
        # Chunks of one size, so that one program serves any number of segments.
        parts = [
            _speeds(commands[:, :, first : first + CHUNK], drone, substeps)
            for first in range(0, count, CHUNK)
        ]
        joined = (np.concatenate(some, axis=1) for some in zip(*parts, strict=True))
        return Rotors(*(some[:, :count].astype(float) for some in joined))


def signals(flights: Sequence[Flight], sensor: Sensor, limit: float = np.inf) -> Signals:
    """Cuts flights into segments.

    Args:
        flights: checked flights of one rate, with what the sensor measures.
        sensor: what is looked at.
        limit: mean speed command beyond which thrust saturates; see `thrust_law`.

    Raises:
        InputError: the flights have different rates, or none is long enough.
    """
    must_have_one_rate(flights)
    period = flights[0].period
    rows = max(1, round(sensor.step / period))
    parts = [
        (flight.name, part)
        for flight in flights
        for part in _segments(flight, rows, rows * period, sensor)
    ]
    if not parts:
        longest = max(flight.duration for flight in flights)
        raise InputError(
            f"no flight is long enough: longest {longest:.2f} s, needed {MEMORY + SHORTEST:.2f} s."
        )
    names, arrays = zip(*parts, strict=True)
    command, measured, rates, climb, used = (
        np.stack(some, axis=1) for some in zip(*arrays, strict=True)
    )
    delay = flights[0].accelerometer_delay
    left = delay if is_slow(flights[0]) and sensor.measured is mean_force else 0.0
    hot = beyond(command.mean(axis=2), limit, period).reshape(len(used), rows, -1).any(axis=1)
    result = Signals(command, measured, rates, climb, used & ~hot, names, period, rows, left, limit)
    return result if np.isinf(limit) else result.some(np.asarray(result.used.any(axis=0)))


def _segments(
    flight: Flight, rows: int, step: float, sensor: Sensor
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """The arrays of `Signals` for each segment of a piece of flight."""
    lead, length = round(LEAD_IN / step), round(SEGMENT_SECONDS / step)
    steps = len(flight) // rows - 1
    first = max(round(MEMORY / step), -(-flight.lead // rows))
    if (steps - first) * step < SHORTEST:
        return
    command, rates = flight.speed_command, means(gyro(flight), rows)[:steps]
    measured = sensor.measured(flight, rows, step)[:steps]
    climb = np.zeros(steps)
    if flight.accelerometer is not None:
        climb = _integral(mean_force(flight, rows, step)[:steps, 0], step)
    count = max(1, round((steps - first) / length))
    edges = first + (steps - first) * np.arange(count + 1) // count
    longest = length + length // 2 + 1
    for start, stop in zip(edges[:-1], edges[1:], strict=True):
        places = np.arange(start - lead, start + longest)
        fine = np.arange((start - lead) * rows, (start + longest) * rows)
        here = np.clip(places, 0, steps - 1)
        used = (places >= start) & (places < stop)
        yield (
            command[fine.clip(0, len(command) - 1)],
            measured[here],
            rates[here],
            climb[here],
            used,
        )


def _integral(force: Float[np.ndarray, "M"], step: float) -> Float[np.ndarray, "M"]:
    """Velocity along z [m/s] by the specific force alone, slowly forgotten."""
    segments = 1 - step / CLIMB_MEMORY
    return np.asarray(scipy.signal.lfilter([0.0, step], [1.0, -segments], force - force.mean()))


@partial(jax.jit, static_argnums=2)
def _speeds(
    commands: Float[Array, "M R S 4"], drone: Parameters, substeps: int
) -> tuple[Float[Array, "M S 4"], Float[Array, "M S 4"], Float[Array, "M S 4"]]:
    """`Rotors` that begin at the speed of the first command."""

    def row(speed: Array, command: Array) -> tuple[Array, tuple[Array, Array]]:
        middles, squares = [], []
        for _ in range(substeps):
            after = speed + drone.time_step * dynamics.spin_up(speed, command, drone)
            middles.append(0.5 * (speed + after))
            squares.append(0.5 * (speed * speed + after * after))
            speed = after
        return speed, (sum(middles[1:], middles[0]), sum(squares[1:], squares[0]))

    def step(speed: Array, some: Array) -> tuple[Array, tuple[Array, Array, Array]]:
        after, (middle, square) = lax.scan(row, speed, some)
        return after, (
            middle.mean(axis=0) / substeps,
            square.mean(axis=0) / substeps,
            after - speed,
        )

    return lax.scan(step, commands[0, 0], commands)[1]
