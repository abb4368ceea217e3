"""Requests of `simulator.py` and `gpu.py`, and answers to them: one JSON object a line."""

import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

Prepared = tuple[Callable[[], Any], int]
"""A call that simulates, and the steps that it counts for."""


def rate(call: Callable[[], Any], steps: int, seconds: float) -> float:
    """Steps a second over at least so many seconds."""
    calls, start = 0, time.perf_counter()
    while (now := time.perf_counter() - start) < seconds or calls == 0:
        call()
        calls += 1
    return calls * steps / now


def serve(prepare: Callable[[str, int, str], Prepared | None]) -> None:
    """Answers `{"series", "batch", "layout", "seconds"}` until there are no more.

    With a rate, `null` where the layout does not fit, and the peak memory of the process.

    What was prepared for another batch is forgotten, and what others print goes to the standard
    error.
    """
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    prepared: dict[tuple[str, int, str], Prepared | None] = {}
    for line in sys.stdin:
        question = json.loads(line)
        name = question["series"], question["batch"], question["layout"]
        if name not in prepared:
            prepared = {known: call for known, call in prepared.items() if known[:2] == name[:2]}
            prepared[name] = prepare(*name)
            warm(prepared[name])
        ready = prepared[name]
        answer = {"rate": rate(*ready, question["seconds"]) if ready else None, "peak": peak()}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def peak() -> int:
    """Most memory [bytes] that this process has held, where it has a GPU of the GPU's."""
    import jax

    of_device = jax.local_devices()[0].memory_stats()
    if of_device is None:
        return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return of_device["peak_bytes_in_use"]


def warm(prepared: Prepared | None) -> None:
    """Compiles and calls twice."""
    for _ in range(2 if prepared else 0):
        prepared[0]()  # type: ignore[index]


class Waiting:
    """A process that is asked and answers in turn."""

    def __init__(self, command: Sequence[Any], **how: Any) -> None:
        """Starts it; `how` as `subprocess.Popen` takes it."""
        self._process = subprocess.Popen(
            list(map(str, command)),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            **how,
        )

    def send(self, question: Any) -> None:
        """Asks without waiting."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(question) + "\n")
        self._process.stdin.flush()

    def answer(self) -> dict[str, Any]:
        """What it answers to the oldest question without an answer."""
        assert self._process.stdout is not None
        # A package may print while it is imported.
        line = next((line for line in self._process.stdout if line.startswith("{")), None)
        if line is None:
            raise RuntimeError(f"{self._process.args} ended; run it by hand to see why.")
        return json.loads(line)

    def ask(self, question: Any) -> dict[str, Any]:
        """Asks and waits."""
        self.send(question)
        return self.answer()

    def close(self) -> None:
        """Ends it."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()
