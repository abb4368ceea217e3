"""Measures how long `maidenflight VERB --help` takes, and how many modules it imports.

Prints a row a verb beside Python alone and `import click`: medians of the wall time and of the
processor time of a process.

    python benchmarks/startup.py
"""

import os
import statistics
import subprocess
import sys
import time

import click

from maidenflight import terminal
from maidenflight.registry import VERBS

COUNT = "import atexit, sys\natexit.register(lambda: sys.stderr.write(str(len(sys.modules))))\n"
"""What has a process write at its end how many modules it has."""
HELP = (
    "sys.argv = ['maidenflight', {words}'--help']\nfrom maidenflight.__main__ import main\nmain()"
)
PROGRAMS = {
    "Python alone": "",
    "import click": "import click",
    "maidenflight": HELP.format(words=""),
    **{name: HELP.format(words=f"'{name}', ") for name in VERBS.own},
}


def run(program: str) -> tuple[float, float, int]:
    """Runs a program in a process; returns wall time, processor time [s] and modules."""
    begin = time.perf_counter()
    words = [sys.executable, "-c", COUNT + program]
    with subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.perf_counter() - begin
        process.returncode = os.waitstatus_to_exitcode(status)
        assert process.stderr is not None
        output = process.stderr.read().decode()
    if process.returncode or not output.isdecimal():
        raise click.ClickException(f"{program}: {output}")
    return wall, usage.ru_utime + usage.ru_stime, int(output)


@click.command(help=__doc__)
@click.option("--runs", default=7, show_default=True, type=click.IntRange(1), help="Of each.")
def main(runs: int) -> None:
    """Measures all programs in turn, so that another's load meets them alike."""
    measured = [{name: run(program) for name, program in PROGRAMS.items()} for _ in range(runs)]
    rows = []
    for name in PROGRAMS:
        wall, processor, modules = map(
            statistics.median, zip(*(one[name] for one in measured), strict=True)
        )
        rows.append([name, f"{wall:.3f}", f"{processor:.3f}", f"{modules:.0f}"])
    terminal.print_table("Help", ["", "wall, s", "processor, s", "modules"], rows)


if __name__ == "__main__":
    main()
