"""The drone that an identification begins with."""

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

from maidenflight import parameters
from maidenflight.flights.reading import Flights
from maidenflight.identification import drone_file
from maidenflight.identification.drone_file import DroneFile
from maidenflight.identification.outcome.bounds import at_bounds


def read_start(drone: str, mass_g: float | None) -> DroneFile:
    """Reads the drone that an identification begins with.

    Args:
        drone: a named drone, or a TOML file.
        mass_g: of what flew [g]; the drone's own by default.

    Raises:
        InputError: see `parameters.read_drone`.
    """
    own = parameters.read_drone(drone, None if mass_g is None else mass_g / 1e3)
    if drone in parameters.DRONES:
        return DroneFile(own, name=drone)
    return replace(drone_file.read(drone), parameters=own)


def note_mass(drone: str, mass_g: float | None, flights: Flights) -> list[str]:
    """Returns a note that asks for the mass where nobody gave it, of real flights."""
    is_mass_known = mass_g is not None or drone not in parameters.DRONES
    if is_mass_known or all(flight.simulated for flight in flights):
        return []
    mass = 1e3 * float(parameters.read_drone(drone).mass)
    return [
        f"mass taken from {drone}, {mass:.4g} g. Inertia, trim and other torques found are in "
        "proportion to it; thrust-to-weight ratio, lags and drag do not depend on it. Weigh yours "
        "with battery and decks, and give --mass GRAMS."
    ]


def note_start_at_bounds(start: DroneFile, estimates: Collection[str]) -> list[str]:
    """Returns what stays of a start although it lay at a search bound there.

    Args:
        start: the drone that the identification began with.
        estimates: names of what was identified.
    """
    return [
        f"kept from {Path(start.name).name}: {text}"
        for name, text in at_bounds(start.estimates).items()
        if name not in estimates
    ]
