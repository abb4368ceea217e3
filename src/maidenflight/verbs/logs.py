"""Flight logs of a command: the drone that an analysis starts with, and what was read."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight import terminal
from maidenflight.verb import Progress

if TYPE_CHECKING:
    from maidenflight.flights.reading import Flights
    from maidenflight.identification.drone_file import DroneFile


def count_files(progress: Progress) -> Callable[[int, int], None]:
    """Returns a function that shows how many files are read."""
    return lambda done, of: progress.move(done, of, "reading flights")


def read_start(drone: str, mass_g: float | None) -> "DroneFile":
    """Reads the drone that an identification begins with.

    Args:
        drone: a named drone, or a TOML file.
        mass_g: of what flew [g]; the drone's own unless given.

    Raises:
        InputError: see `parameters.read`.
    """
    from maidenflight import parameters
    from maidenflight.identification import drone_file
    from maidenflight.identification.drone_file import DroneFile

    own = parameters.read(drone, None if mass_g is None else mass_g / 1e3)
    if drone in parameters.DRONES:
        return DroneFile(own, name=drone)
    return replace(drone_file.read(drone), parameters=own)


def note_mass(drone: str, mass_g: float | None, flights: "Flights") -> list[str]:
    """Returns a note that asks for the mass where nobody gave it, of real flights."""
    from maidenflight import parameters

    known = mass_g is not None or drone not in parameters.DRONES
    if known or all(flight.simulated for flight in flights):
        return []
    mass = 1e3 * float(parameters.read(drone).mass)
    return [
        f"mass taken from {drone}, {mass:.4g} g. Inertia, trim and other torques found are in "
        "proportion to it; thrust-to-weight ratio, lags and drag do not depend on it. Weigh yours "
        "with battery and decks, and give --mass GRAMS."
    ]


def own_files(*given: Any) -> list[str]:
    """Returns those of some paths and names that are files, for records."""
    return [str(one) for one in given if one is not None and Path(one).is_file()]


def to_content(flights: "Flights") -> dict[str, Any]:
    """Returns what was read, for JSON."""
    return {
        "files": len(flights.paths),
        "pieces": len(flights),
        "seconds": round(flights.duration, 2),
        "dropped": flights.notes,
        "refused": flights.refused,
    }


def show_flights(flights: "Flights", further: str = "") -> None:
    """Prints what was read, dropped and refused."""
    print(
        f"{len(flights.paths)} files, {len(flights)} usable pieces of flight, "
        f"{flights.duration:.0f} s{further}"
    )
    if flights.notes:
        terminal.print_file_notes(flights.notes)
    _show_refused(flights.refused)


def _show_refused(reasons: Sequence[str]) -> None:
    if reasons:
        print(f"{len(reasons)} files refused:", file=sys.stderr)
    for reason in reasons[:3]:
        print(f"  {reason}", file=sys.stderr)
    if len(reasons) > 3:
        print(f"  and {len(reasons) - 3} more; --json lists them all", file=sys.stderr)


def scale_of(name: str, value: float) -> tuple[float, str]:
    """Returns the shown value per SI value of a parameter, and the unit in which it is shown."""
    from maidenflight.parameters import COMPONENTS, QUANTITIES

    unit = QUANTITIES[COMPONENTS[name][0]].unit
    unit = "" if unit == "-" else unit
    if unit == "s":
        return 1e3, "ms"
    return (1e6, f"1e-6 {unit}".strip()) if 0.0 < abs(value) < 1e-3 else (1.0, unit)
