"""Output of flight logs: what was read of them."""

import math
import sys
from typing import TYPE_CHECKING, Any

from maidenflight import terminal

if TYPE_CHECKING:
    from collections.abc import Sequence

    from maidenflight.flights.reading import Flights
    from maidenflight.flights.summary import Summary

_STATE = ("position", "velocity", "attitude")


def content(flights: "Flights") -> dict[str, Any]:
    """What was read, for JSON."""
    return {
        "files": len(flights.paths),
        "pieces": len(flights),
        "seconds": round(flights.duration, 2),
        "dropped": flights.notes,
        "refused": flights.refused,
    }


def show(flights: "Flights", windows: int) -> None:
    """Prints what was read, and how many windows were cut of it."""
    _read(flights, f"; {windows} windows of rows")


def held(flights: "Flights", logs: "Sequence[Summary]") -> None:
    """Prints what logs hold, a row each, and what was assumed, dropped and refused."""
    holding, moved = [], []
    for one in logs:
        signals = [name.replace("_", " ") for name in one.signals if name not in _STATE]
        if set(_STATE) <= set(one.signals):
            signals = ["state", *signals]
        volts = "" if one.battery is None else "{:.2f} .. {:.2f}".format(*one.battery)
        seconds, rate = f"{one.seconds:.1f}", f"{one.rate:.4g}"
        holding.append([one.name, ", ".join(signals), one.commands, seconds, rate, volts])
        moved.append(
            [
                one.name,
                "" if one.speed is None else f"{one.speed:.2f}",
                "" if one.tilt is None else f"{math.degrees(one.tilt):.0f}",
                f"{math.degrees(one.body_rates):.0f}",
                f"{one.command:.3f}",
                f"{one.thrust_spread:.3f}",
                f"{one.torque_spread:.3f}",
            ]
        )
    terminal.table(
        "Flight logs",
        ["log", "signals", "commands", "usable [s]", "rate [Hz]", "battery [V]"],
        holding,
        numbers_from=3,
    )
    columns = ["speed\n[m/s]", "most tilt\n[deg]", "body rates\n[deg/s]", "mean u"]
    terminal.table(
        "How they move the drone",
        ["log", *columns, "spread of\nthrust", "spread of\ntorque"],
        moved,
    )
    print("state: position, velocity and attitude. Speed and body rates: root mean square; spread:")
    print("standard deviation of the mean command u and of the motors' difference in roll or pitch")
    calm = sum(one.is_calm for one in logs)
    if calm:
        print(
            f"calm: {calm} of {len(logs)} logs, in which the motors differ little; quick rolls and "
            "pitches would tell more of inertia, lag and latency"
        )
    _read(flights)


def _read(flights: "Flights", further: str = "") -> None:
    print(
        f"{len(flights.paths)} files, {len(flights)} usable pieces of flight, "
        f"{flights.duration:.0f} s{further}"
    )
    if flights.notes:
        terminal.notes(flights.notes)
    if flights.refused:
        print(f"{len(flights.refused)} files refused:", file=sys.stderr)
        for reason in flights.refused[:3]:
            print(f"  {reason}", file=sys.stderr)
        if len(flights.refused) > 3:
            print(f"  and {len(flights.refused) - 3} more; --json lists them all", file=sys.stderr)
