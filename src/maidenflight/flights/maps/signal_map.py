"""What maps of topics and of columns share: the signals, how motors are scaled, and the flight.

Axes are ours: the world's z up, the body's x forward, y left, z up.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from maidenflight.errors import InputError
from maidenflight.flights.log import Flight
from maidenflight.flights.streams import joining, streams
from maidenflight.flights.streams.streams import Stream

THRUSTS = ("square", "linear")
"""How thrust follows the motors' numbers."""
COUNTS = {
    "position": 3,
    "velocity": 3,
    "attitude": 4,
    "body_rates": 3,
    "accelerometer": 3,
    "motors": 4,
    "rotor_speed": 4,
    "battery": 1,
}
"""Signals, and how many numbers each has."""
MOTOR_KEYS = ("low", "high", "thrust")
"""What the entry of the motors may have beside that of any signal."""


class Motors(NamedTuple):
    """What the numbers of the motors mean."""

    low: float = 0.0
    """Number of a motor that does not turn."""
    high: float = 1.0
    """Number of a motor at full throttle."""
    square: bool = True
    """Whether rotor speed follows the numbers, or thrust does."""


def check_signals(path: Path, entries: Mapping[str, Any], needed: tuple[str, ...]) -> None:
    """Refuses a map with unknown signals, or without one that is needed.

    Raises:
        InputError: which are unknown and which are missing.
    """
    unknown = set(entries) - set(COUNTS)
    lacking = [signal for signal in needed if signal not in entries]
    if unknown or lacking:
        raise InputError(
            f"{path}: {', '.join(sorted(unknown)) or 'nothing'} unknown and "
            f"{', '.join(lacking) or 'nothing'} missing; expected {', '.join(needed)}, and perhaps "
            f"{', '.join(signal for signal in COUNTS if signal not in needed)}."
        )


def motors(path: Path, entry: Mapping[str, Any]) -> Motors:
    """Reads what the entry of the motors says of their numbers.

    Raises:
        InputError: the law of thrust is unknown, or full throttle is not above idle.
    """
    thrust = entry.get("thrust", THRUSTS[0])
    low, high = (
        number(path, "motors", key, entry.get(key, usual))
        for key, usual in (("low", 0.0), ("high", 1.0))
    )
    if thrust not in THRUSTS or not low < high:
        raise InputError(
            f"{path}: motors have thrust = {thrust!r}, low = {low:g}, high = {high:g}; expected "
            f"{' or '.join(map(repr, THRUSTS))}, and low below high."
        )
    return Motors(low, high, thrust == THRUSTS[0])


def number(path: Path, signal: str, key: str, value: Any) -> float:
    """Reads a number of an entry.

    Raises:
        InputError: it is none.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e12:
        raise InputError(f"{path}: {key} of [{signal}] is {value!r}; expected a number.")
    return float(value)


def flight(
    name: str, signals: Mapping[str, Stream], scale: Motors, remedy: str
) -> tuple[Flight, np.ndarray, list[str]]:
    """Returns the flight in some signals, unchecked, with the time of its rows [s], and notes.

    Args:
        name: of the file.
        signals: by keys of `COUNTS`, body rates and motors among them, in SI units and our axes.
        scale: of the motors.
        remedy: a sentence that says what makes the drone log faster.

    Raises:
        InputError: a signal is missing or logged too rarely.
    """
    raw = signals["motors"]
    share = np.clip((raw.values - scale.low) / (scale.high - scale.low), 0.0, None)
    state, state_notes = None, []
    if {"position", "velocity", "attitude"} <= set(signals):
        place, velocity = signals["position"], signals["velocity"]
        moved = np.concatenate([place.values, streams.between(place.time, velocity)], axis=1)
        state, state_notes = joining.state(name, Stream(place.time, moved), signals["attitude"])
    else:
        state_notes = [f"{name}: no position, velocity and attitude together: {joining.ALONE}"]
    joined = joining.Signals(
        signals["body_rates"],
        Stream(raw.time, share if scale.square else np.sqrt(share)),
        signals.get("accelerometer"),
        state,
        signals.get("rotor_speed"),
        signals.get("battery"),
    )
    flight_rows, time, more = joining.flight(name, joined, remedy)
    thrust = THRUSTS[0] if scale.square else THRUSTS[1]
    motor_note = (
        f"{name}: thrust by the {thrust} law of motors between {scale.low:g} and {scale.high:g}"
    )
    return flight_rows, time, [*state_notes, motor_note, *more]
