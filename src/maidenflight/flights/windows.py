"""Windows of flight, each with the commands before it (the paper's mini-trajectories).

The motors and the delay line have a memory, so each window carries up to a second of commands from
before its start, its lead-in.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from maidenflight.errors import InputError
from maidenflight.flights.log import Flight

LEAD_IN = 100
"""Rows before a window's start from which the motors' speed and the delay line are inferred: nine
lags of a motor of 0.11 s. With 30 rows the guess of the motors' first speed still matters, and
their lag comes out up to a tenth too short."""
SHORTEST_LEAD_IN = 30
"""Rows that must have been recorded before a window's start; what lies before a flight's first row
is taken to equal it."""
EVERY = 10
"""Every tenth row starts a window (Gronauer et al. 2022, sec. Simulation Optimization)."""
SAME_RATE = 0.005
"""Share by which periods may differ and still be one: a drone's clock is off by as much."""
SEGMENT_SECONDS = 5.0
"""Length of the segments of flight that count as independent when uncertainty is estimated [s]."""


class Windows(NamedTuple):
    """W windows of T rows."""

    position: Float[np.ndarray, "W 3"]
    velocity: Float[np.ndarray, "W 3"]
    quaternion: Float[np.ndarray, "W 4"]
    body_rates: Float[np.ndarray, "W 3"]
    command: Float[np.ndarray, "W (P+T)*S 4"]
    """u in each period from P = `LEAD_IN` rows before the start to the end; S commands to a row."""
    measured: Float[np.ndarray, "W T 12"]
    """Position, velocity, attitude, body rates in the T rows after the start."""
    segment: Int[np.ndarray, "W"]
    """Number of the segment of flight that the window lies in."""


def first_start(flight: Flight, stride: int = 1) -> int:
    """Returns the row of a first window: those before tell what motors and delay line hold."""
    return max(SHORTEST_LEAD_IN * stride, flight.lead)


def segment_names(flights: Iterable[Flight], length: int, stride: int = 1) -> list[str]:
    """Returns the name of the flight of each segment that `windows` numbers, in their order.

    Args:
        flights: as of `windows`.
        length: as of `windows`.
        stride: as of `windows`.
    """
    return [
        flight.name
        for flight in flights
        if first_start(flight, stride) < len(flight) - length * stride
        for _ in range(_segments(flight))
    ]


def _segments(flight: Flight) -> int:
    return max(1, round(flight.duration / SEGMENT_SECONDS))


def must_have_one_rate(flights: Iterable[Flight]) -> None:
    """Refuses flights whose periods differ by more than `SAME_RATE`.

    Raises:
        InputError: flights of the lowest and the highest rate.
    """
    ranked = sorted(flights, key=lambda flight: flight.period)
    if ranked and ranked[-1].period > (1 + SAME_RATE) * ranked[0].period:
        (fast, high), (slow, low) = (
            (flight.name, 1 / flight.period) for flight in (ranked[0], ranked[-1])
        )
        raise InputError(
            f"flights of different rates: {slow} has {low:.6g} Hz, {fast} {high:.6g} Hz. Identify "
            "from flights of one rate at a time: put the others into a folder of their own."
        )


def windows(
    flights: Iterable[Flight],
    length: int,
    every: int = EVERY,
    lead_in: int = LEAD_IN,
    stride: int = 1,
) -> Windows:
    """Cuts flights into windows.

    Args:
        flights: checked flights, all of one period.
        length: T, rows that the simulation must predict.
        every: rows between the starts of two windows.
        lead_in: P, rows of commands before each start; with 0 a row of no thrust, so that motors
            and delay line begin at rest.
        stride: S, rows of the log to a row of the windows, which keep the commands of all.

    Raises:
        InputError: the flights have different rates, none is long enough, or one has no state.
    """
    flights = list(flights)
    bare = [flight.name for flight in flights if not flight.has_state]
    if bare:
        raise InputError(
            f"{bare[0]}: no position, velocity and attitude in it, with which predictions are "
            f"compared, and so in {len(bare)} of {len(flights)} flights. Leave them out."
        )
    must_have_one_rate(flights)
    before = max(lead_in, 1) * stride
    parts: dict[str, list[np.ndarray]] = {name: [] for name in Windows._fields}
    segments = 0
    for flight in flights:
        starts = np.arange(
            first_start(flight, stride), len(flight) - length * stride, every * stride
        )
        if starts.size == 0:
            continue
        rows = np.concatenate(
            [flight.position, flight.velocity, flight.attitude, flight.body_rates], axis=1
        )
        parts["position"].append(flight.position[starts])
        parts["velocity"].append(flight.velocity[starts])
        parts["quaternion"].append(
            Rotation.from_euler("ZYX", flight.attitude[starts, ::-1]).as_quat()
        )
        parts["body_rates"].append(flight.body_rates[starts])
        # A flight's first row stands for what came before it.
        rows_of_commands = np.maximum(starts[:, None] + np.arange(-before, length * stride), 0)
        commands = flight.mean_command[rows_of_commands]
        if lead_in == 0:
            commands[:, :before] = 0.0
        parts["command"].append(commands)
        parts["measured"].append(rows[starts[:, None] + stride * np.arange(1, length + 1)])
        pieces = _segments(flight)
        parts["segment"].append(segments + np.arange(starts.size) * pieces // starts.size)
        segments += pieces
    if not parts["position"]:
        longest = max((flight.duration for flight in flights), default=0.0)
        period = stride * flights[0].period if flights else 0.01
        needed = (SHORTEST_LEAD_IN + length + 1) * period
        raise InputError(
            f"no flight is long enough for a window of {length} rows: longest {longest:.2f} s, "
            f"needed {needed:.2f} s."
        )
    joined = {name: np.concatenate(arrays) for name, arrays in parts.items()}
    return Windows(
        **{
            name: array if name == "segment" else array.astype(np.float32)
            for name, array in joined.items()
        }
    )
