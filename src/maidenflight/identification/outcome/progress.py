"""How far an identification is, for whoever waits for it."""

from collections.abc import Callable, Mapping
from itertools import count
from typing import NamedTuple

from maidenflight.identification.drone_file import GroupGain
from maidenflight.identification.outcome.plausible import ExpectedInterval

MOTOR_LAG, EXPECTING = "motor lag", "what flights determine"
CHOICE, FITTING, INTERVALS = "choosing parameters", "fitting", "intervals"
STAGES = (MOTOR_LAG, EXPECTING, CHOICE, FITTING, INTERVALS)
"""Stages of an identification, in order. Not every one has all, and the last three come again where
intervals are wider than what is plausible."""


class Progress(NamedTuple):
    """How far an identification is."""

    stage: str
    """Of `STAGES`."""
    done: int
    """Flights, groups of parameters, fits or evaluations done in this stage."""
    of: int
    """How many there are; 0 where that is not known."""
    evaluations: int
    """Evaluations of the objective so far."""
    expected: Mapping[str, ExpectedInterval] | None = None
    """What the flights can tell, just found; see `identify.expected_intervals`."""
    gain: GroupGain | None = None
    """Of the group of parameters that was tried last, while others are."""

    @property
    def unidentifiable(self) -> list[str]:
        """Returns the parameters of `expected` that the flights do not determine."""
        return [name for name, one in (self.expected or {}).items() if not one.identifiable]


class Reporter:
    """Tells a listener how far an identification is."""

    def __init__(self, listener: Callable[[Progress], None] | None) -> None:
        """Begins at the fit.

        Args:
            listener: called after each change.
        """
        self._listener = listener
        self._now = Progress(FITTING, 0, 0, 0)

    def stage(self, stage: str, done: int, of: int, gain: GroupGain | None = None) -> None:
        """Tells where the identification is."""
        self._tell(self._now._replace(stage=stage, done=done, of=of, expected=None, gain=gain))

    def choosing(self, of: int) -> Callable[[GroupGain], None]:
        """Tells that the choice among groups of parameters begins.

        Args:
            of: how many groups are tried.

        Returns:
            What tells of each group that was tried, by its gain.
        """
        tried = count(1)
        self.stage(CHOICE, 0, of)
        return lambda gain: self.stage(CHOICE, next(tried), of, gain)

    def expected(self, expectations: Mapping[str, ExpectedInterval]) -> None:
        """Tells what the flights can tell."""
        self._tell(
            self._now._replace(stage=EXPECTING, done=1, of=1, expected=expectations, gain=None)
        )

    def evaluated(self, planned: int = 0) -> None:
        """Counts an evaluation of the objective, of so many planned where that is known."""
        so_far = self._now.evaluations + 1
        now = self._now._replace(evaluations=so_far, expected=None)
        self._tell(now._replace(done=so_far, of=planned) if planned else now)

    def _tell(self, now: Progress) -> None:
        self._now = now
        if self._listener is not None:
            self._listener(now)
