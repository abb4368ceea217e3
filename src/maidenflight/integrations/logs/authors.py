"""The authors' flight logs: 22 columns at 100 Hz, in float16 as sent over the radio.

The motors are logged after battery compensation, so the command is recovered with
`physics.battery`. `time` is rounded to as much as 31 ms and serves only to find where a file
holds several flights; rows are 10 ms apart.

Source: github SvenGronauer/phoenix-drone-simulation c5d6907; signs and scales verified on the logs.
"""

import numpy as np

from maidenflight.errors import InputError
from maidenflight.flights import tables
from maidenflight.flights.formats import LoggedFlights, TableFormat
from maidenflight.flights.log import Flight, flight_of
from maidenflight.flights.tables import Table
from maidenflight.simulator.physics import battery

COLUMNS = (
    *("x", "y", "z", "x_dot", "y_dot", "z_dot"),
    *("roll", "pitch", "yaw", "roll_dot", "pitch_dot", "yaw_dot"),
    *("n0", "n1", "n2", "n3", "mot0", "mot1", "mot2", "mot3", "bat", "time"),
)

_SATURATED = 255 / 256
"""Motor ratio at which the motors are saturated."""

PERIOD = 0.01
"""Time between two rows [s]."""


GAP = 0.1
"""Step of the rounded time above which rows must be missing [s]; rounding makes steps of up to 63
ms."""


def flights(table: Table) -> LoggedFlights:
    """Reads one file; where time runs backwards or leaps another flight begins.

    Returns:
        The flights in it, unchecked, each with the time of its rows [s]; and a note if there are
        several. The set-point is that of the circle, which every flight starts with its clock.

    Raises:
        InputError: not the authors' columns, or not 100 Hz.
    """
    column = tables.numbers(table, COLUMNS)
    time = column["time"] = np.where(np.isfinite(column["time"]), column["time"], np.nan)
    step = np.diff(time)
    starts = [0, *(np.flatnonzero((step < 0) | (step > GAP)) + 1), len(time)]
    parts = list(zip(starts[:-1], starts[1:], strict=True))
    _refuse_another_rate(table.name, [time[start:stop] for start, stop in parts])
    logs = []
    for number, (start, stop) in enumerate(parts, 1):
        part = {name: values[start:stop] for name, values in column.items()}
        flight = _flight(part, table.name if len(parts) == 1 else f"{table.name} part {number}")
        logs.append((flight, np.arange(len(flight)) * PERIOD))
    if len(parts) == 1:
        return logs, []
    places = ", ".join(table.location(start) for start, _ in parts[1:4])
    reason = f"time runs backwards or leaps at {places}"
    return logs, [f"{table.name}: {len(parts)} flights in one file; {reason}"]


def _refuse_another_rate(name: str, times: list[np.ndarray]) -> None:
    """Time is rounded, so only the whole of a flight tells its rate."""
    if not np.isfinite(times[0]).any():
        raise InputError(
            f"{name}: column time holds no number. It separates flights; put seconds there."
        )
    longest = max(times, key=len)
    longest = longest[np.isfinite(longest)]
    if len(longest) >= 100:
        step = (longest[-1] - longest[0]) / (len(longest) - 1)
        if not 0.8 * PERIOD < step < 1.2 * PERIOD:
            raise InputError(
                f"{name}: rows are {1000 * step:.3g} ms apart by column time; expected "
                f"{1000 * PERIOD:g} ms (in seconds, 100 Hz)."
            )
    elif len(times) > 3 and len(longest) < sum(map(len, times)) / 10:
        raise InputError(
            f"{name}: time runs backwards or leaps {len(times) - 1} times; expected one flight. "
            "Are the columns shuffled?"
        )


def _flight(table: dict[str, np.ndarray], name: str) -> Flight:
    def columns(*names: str) -> np.ndarray:
        return np.stack([table[column] for column in names], axis=-1).astype(np.float32)

    voltage = table["bat"].astype(np.float32)
    ratio = columns("mot0", "mot1", "mot2", "mot3") / np.float32(65536.0)
    with np.errstate(invalid="ignore"):  # checking drops what is not a number
        command = battery.thrust_command(ratio, voltage[:, None], battery.AUTHORS)
    # Where the network commanded the motors, its own command equals that of the motors.
    commanded = (np.clip(columns("n0", "n1", "n2", "n3"), -1.0, 1.0) + 1.0) / 2.0
    free = np.isfinite(command) & (ratio < _SATURATED)
    zero_order_hold = bool(free.any() and np.median(np.abs(command - commanded)[free]) < 0.02)
    # A network commands up to u = 1, the firmware's mixer up to full PWM.
    largest = 1.0 if zero_order_hold else battery.MOST_COUNTS / battery.COUNTS
    command = np.minimum(command, np.float32(largest))
    clock = (np.round(table["time"][0] / PERIOD) + np.arange(len(voltage))) * PERIOD
    angle, height = 2 * np.pi * clock / 3.0, np.ones_like(clock)
    setpoint = np.stack([0.25 * (1 - np.cos(angle)), 0.25 * np.sin(angle), height], axis=-1)
    return flight_of(
        name,
        PERIOD,
        position=columns("x", "y", "z"),
        velocity=columns("x_dot", "y_dot", "z_dot"),
        attitude=columns("roll", "pitch", "yaw"),
        body_rates=columns("roll_dot", "pitch_dot", "yaw_dot"),
        command=command,
        battery=voltage,
        setpoint=setpoint,
        zero_order_hold=zero_order_hold,
    )


FORMAT = TableFormat(
    "the 22 columns of Gronauer et al.", lambda table: table.has_most_of(COLUMNS), flights
)
