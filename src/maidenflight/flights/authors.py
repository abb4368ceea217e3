"""The authors' flight logs: 22 columns at 100 Hz, float16 as it came over the radio.

The motors are logged after battery compensation, so the command is recovered with `simulator.battery`. `time` is rounded to as
much as 31 ms and serves only to find where a file holds several flights; rows are 10 ms apart.

Source: github SvenGronauer/phoenix-drone-simulation c5d6907; signs and scales verified on the logs.
"""

import numpy as np

from maidenflight.flights.log import Flight, numbers
from maidenflight.simulator import battery

COLUMNS = (
    *("x", "y", "z", "x_dot", "y_dot", "z_dot", "roll", "pitch", "yaw", "roll_dot", "pitch_dot", "yaw_dot"),
    *("n0", "n1", "n2", "n3", "mot0", "mot1", "mot2", "mot3", "bat", "time"),
)

_SATURATED = 255 / 256
"""Motor ratio at which the battery gives all it has, whatever was commanded."""

PERIOD = 0.01
"""Time between two rows [s]."""


def from_csv(text: str, name: str) -> list[Flight]:
    """Reads one file; where time runs backwards another flight begins.

    Args:
        text: content of the file.
        name: what errors name.

    Returns:
        The flights in it, unchecked. The set-point is that of the circle, which every flight starts with its clock.

    Raises:
        InputError: not the authors' columns.
    """
    table = numbers(text, name, COLUMNS)
    starts = [0, *(np.flatnonzero(np.diff(table["time"]) < 0) + 1), len(table["time"])]
    flights = []
    for number, (start, stop) in enumerate(zip(starts[:-1], starts[1:], strict=True), 1):
        part = {column: values[start:stop] for column, values in table.items()}
        flights.append(_flight(part, name if len(starts) == 2 else f"{name} part {number}"))
    return flights


def _flight(table: dict[str, np.ndarray], name: str) -> Flight:
    def columns(*names: str) -> np.ndarray:
        return np.stack([table[column] for column in names], axis=-1).astype(np.float32)

    voltage = table["bat"].astype(np.float32)
    ratio = columns("mot0", "mot1", "mot2", "mot3") / np.float32(65536.0)
    with np.errstate(invalid="ignore"):  # a battery that is not a number makes a command that is not one, which checking drops
        command = battery.thrust_command(ratio, voltage[:, None])
    # The network's own command, where the network commanded the motors, equals what the motors were told.
    wanted = (np.clip(columns("n0", "n1", "n2", "n3"), -1.0, 1.0) + 1.0) / 2.0
    free = np.isfinite(command) & (ratio < _SATURATED)
    held = bool(free.any() and np.median(np.abs(command - wanted)[free]) < 0.02)
    clock = (np.round(table["time"][0] / PERIOD) + np.arange(len(voltage))) * PERIOD
    angle = 2 * np.pi * clock / 3.0
    setpoint = np.stack([0.25 * (1 - np.cos(angle)), 0.25 * np.sin(angle), np.ones_like(angle)], axis=-1)
    return Flight(
        name=name,
        period=PERIOD,
        position=columns("x", "y", "z"),
        velocity=columns("x_dot", "y_dot", "z_dot"),
        attitude=columns("roll", "pitch", "yaw"),
        body_rates=columns("roll_dot", "pitch_dot", "yaw_dot"),
        command=command.astype(np.float32),
        battery=voltage,
        setpoint=setpoint.astype(np.float32),
        held=held,
    )
