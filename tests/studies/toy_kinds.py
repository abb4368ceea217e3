"""Verbs that need no JAX; each run of one leaves a line in the file `ran`."""

import os
import signal
import time
from pathlib import Path
from typing import Any

from maidenflight.errors import InputError
from maidenflight.settings import number, setting, text, whole
from maidenflight.verb import Output, Progress, Result, Verb


class Toy(Verb):
    ran: str | None = setting(text("a file"), None)
    seconds: float = setting(number(0, 60), 0.0)

    def note(self, *words: object) -> None:
        if self.ran:
            with open(self.ran, "a") as file:
                file.write(" ".join(map(str, words)) + "\n")


class Square(Toy):
    output = Output("squared.txt", "")
    value: int = setting(whole(0, 10**6))

    def compute(self, output: Path, progress: Progress) -> Result:
        self.note("begun", self.value)
        time.sleep(self.seconds)
        output.write_text(str(self.value * self.value))
        self.note("ended", self.value)
        return Result(rows=[{"square": self.value * self.value, "third": self.value / 3}])


class Add(Toy):
    square: str = setting(text("a file"), producer="toy_kinds:Square")
    more: int = setting(whole(0, 10**6), 0)

    def compute(self, output: Path, progress: Progress) -> Result:
        time.sleep(self.seconds)
        found = int(Path(self.square).read_text()) + self.more
        self.note("added", found)
        return Result(rows=[{"sum": found, "word": "odd" if found % 2 else "even"}])


class Wrong(Toy):
    how: str = setting(text("an error"), "value")

    def compute(self, output: Path, progress: Progress) -> Result:
        self.note("tried")
        raise {"value": ValueError, "input": InputError}[self.how]("it went wrong")


class Killed(Toy):
    """Kills its process the first time."""

    def compute(self, output: Path, progress: Progress) -> Result:
        self.note("killed")
        if len(Path(str(self.ran)).read_text().splitlines()) < 2:
            os.kill(os.getpid(), signal.SIGKILL)
        return Result(rows=[{"survived": 1}])


another = 3


def entry(
    name: str,
    kind: str,
    settings: dict[str, Any] | None = None,
    grid: dict[str, Any] | None = None,
    **inputs: str,
) -> dict[str, Any]:
    """An entry of a study."""
    parts = {"settings": settings, "grid": grid, "inputs": inputs}
    return {"name": name, "kind": kind} | {part: one for part, one in parts.items() if one}


def study(
    count: int = 4, more: int = 2, seconds: float = 0.0, ran: str | None = None
) -> list[dict[str, Any]]:
    """Squares of numbers, and sums with each."""
    settings = {"seconds": seconds, **({} if ran is None else {"ran": ran})}
    values, numbers = {"first": 1, "count": count}, list(range(more))
    return [
        entry("squared", "toy_kinds:Square", settings, {"value": values}),
        entry("added", "toy_kinds:Add", settings, {"more": numbers}, square="squared"),
    ]
