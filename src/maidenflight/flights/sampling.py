"""A sample of more flight than can be held: stretches of every flight, as much of it as asked for.

Each flight gives up to the same number of seconds, so that no long one drowns the others.
"""

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from maidenflight.flights.log import Flight
from maidenflight.flights.windows import BLOCK, HISTORY, SHORTEST_HISTORY

UNIT = 100
"""Rows by which stretches grow: those of a window of the likelihood, so that a stretch wastes
none."""
_SLACK = 1.25
"""Times the flight asked for that is held while more is read, so that not every new flight makes
all others be cut anew."""


def sampled(
    flights: Iterable[Flight], most: float, history: int = HISTORY
) -> tuple[list[Flight], float]:
    """Keeps all flights if they last no longer than asked for together, else stretches of those
    that last longer than their share.

    Stretches lie at random places, always the same ones, and carry the rows before them that their
    windows need; those are windows that would be cut from the whole flight, too. However many
    flights there are, each gives `UNIT` rows.

    Args:
        flights: checked flights, of which one at a time need be in memory beside those that are
            kept.
        most: what to keep, all flights together [s]; a stretch may bring a row more.
        history: rows of commands before a window.

    Returns:
        What is kept, in the order of the flights, and how long all flights last together [s].
    """
    kept: list[list[Flight]] = []
    durations: list[float] = []
    share, held, limit = math.inf, 0.0, _SLACK * most
    for flight in flights:
        durations.append(flight.duration)
        kept.append(_shortened([flight], len(kept), share, history))
        held += _duration(kept[-1])
        if held > limit:
            # What was cut by a larger share is cut further: the share only falls as flights come
            # in.
            share = _share(np.array(durations), most)
            kept = [_shortened(parts, number, share, history) for number, parts in enumerate(kept)]
            held = sum(map(_duration, kept))
            limit = _SLACK * max(most, held)
    share = _share(np.array(durations), most)
    return [
        part
        for number, parts in enumerate(kept)
        for part in _shortened(parts, number, share, history)
    ], sum(durations)


def _duration(parts: list[Flight]) -> float:
    return sum(part.duration for part in parts)


def _share(durations: Float[np.ndarray, "N"], most: float) -> float:
    """The longest that each flight may last for all to last `most` together.

    Infinite where all may be kept.
    """
    if durations.sum() <= most:
        return math.inf
    rising = np.sort(durations)
    shares = (most - np.concatenate([[0.0], np.cumsum(rising)[:-1]])) / np.arange(
        len(rising), 0, -1
    )
    return float(shares[np.argmax(rising > shares)])


def _shortened(parts: list[Flight], number: int, share: float, history: int) -> list[Flight]:
    """What its share leaves of the `number`-th flight, whole or cut to stretches by a larger share
    before: the first ones of those.
    """
    if share == math.inf:
        return parts
    uncut = parts[0].lead == 0
    if uncut and _duration(parts) <= share:
        return [_copied(parts[0], 0, len(parts[0]), 0)]
    places = (
        _places(parts[0], number, history)
        if uncut
        else [(part, part.lead, (len(part) - part.lead) // UNIT) for part in parts]
    )
    left = max(1, int(share / (UNIT * parts[0].period)))
    cut = []
    for flight, start, units in places:
        if left > 0:
            lead = max(history, SHORTEST_HISTORY)
            cut.append(_copied(flight, start - lead, start + UNIT * min(units, left) + 1, lead))
            left -= units
    # A flight too short for a stretch and its history is kept as it is.
    return cut or [_copied(parts[0], 0, len(parts[0]), 0)]


def _places(flight: Flight, number: int, history: int) -> list[tuple[Flight, int, int]]:
    """Where stretches of `BLOCK` lie in a flight, in the order in which they are taken: row of the
    first window, and units.
    """
    # Windows start where they do in the whole flight.
    first = SHORTEST_HISTORY + UNIT * max(0, math.ceil((history - SHORTEST_HISTORY) / UNIT))
    units = max(0, len(flight) - first - 1) // UNIT
    each = max(1, round(BLOCK / (UNIT * flight.period)))
    begins = each * np.random.default_rng(number).permutation(math.ceil(units / each))
    return [(flight, first + UNIT * int(begin), min(each, units - int(begin))) for begin in begins]


def _copied(flight: Flight, start: int, stop: int, lead: int) -> Flight:
    """Some rows of a flight, apart from the others, which can be forgotten then."""
    arrays = {group: values[start:stop].copy() for group, values in flight.arrays.items()}
    return replace(flight, lead=lead, **arrays)
