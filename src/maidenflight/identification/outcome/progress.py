"""How far an identification is, with the reading of its flights, for whoever waits for it."""

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
READING = "reading flights"
SHARES = {
    READING: 1.0,
    MOTOR_LAG: 4.0,
    EXPECTING: 2.0,
    CHOICE: 8.0,
    FITTING: 5.0,
    INTERVALS: 2.0,
}
"""How long each stage takes beside the others, measured on four minutes of flight with an
accelerometer: moves the progress bar alone."""
_COUNTED = {MOTOR_LAG: "flights", CHOICE: "groups"}


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
        return [
            name for name, interval in (self.expected or {}).items() if not interval.identifiable
        ]


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


class Overall:
    """The share of an identification that is done, which never falls."""

    def __init__(self) -> None:
        self._reached = 0.0

    def read(self, done: int, of: int) -> tuple[float, str]:
        """Returns the share, and in words how many files are read."""
        return self._reach(READING, done, of), f"{READING}, {done} of {of}"

    def reach(self, now: Progress) -> tuple[float, str]:
        """Returns the share, and the stage in words."""
        return self._reach(now.stage, now.done, now.of), describe(now)

    def _reach(self, stage: str, done: int, of: int) -> float:
        before = sum(SHARES[name] for name in list(SHARES)[: list(SHARES).index(stage)])
        within = SHARES[stage] * min(done / of, 1.0) if of else 0.0
        self._reached = max(self._reached, (before + within) / sum(SHARES.values()))
        return self._reached


def describe(now: Progress) -> str:
    """Returns a stage of an identification in words."""
    parts = [now.stage]
    if now.of and now.stage in _COUNTED:
        parts.append(f"{now.done} of {now.of} {_COUNTED[now.stage]}")
    if now.gain is not None:
        parts.append(f"{now.gain.group} {'kept' if now.gain.is_in_model else 'not kept'}")
    if now.evaluations:
        parts.append(f"evaluation {now.evaluations}")
    return ", ".join(parts)
