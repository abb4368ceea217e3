"""Ctrl-C at random moments of every command that computes: exit code, output, time and files.

`python benchmarks/interrupted_commands.py` prints each interruption and writes the table of
paper/notes/reliability.md. Every command but the demo does little work. A third of the runs begin
with an empty compilation cache, and so are mostly compiling. Half of the others may replace the
results of an earlier run (`--overwrite`, of another seed). After each, every file must be whole,
byte for byte what the earlier run or an undisturbed one wrote, and none of the earlier results may
be missing.
"""

import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import click
from page import write

import maidenflight
from maidenflight import results
from maidenflight.run_folder import CHECKPOINT


class Command(NamedTuple):
    """A command with little work."""

    name: str
    arguments: tuple[str, ...]
    output: str
    """File or folder, as `-o` names it."""
    seeded: bool = True
    timed: tuple[str, ...] = ()
    """Files that hold how long the run took, and so differ from run to run."""


COMMANDS = (
    Command("record", ("--flights", "2", "--duration", "2"), "made/flights"),
    Command(
        "identify",
        ("flights", "--over", "thrust_to_weight,latency", "--evaluations", "11", "--trials", "1"),
        "made/drone.toml",
    ),
    Command("validate", ("crazyflie", "flights"), "made/validation.csv"),
    Command(
        "train",
        ("--drone", "crazyflie", "--task", "hover", "--policies", "1", "--updates", "30"),
        "made/policies",
    ),
    Command("transfer", ("policies", "--trials", "2", "--duration", "1"), "made/transfer"),
    Command(
        "predict",
        ("policies", "--drone", "crazyflie", "--trials", "2", "--duration", "1"),
        "made/prediction.csv",
    ),
    Command("export", ("policies/policy_1.json",), "made/firmware"),
    Command("report", (".",), "made/report.html", seeded=False),
    Command("demo", (), "made/run", timed=("run/demo.json", "run/report.html")),
)
PROMISED = 3.0, 30.0
"""Longest time to stop, with the programs in the cache, and with none there, where a compilation
ends first [s]."""


def start_command(
    command: Command, folder: Path, cache: Path, seed: int, overwrite: bool
) -> subprocess.Popen[str]:
    """A command in a process of its own, in a folder."""
    line = [
        sys.executable,
        "-m",
        "maidenflight",
        command.name,
        *command.arguments,
        "-o",
        command.output,
    ]
    line += ["--seed", str(seed)] if command.seeded else []
    line += ["--overwrite"] if overwrite else []
    environment = {
        **os.environ,
        "PYTHONPATH": str(Path(maidenflight.__file__).parents[1]),
        "JAX_COMPILATION_CACHE_DIR": str(cache),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.5",
    }
    return subprocess.Popen(
        line, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def files(folder: Path) -> dict[str, bytes]:
    """All files below a folder."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def run_undisturbed(
    command: Command, place: Path, cache: Path, seed: int
) -> tuple[dict[str, bytes], float]:
    """What a command writes, and how long it takes [s].

    Raises:
        click.ClickException: it fails.
    """
    began = time.perf_counter()
    process = start_command(command, place, cache, seed, overwrite=False)
    said = process.communicate()[1]
    if process.returncode:
        raise click.ClickException(f"{command.name}: {said}")
    result_files = files(place / "made")
    shutil.rmtree(place / "made")
    return result_files, time.perf_counter() - began


def interrupt(
    command: Command, place: Path, cache: Path, after: float, overwrite: bool
) -> tuple[int, str, float]:
    """Sends SIGINT some seconds after the start.

    Returns:
        Exit code, what was said, and how long it took to end [s].
    """
    process = start_command(command, place, cache, 0, overwrite)
    try:
        process.wait(after)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGINT)
    sent = time.perf_counter()
    said = process.communicate(timeout=120)[1]
    return process.returncode, said, time.perf_counter() - sent


def wrong(
    code: int,
    said: str,
    left: dict[str, bytes],
    old: dict[str, bytes],
    new: dict[str, bytes],
    timed: tuple[str, ...] = (),
) -> list[str]:
    """What an interruption should not have left or said."""
    messages = [line for line in said.splitlines() if line.startswith("maidenflight: interrupted")]
    odd = [
        name
        for name, content in left.items()
        if content not in (old.get(name), new.get(name))
        and Path(name).name != CHECKPOINT
        and not (name in timed and name in new)
    ]
    lost = [name for name in old if name not in left]
    faults = {
        f"exit code {code}": code != 130,
        f"said {said[-300:]!r}": len(messages) != 1 or "Traceback" in said,
        f"not whole: {', '.join(odd)}": bool(odd),
        f"lost: {', '.join(lost)}": bool(lost),
    }
    return [fault for fault, there in faults.items() if there]


class Interruption(NamedTuple):
    """One that came before the command had ended."""

    command: str
    cold: bool
    """Whether nothing was compiled yet."""
    seconds: float
    """Until the process ended."""
    faults: list[str]


@click.command()
@click.option("--moments", default=15, show_default=True, type=click.IntRange(1), help="Of each.")
@click.option("--seed", default=0, show_default=True, help="Of the moments.")
@click.option(
    "--earliest",
    default=0.2,
    show_default=True,
    help="Seconds that Python itself may take to start.",
)
@click.option("--command", "wanted", multiple=True, help="These commands alone; may be repeated.")
@click.option(
    "--output",
    default="paper/notes/reliability.md",
    show_default=True,
    help="Page to write; none for a look.",
)
def main(moments: int, seed: int, earliest: float, wanted: tuple[str, ...], output: str) -> None:
    """Interrupts and looks."""
    # A shell starts what runs in its background with SIGINT ignored, and commands would inherit it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    chosen = [command for command in COMMANDS if not wanted or command.name in wanted]
    drawn, done = random.Random(seed), list[Interruption]()
    with tempfile.TemporaryDirectory() as result_files:
        place, cache = Path(result_files) / "run", Path(result_files) / "cache"
        place.mkdir()
        named = {command.name: command for command in COMMANDS}
        for name, product in (("record", "flights"), ("train", "policies")):
            command = named[name]._replace(output=product)
            start_command(command, place, cache, 7, overwrite=False).communicate()
        for command in chosen:
            done += _of(command, place, cache, moments, drawn, earliest)
    rows = [
        _row(command.name, [one for one in done if one.command == command.name])
        for command in chosen
    ]
    text = "\n".join(
        [
            "| command | interruptions | as promised | slowest [s] | while compiling [s] |",
            "|---|---|---|---|---|",
            *rows,
            _row("**all**", done),
        ]
    )
    print(text)
    if output != "none":
        write(Path(output), {"interruptions": text})
    sys.exit(int(any(one.faults for one in done)))


def _of(
    command: Command, place: Path, cache: Path, moments: int, drawn: random.Random, earliest: float
) -> list[Interruption]:
    """Interrupts a command so often; one that had ended already does not count."""
    slow = run_undisturbed(command, place, cache, 0)[1]  # compiles
    new, quick = run_undisturbed(command, place, cache, 0)
    replaces = command.name not in ("report", "demo")
    old = run_undisturbed(command, place, cache, 1)[0] if replaces else {}
    done = list[Interruption]()
    while len(done) < moments:
        number = len(done)
        cold, overwrite = number % 3 == 2, replaces and number % 2 == 1
        for name, content in old.items() if overwrite else ():
            results.write(place / "made" / name, content)
        after = drawn.uniform(earliest, slow if cold else quick)
        fresh = Path(tempfile.mkdtemp(dir=cache.parent))
        code, said, seconds = interrupt(command, place, fresh if cold else cache, after, overwrite)
        if code != 0:
            left = files(place / "made")
            faults = wrong(code, said, left, old if overwrite else {}, new, command.timed)
            if seconds > PROMISED[cold]:
                faults.append(f"{seconds:.1f} s to stop")
            done.append(Interruption(command.name, cold, seconds, faults))
            print(
                f"{command.name} after {after:.2f} s{', compiling' * cold}"
                f"{', over earlier results' * overwrite}: {seconds:.2f} s, "
                f"{'; '.join(faults) or 'as promised'}",
                flush=True,
            )
        shutil.rmtree(place / "made", ignore_errors=True)
        shutil.rmtree(fresh)
    return done


def _row(name: str, done: list[Interruption]) -> str:
    """A row of the table."""
    slowest = [
        max((one.seconds for one in done if one.cold is cold), default=float("nan"))
        for cold in (False, True)
    ]
    good = sum(not one.faults for one in done)
    return f"| {name} | {len(done)} | {good} | {slowest[0]:.1f} | {slowest[1]:.1f} |"


if __name__ == "__main__":
    main()
