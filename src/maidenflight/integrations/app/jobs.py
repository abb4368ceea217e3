"""Commands that run: each a process of the command line, which tells how far it is."""

import asyncio
import json
import os
import shlex
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from maidenflight import events
from maidenflight.cli.interruption import CODE


@dataclass
class Job:
    """A command that runs or has run."""

    verb: str
    words: Sequence[str]
    process: asyncio.subprocess.Process
    state: str = "running"
    """`running`, `stopping`, `done`, `failed` or `cancelled`."""
    began: float = field(default_factory=time.monotonic)
    seconds: float = 0.0
    done: int = 0
    total: int | None = None
    remark: str = "starting"
    line: str = ""
    notes: deque[str] = field(default_factory=lambda: deque(maxlen=200))
    summary: list[Any] = field(default_factory=list)
    """Texts and tables."""
    next: list[str] = field(default_factory=list)
    error: str = ""
    scores: list[dict[str, Any]] = field(default_factory=list)
    """Of policies in training, a row a policy and evaluation."""
    policy: str = ""
    """The first of them, as a file would hold it."""

    @property
    def running(self) -> bool:
        """Returns whether it has not ended."""
        return self.state in ("running", "stopping")

    @property
    def command(self) -> str:
        """Returns it as one types it."""
        words = [word for word in self.words if word != "--"]
        return shlex.join(["maidenflight", self.verb, *words])

    def interrupt(self) -> None:
        """Interrupts it as Ctrl-C does."""
        if self.state == "running":
            self.state = "stopping"
            with suppress(ProcessLookupError):
                self.process.send_signal(signal.SIGINT)

    def hear(self, text: str) -> None:
        """Takes in an event of the command, or what it printed otherwise."""
        try:
            event: Any = json.loads(text)
        except ValueError:
            event = {"line": text}
        if not isinstance(event, dict):
            return
        if "remark" in event:
            self.done, self.total = event["done"], event["total"]
        if "note" in event:
            self.notes.append(event["note"])
        for number, score in enumerate(event.get("scores", ()), 1):
            about = {"update": event["update"], "steps": event["steps"], "policy": number}
            self.scores.append(about | score)
        for name in ("remark", "line", "policy", "summary", "next"):
            setattr(self, name, event.get(name) or getattr(self, name))

    async def follow(self) -> None:
        """Listens to it until it has ended."""
        errors = deque[str](maxlen=200)
        out, err = self.process.stdout, self.process.stderr
        await asyncio.gather(_listen(out, self.hear), _listen(err, errors.append))
        code, self.seconds = await self.process.wait(), time.monotonic() - self.began
        own = [line for line in errors if line.startswith("maidenflight: ")]
        interrupted = self.state == "stopping" or code == CODE  # Python's own start has others
        others = ["before it had begun."] if interrupted else [*errors, f"It ended with {code}."]
        self.error = "\n".join(own[-1:] or others).removeprefix("maidenflight: ")
        self.state = "done" if code == 0 else "cancelled" if interrupted else "failed"


async def _listen(stream: asyncio.StreamReader | None, take: Callable[[str], object]) -> None:
    while stream is not None:
        try:
            if not (line := await stream.readline()):
                return
        except ValueError:  # longer than any event
            continue
        take(line.decode(errors="replace").rstrip())


async def start(folder: Path, verb: str, words: Sequence[str], behind: bool = False) -> Job:
    """Starts a command in a folder, `behind` others on this machine if asked to."""
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(
        *(["nice", "-n", "19"] if behind and os.name == "posix" else []),
        # Without -P Python would import a module of that folder in place of its own.
        *(sys.executable, "-P", "-m", "maidenflight", verb, *words),
        # Without columns an error stays on one line.
        env={**os.environ, events.VARIABLE: "1", "PYTHONUTF8": "1", "COLUMNS": ""},
        **{"cwd": folder, "stdin": asyncio.subprocess.DEVNULL, "stdout": pipe, "stderr": pipe},
        **{"limit": 2**24, "start_new_session": True},
    )
    return Job(verb, words, process)


async def interrupt_all(jobs: Iterable[Job]) -> None:
    """Interrupts commands, and waits until they have ended; at most a minute."""
    running = [job for job in jobs if job.running]
    for job in running:
        job.interrupt()
    for job in running:
        with suppress(TimeoutError):
            await asyncio.wait_for(job.process.wait(), 60.0)
        if job.process.returncode is None:
            job.process.kill()
