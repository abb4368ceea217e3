"""Measures how long a person waits for a first word of each verb, and between words, under load.

Each verb runs on a terminal beside a busy loop for every core, at the lowest priority unless
`--nice` says otherwise. A redrawn bar counts as a word: its clock and share move.
"""

import argparse
import contextlib
import os
import pty
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

FIRST_S, BETWEEN_S = 1.0, 5.0
"""What is promised: a first word within, and never more silence than [s]."""
VERBS = {
    "record": ["record", "--flights", "3", "-o", "recorded"],
    "log": ["log", "recorded"],
    "identify": ["identify", "recorded", "-o", "drone.toml"],
    "validate": ["validate", "drone.toml", "recorded", "-o", "validation.csv"],
    "plan": ["plan", "drone.toml", "-o", "plan"],
    "train": ["train", "--drone", "drone.toml", "-o", "policies"],
    "predict": ["predict", "policies", "--drone", "drone.toml", "-o", "prediction.csv"],
    "transfer": ["transfer", "policies", "--drone", "drone.toml", "-o", "transfer"],
    "envelope": ["envelope", "policies", "--drone", "drone.toml", "-o", "envelope.csv"],
    "export": ["export", "policies/policy_1.json", "-o", "firmware"],
    "report": ["report", ".", "-o", "report.html"],
    "doctor": ["doctor"],
}
"""Arguments of each verb, in the order in which each finds what it needs."""


class Silence(NamedTuple):
    """How long a command was silent."""

    first: float
    """Until its first word [s]."""
    longest: float
    """Longest between two words [s]; after the last, the result is there."""
    before: str
    """The words before the longest silence."""
    seconds: float
    code: int


def listen(arguments: list[str], folder: Path, nice: int, most: float) -> Silence:
    """Runs a verb on a terminal of its own, for some seconds at most, and notes when it writes."""
    terminal, its_end = pty.openpty()
    command = ["nice", "-n", str(nice), sys.executable, "-m", "maidenflight", *arguments]
    start = last = time.monotonic()
    process = subprocess.Popen(command, cwd=folder, stdout=its_end, stderr=its_end, stdin=its_end)
    os.close(its_end)
    first, longest, before, words = 0.0, 0.0, "", ""
    while True:
        ready, _, _ = select.select([terminal], [], [], 0.2)
        text = b""
        if ready:
            with contextlib.suppress(OSError):
                text = os.read(terminal, 65536)
        now = time.monotonic()
        if now - start > most:
            process.kill()
            longest = max(longest, now - last)
        ended = process.poll() is not None
        if text:
            if now - last > longest and first:
                longest, before = now - last, words
            first, last = first or now - start, now
            words = text.decode(errors="replace").strip().splitlines()[-1:] or words
        if ended and not text:
            break
    os.close(terminal)
    seconds, code = time.monotonic() - start, process.wait()
    return Silence(first, longest, str(before)[-70:], seconds, 0 if seconds > most else code)


@contextlib.contextmanager
def busy(loops: int) -> Iterator[None]:
    """Keeps cores busy meanwhile."""
    processes = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(loops)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def main() -> None:
    """Measures all verbs, and exits with 1 where a promise is broken."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--loops", type=int, default=os.cpu_count() or 1, help="busy loops beside")
    parser.add_argument("--verbs", nargs="*", default=list(VERBS), help="of " + ", ".join(VERBS))
    parser.add_argument("--nice", type=int, default=19, help="priority of the verbs, 0 to 19")
    parser.add_argument("--most", type=float, default=3600.0, help="seconds of each verb at most")
    parser.add_argument("--folder", type=Path, help="where earlier verbs have run, and files stay")
    options = parser.parse_args()
    broken = 0
    print("| verb | first word [s] | longest silence [s] | whole [s] | before the silence |")
    print("|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as temporary, busy(options.loops):
        folder = options.folder or Path(temporary)
        folder.mkdir(exist_ok=True)
        for name in options.verbs:
            one = listen(VERBS[name], folder, options.nice, options.most)
            passes = one.first <= FIRST_S and one.longest <= BETWEEN_S and one.code == 0
            broken += not passes
            sign = "" if passes else " **"
            print(
                f"| {name}{sign} | {one.first:.1f} | {one.longest:.1f} | {one.seconds:.0f} | "
                f"{one.before if one.longest > BETWEEN_S or one.code else ''} |",
                flush=True,
            )
    sys.exit(1 if broken else 0)


if __name__ == "__main__":
    main()
