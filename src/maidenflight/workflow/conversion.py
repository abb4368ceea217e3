"""From logs of any format to logs of ours."""

from collections import Counter
from pathlib import Path

from maidenflight import manifest, results
from maidenflight.flights import log
from maidenflight.flights.reading import Flights
from maidenflight.inputs import StrPath
from maidenflight.workflow.logs import Reading


def convert(flights: Flights, folder: StrPath, reading: Reading) -> list[Path]:
    """Writes each piece of flight as CSV in our format.

    Args:
        flights: read with `reading`.
        folder: where to write, a file a piece: the log's name, and a number where it has several.
        reading: how they were read, for the record.

    Raises:
        WriteError: a file cannot be written.
    """
    settings = {"commands": reading.commands, "battery_law": reading.battery_law}
    made = results.record(seed=None, inputs=flights.paths, settings=settings)
    names = [Path(flight.name).name.split(".")[0] for flight in flights]
    several, seen = Counter(names), Counter[str]()
    written = []
    for name, flight in zip(names, flights, strict=True):
        seen[name] += 1
        number = f"_{seen[name]}" if several[name] > 1 else ""
        written.append(log.write(Path(folder, f"{name}{number}.csv"), flight, made))
    results.remove_older(written, made)
    manifest.append(folder, "log", {"logs": written}, made, {"logs": flights.paths})
    return written
