"""Faults at random moments of `identify`, `train`, `transfer` and `sweep`; then the same again.

`python benchmarks/faults.py --times 50` kills (SIGKILL), ends (SIGTERM) or leaves without disk
space, and compares what the command given again writes with an undisturbed run, byte for byte.
Full disks need a superuser, who may mount a small one. A command that finds room again may go on
by itself. Programs are compiled once and kept in JAX's cache.
"""

import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import click

from maidenflight.run_folder import CHECKPOINT

STUDY = """
[[task]]
name = "f"
kind = "record"
[task.settings]
flights = 1
duration = 3.0
[task.grid]
seed = [0, 1, 2]
"""
COMMANDS = {
    "identify": (
        *("identify", "flights", "--trials", "1", "--evaluations", "11"),
        *("--over", "latency,motor_time_constant"),
    ),
    "train": ("train", "--drone", "crazyflie", "--policies", "2", "--updates", "60"),
    "transfer": ("transfer", "policies", "--trials", "2", "--duration", "2"),
    "sweep": ("sweep", "study.toml"),
}
FAULTS = ("kill", "term", "full disk")
TIMED = ("run.json", "progress.json")
"""Files that hold times."""
DISK_MB, ROOM_S = 24, 2.0
"""Size of the disk, and how long it stays full."""


def begin(arguments: list[str], folder: Path) -> subprocess.Popen[str]:
    """Starts a command in a process of its own."""
    cache = {
        "JAX_COMPILATION_CACHE_DIR": str(folder / "cache"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    return subprocess.Popen(
        [sys.executable, "-m", "maidenflight", *arguments],
        cwd=folder,
        env={**os.environ, **cache},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(arguments: list[str], folder: Path) -> None:
    """Runs a command to its end.

    Raises:
        click.ClickException: it failed.
    """
    process = begin(arguments, folder)
    _, words = process.communicate()
    if process.returncode:
        raise click.ClickException(f"{' '.join(arguments)}: {words}")


def contents(place: Path) -> dict[str, bytes]:
    """Returns the files of an output that do not hold times."""
    return {
        str(path.relative_to(place)): path.read_bytes()
        for path in sorted(place.rglob("*"))
        if path.is_file() and path.name not in TIMED and path.suffix != ".lock"
    }


def strike(process: subprocess.Popen[str], fault: str, after: float, disk: Path) -> None:
    """Lets a fault happen to a command some seconds after its start, if it still runs."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(after)
        return
    if fault != "full disk":
        process.send_signal(signal.SIGKILL if fault == "kill" else signal.SIGTERM)
        process.communicate()
        return
    ballast = disk / "ballast"
    with contextlib.suppress(OSError), ballast.open("wb") as file:
        while True:
            file.write(bytes(65536))
            file.flush()
    time.sleep(ROOM_S)
    ballast.unlink()
    process.communicate()


@contextlib.contextmanager
def small_disk(folder: Path) -> Iterator[Path]:
    """A disk of `DISK_MB`, of memory."""
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={DISK_MB}m", "tmpfs", str(folder)]
    subprocess.run(command, check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def again(arguments: list[str], results_folder: Path) -> list[str]:
    """Returns the command that goes on from what a fault left."""
    if arguments[0] == "sweep" or not any(results_folder.rglob("*")):
        return arguments
    unfinished = (results_folder / "out" / CHECKPOINT).exists()
    return [*arguments, "--resume" if unfinished else "--overwrite"]


def try_faults(name: str, fault: str, times: int, folder: Path, moments: random.Random) -> Counter:
    """Lets a fault happen several times, and counts what came of the command given again."""
    count: Counter[str] = Counter()
    with small_disk(folder / "disk") as disk:
        results_folder = disk / "made"
        arguments = [*COMMANDS[name], "-o", str(results_folder / "out")]
        finish(arguments, folder)
        shutil.rmtree(results_folder)
        began = time.perf_counter()
        finish(arguments, folder)
        expected, usual = contents(results_folder), time.perf_counter() - began
        while count.total() < times:
            shutil.rmtree(results_folder, ignore_errors=True)
            strike(begin(arguments, folder), fault, moments.uniform(0.2, usual), disk)
            process = begin(again(arguments, results_folder), folder)
            _, words = process.communicate()
            same = process.returncode == 0 and contents(results_folder) == expected
            count["same bytes" if same else "other"] += 1
            if not same:
                print(f"{name}, {fault}: code {process.returncode}, {words[-300:]}", flush=True)
    return count


@click.command()
@click.option("--times", default=50, show_default=True, help="Of each fault in each command.")
@click.option("--seed", default=0, show_default=True, help="Of the moments.")
@click.option("--fault", "faults", multiple=True, default=FAULTS, type=click.Choice(FAULTS))
@click.option("--command", "names", multiple=True, default=tuple(COMMANDS))
def main(times: int, seed: int, faults: tuple[str, ...], names: tuple[str, ...]) -> None:
    """Tries faults and prints a table."""
    moments, other = random.Random(seed), 0
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "study.toml").write_text(STUDY)
        finish(["record", "--flights", "2", "--duration", "8", "-o", "flights"], folder)
        finish([*COMMANDS["train"], "-o", "policies"], folder)
        print("| command | fault | times | same bytes after the same command |\n|---|---|---|---|")
        for name in names:
            for fault in faults:
                count = try_faults(name, fault, times, folder, moments)
                (folder / "disk").rmdir()
                other += count["other"]
                print(f"| {name} | {fault} | {times} | {count['same bytes']} |", flush=True)
    sys.exit(int(other > 0))


if __name__ == "__main__":
    main()
