"""`Log`: what flight logs hold, and their conversion into our format."""

import math
from collections import Counter
from dataclasses import asdict
from pathlib import Path

from maidenflight.terminal import Table
from maidenflight.verb import Output, Progress, Result, Row, Verb
from maidenflight.verbs import core, shared

_STATE = ("position", "velocity", "attitude")


class Log(Verb):
    """Show what LOGS hold, and convert them.

    LOGS is a flight log of any format that is read, or a folder of them. Signals, rates, how the
    drone was moved, what was assumed or dropped, and why files were refused. With -o the usable
    pieces are written in our format, which every command reads.
    """

    output = Output(
        None, "Folder for the logs in our format, a CSV a piece; nothing is written by default."
    )

    logs: Path = shared.logs()
    commands: str | None = shared.commands()
    battery_law: str | None = shared.battery_law()

    def compute(self, output: Path | None, progress: Progress) -> Result:
        """Reads the logs; writes the usable pieces where there is an output."""
        flights = core.read_flights(
            *(self.logs, core.logs.count_files(progress), math.inf),
            commands=self.commands,
            battery_law=self.battery_law,
        )
        record = self.make_record(flights.paths)
        written = [] if output is None else core.logs.write_logs(output, _name(flights), record)
        logs = [asdict(one) | {"is_calm": one.is_calm} for one in core.summaries(flights)]
        return Result(
            content={
                **core.logs.to_content(flights),
                "logs": logs,
                "written": [str(path) for path in written],
            },
            summary=[
                *_tabulate(logs),
                *core.logs.describe_flights(flights),
                f"pictures: maidenflight report --logs {self.logs} -o look.html",
            ],
            written={"logs": written} if written else {},
            read={"logs": flights.paths},
            record=record,
            next=("identify", self.logs if output is None else output, "--start", "DRONE"),
            next_remark="DRONE: a name of maidenflight drone --list, or a file",
            value=flights,
        )


def _name(flights: "core.Flights") -> "dict[str, core.Flight]":
    """Returns pieces of flight by their log's name, with a number where it has several."""
    names = [Path(flight.name).name.split(".")[0] for flight in flights]
    several, count, named = Counter(names), Counter[str](), {}
    for name, flight in zip(names, flights, strict=True):
        count[name] += 1
        named[f"{name}_{count[name]}" if several[name] > 1 else name] = flight
    return named


def _tabulate(logs: list[Row]) -> list[Table | str]:
    """Returns what logs hold and how they move the drone, a row each."""
    rows = []
    for one in logs:
        signals = [name.replace("_", " ") for name in one["signals"] if name not in _STATE]
        state = ["state"] if set(_STATE) <= set(one["signals"]) else []
        battery = "" if one["battery"] is None else "{:.2f} .. {:.2f} V".format(*one["battery"])
        rows.append({**one, "signals": ", ".join([*state, *signals]), "battery": battery})
    holding = {"log": "{name}", "signals": "{signals}", "commands": "{commands}"}
    holding |= {"usable": "{seconds:.1f s}", "rate": "{rate:.4g Hz}", "battery": "{battery}"}
    moved = {"log": "{name}", "speed": "{speed:.2f m/s}", "most\ntilt": "{tilt:.0f deg}"}
    moved |= {"body\nrates": "{body_rates:.0f deg/s}", "mean u": "{command:.3f}"}
    moved |= {"SD of\nthrust": "{thrust_spread:.3f}", "SD of\ntorque": "{torque_spread:.3f}"}
    calm = sum(one["is_calm"] for one in logs)
    remark = (
        f"calm: {calm} of {len(logs)} logs, in which the motors differ little; quick rolls and "
        "pitches would tell more of inertia, lag and latency"
    )
    return [
        Table("Flight logs", holding, rows),
        Table("How they move the drone", moved, rows),
        "state: position, velocity and attitude. Speed and body rates: root mean square; SD:",
        "standard deviation of the mean command u and of the motors' difference in roll or pitch",
        *([remark] if calm else []),
    ]
