"""A stranger's file costs its reader little and runs nothing, whatever it holds."""

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import hostile_files
from hostile_files import HOSTILE

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="memory is asked of /proc")

MOST_MB, MOST_SECONDS = 500, 5.0
"""Memory of the process, and time of a processor for each file."""
ADDRESS_SPACE = 6_000_000_000
"""What the process may ask the system for at all; JAX alone asks for two thirds of it."""
READ = """
import contextlib, io, json, os, resource, sys, time
resource.setrlimit(resource.RLIMIT_AS, (SPACE, SPACE))
from maidenflight import cli
for words in json.loads(sys.stdin.read()):
    said, began = io.StringIO(), time.process_time()
    sys.argv[1:] = words
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            cli.main()
            code = 0
        except SystemExit as leaving:
            code = leaving.code
    status = open("/proc/self/status").read()
    most = int(status.split("VmHWM:")[1].split()[0]) / 1e3
    print(json.dumps([code, said.getvalue(), time.process_time() - began, most]), flush=True)
"""


def read_all(names: list[str], folder: Path) -> dict[str, Any]:
    """Reads files one after another in one process, and returns what each command said and took."""
    commands = []
    for name in names:
        path = hostile_files.write(folder, name)
        words = HOSTILE[name][1].replace("FOLDER", str(folder)).replace("FILE", str(path))
        commands.append(shlex.split(words))
    # What is imported at its first use is not the file's.
    commands = [["log", str(folder / "none")], ["transfer", str(folder / "none")], *commands]
    code = READ.replace("SPACE", str(ADDRESS_SPACE))
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        input=json.dumps(commands),
        capture_output=True,
        text=True,
        check=False,
    )
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(lines) == len(commands), f"ended by {commands[len(lines)]}: {done.stderr[-600:]}"
    return dict(zip(names, lines[2:], strict=True))


GROUPS = [
    [name for name, (_, command) in HOSTILE.items() if command == "log FILE"],
    [name for name, (_, command) in HOSTILE.items() if command == "transfer FILE"],
    [name for name, (_, c) in HOSTILE.items() if c not in ("log FILE", "transfer FILE")],
]


@pytest.mark.slow
@pytest.mark.parametrize("names", GROUPS, ids=["logs", "policies", "settings and tables"])
def test_hostile_files_give_one_line_soon_and_take_little_memory(
    names: list[str], tmp_path: Path
) -> None:
    for name, (code, said, seconds, most) in read_all(names, tmp_path).items():
        lines = said.splitlines()
        assert code == 2, f"{name}: {said[-600:]}"
        assert len([line for line in lines if line.startswith("maidenflight: ")]) == 1, name
        assert len(lines) <= 2, name
        assert seconds < MOST_SECONDS, name
        assert most < MOST_MB, name
    assert not (tmp_path / "touched").exists()


def test_the_tries_that_run_code_are_no_blanks(tmp_path: Path) -> None:
    """Python's own reader runs what ours does not."""
    import pickle

    before = os.getcwd()
    os.chdir(tmp_path)
    try:
        pickle.loads(hostile_files.evil_call("os.system", "touch touched"))
    finally:
        os.chdir(before)
    assert (tmp_path / "touched").exists()
