"""Ctrl-C at random moments of every command that computes: exit code, output and files after it.

`python benchmarks/interrupted_commands.py` prints each interruption and writes the table of
docs/studies/reliability.md. Every command does little work, with the command line's compilation
cache. Half of the interrupted runs write into a new folder, half may replace the results of an
earlier run (`--overwrite`, of another seed). After each, every file must be whole, byte for byte
what the earlier run or an undisturbed one wrote, and none of the earlier results may be missing.
"""

import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import click
from page import write

from maidenflight import results
from maidenflight.run_folder import CHECKPOINT


class Command(NamedTuple):
    """A command with little work."""

    name: str
    arguments: tuple[str, ...]
    output: str
    """File or folder, as `-o` names it."""
    seeded: bool = True


COMMANDS = (
    Command("record", ("--flights", "2", "--duration", "2"), "made/flights"),
    Command(
        "identify",
        ("flights", "--over", "thrust_to_weight,latency", "--evaluations", "11", "--trials", "1"),
        "made/drone.toml",
    ),
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
)


def begun(
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


def undisturbed(
    command: Command, place: Path, cache: Path, seed: int
) -> tuple[dict[str, bytes], float]:
    """What a command writes, and how long it takes [s].

    Raises:
        click.ClickException: it fails.
    """
    began = time.perf_counter()
    process = begun(command, place, cache, seed, overwrite=False)
    said = process.communicate()[1]
    if process.returncode:
        raise click.ClickException(f"{command.name}: {said}")
    made = files(place / "made")
    shutil.rmtree(place / "made")
    return made, time.perf_counter() - began


def interrupted(
    command: Command, place: Path, cache: Path, after: float, overwrite: bool
) -> tuple[int, str]:
    """Sends SIGINT some seconds after the start; exit code and what was said."""
    process = begun(command, place, cache, 0, overwrite)
    try:
        process.wait(after)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=120)[1]
    return process.returncode, said


def wrong(
    code: int, said: str, left: dict[str, bytes], old: dict[str, bytes], new: dict[str, bytes]
) -> list[str]:
    """What an interruption should not have left or said.

    One that falls into Python's leaving comes after all is done and told.
    """
    if code == -signal.SIGINT and said.strip() == "" and left == new:
        return []
    told = [line for line in said.splitlines() if line.startswith("maidenflight: interrupted")]
    odd = [
        name
        for name, content in left.items()
        if content not in (old.get(name), new.get(name)) and Path(name).name != CHECKPOINT
    ]
    lost = [name for name in old if name not in left]
    faults = {
        f"exit code {code}": code != 130,
        f"said {said[-300:]!r}": len(told) != 1 or "Traceback" in said,
        f"not whole: {', '.join(odd)}": bool(odd),
        f"lost: {', '.join(lost)}": bool(lost),
    }
    return [fault for fault, there in faults.items() if there]


@click.command()
@click.option("--moments", default=42, show_default=True, type=click.IntRange(1))
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
    default="docs/studies/reliability.md",
    show_default=True,
    help="Page to write; none for a look.",
)
def main(moments: int, seed: int, earliest: float, wanted: tuple[str, ...], output: str) -> None:
    """Interrupts and looks."""
    chosen = [command for command in COMMANDS if not wanted or command.name in wanted]
    drawn, counts, bad = random.Random(seed), Counter[str](), Counter[str]()
    usual: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as made:
        place, cache = Path(made) / "run", Path(made) / "cache"
        place.mkdir()
        for command, given in ((COMMANDS[0], "flights"), (COMMANDS[2], "policies")):
            begun(command._replace(output=given), place, cache, 7, overwrite=False).communicate()
        known = {}
        for command in chosen:
            undisturbed(command, place, cache, 0)  # compiles
            new, usual[command.name] = undisturbed(command, place, cache, 0)
            known[command.name] = undisturbed(command, place, cache, 1)[0], new
        while counts.total() < moments:
            command = chosen[counts.total() % len(chosen)]
            overwrite = command.name != "report" and (counts.total() // len(chosen)) % 2 == 1
            old, new = known[command.name]
            for name, content in old.items() if overwrite else ():
                results.write(place / "made" / name, content)
            after = drawn.uniform(earliest, usual[command.name])
            code, said = interrupted(command, place, cache, after, overwrite)
            if code != 0:  # else it had ended already
                faults = wrong(code, said, files(place / "made"), old if overwrite else {}, new)
                counts[command.name] += 1
                bad[command.name] += bool(faults)
                print(
                    f"{command.name} after {after:.2f} s{', over earlier results' * overwrite}: "
                    f"{'; '.join(faults) or 'as promised'}",
                    flush=True,
                )
            shutil.rmtree(place / "made", ignore_errors=True)
    rows = [
        f"| {name} | {counts[name]} | {usual[name]:.1f} | {counts[name] - bad[name]} |"
        for name in usual
    ]
    total = f"| **all** | {counts.total()} | | {counts.total() - bad.total()} |"
    text = "\n".join(
        [
            "| command | interruptions | undisturbed [s] | as promised |",
            "|---|---|---|---|",
            *rows,
            total,
        ]
    )
    print(text)
    if output != "none":
        write(Path(output), {"interruptions": text})
    sys.exit(int(bad.total() > 0))


if __name__ == "__main__":
    main()
