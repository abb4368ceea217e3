"""The same seed gives the same bytes on one core and on two, whatever Python hashes texts by."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

COMMANDS = """
record --flights 1 --duration 6 -o flights
identify flights --over latency --evaluations 11 --trials 1 -o drone.toml
train --drone drone.toml --accept-bounds --policies 2 --updates 3 --hidden 4 -o policies
export policies/policy_1.json -o firmware
transfer policies --drone drone.toml --accept-bounds --trials 1 --duration 0.3 -o transfer
report . -o report.html
"""
NAMED = {"drone.toml", "identification.svg", "report.html", "policies/policy_1.json"}
RUN = """
import os, shlex, sys
os.sched_setaffinity(0, {cores})
from maidenflight import cli
for words in map(shlex.split, {commands!r}.split("\\n")):
    if words:
        sys.argv[1:] = words
        try:
            cli.main()
        except SystemExit as leaving:
            assert not leaving.code, words
"""


@pytest.mark.night
@pytest.mark.skipif(
    not hasattr(os, "sched_getaffinity") or len(os.sched_getaffinity(0)) < 2, reason="one core"
)
def test_the_same_bytes_on_one_and_two_cores_and_with_another_seed_of_hashes(
    tmp_path: Path,
) -> None:
    cores = sorted(os.sched_getaffinity(0))[:2]
    runs, processes = [], []
    for name, some, seed in (("one", set(cores[:1]), "1"), ("two", set(cores), "2")):
        runs.append(folder := tmp_path / name / "run")
        folder.mkdir(parents=True)
        code = RUN.format(cores=some, commands=COMMANDS)
        process = subprocess.Popen(
            [sys.executable, "-c", code],
            cwd=folder,
            env={**os.environ, "PYTHONHASHSEED": seed, "JAX_DISABLE_MOST_OPTIMIZATIONS": "0"},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        processes.append(process)
    for process in processes:
        _, said = process.communicate()
        assert process.returncode == 0, said[-1500:]
    one, two = (
        {str(path.relative_to(run)): path.read_bytes() for path in run.rglob("*") if path.is_file()}
        for run in runs
    )
    assert one.keys() == two.keys()
    assert one.keys() > NAMED
    assert one["run.json"] == two["run.json"]
    assert any(name.endswith(".c") for name in one)
    # Threads sum scores in another order, which shows in their last digit.
    scores = {"policies/training.csv", "policies/training.npz"}
    assert {name for name in one if one[name] != two[name]} <= scores
