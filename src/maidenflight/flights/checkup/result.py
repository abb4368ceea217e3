"""`CheckResult`, what one test of the check-up concludes, and `LogWarning`, what becomes of it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from maidenflight.inputs import Fields

PASSES, WARNS, FAILS, UNKNOWN = "passes", "warns", "fails", "cannot tell"
"""Verdicts. Logs that fail are refused; a warning is a note."""
MOST_LINES = 10
"""Lines of warnings that people are shown of one input; chosen to fit a screen."""


@dataclass(frozen=True)
class CheckResult:
    """What one test concludes."""

    name: str
    """Of the test."""
    verdict: str
    """`PASSES`, `WARNS`, `FAILS` or `UNKNOWN`."""
    cause: str
    """What was measured; of a fault what it is."""
    statistic: float | None = None
    """The number that decides; None where there is none."""
    threshold: str = ""
    """Where it has to lie."""
    remedy: str = ""
    """How a fault is mended: sentences."""

    @property
    def is_failure(self) -> bool:
        """Whether logs are refused for it."""
        return self.verdict == FAILS

    @property
    def sentence(self) -> str:
        """Cause and remedy."""
        return f"{self.cause} {self.remedy}".rstrip()


@dataclass(frozen=True)
class LogWarning:
    """What makes flights doubtful; terminal, JSON, drone file and report show the same ones."""

    kind: str
    """Name of the test, or the stage that found it."""
    file: str
    """Name of the log; empty where it concerns several."""
    cause: str
    """What is wrong, a sentence."""
    remedy: str = ""
    """What to do, sentences."""
    measured: float | None = None
    """The number that decides; None where there is none."""
    expected: str = ""
    """Where it has to lie."""
    sure: bool = False
    """Whether logs are refused for it."""

    def __str__(self) -> str:
        return f"{self.file}: {self.cause} {self.remedy}".removeprefix(": ").rstrip()


def read_warning(table: Fields) -> LogWarning:
    """Reads a warning from a result file.

    Raises:
        InputError: an entry is missing, unknown or of the wrong kind.
    """
    result = LogWarning(
        kind=table.text("kind"),
        file=table.text("file"),
        cause=table.text("cause"),
        remedy=table.text("remedy"),
        measured=table.number("measured") if "measured" in table.content else None,
        expected=table.text("expected"),
        sure=table.flag("sure"),
    )
    table.end()
    return result


def unknown(name: str, reason: str, statistic: float | None = None) -> CheckResult:
    """Returns the result of a test that cannot tell, and why."""
    return CheckResult(name, UNKNOWN, reason, statistic)


def warnings_of(
    checks: Mapping[str, Iterable[CheckResult]], verdicts: Sequence[str] = (FAILS, WARNS)
) -> list[LogWarning]:
    """Returns what is wrong with logs, the surest first.

    Args:
        checks: the check-up of each log, by its name.
        verdicts: those to look at.
    """
    return [
        LogWarning(
            *(result.name, name, result.cause, result.remedy),
            *(result.statistic, result.threshold, verdict == FAILS),
        )
        for verdict in verdicts
        for name, results in checks.items()
        for result in results
        if result.verdict == verdict
    ]


def warning_lines(warnings: Sequence[LogWarning], marks: tuple[str, str] = ("", "")) -> list[str]:
    """Returns a line for each kind of warning, `MOST_LINES` at most.

    Args:
        warnings: the surest first.
        marks: what lines begin with, of sure ones and others.
    """
    kinds: dict[str, list[LogWarning]] = {}
    for warning in warnings:
        # What a stage says of all logs is of many kinds.
        kinds.setdefault(warning.kind if warning.file else str(warning), []).append(warning)
    lines = [
        f"{marks[not first.sure]}{first}"
        + (f" (And {len(others)} more log{'s' * (len(others) > 1)}.)" if others else "")
        for first, *others in kinds.values()
    ]
    more = len(lines) - MOST_LINES + 1
    return lines if more <= 1 else [*lines[: MOST_LINES - 1], f"and {more} more; --json lists them"]


def typical_results(parts: Sequence[tuple[CheckResult, ...]]) -> tuple[CheckResult, ...]:
    """Concludes what parts of one flight say together: of each test the median verdict.

    Parts in which a test cannot tell do not count, unless all are such.
    """
    if len(parts) == 1:
        return parts[0]
    tests: dict[str, list[CheckResult]] = {}
    for result in (result for results in parts for result in results):
        tests.setdefault(result.name, []).append(result)
    certain = {
        name: [result for result in results if result.verdict != UNKNOWN] or results
        for name, results in tests.items()
    }
    order = (PASSES, WARNS, FAILS, UNKNOWN)
    return tuple(
        sorted(results, key=lambda result: order.index(result.verdict))[len(results) // 2]
        for results in certain.values()
    )
