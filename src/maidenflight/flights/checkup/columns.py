"""Tests of single columns: two motors that are logged alike, a sensor that froze, a dead battery.

None of 142 sound logs of ten sources has two motors alike in more than 76 % of its rows, a body
rate or force that stands still for 0.15 s, or a voltage that never changes.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from jaxtyping import Float

from maidenflight.flights.checkup.result import (
    FAILS,
    PASSES,
    WARNS,
    CheckResult,
    LogWarning,
    unknown,
)
from maidenflight.flights.log import GROUPS, OPTIONAL, Flight

NAME, BATTERY, BALANCE = "columns", "battery", "motor balance"
PLACES = ("front right", "back right", "back left", "front left")
_ALIKE = 0.95
"""Share of rows in which two motors must be equal to be one motor logged twice; measured, 0.76 in
a sound log."""
_LONGEST_S = {"body_rates": 0.3, "accelerometer": 0.3, "attitude": 1.0, "velocity": 1.0}
"""Times for which all columns of a sensor may stand still [s]; measured, 0.15 s of gyros and 0.3 s
of estimates."""
_WORST, _MOST = 0.02, 0.9
"""Share of the rows from which a log is refused for a column that stands still, and from which it
was not measured at all; chosen."""
_WEAK, _AGREE, _BALANCED_S = 0.3, 0.4, 5.0
"""What a weak motor takes more than the others, how well these agree as a share of it, and the
flight that shows it [s]; measured, sound logs have 0.22 where others agree so."""
_BATTERY_S = 60.0
"""Flight in which any battery's voltage changes [s]; chosen."""


def check_columns(pieces: Sequence[Flight]) -> list[CheckResult]:
    """Checks the columns of pieces of one flight, each by itself."""
    seconds = sum(piece.duration for piece in pieces)
    for fault in (_find_equal(pieces), _find_frozen(pieces, seconds)):
        if fault is not None:
            return [fault]
    return [
        _check_balance(pieces, seconds),
        CheckResult(NAME, PASSES, "no two motors are alike, and no sensor stands still"),
    ]


def _check_balance(pieces: Sequence[Flight], seconds: float) -> CheckResult:
    """Checks that no motor takes far more than three others that agree: a weak one does."""
    mean = np.concatenate([piece.command for piece in pieces]).mean(axis=0, dtype=np.float64)
    worst = int(np.argmax(mean))
    others = np.delete(mean, worst)
    more = float(mean[worst] / max(float(others.mean()), 1e-9) - 1.0)
    spread = float(np.ptp(others) / max(float(others.mean()), 1e-9))
    text = f"command_{worst + 1} is {1 + more:.2f} times the mean of the others in the mean"
    threshold = f"below {1 + _WEAK:g}"
    if more < _WEAK:
        return CheckResult(BALANCE, PASSES, text, 1 + more, threshold)
    if spread > _AGREE * more or seconds < _BALANCED_S:
        return unknown(BALANCE, f"{text}, but these disagree, or fly too shortly", 1 + more)
    cause = (
        f"{text}, which agree within {spread:.0%}: the {PLACES[worst]} motor or its propeller "
        f"gives about {1 - 1 / (1 + more):.0%} less thrust."
    )
    remedy = "Look at motor, propeller and bearing; a drone identified from this has a trim."
    return CheckResult(BALANCE, WARNS, cause, 1 + more, threshold, remedy)


def _find_equal(pieces: Sequence[Flight]) -> CheckResult | None:
    command = np.concatenate([piece.command for piece in pieces])
    for first, second in combinations(range(command.shape[1]), 2):
        values = command[:, first]
        # Motors at their limits are alike in any flight.
        free = (values > values.min()) & (values < values.max())
        share = float((values == command[:, second])[free].mean()) if free.any() else 0.0
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
        still, worst, at, before = 0.0, 0.0, 0.0, 0.0
        for piece in pieces:
            for start, rows in _runs(np.asarray(getattr(piece, group))):
                time = rows * piece.period
                still += time if time > longest else 0.0
                if time > worst:
                    worst, at = time, before + start * piece.period
            before += piece.duration
        if 0 < still < _MOST * seconds:
            names = ", ".join((GROUPS | OPTIONAL)[group])
            cause = (
                f"{names} stand still for {worst:.1f} s from {at:.1f} s of flight on, and for "
                f"{still / seconds:.0%} of it in all: sensor or logger stopped."
            )
            verdict = FAILS if still > _WORST * seconds else WARNS
            remedy = "Cut these rows out of the log."
            return CheckResult(NAME, verdict, cause, worst, f"below {longest:g} s", remedy)
    return None


def _runs(values: Float[np.ndarray, "N 3"]) -> list[tuple[int, int]]:
    """Returns start and number of steps of each stretch in which nothing changes."""
    same = np.concatenate([[0], (np.diff(values, axis=0) == 0).all(axis=1).astype(int), [0]])
    edges = np.flatnonzero(np.diff(same))
    return list(zip(edges[::2].tolist(), (edges[1::2] - edges[::2]).tolist(), strict=True))


def check_one_motor(
    flights: Sequence[Flight], checks: Mapping[str, Sequence[CheckResult]]
) -> list[LogWarning]:
    """Names a motor that takes more than the others in several logs of one drone.

    Each of them may be too short to tell.

    Args:
        flights: of several logs, pieces of at least one of each.
        checks: what was found of each log.
    """
    results = [result for each in checks.values() for result in each if result.name == BALANCE]
    means = [flight.command.mean(axis=0, dtype=np.float64) for flight in flights]
    if len(results) < 2 or any(result.verdict == WARNS for result in results):
        return []
    result = _check_balance(flights, sum(flight.duration for flight in flights))
    if result.verdict != WARNS or len({int(np.argmax(mean)) for mean in means}) > 1:
        return []
    cause = f"in {len(results)} logs {result.cause}"
    return [LogWarning(BALANCE, "", cause, result.remedy, result.statistic, result.threshold)]


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
