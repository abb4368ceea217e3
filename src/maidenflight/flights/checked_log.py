"""`CheckedLog`, what a file holds and what its check-up says, whatever its length."""

from collections.abc import Collection, Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from maidenflight.flights.checks import checking
from maidenflight.flights.checkup import one_drone, rotor_speeds
from maidenflight.flights.checkup.checkup import check_up
from maidenflight.flights.checkup.result import (
    FAILS,
    WARNS,
    CheckResult,
    LogWarning,
    typical_results,
    warnings_of,
)
from maidenflight.flights.formats import Logged
from maidenflight.flights.log import Flight


class CheckedLog(NamedTuple):
    """What the check-up of a file says."""

    name: str
    parts: int
    pieces: list[Flight]
    """Of the first part."""
    notes: list[str]
    checks: dict[str, tuple[CheckResult, ...]]
    """By the flight's name."""
    faults: list[LogWarning]
    """Failures of the check-up, which logs are refused for."""
    keys: np.ndarray
    """What tells its rows apart; see `one_drone.row_keys`."""

    def without_wrong_speeds(self, piece: Flight) -> Flight:
        """Returns a piece without rotor speeds that contradict the motion."""
        wrong = any(
            result.verdict == WARNS and result.name == rotor_speeds.NAME
            for result in self.checks.get(piece.name, ())
        )
        return replace(piece, rotor_speed=None) if wrong else piece


def check_log(parts: Iterable[Logged], ignore: Collection[str] = ()) -> CheckedLog:
    """Cuts and checks the flights of a file, a part in memory at a time.

    Args:
        parts: what the file holds, one after another.
        ignore: signals to pass over.
    """
    first: list[Flight] = []
    notes: dict[str, None] = {}
    results: dict[str, list[tuple[CheckResult, ...]]] = {}
    keys = [np.zeros(0, np.uint64)]
    number, name = 0, ""
    for number, log in enumerate(parts, 1):
        name = log.name
        notes |= dict.fromkeys(log.notes)
        for flight, time in log.flights:
            pieces, dropped = cut(flight, time, ignore)
            notes |= dict.fromkeys(dropped)
            if pieces:
                keys.append(one_drone.row_keys(pieces))
            results.setdefault(flight.name, []).append(check_up(pieces) if pieces else ())
            first.extend(pieces if number == 1 else [])
    checks = {flight: typical_results(several) for flight, several in results.items()}
    return CheckedLog(
        *(name, number, first, [*notes], checks, warnings_of(checks, [FAILS])),
        keys[1] if len(keys) == 2 else np.unique(np.concatenate(keys)),
    )


def cut(
    flight: Flight, time: np.ndarray, ignore: Collection[str]
) -> tuple[list[Flight], list[str]]:
    """Cuts a flight into usable pieces, without the signals to pass over; see `checking.pieces`."""
    return checking.pieces(replace(flight, **dict.fromkeys(ignore)), time)
