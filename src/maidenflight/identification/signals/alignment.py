"""Commands that were logged late, and flights whose commands and motion have one clock.

No motion begins before its command. Where the loop of commands and gyro has a latency below what
the time stamps of one clock differ by, commands are moved back until it is the usual one: else the
lag is too short by as much, and the inertia too large. The clocks' difference hides the latency
then, which keeps the usual range.

A delay to the other side may be the way to the motors, and stays latency. Neither shows where a
feedback alone moves the drone, or where a policy flew at the log's rate (paper/notes/checkup.md).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from maidenflight.flights.checkup.response import DELAY, is_before, measure_delay
from maidenflight.flights.checkup.result import LogWarning
from maidenflight.flights.log import Flight
from maidenflight.identification.signals.motor_response import (
    LATENCIES,
    SHORTEST,
    USUAL,
    latency_of_loop,
)
from maidenflight.parameters import Parameters

_AT_END = 4
"""Latencies of which a loop that was looked for too late has one; chosen."""


def align_commands(
    flights: Sequence[Flight], drone: Parameters
) -> tuple[Sequence[Flight], list[LogWarning]]:
    """Returns flights whose commands are not behind their motion, and what was wrong.

    Args:
        flights: of one rate.
        drone: where its rotors are.
    """
    # A policy at the log's rate is modelled row by row, and measured speeds show the lag.
    is_loop = any(
        not flight.zero_order_hold or flight.accelerometer is not None for flight in flights
    )
    is_short = sum(flight.duration for flight in flights) < 2 * SHORTEST
    if not is_loop or is_short or any(flight.rotor_speed is not None for flight in flights):
        return flights, []
    as_logged = latency_of_loop(flights, drone)
    is_inside = as_logged.weight[:_AT_END].sum() < 0.5 * as_logged.weight.sum()
    if not as_logged.loops or (is_inside and not is_before(measure_delay(flights))):
        return flights, []
    # So far that the latencies that are tried join those of the log as it is.
    rows = int(np.ceil((LATENCIES[0] + LATENCIES[-1]) / flights[0].period))
    moved = latency_of_loop([_earlier(flight, rows) for flight in flights], drone, rows)
    latencies = LATENCIES - rows * flights[0].period
    if moved.weight @ (latencies < LATENCIES[0]) < 0.975:
        return flights, []
    middle = float(moved.weight @ latencies)
    error = float(np.sqrt(moved.weight @ (latencies - middle) ** 2))
    rows = round((USUAL - middle) / flights[0].period)
    late = 1e3 * rows * flights[0].period
    warning = LogWarning(
        DELAY,
        "",
        f"commands are logged about {late:.0f} ms late: in their loop with the gyro motion begins "
        f"{-1e3 * middle:.1f} +- {1e3 * error:.1f} ms before them, which none does. They were "
        "moved back: lag and inertia are the drone's, the latency only the usual one.",
        "Log commands and gyro with one clock.",
        1e3 * middle,
        f"{1e3 * LATENCIES[0]:.0f} ms or more",
    )
    return [_earlier(flight, rows) for flight in flights], [warning]


def _earlier(flight: Flight, rows: int) -> Flight:
    """Returns the flight with commands so many rows earlier."""
    if len(flight) < 2 * rows + 2:
        return flight
    part = flight.part(0, len(flight) - rows)
    return replace(part, command=flight.command[rows:], gyro_delay_known=False)
