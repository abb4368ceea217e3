"""How far a study is: what its driver writes, and what `--status` reads in another terminal."""

import dataclasses
import json
import time
from dataclasses import dataclass
from typing import Any

from maidenflight import inputs
from maidenflight.errors import InputError
from maidenflight.studies.store import Store
from maidenflight.studies.study import Study

PROGRESS = "progress.json"
"""Beside the results; the driver writes it while it runs."""
NAMED = 50
"""Running tasks that are named there at most."""
SILENT_S = 60.0
"""A driver that has written nothing for so long is gone [s]."""


@dataclass(frozen=True)
class Progress:
    """How far a run of a study is."""

    tasks: int
    """Of the study; equal ones, which are computed once, count once."""
    existing_count: int = 0
    """Results that were there when it began."""
    computed: int = 0
    running: tuple[str, ...] = ()
    """Tasks that are with the engine, which may still wait there; read again, the first `NAMED`."""
    failed: tuple[str, ...] = ()
    """Tasks that failed as often as they may."""
    repeated: int = 0
    """Tasks begun again, since they failed or were lost."""
    seconds: float = 0.0
    """Since the run began [s]."""
    policies_per_hour: float | None = None
    """That the run trained; None where it has trained none yet."""
    seconds_left: float | None = None
    """As if what is left takes as long as what was computed [s]; None before there is any."""
    on: str = ""
    """The engine."""
    state: str = "running"
    """`running`, `interrupted`, `ended`, or, where nobody writes it any more, `silent`."""

    @property
    def done(self) -> int:
        """Tasks whose result is there."""
        return self.existing_count + self.computed

    def describe(self) -> str:
        """Returns how far it is, in a line."""
        parts = [f"{self.done} of {self.tasks} tasks", f"{len(self.running)} running"]
        parts += [f"{len(self.failed)} failed"] if self.failed else []
        rate = self.policies_per_hour
        parts += [f"{rate:.0f} policies/h"] if rate else []
        parts += [f"{clock(self.seconds_left)} left"] if self.seconds_left else []
        return ", ".join(parts)


def clock(seconds: float | None) -> str:
    """Returns a time in hours, minutes and seconds."""
    if seconds is None:
        return "unknown"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"


def write_status(store: Store, now: Progress) -> None:
    """Writes how far a run is, for `read`."""
    content = dataclasses.asdict(now) | {"written": time.time()}
    store.write(PROGRESS, f"{json.dumps(content, indent=1)}\n")


def read_status(store: Store, study: Study) -> Progress:
    """Returns how far a study is, by its results and by what its driver wrote last.

    Raises:
        InputError: what the driver wrote is no such thing.
    """
    keys = {task.key for task in study.tasks}
    there = len(keys & store.keys())
    text = store.read(PROGRESS)
    if text is None:
        return Progress(len(keys), existing_count=there, state="not begun")
    try:
        content: dict[str, Any] = inputs.from_json(text)
        written = float(content.pop("written"))
        status = Progress(**content)
        status = dataclasses.replace(
            status, running=tuple(status.running), failed=tuple(status.failed)
        )
    except (ValueError, LookupError, TypeError) as error:
        raise InputError(
            f"{PROGRESS}: not what a study writes ({error}). Remove it from the study's results."
        ) from error
    if status.state == "running" and time.time() - written > SILENT_S:
        status = dataclasses.replace(status, state="silent", running=())
    return dataclasses.replace(
        status,
        tasks=len(keys),
        existing_count=max(0, there - status.computed),
        seconds=round(status.seconds, 1),
    )
