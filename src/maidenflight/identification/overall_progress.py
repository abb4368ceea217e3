"""How far all of an identification is, with the reading of its flights, and what it does."""

from maidenflight.identification.outcome.progress import (
    CHOICE,
    EXPECTING,
    FITTING,
    INTERVALS,
    MOTOR_LAG,
    Progress,
)

READING = "reading flights"
SHARES = {
    READING: 1.0,
    MOTOR_LAG: 4.0,
    EXPECTING: 2.0,
    CHOICE: 8.0,
    FITTING: 5.0,
    INTERVALS: 2.0,
}
"""How long each stage takes beside the others: four minutes of flight with an accelerometer."""
_COUNTED = {MOTOR_LAG: "flights", CHOICE: "groups"}


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
