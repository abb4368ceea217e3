"""Tests of single columns: two motors that are logged alike, a sensor that froze, a dead battery.

None of 142 sound logs of ten sources has two motors alike in more than 76 % of its rows, a body
rate or force that stands still for 0.15 s, or a voltage that never changes.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from maidenflight.flights.checkup.result import FAILS, PASSES, WARNS, CheckResult, LogWarning
from maidenflight.flights.log import GROUPS, OPTIONAL, Flight

NAME, BATTERY = "columns", "battery"
_ALIKE = 0.95
"""Share of rows in which two motors must be equal to be one motor logged twice; measured, 0.76 in
a sound log."""
_LONGEST_S = {"body_rates": 0.3, "accelerometer": 0.3, "attitude": 1.0, "velocity": 1.0}
"""Times for which a column may stand still [s]; measured, 0.15 s of gyros, 0.3 s of estimates."""
_WORST, _MOST = 0.02, 0.9
"""Share of the rows from which a log is refused for a column that stands still, and from which it
was not measured at all; chosen."""
_BATTERY_S = 60.0
"""Flight in which any battery's voltage changes [s]; chosen."""


def check_columns(pieces: Sequence[Flight]) -> list[CheckResult]:
    """Checks the columns of pieces of one flight, each by itself."""
    seconds = sum(piece.duration for piece in pieces)
    for fault in (_find_equal(pieces), _find_frozen(pieces, seconds)):
        if fault is not None:
            return [fault]
    return [CheckResult(NAME, PASSES, "no two motors are alike, and no sensor stands still")]


def _find_equal(pieces: Sequence[Flight]) -> CheckResult | None:
    command = np.concatenate([piece.command for piece in pieces])
    for first, second in combinations(range(command.shape[1]), 2):
        one = command[:, first]
        # Motors at their limits are alike in any flight.
        free = (one > one.min()) & (one < one.max())
        share = float((one == command[:, second])[free].mean()) if free.any() else 0.0
        if share > _ALIKE:
            names = f"command_{first + 1} and command_{second + 1}"
            cause = f"{names} are equal in {share:.0%} of the rows: one motor was logged twice."
            remedy = "Log four motors, front right, back right, back left, front left."
            return CheckResult(NAME, FAILS, cause, share, f"below {_ALIKE:.0%}", remedy)
    return None


def _find_frozen(pieces: Sequence[Flight], seconds: float) -> CheckResult | None:
    for group, longest in _LONGEST_S.items():
        if pieces[0].arrays.get(group) is None:
            continue
        for axis, name in enumerate((GROUPS | OPTIONAL)[group]):
            still, worst, at = 0.0, 0.0, 0.0
            before = 0.0
            for piece in pieces:
                for start, rows in _runs(np.asarray(getattr(piece, group))[:, axis]):
                    time = rows * piece.period
                    still += time if time > longest else 0.0
                    if time > worst:
                        worst, at = time, before + start * piece.period
                before += piece.duration
            if 0 < still < _MOST * seconds:
                cause = (
                    f"{name} stands still for {worst:.1f} s from {at:.1f} s of flight on, and for "
                    f"{still / seconds:.0%} of it in all: sensor or logger stopped."
                )
                verdict = FAILS if still > _WORST * seconds else WARNS
                remedy = "Cut these rows out of the log."
                return CheckResult(NAME, verdict, cause, worst, f"below {longest:g} s", remedy)
    return None


def _runs(values: np.ndarray) -> list[tuple[int, int]]:
    """Returns start and number of steps of each stretch in which nothing changes."""
    same = np.concatenate([[0], (np.diff(values) == 0).astype(int), [0]])
    edges = np.flatnonzero(np.diff(same))
    return list(zip(edges[::2].tolist(), (edges[1::2] - edges[::2]).tolist(), strict=True))


def check_battery(flights: Sequence[Flight]) -> list[LogWarning]:
    """Checks that the voltage changes over flights of one drone, however many."""
    seconds = sum(flight.duration for flight in flights)
    volts = np.concatenate([flight.battery for flight in flights])
    is_simulated = any(flight.simulated for flight in flights)
    if seconds < _BATTERY_S or is_simulated or not np.isfinite(volts).all() or np.ptp(volts) > 0:
        return []
    cause = (
        f"the battery reads {volts[0]:.2f} V in every row of {seconds:.0f} s of flight, which none "
        "does: it was not measured, and is passed over. A thrust that falls with it counts as the "
        "drone's."
    )
    return [LogWarning(BATTERY, "", cause, "Log the voltage while it flies.", 0.0, "a change")]
