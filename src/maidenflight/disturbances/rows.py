"""Rows of flights in stretches of one length, as the filter reads them."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from maidenflight.errors import InputError
from maidenflight.flights.log import Flight, thinned
from maidenflight.flights.trims import rotors
from maidenflight.flights.windows import must_have_one_rate
from maidenflight.parameters import Parameters, replace
from maidenflight.simulator.physics.dynamics import hover_command

ROW = 0.01
"""Rows are about this far apart [s], as the benchmark's (Busetto et al. 2025); of faster logs some
are passed over, with the mean speed of the rotors about each."""
STRETCH = 1000
"""Rows that are filtered one after the other; stretches side by side."""
SETTLING = 200
"""Rows after which the filter has forgotten where it began, where a flight goes on in the next
stretch."""
FIRST = 30
"""Rows of a flight before the first prediction."""
LONGEST = 100
"""Rows that are predicted at most; as many of a stretch's last begin no window, but those of the
next stretch."""


class Rows(NamedTuple):
    """C stretches of N rows, the last of a flight filled up; float64."""

    position: Float[Any, "C N 3"]
    velocity: Float[Any, "C N 3"]
    quaternion: Float[Any, "C N 4"]
    body_rates: Float[Any, "C N 3"]
    rotor_speed: Float[Any, "C N 4"]
    """nu in each row [-]."""


class Stretches(NamedTuple):
    """Rows, and where they come from."""

    rows: Rows
    period: float
    """[s]."""
    flight: Int[np.ndarray, "C"]
    """Number of the flight of each stretch."""
    first: Int[np.ndarray, "C"]
    """Row of the flight at which it begins."""
    row_count: Int[np.ndarray, "C"]
    """Rows of it that are the flight's."""
    is_own: Bool[np.ndarray, "C N"]
    """Rows that no other stretch estimates."""

    def starts(self, length: int, every: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """Returns stretch and row of all windows of some rows, each so many rows.

        Raises:
            InputError: windows are longer than `LONGEST`.
        """
        if length > LONGEST:
            raise InputError(
                f"{length * self.period:g} s to predict; at most {LONGEST * self.period:g} s."
            )
        ends = np.arange(self.is_own.shape[1]) + length < self.row_count[:, None]
        stretch, row = np.nonzero(self.is_own & ends)
        chosen = (self.first[stretch] + row) % every == 0
        return stretch[chosen], row[chosen]


def has_speeds(flights: Sequence[Flight]) -> bool:
    """Returns whether all logs hold the rotors' measured speeds, which then are the inputs."""
    return all(
        flight.rotor_speed is not None and bool(np.isfinite(flight.rotor_speed).all())
        for flight in flights
    )


def input_drone(drone: Parameters, *, measured: bool) -> Parameters:
    """Returns a drone whose thrust is that of its inputs: of measured speeds, their squares."""
    if not measured:
        return drone
    return replace(
        drone,
        thrust_offset=np.zeros_like(drone.thrust_offset),
        thrust_linear=np.zeros_like(drone.thrust_linear),
        rotor_thrust=np.ones(4, np.float32),
    )


def hover_speed(flights: Sequence[Flight]) -> float:
    """Returns the root mean square of measured rotor speeds [rad/s], which carries the weight."""
    squares = [np.square(flight.rotor_speed.astype(float)) for flight in flights]  # type: ignore[union-attr]
    return float(np.sqrt(np.concatenate(squares).mean()))


def stretches(
    flights: Sequence[Flight], drone: Parameters, carrying: float | None = None
) -> Stretches:
    """Cuts flights into stretches.

    Args:
        flights: checked flights with a state, of one rate.
        drone: whose motors follow the commands where no speeds are given.
        carrying: measured speed that carries the weight [rad/s], of `hover_speed`; None for
            rotors that follow the commands.

    Raises:
        InputError: no flight is long enough, one has no state, or their rates differ.
    """
    must_have_one_rate(flights)
    bare = [flight.name for flight in flights if not flight.has_state]
    if bare:
        raise InputError(f"{bare[0]}: no position, velocity and attitude in it. Leave it out.")
    every = max(1, round(ROW / flights[0].period)) if flights else 1
    parts: dict[str, list[np.ndarray]] = {name: [] for name in Rows._fields}
    numbers, firsts, counts, own = [], [], [], []
    rows = np.arange(STRETCH)
    for number, flight in enumerate(flights):
        columns = _columns(flight, every, drone, carrying)
        count = len(columns["position"])
        overlap = SETTLING + LONGEST
        for first in range(0, max(count - overlap, 1), STRETCH - overlap):
            begin, left = SETTLING if first else FIRST, count - first
            end = left if left <= STRETCH else STRETCH - LONGEST
            places = np.minimum(first + rows, count - 1)
            for name, values in columns.items():
                parts[name].append(values[places])
            own.append((rows >= begin) & (rows < end))
            numbers.append(number)
            firsts.append(first)
            counts.append(left)
    if not any(some.any() for some in own):
        raise InputError(
            f"no flight has more than {FIRST} rows of {ROW * 1e3:g} ms; give longer flights."
        )
    return Stretches(
        Rows(**{name: np.stack(values) for name, values in parts.items()}),
        flights[0].period * every,
        np.array(numbers),
        np.array(firsts),
        np.array(counts),
        np.stack(own),
    )


def _columns(
    flight: Flight, every: int, drone: Parameters, carrying: float | None
) -> dict[str, np.ndarray]:
    if carrying is None:
        # What a row's command has made by its end is the speed in the next row.
        ends = rotors(flight, drone).speed
        speed = np.concatenate([ends[:1], ends[:-1]])
    else:
        hover = np.sqrt(float(hover_command(drone)))
        speed = np.asarray(flight.rotor_speed, float) * hover / carrying
    about = np.arange(len(flight))[:, None] + np.arange(every) - every // 2
    speed = speed[about.clip(0, len(flight) - 1)].mean(axis=1)[::every]
    few = thinned(flight, every)
    angles = few.attitude[:, ::-1].astype(float)
    return {
        "position": few.position.astype(float),
        "velocity": few.velocity.astype(float),
        "quaternion": Rotation.from_euler("ZYX", angles).as_quat(),
        "body_rates": few.body_rates.astype(float),
        "rotor_speed": speed[: len(few)],
    }
