"""Kinds of flights, simulated or real, and the flights that a drone was identified from."""

from collections.abc import Iterable, Mapping

from maidenflight.identification.drone_file import DroneFile
from maidenflight.reporting import text

Kinds = frozenset[bool | None]
"""Of flights, whether they were of a simulated drone; holds `None` where some may be of either
kind."""
UNKNOWN: Kinds = frozenset([None])
SIMULATED: Kinds = frozenset([True])
REAL: Kinds = frozenset([False])


def kinds_of(used: Iterable[str], known: Mapping[str, bool | None], otherwise: Kinds) -> Kinds:
    """Returns kinds of flights.

    Args:
        used: digests of their logs.
        known: by digest of a log, whether its flight was simulated.
        otherwise: the answer where no record names the logs that were used.
    """
    return frozenset(known.get(each) for each in used) or otherwise


def kinds_identified(drone: DroneFile | None, others: Kinds) -> Kinds:
    """Returns kinds of the flights that a drone was identified from.

    Args:
        drone: its file says whether any flight was simulated, not whether all were.
        others: the kinds as far as the logs show.
    """
    if drone is None or drone.source is None:
        return others
    if not drone.source.simulated:
        return REAL
    return SIMULATED if drone.source.flights == 1 else others | SIMULATED


def flights(drone: DroneFile | None, kinds: Kinds, before: str, after: str = "") -> str:
    """Counts the flights of an identification by kind, their seconds between two texts."""
    if drone is None or drone.source is None:
        return ""
    source, word = drone.source, ""
    if kinds in (SIMULATED, REAL, SIMULATED | REAL):
        word = " and ".join(["real"] * (False in kinds) + ["simulated"] * (True in kinds)) + " "
    some = ", some or all simulated" if kinds == SIMULATED | UNKNOWN else ""
    seconds = f"{before}{source.seconds:.0f} s{after}"
    return f"{text.plural(source.flights, word + 'flight')}{seconds}{some}"
