"""Kills `maidenflight train` at random moments and resumes it each time.

Compares its files with those of an undisturbed training.

`python benchmarks/interruptions.py` prints where each kill fell and ends with exit code 1 if a file
differs in a single byte. Every second kill waits for its moment and then for the next file to be
written, for writing takes milliseconds of a training and chance alone would seldom meet it.
Programs are compiled once and kept in JAX's cache; the first training, with which all others are
compared, compiles them.
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import click
import numpy as np

from maidenflight import results
from maidenflight.run_folder import CHECKPOINT

POLL = 2e-4
"""How often a folder is looked at for a file that is being written [s]."""


def start_command(
    arguments: list[str], folder: Path, cache: Path, resume: bool
) -> subprocess.Popen[str]:
    """A training in a process of its own."""
    environment = {
        **os.environ,
        "JAX_COMPILATION_CACHE_DIR": str(cache),
        "JAX_PERSISTENT_COMPILATION_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_COMPILATION_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }
    command = [
        sys.executable,
        "-m",
        "maidenflight",
        "train",
        *arguments,
        "-o",
        str(folder),
        *(["--resume"] if resume else []),
    ]
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )


def await_end(process: subprocess.Popen[str]) -> None:
    """Waits for a training that nobody disturbs, or no longer.

    Raises:
        click.ClickException: it failed.
    """
    _, text = process.communicate()
    if process.returncode:
        raise click.ClickException(f"training ended with {process.returncode}: {text}")


def kill_training(
    process: subprocess.Popen[str], folder: Path, after: float, writing: bool
) -> bool:
    """Kills a training some seconds after its start, or at the next writing of a file after that.

    Whether it still ran.
    """
    end, old = time.perf_counter() + after, set(results.leftovers(folder))
    while process.poll() is None and time.perf_counter() < end:
        time.sleep(min(0.05, max(0.0, end - time.perf_counter())))
    while writing and process.poll() is None and not set(results.leftovers(folder)) - old:
        time.sleep(POLL)
    if process.poll() is not None:
        await_end(process)
        return False
    process.send_signal(signal.SIGKILL)
    process.communicate()
    # It may have ended between the last look and the signal.
    return process.returncode == -signal.SIGKILL


def met(folder: Path, before: dict[Path, float]) -> str:
    """What a kill fell into, as the folder tells that was in a state `before` the process began."""
    new = [path for path, changed in state(folder).items() if before.get(path) != changed]
    written = [path for path in results.leftovers(folder) if path in new]
    if written:
        return f"writing {written[0].name.rsplit('.', 2)[0].lstrip('.')}"
    if not new:
        return "starting, compiling or learning, before its first score"
    written = any(path.name == "training.csv" for path in new)
    return "leaving" if written else "learning after a score"


def state(folder: Path) -> dict[Path, float]:
    """Files of a folder and when they were changed."""
    return {path: path.stat().st_mtime for path in folder.iterdir()} if folder.exists() else {}


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def moments(seed: int, longest: float) -> Iterator[float]:
    random = np.random.default_rng(seed)
    while True:
        yield float(random.uniform(0.0, longest))


@click.command()
@click.option("--kills", default=20, show_default=True, type=click.IntRange(1))
@click.option("--seed", default=0, show_default=True, help="Of the moments.")
@click.option("--updates", default=60, show_default=True, type=click.IntRange(1))
@click.option(
    "--method", default="gradient", show_default=True, type=click.Choice(["gradient", "ppo"])
)
def main(kills: int, seed: int, updates: int, method: str) -> None:
    """Kills, resumes and compares."""
    arguments = [
        "--drone",
        "crazyflie",
        "--policies",
        "2",
        "--updates",
        str(updates),
        "--method",
        method,
    ]
    with tempfile.TemporaryDirectory() as place:
        cache, undisturbed = Path(place) / "cache", Path(place) / "undisturbed"
        await_end(start_command(arguments, undisturbed, cache, resume=False))
        expected = contents(undisturbed)
        began = time.perf_counter()
        await_end(start_command(arguments, Path(place) / "cached", cache, resume=False))
        usual = time.perf_counter() - began
        different = int(contents(Path(place) / "cached") != expected)
        print(
            f"undisturbed: {usual:.1f} s; the same bytes with programs from the cache: "
            f"{not different}",
            flush=True,
        )
        where: Counter[str] = Counter()
        trainings, after = 0, moments(seed, 1.15 * usual)
        while where.total() < kills:
            trainings += 1
            folder = Path(place) / f"training_{trainings}"
            over = False
            while not over and where.total() < kills:
                before = state(folder)
                process = start_command(arguments, folder, cache, (folder / CHECKPOINT).exists())
                if kill_training(process, folder, next(after), where.total() % 2 == 1):
                    what = met(folder, before)
                    where[what] += 1
                    print(f"kill {where.total()}, training {trainings}: {what}", flush=True)
                over = (folder / "training.csv").exists()
            if not over:
                await_end(start_command(arguments, folder, cache, (folder / CHECKPOINT).exists()))
            same = contents(folder) == expected
            different += not same
            print(
                f"training {trainings} ended with the same bytes in {', '.join(expected)}: {same}",
                flush=True,
            )
    text = ", ".join(f"{count} while {what}" for what, count in where.most_common())
    print(f"{where.total()} kills ({text}), {trainings} trainings ended, {different} differed")
    sys.exit(int(different > 0))


if __name__ == "__main__":
    main()
