"""A sample of more flight than can be held: stretches of every flight, as much of it as asked for.

What a drone is shows in an hour of flight; ten hours tell it hardly better and cost ten times as much. Each flight gives up to the same
number of seconds, so that no long one drowns the others. What is kept does not depend on what was read before it, only on the flights.
"""

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from maidenflight.flights.log import GROUPS, Flight
from maidenflight.flights.windows import BLOCK, HISTORY, SHORTEST_HISTORY

UNIT = 100
"""Rows by which stretches grow: those of a window of the likelihood, so that a stretch wastes none."""
_SLACK = 1.25
"""Times the flight asked for that is held while more is read, so that not every file makes all be cut anew."""


def sampled(flights: Iterable[Flight], most: float, history: int = HISTORY) -> tuple[list[Flight], float]:
    """Keeps all flights if they last no longer than asked for together, else stretches of those that last longer than their share.

    Stretches lie at random places, always the same ones, and carry the rows before them that their windows need; those are the windows
    that would be cut from the whole flight. One flight at a time is held beside what is kept. However many the flights, each gives at
    least one stretch of `UNIT` rows.

    Args:
        flights: checked flights, of which only one at a time need be in memory.
        most: seconds to keep, all flights together.
        history: rows of commands before a window.

    Returns:
        What is kept, in the order of the flights, and the seconds of all flights.
    """
    kept: list[list[Flight]] = []
    durations: list[float] = []
    held = 0.0
    for flight in flights:
        durations.append(flight.duration)
        kept.append([flight])
        held += flight.duration
        if held > _SLACK * most:
            share = _share(np.array(durations), most)
            kept = [_shortened(parts, number, share, history) for number, parts in enumerate(kept)]
            held = sum(part.duration for parts in kept for part in parts)
    if sum(durations) > most:
        share = _share(np.array(durations), most)
        kept = [_shortened(parts, number, share, history) for number, parts in enumerate(kept)]
    return [part for parts in kept for part in parts], sum(durations)


def _share(durations: Float[np.ndarray, "N"], most: float) -> float:
    """The longest that a flight may last for all to last `most` together; it only falls as flights come in. Infinite for few."""
    rising = np.sort(durations)
    shorter = np.concatenate([[0.0], np.cumsum(rising)[:-1]])
    shares = (most - shorter) / np.arange(len(rising), 0, -1)
    return float(shares[np.argmax(rising > shares)]) if (rising > shares).any() else math.inf


def _shortened(parts: list[Flight], number: int, share: float, history: int) -> list[Flight]:
    """Of the `number`-th flight, whole or cut to stretches before, what its share allows; a smaller share is a part of a larger one."""
    whole = parts[0].lead == 0
    if whole and parts[0].duration <= share:
        return parts
    left = max(1, int(share / (UNIT * parts[0].period)))
    chosen = []
    for part, start, units in _stretches(parts[0], number, history) if whole else [(part, part.lead, _units(part)) for part in parts]:
        if left > 0:
            chosen.append(_stretch(part, start, min(units, left)))
            left -= units
    return chosen or parts


def _units(stretch: Flight) -> int:
    return (len(stretch) - stretch.lead) // UNIT


def _stretches(flight: Flight, number: int, history: int) -> list[tuple[Flight, int, int]]:
    """Stretches of `BLOCK` that a flight can be cut to: each with its first window's row and its units, in the order of taking them."""
    # Windows start where they would in the whole flight, whatever its windows' distance is.
    first = SHORTEST_HISTORY + UNIT * max(0, math.ceil((history - SHORTEST_HISTORY) / UNIT))
    each = max(1, round(BLOCK / (UNIT * flight.period)))
    units = max(0, len(flight) - first - 1) // UNIT
    places = np.random.default_rng(number).permutation(-(-units // each)) * each
    return [(flight, first + UNIT * int(place), min(each, units - int(place))) for place in places]


def _stretch(flight: Flight, start: int, units: int) -> Flight:
    """Some units of a flight from a row on, with the rows before it; copied, so that the rest can be forgotten."""
    lead = ...
