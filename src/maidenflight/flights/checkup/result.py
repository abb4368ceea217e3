"""`CheckResult`, what one test of the check-up concludes."""

from collections.abc import Iterable
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
