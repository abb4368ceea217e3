"""Processes of benchmarks that answer one JSON object a line, as `serving.serve` does."""

import json
import subprocess
from collections.abc import Sequence
from typing import Any


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
