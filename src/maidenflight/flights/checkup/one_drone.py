"""Tests of whether one drone flew: a load that changes, in a flight or between them, and copies.

Thrust per command, the specific force in g by the mean command, is the ratio of full thrust to
weight. It stays within 4 % over 4 s of a calm flight, and steps where a load is taken up or lost.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, UInt64

from maidenflight.errors import first_few
from maidenflight.flights.checkup.in_flight import BLOCK_S, thrust_per_command
from maidenflight.flights.checkup.result import PASSES, WARNS, CheckResult, LogWarning, unknown
from maidenflight.flights.log import Flight

NAME = "one drone"
STEP = 0.07
"""Step of thrust per command, as a share, that a calm flight does not have."""
CERTAIN = 5.0
"""Standard errors that it must be."""
UNSTEADY = 0.1
"""Standard deviation of thrust per command, as a share, above which a flight is not calm."""
BETWEEN = 0.12
"""Difference of thrust per command between logs, as a share, that one drone does not have."""
COPIED = 0.1
"""Share of rows that a flight may have in common with another one."""
_BLOCKS = 8
_GRID = 1e-3
"""Steps of body rates and commands by which rows are compared [rad/s, -]."""


def check_load(pieces: Sequence[Flight]) -> CheckResult:
    """Checks that thrust per command does not step within pieces of one flight."""
    ratio = thrust_per_command(pieces)
    if len(ratio) < 2 * _BLOCKS + 4:
        return unknown(NAME, f"shorter than {(2 * _BLOCKS + 4) * BLOCK_S:g} s")
    steps = [
        (float(np.median(after) - np.median(before)), _error(before, after), index)
        for index in range(_BLOCKS, len(ratio) - _BLOCKS)
        for before, after in [(ratio[index - _BLOCKS : index], ratio[index : index + _BLOCKS])]
    ]
    step, error, index = max(steps, key=lambda change: abs(change[0]))
    flat = np.concatenate([ratio[:index], ratio[index:] - step])
    if 1.4826 * float(np.median(np.abs(flat - np.median(flat)))) > UNSTEADY:
        return unknown(NAME, "too lively a flight to show a change of load", step)
    threshold = f"-{STEP:g} .. {STEP:g}"
    if abs(step) < STEP or abs(step) < CERTAIN * error:
        text = f"thrust per command stays within {100 * abs(step):.1f} %"
        return CheckResult(NAME, PASSES, text, step, threshold)
    if abs(step) - error < STEP:
        text = f"thrust per command changes by {100 * abs(step):.1f} % +- {100 * error:.1f} %"
        return unknown(NAME, f"{text}, too little to tell it from {100 * STEP:g} %", step)
    change = (
        f"thrust per command changes by {100 * np.expm1(step):+.0f} % after {index * BLOCK_S:.0f} s"
    )
    volts = np.concatenate([piece.battery for piece in pieces])
    if np.isfinite(volts).any():
        sentence = f"{change}: a load was taken up or lost, or a propeller or battery gave way."
        remedy = "Cut the log there: it is of two drones."
    else:
        sentence = (
            f"{change}: it may be the battery, whose voltage is not logged, or a load or propeller."
        )
        remedy = (
            "Log the battery's voltage, which tells; only if the load or a propeller changed, cut "
            "the log there."
        )
    return CheckResult(NAME, WARNS, sentence, step, threshold, remedy)


def _error(before: Float[np.ndarray, "B"], after: Float[np.ndarray, "B"]) -> float:
    """Estimates the standard error of the difference of two medians."""
    left = np.concatenate([before - np.median(before), after - np.median(after)])
    deviation = 1.4826 * float(np.median(np.abs(left)))
    return 1.25 * deviation * float(np.sqrt(2 / len(before))) + 0.002


def compare_loads(ratios: Mapping[str, float]) -> list[LogWarning]:
    """Says which logs are of another load than others, by thrust per command.

    Args:
        ratios: full thrust by weight of each log in calm flight.
    """
    if len(ratios) < 2:
        return []
    names = sorted(ratios, key=lambda name: ratios[name])
    values = np.log([ratios[name] for name in names])
    cut = int(np.argmax(np.diff(values))) + 1
    low, high = np.exp(values[:cut].mean()), np.exp(values[cut:].mean())
    within = max(float(np.ptp(values[:cut])), float(np.ptp(values[cut:])))
    gap = float(values[cut] - values[cut - 1])
    if gap < BETWEEN or gap < within:
        return []
    cause = (
        f"flights of two drones or loads: full thrust is {low:.2f} times the weight in "
        f"{first_few(names[:cut])}, and {high:.2f} times in {first_few(names[cut:])}."
    )
    expected = f"within {100 * BETWEEN:.0f} %"
    return [LogWarning(NAME, "", cause, "Identify each by itself.", gap, expected)]


def row_keys(flights: Sequence[Flight]) -> UInt64[np.ndarray, "N"]:
    """Returns a number for each different row, by body rates and commands alone.

    Copies that are shifted, cut, thinned or have another position share them.
    """
    rows = [np.concatenate([flight.body_rates, flight.command], axis=1) for flight in flights]
    grid = np.round(np.nan_to_num(np.concatenate(rows)) / _GRID).astype(np.int64).astype(np.uint64)
    odd = np.random.default_rng(0).integers(1, 2**63, grid.shape[1], dtype=np.uint64) | np.uint64(1)
    with np.errstate(over="ignore"):
        mixed = (grid * odd).sum(axis=1, dtype=np.uint64)
        mixed = (mixed ^ (mixed >> np.uint64(29))) * odd[0]
    return np.unique(mixed)


def find_copy(
    keys: UInt64[np.ndarray, "N"], others: Mapping[str, UInt64[np.ndarray, "M"]]
) -> str | None:
    """Finds another flight that has the same rows, by its name."""
    for name, other in others.items():
        if min(len(keys), len(other)) < 20:
            if len(keys) == len(other) and np.array_equal(keys, other):
                return name
            continue
        shared = len(np.intersect1d(keys, other, assume_unique=True))
        if shared > COPIED * min(len(keys), len(other)):
            return name
    return None
