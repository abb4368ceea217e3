"""What a flight's sensors measured and what its rotors did, in steps of about 10 ms.

Delays of the sensors' low-pass filters are undone, so that signals and commands have one clock.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from maidenflight.flights.log import GRAVITY, Flight

STEP = 0.01
"""Time over which signals are averaged [s]: rows of Gronauer et al. 2022, sec. Simulation
Optimization."""


def stride(flight: Flight) -> int:
    """Returns rows of a step."""
    return max(1, round(STEP / flight.period))


def is_zero_order_hold(flights: Sequence[Flight]) -> bool:
    """Returns whether each logged command acted until the next."""
    return all(flight.zero_order_hold for flight in flights)


def means(values: Float[np.ndarray, "N c"], rows: int) -> Float[np.ndarray, "M c"]:
    """Means of each so many rows."""
    count = len(values) // rows
    return values[: count * rows].reshape(count, rows, -1).mean(axis=1)


def force_along_z(flight: Flight) -> Float[np.ndarray, "N"]:
    """Returns specific force along z half a row later, the filter's delay undone [m/s2].

    Of a log without an accelerometer it is what changes the velocity, and gravity.
    """
    places = np.arange(len(flight))
    if flight.accelerometer is None:
        angles = flight.attitude[:, ::-1].astype(float)
        upward = Rotation.from_euler("ZYX", angles).as_matrix()[..., 2]
        velocity = flight.velocity.astype(float)
        push = np.diff(velocity, axis=0, append=velocity[-1:]) / flight.period
        return np.asarray(np.sum(upward * (push + np.array([0.0, 0.0, GRAVITY])), axis=1))
    later = places + 0.5 + flight.accelerometer_delay / flight.period
    return np.interp(later, places, flight.accelerometer[:, 2].astype(float))


def gyro(flight: Flight) -> Float[np.ndarray, "N 3"]:
    """Returns the body rates [rad/s], the filter's delay undone where rows are close enough."""
    rates = flight.body_rates.astype(float)
    if stride(flight) == 1:
        return rates
    places = np.arange(len(flight))
    later = places + flight.gyro_delay / flight.period
    return np.stack([np.interp(later, places, column) for column in rates.T], axis=1)


def undo_filter_delay(flight: Flight) -> Flight:
    """Returns the flight without the delay of the gyro's filter."""
    return replace(flight, body_rates=gyro(flight).astype(np.float32))


def delay_command(command: Float[np.ndarray, "N ..."], rows: float) -> Float[np.ndarray, "N ..."]:
    """Returns the mean command of each row where all come so many rows late."""
    whole, share = divmod(rows, 1.0)
    extended = np.concatenate([np.repeat(command[:1], int(whole) + 1, axis=0), command])
    return (1 - share) * extended[1 : len(command) + 1] + share * extended[: len(command)]
