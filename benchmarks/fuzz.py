"""Feeds damaged files to everything that reads files, and counts what comes of it.

`python benchmarks/fuzz.py` reads 100,000 inputs and writes the table of
paper/notes/reliability.md; `--inputs 2000 --output none` is a short run. A reader may accept a
file or raise `InputError` with one short line. Failures are: any other exception, a warning or a
dead process (crash); an answer that takes longer than `LONGEST` (hang); and accepting a file whose
content has changed, or is outside the documented range (silent acceptance). Input n of a reader is
always the same: `--reader NAME --only n` reads it again.
"""

import multiprocessing
import os
import random
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import click
import fuzz_damage as damage
import numpy as np
from fuzz_damage import ANY, PREFIX, REFUSED, SAME, TOLD, Damaged
from fuzz_files import file_readers
from fuzz_logs import flight_readers
from fuzz_reader import Good, Reader
from fuzz_recordings import recording_readers
from fuzz_runs import run_readers
from page import write

from maidenflight.errors import InputError, require_packages

LONGEST = 5.0
"""Time that a reader may take [s]."""
AGAIN = 0.5
"""Time after which a reader that still runs is told again [s]: what is raised in a callback of the
garbage collector, or in Python that a compiled module calls, can be dropped there."""
PATIENCE = 30.0
"""Time after which a process that says nothing is ended [s]: it waits where no signal reaches
it."""
LINE = 2000
"""Characters that an error may have."""
SPECIAL = 0.03
"""Share of inputs that are no ordinary files."""


@dataclass
class Counts:
    """What came of a reader's inputs."""

    inputs: int = 0
    accepted: int = 0
    refused: int = 0
    crashes: int = 0
    hangs: int = 0
    silent: int = 0
    slowest: float = 0.0
    """[s]."""
    faults: dict[str, list[int]] = field(default_factory=dict)
    """Inputs, by what was wrong."""

    def add(self, number: int, step_result: str, fault: str, seconds: float) -> None:
        """Counts one input."""
        self.inputs += 1
        setattr(self, step_result, getattr(self, step_result) + 1)
        self.slowest = max(self.slowest, seconds)
        if fault:
            self.faults.setdefault(fault, []).append(number)


class Late(BaseException):
    """Raised in a reader that takes too long."""


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Ends what takes longer, where Python can."""

    def late(*_: Any) -> None:
        raise Late

    before = signal.signal(signal.SIGALRM, late)
    try:
        signal.setitimer(signal.ITIMER_REAL, seconds, AGAIN)
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def drawn(reader: Reader, seed: int, number: int) -> tuple[Good, Damaged]:
    """Input `number` of a reader."""
    generator = random.Random(f"{seed} {reader.name} {number}")
    good = generator.choice(reader.good)
    if generator.random() < SPECIAL:
        return good, damage.special(generator)
    return good, good.damaged(generator, good.content, generator.choice(reader.good).content)


def put(path: Path, good: Good, damaged: Damaged) -> None:
    """Lays an input where its reader looks for it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if damaged.content is not None:
        path.write_bytes(damaged.content)
    elif damaged.what == "folder":
        path.mkdir()
    elif damaged.what == "pipe":
        os.mkfifo(path)
    elif damaged.what == "link to the file":
        beside = path.with_name(f"beside.{path.name}.bin")
        beside.write_bytes(good.content)
        path.symlink_to(beside)
    else:
        path.symlink_to(
            {
                "link to itself": path,
                "link to nothing": path / "nothing",
                "link to a device": "/dev/zero",
            }[damaged.what]
        )


def removed(path: Path) -> None:
    """Clears the place of an input."""
    path.with_name(f"beside.{path.name}.bin").unlink(missing_ok=True)
    if path.is_dir() and not path.is_symlink():
        path.rmdir()
    else:
        path.unlink(missing_ok=True)


def tried(reader: Reader, number: int, seed: int, folder: Path) -> tuple[str, str, float]:
    """Reads one input: what came of it, what was wrong, and how long it took [s].

    `folder` holds what the reader needs beside its file; the file that the input took the place of
    is put back.
    """
    good, damaged = drawn(reader, seed, number)
    path = folder / good.place
    removed(path)
    put(path, good, damaged)
    began, value = time.perf_counter(), None
    try:
        with warnings.catch_warnings(), at_most(LONGEST):
            warnings.simplefilter("error")
            value = reader.read(folder, path)
        step_result, fault = "accepted", ""
    except InputError as error:
        step_result, fault = "refused", unreadable(str(error))
        step_result = "crashes" if fault else step_result
    except Late:
        step_result, fault = "hangs", f"longer than {LONGEST:g} s"
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # polars' panics are no exceptions to Python
        step_result, fault = (
            "crashes",
            f"{type(error).__name__} at {_place(error)}: {str(error)[:80]!r}",
        )
    seconds = time.perf_counter() - began
    if step_result == "accepted":
        verdict = ANY if reader.lenient else damaged.verdict
        before = (
            _good(reader, good.place, reader.good.index(good))
            if verdict in (SAME, PREFIX, TOLD)
            else None
        )
        fault = reader.unsound(value) or misread(reader, before, value, verdict)
        step_result = "silent" if fault else step_result
    removed(path)
    if good.place in reader.around:
        path.write_bytes(reader.around[good.place])
    return (
        step_result,
        f"{fault} ({damaged.what.split(':')[0].split(' at ')[0]})" if fault else "",
        seconds,
    )


def unreadable(said: str) -> str:
    """What is wrong with an error's words."""
    return (
        "an error of several lines"
        if "\n" in said
        else "an error that is too long"
        if len(said) > LINE
        else ""
    )


def misread(reader: Reader, before: Any, value: Any, verdict: str) -> str:
    """What a reader made of a file that it should not have made of it; see `damage`."""
    if verdict == REFUSED:
        return "not refused"
    if before is None:
        return ""
    old, new = reader.told(before), reader.told(value)
    if verdict == SAME and not (
        len(old) == len(new)
        and all(_equal(one, other) for one, other in zip(old, new, strict=True))
    ):
        return "other than before"
    if verdict == PREFIX and not all(
        _begins(one, other) for one, other in zip(old[3:4], new[3:4], strict=True)
    ):
        return "no beginning of what was before"
    if (
        verdict == TOLD
        and new
        and len(new[0]) < len(old[0])
        and len(reader.notes(value)) <= len(reader.notes(before))
    ):
        return "rows lost without a word"
    return ""


def _equal(one: np.ndarray, other: np.ndarray) -> bool:
    return one.shape == other.shape and np.array_equal(one, other, equal_nan=one.dtype.kind == "f")


def _begins(whole: np.ndarray, part: np.ndarray) -> bool:
    return len(part) <= len(whole) and _equal(whole[: len(part)], part)


def _place(error: BaseException) -> str:
    frames = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if "maidenflight" in frame.filename
    ]
    return f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "?"


_known: dict[tuple[str, int], Any] = {}


def _good(reader: Reader, place: str, number: int) -> Any:
    """What a reader makes of a good file."""
    if (reader.name, number) not in _known:
        with tempfile.TemporaryDirectory() as made:
            for name, content in {**reader.around, place: reader.good[number].content}.items():
                Path(made, name).parent.mkdir(parents=True, exist_ok=True)
                Path(made, name).write_bytes(content)
            _known[reader.name, number] = reader.read(Path(made), Path(made, place))
    return _known[reader.name, number]


@cache
def known_readers() -> dict[str, Reader]:
    """Readers by name."""
    makers = (flight_readers, recording_readers, file_readers, run_readers)
    return {reader.name: reader for maker in makers for reader in maker()}


@contextmanager
def laid(reader: Reader) -> Iterator[Path]:
    """A folder with what a reader needs beside its file."""
    with tempfile.TemporaryDirectory() as made:
        for name, content in reader.around.items():
            Path(made, name).parent.mkdir(parents=True, exist_ok=True)
            Path(made, name).write_bytes(content)
        yield Path(made)


def _worker(name: str, numbers: range, seed: int, answers: Connection) -> None:
    # polars prints a trace of what it panics over.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())
    reader = known_readers()[name]
    with laid(reader) as folder:
        answers.send(None)
        for number in numbers:
            answer = tried(reader, number, seed, folder)
            # A machine that is busy may be slow; a reader that waits does so again.
            answers.send(
                (number, *(tried(reader, number, seed, folder) if answer[0] == "hangs" else answer))
            )


def counted(reader: Reader, inputs: int, seed: int) -> Counts:
    """Reads a reader's inputs in a process of their own, and in another one where that dies."""
    counts = Counts()
    context = multiprocessing.get_context("spawn")
    while counts.inputs < inputs:
        ours, theirs = context.Pipe(duplex=False)
        process = context.Process(
            target=_worker, args=(reader.name, range(counts.inputs, inputs), seed, theirs)
        )
        process.start()
        theirs.close()
        try:
            begun = ours.recv() is None
        except EOFError as error:
            raise click.ClickException(f"{reader.name}: its process does not start.") from error
        try:
            while begun and counts.inputs < inputs:
                if not ours.poll(PATIENCE):
                    counts.add(counts.inputs, "hangs", f"longer than {PATIENCE:g} s", PATIENCE)
                    break
                counts.add(*ours.recv())
        except EOFError:
            process.join()
            counts.add(counts.inputs, "crashes", f"the process ended with {process.exitcode}", 0.0)
        process.kill()
        process.join()
    return counts


def table(found: dict[str, Counts]) -> str:
    """The table of the page."""
    total = Counts()
    titles = (
        "reader",
        "inputs",
        "accepted",
        "refused",
        "crashes",
        "hangs",
        "silent acceptances",
        "slowest [ms]",
    )
    lines = [f"| {' | '.join(titles)} |", "|" + "---|" * len(titles)]
    for name, one in [*found.items(), ("**all**", total)]:
        numbers = (one.inputs, one.accepted, one.refused, one.crashes, one.hangs, one.silent)
        lines.append(
            f"| {name} | "
            + " | ".join(f"{number:,}" for number in numbers)
            + f" | {1000 * one.slowest:.0f} |"
        )
        for part in ("inputs", "accepted", "refused", "crashes", "hangs", "silent"):
            setattr(total, part, getattr(total, part) + getattr(one, part))
        total.slowest = max(total.slowest, one.slowest)
    return "\n".join(lines)


@click.command()
@click.option("--inputs", default=100_000, show_default=True, type=click.IntRange(1))
@click.option("--seed", default=0, show_default=True)
@click.option("--reader", "wanted", help="One reader alone, by a part of its name.")
@click.option("--only", type=int, help="One input alone, by its number.")
@click.option(
    "--output",
    default="paper/notes/reliability.md",
    show_default=True,
    help="Page to write; none for a look.",
)
def main(inputs: int, seed: int, wanted: str | None, only: int | None, output: str) -> None:
    """Reads and counts."""
    require_packages("rosbags", "pyulog", "orangebox", "pymavlink")
    chosen = [
        reader for reader in known_readers().values() if wanted is None or wanted in reader.name
    ]
    if only is not None:
        good, damaged = drawn(chosen[0], seed, only)
        shutil.rmtree("/tmp/fuzzed", ignore_errors=True)
        put(Path("/tmp/fuzzed") / good.place, good, damaged)
        with laid(chosen[0]) as folder:
            print(
                damaged.what,
                damaged.verdict,
                f"/tmp/fuzzed/{good.place}",
                tried(chosen[0], only, seed, folder),
            )
        return
    whole, found, faults = sum(reader.weight for reader in chosen), {}, Counter[str]()
    for reader in chosen:
        counts = found[reader.name] = counted(
            reader, max(1, round(inputs * reader.weight / whole)), seed
        )
        bad = counts.crashes + counts.hangs + counts.silent
        print(
            f"{reader.name}: {counts.inputs} inputs, {counts.accepted} accepted, {counts.refused} "
            f"refused, {bad} at fault",
            flush=True,
        )
        for fault, numbers in sorted(counts.faults.items(), key=lambda entry: -len(entry[1])):
            print(f"    {len(numbers)} x {fault}, such as {numbers[:3]}", flush=True)
            faults[fault] += len(numbers)
    text = table(found)
    print(text)
    if output != "none" and wanted is None:
        write(Path(output), {"fuzz": text})
    sys.exit(int(bool(faults)))


if __name__ == "__main__":
    main()
