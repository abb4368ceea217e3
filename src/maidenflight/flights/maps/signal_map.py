"""What maps of topics and of columns share: the signals, how motors are scaled, and the flight.

Axes are ours: the world's z up, the body's x forward, y left, z up.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from maidenflight.errors import InputError
from maidenflight.flights.log import Flight
from maidenflight.flights.streams import joining, streams
from maidenflight.flights.streams.streams import Stream
from maidenflight.inputs import Fields

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
"""Signals, and how many numbers each has by definition."""
CURE = "Mend it; see docs/flight-log.md."
SourceType = TypeVar("SourceType")


class Motors(NamedTuple):
    """What the numbers of the motors mean."""

    low: float = 0.0
    """Number of a motor that does not turn."""
    high: float = 1.0
    """Number of a motor at full throttle."""
    square: bool = True
    """Whether rotor speed follows the numbers, or thrust does."""


def read_sources(
    path: Path,
    entries: Mapping[str, Any],
    needed: Sequence[str],
    read_source: Callable[[str, Fields], SourceType],
) -> tuple[dict[str, SourceType], Motors]:
    """Reads where each signal of a map is, and what the motors' numbers mean.

    Args:
        path: of the map.
        entries: its tables, by signal.
        needed: signals that it must have.
        read_source: reads where a signal is of its table.

    Raises:
        InputError: signals are unknown or missing, or an entry is missing, unknown or of the wrong
            kind.
    """
    unknown = set(entries) - {*COUNTS, *needed}
    lacking = [signal for signal in needed if signal not in entries]
    if unknown or lacking:
        if "motors" in lacking and "rotor_speed" in entries:
            raise InputError(
                f"{path}: measured rotor speeds, but no commands of the motors, without which no "
                "drone is identified. Log the commands too, and add [motors]."
            )
        wrong = [
            *([f"{', '.join(sorted(unknown))} unknown"] if unknown else []),
            *([f"{', '.join(lacking)} missing"] if lacking else []),
        ]
        raise InputError(
            f"{path}: {' and '.join(wrong)}; expected {', '.join(needed)}, and perhaps "
            f"{', '.join(signal for signal in COUNTS if signal not in needed)}."
        )
    sources, motors = {}, Motors()
    for signal, entry in entries.items():
        fields = Fields(entry, str(path), signal, CURE)
        sources[signal] = read_source(signal, fields)
        if signal == "motors":
            motors = _motors(fields)
        fields.end()
    return sources, motors


def _motors(fields: Fields) -> Motors:
    low, high = fields.number("low", usual=0.0), fields.number("high", usual=1.0)
    if not low < high:
        raise fields.refused("low", f"less than high, {high:g}")
    return Motors(low, high, fields.choice("thrust", THRUSTS, THRUSTS[0]) == THRUSTS[0])


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
        position, velocity = signals["position"], signals["velocity"]
        moved = np.concatenate([position.values, streams.between(position.time, velocity)], axis=1)
        state, state_notes = joining.state(name, Stream(position.time, moved), signals["attitude"])
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
    law = f"{THRUSTS[0] if scale.square else THRUSTS[1]} law"
    motor_note = f"{name}: thrust by the {law} of motors between {scale.low:g} and {scale.high:g}"
    return flight_rows, time, [*state_notes, motor_note, *more]
