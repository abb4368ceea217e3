"""`Log`: what flight logs hold, and their conversion into our format."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight import terminal
from maidenflight.verb import Output, Progress, Result, Verb
from maidenflight.verbs import logs as read
from maidenflight.verbs import shared

if TYPE_CHECKING:
    from maidenflight.flights.reading import Flights
    from maidenflight.flights.summary import Summary

_STATE = ("position", "velocity", "attitude")


class Log(Verb):
    """Show what LOGS hold, and convert them.

    LOGS is a flight log of any format that is read, or a folder of them. Signals, rates, how the
    drone was moved, what was assumed or dropped, and why files were refused. With -o the usable
    pieces are written in our format, which every command reads.
    """

    output = Output(
        None, "Folder for the logs in our format, a CSV a piece; nothing is written unless given."
    )

    logs: Path = shared.logs()
    commands: str | None = shared.commands()
    battery_law: str | None = shared.battery_law()

    def compute(self, output: Path | None, progress: Progress) -> Result:
        """Reads the logs; writes the usable pieces where an output is given."""
        from maidenflight.flights.reading import read_flights
        from maidenflight.flights.summary import summaries

        flights = read_flights(
            *(self.logs, read.count_files(progress), math.inf),
            commands=self.commands,
            battery_law=self.battery_law,
        )
        record = self.make_record(flights.paths)
        written = [] if output is None else _convert(flights, output, record)
        found = summaries(flights)

        def show() -> None:
            _show(flights, found)
            if output is not None:
                print(f"written to {output}/: {len(flights)} logs in our format")
            print(f"pictures: maidenflight report --logs {self.logs} -o look.html")

        return Result(
            content={
                **read.to_content(flights),
                "logs": [asdict(one) | {"is_calm": one.is_calm} for one in found],
                "written": [str(path) for path in written],
            },
            show=show,
            written={"logs": written} if written else {},
            read={"logs": flights.paths},
            record=record,
            next=("identify", self.logs if output is None else output, "--start", "DRONE"),
            next_remark="DRONE: a name of maidenflight drone --list, or a file",
            value=flights,
        )


def _convert(flights: "Flights", folder: Path, record: dict[str, Any]) -> list[Path]:
    """Writes each piece of flight as CSV: the log's name, and a number where it has several."""
    from maidenflight import results
    from maidenflight.flights import log

    names = [Path(flight.name).name.split(".")[0] for flight in flights]
    several, seen = Counter(names), Counter[str]()
    written = []
    for name, flight in zip(names, flights, strict=True):
        seen[name] += 1
        number = f"_{seen[name]}" if several[name] > 1 else ""
        written.append(log.write(folder / f"{name}{number}.csv", flight, record))
    results.remove_older(written, record)
    return written


def _show(flights: "Flights", logs: "Sequence[Summary]") -> None:
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
    columns = ["log", "signals", "commands", "usable [s]", "rate [Hz]", "battery [V]"]
    terminal.print_table("Flight logs", columns, holding, numbers_from=3)
    columns = ["log", "speed\n[m/s]", "most tilt\n[deg]", "body rates\n[deg/s]", "mean u"]
    columns += ["SD of\nthrust", "SD of\ntorque"]
    terminal.print_table("How they move the drone", columns, moved)
    print("state: position, velocity and attitude. Speed and body rates: root mean square; SD:")
    print("standard deviation of the mean command u and of the motors' difference in roll or pitch")
    calm = sum(one.is_calm for one in logs)
    if calm:
        print(
            f"calm: {calm} of {len(logs)} logs, in which the motors differ little; quick rolls and "
            "pitches would tell more of inertia, lag and latency"
        )
    read.show_flights(flights)
