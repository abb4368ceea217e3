"""`CheckResult`, what one test of the check-up concludes."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

PASSES, WARNS, FAILS, UNKNOWN = "passes", "warns", "fails", "cannot tell"
"""Verdicts. Logs that fail are refused; a warning is a note."""


@dataclass(frozen=True)
class CheckResult:
    """What one test concludes."""

    name: str
    """Of the test."""
    verdict: str
    """`PASSES`, `WARNS`, `FAILS` or `UNKNOWN`."""
    sentence: str
    """What was measured; of a fault what it is and how it is mended."""
    statistic: float | None = None
    """The number that decides; None where there is none."""
    threshold: str = ""
    """Where it has to lie."""


def unknown(name: str, reason: str, statistic: float | None = None) -> CheckResult:
    """Returns the result of a test that cannot tell, and why."""
    return CheckResult(name, UNKNOWN, reason, statistic)


def sentences(results: Iterable[CheckResult], verdict: str) -> list[str]:
    """Returns what the tests of one verdict say."""
    return [one.sentence for one in results if one.verdict == verdict]


def typical_results(parts: Sequence[tuple[CheckResult, ...]]) -> tuple[CheckResult, ...]:
    """Concludes what parts of one flight say together: of each test the median verdict.

    Parts in which a test cannot tell do not count, unless all are such.
    """
    if len(parts) == 1:
        return parts[0]
    tests: dict[str, list[CheckResult]] = {}
    for one in (result for results in parts for result in results):
        tests.setdefault(one.name, []).append(one)
    certain = {
        name: [one for one in results if one.verdict != UNKNOWN] or results
        for name, results in tests.items()
    }
    order = (PASSES, WARNS, FAILS, UNKNOWN)
    return tuple(
        sorted(results, key=lambda one: order.index(one.verdict))[len(results) // 2]
        for results in certain.values()
    )
