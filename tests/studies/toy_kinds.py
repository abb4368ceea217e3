"""Kinds of task that need no JAX; each run of one leaves a line in the file `ran`."""

import os
import signal
import time
from pathlib import Path

from maidenflight.errors import InputError
from maidenflight.studies.kinds import Kind, Row, Work, number, optional, text, whole

_RAN = {"ran": optional(text("a file")), "seconds": number(0, 60, 0.0)}


def _note(work: Work, *words: object) -> None:
    if work.settings["ran"]:
        with open(work.settings["ran"], "a") as file:
            file.write(" ".join(map(str, words)) + "\n")


def _square(work: Work) -> list[Row]:
    value = work.settings["value"]
    _note(work, "begun", value)
    time.sleep(work.settings["seconds"])
    (work.folder / "squared.txt").write_text(str(value * value))
    _note(work, "ended", value)
    return [{"square": value * value, "third": value / 3}]


def _sum(work: Work) -> list[Row]:
    time.sleep(work.settings["seconds"])
    found = int(Path(work.settings["square"]).read_text()) + work.settings["more"]
    _note(work, "added", found)
    return [{"sum": found, "word": "odd" if found % 2 else "even"}]


def _wrong(work: Work) -> list[Row]:
    _note(work, "tried")
    raise {"value": ValueError, "input": InputError}[work.settings["how"]]("it went wrong")


def _killed(work: Work) -> list[Row]:
    """Kills its process the first time."""
    _note(work, "killed")
    if len(Path(work.settings["ran"]).read_text().splitlines()) < 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return [{"survived": 1}]


square = Kind(_square, {"value": whole(0, 10**6), **_RAN}, product="squared.txt")
add = Kind(
    _sum,
    {"square": text("a file"), "more": whole(0, 10**6, 0), **_RAN},
    takes={"square": "toy_kinds:square"},
)
wrong = Kind(_wrong, {"how": text("an error", "value"), **_RAN})
killed = Kind(_killed, dict(_RAN))
another = 3


def study(
    count: int = 4, more: int = 2, seconds: float = 0.0, ran: str | None = None
) -> list[dict[str, object]]:
    """Squares of numbers, and sums with each."""
    told = {} if ran is None else {"ran": ran}
    return [
        {
            "name": "squared",
            "kind": "toy_kinds:square",
            "settings": {"seconds": seconds, **told},
            "grid": {"value": {"first": 1, "count": count}},
        },
        {
            "name": "added",
            "kind": "toy_kinds:add",
            "settings": {"seconds": seconds, **told},
            "grid": {"more": list(range(more))},
            "inputs": {"square": "squared"},
        },
    ]
