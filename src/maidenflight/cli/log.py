"""The command log: what flight logs hold, and their conversion into our format."""

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from maidenflight import terminal
from maidenflight.cli import options
from maidenflight.terminal import log_output

if TYPE_CHECKING:
    from maidenflight.flights.reading import Flights
    from maidenflight.flights.summary import Summary


@click.command()
@click.argument("logs", type=options.PATH)
@options.output(
    "Folder for the logs in our format, a CSV a piece; nothing is written unless given."
)
@options.commands
@options.battery_law
@options.as_json
@options.overwrite
def log(
    logs: Path,
    output: Path | None,
    commands: str | None,
    battery_law: str | None,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Show what LOGS hold, and convert them.

    LOGS is a flight log of any format that is read, or a folder of them. Signals, rates, how the
    drone was moved, what was assumed or dropped, and why files were refused. With -o the usable
    pieces are written in our format, which every command reads.
    """
    if output is not None:
        options.must_be_new(output, overwrite)
    from maidenflight import workflow
    from maidenflight.flights.summary import summaries

    with terminal.progress("log", None) as move:
        reading = workflow.Reading(
            math.inf,
            commands,
            battery_law,
            on_file=lambda done, of: move(done, of, "reading flights"),
        )
        flights = reading.flights(logs)
        written = [] if output is None else workflow.convert(flights, output, reading)
    found = summaries(flights)
    then = ("identify", logs if output is None else output, "--start", "DRONE")
    options.emit(
        as_json,
        _content(flights, found) | {"written": [str(path) for path in written]},
        lambda: _show(flights, found, logs, output),
        then,
        "DRONE: a name of maidenflight drone --list, or a file",
    )


def _content(flights: "Flights", found: "tuple[Summary, ...]") -> dict[str, Any]:
    return {
        **log_output.content(flights),
        "logs": [asdict(one) | {"is_calm": one.is_calm} for one in found],
    }


def _show(
    flights: "Flights", found: "tuple[Summary, ...]", logs: Path, output: Path | None
) -> None:
    log_output.held(flights, found)
    if output is not None:
        print(f"written to {output}/: {len(flights)} logs in our format")
    print(f"pictures: maidenflight report --logs {logs} -o look.html")
