"""`sampled`: segments of every flight, where there is more flight than is wanted in memory.

Each flight gives at most the same number of seconds, so that long ones do not dominate.
"""

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from maidenflight.flights.log import Flight
from maidenflight.flights.windows import LEAD_IN, SEGMENT_SECONDS, SHORTEST_LEAD_IN

UNIT = 100
"""Rows by which segments grow: those of a window of the likelihood, so that none are wasted."""
_SLACK = 1.25
"""Share of the wanted duration that stays while more is read, so that not every new flight makes
all others be cut again."""


def sampled(
    flights: Iterable[Flight], most: float, lead_in: int = LEAD_IN
) -> tuple[list[Flight], float]:
    """Keeps all flights if they are short enough together, else segments of the longer ones.

    Flights that last longer than an equal share are cut. Segments lie at random places that depend
    on the flight's number alone, and carry the rows before them that their windows need; their
    windows are among those of the whole flight. Each flight gives at least `UNIT` rows.

    Args:
        flights: checked flights, of which one at a time need be in memory beside those that are
            kept.
        most: what to keep, all flights together [s]; a segment may add a row.
        lead_in: rows of commands before a window.

    Returns:
        The choice, in the order of the flights, and how long all flights last together [s].
    """
    chosen_parts: list[list[Flight]] = []
    durations: list[float] = []
    share, seconds, limit = math.inf, 0.0, _SLACK * most
    for flight in flights:
        durations.append(flight.duration)
        chosen_parts.append(_shortened([flight], len(chosen_parts), share, lead_in))
        seconds += _duration(chosen_parts[-1])
        if seconds > limit:
            # What was cut by a larger share is cut further: the share only falls as flights come
            # in.
            share = _share(np.array(durations), most)
            # In place, so that what is cut is forgotten at once.
            for number, parts in enumerate(chosen_parts):
                chosen_parts[number] = _shortened(parts, number, share, lead_in)
            seconds = sum(map(_duration, chosen_parts))
            limit = _SLACK * max(most, seconds)
    share = _share(np.array(durations), most)
    for number, parts in enumerate(chosen_parts):
        chosen_parts[number] = _shortened(parts, number, share, lead_in)
    return [part for parts in chosen_parts for part in parts], sum(durations)


def _duration(parts: list[Flight]) -> float:
    return sum(part.duration for part in parts)


def _share(durations: Float[np.ndarray, "N"], most: float) -> float:
    """Longest duration of each for all to last `most`; infinite where all may stay whole [s]."""
    if durations.sum() <= most:
        return math.inf
    rising = np.sort(durations)
    shorter = np.concatenate([[0.0], np.cumsum(rising)[:-1]])
    shares = (most - shorter) / np.arange(len(rising), 0, -1)
    return float(shares[np.argmax(rising > shares)])


def _shortened(parts: list[Flight], number: int, share: float, lead_in: int) -> list[Flight]:
    """What its share leaves of the `number`-th flight, which a larger share may have cut."""
    if share == math.inf:
        return parts
    uncut = parts[0].lead == 0
    if uncut and _duration(parts) <= share:
        return [_copied(parts[0], 0, len(parts[0]), 0)]
    if uncut:
        places = _places(parts[0], number, lead_in)
    else:
        places = [(part, part.lead, (len(part) - part.lead) // UNIT) for part in parts]
    left = max(1, int(share / (UNIT * parts[0].period)))
    pieces = []
    for flight, start, units in places:
        if left > 0:
            lead = max(lead_in, SHORTEST_LEAD_IN)
            pieces.append(_copied(flight, start - lead, start + UNIT * min(units, left) + 1, lead))
            left -= units
    # A flight too short for a segment and its lead-in stays as it is.
    return pieces or [_copied(parts[0], 0, len(parts[0]), 0)]


def _places(flight: Flight, number: int, lead_in: int) -> list[tuple[Flight, int, int]]:
    """Returns segments of `SEGMENT_SECONDS` of a flight in the order in which they are taken.

    Each as the flight, the row of its first window, and its number of units.
    """
    # Windows start where they do in the whole flight.
    first = SHORTEST_LEAD_IN + UNIT * max(0, math.ceil((lead_in - SHORTEST_LEAD_IN) / UNIT))
    units = max(0, len(flight) - first - 1) // UNIT
    each = max(1, round(SEGMENT_SECONDS / (UNIT * flight.period)))
    begins = each * np.random.default_rng(number).permutation(math.ceil(units / each))
    return [(flight, first + UNIT * int(begin), min(each, units - int(begin))) for begin in begins]


def _copied(flight: Flight, start: int, stop: int, lead: int) -> Flight:
    """Some rows of a flight, apart from the others, which can be forgotten then."""
    arrays = {group: values[start:stop].copy() for group, values in flight.arrays.items()}
    return replace(flight, lead=lead, **arrays)
