"""Ray with three raylets, and jobs of submitit: the table of this process, whoever is killed."""

import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import tomlkit
import toy_kinds
from test_sweeping import Here

import maidenflight as mf
from maidenflight.integrations.clusters.slurm import Slurm
from maidenflight.studies.engine import Resources

pytestmark = pytest.mark.slow
HERE = Path(__file__).parent
PATIENCE = 300
"""Time after which what does not end is a failure, on a busy machine too [s]."""


def environment() -> dict[str, str]:
    """Where workers find the kinds of these tests and, not installed, maidenflight."""
    places = [str(HERE), str(Path(mf.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, places))}


@pytest.fixture(scope="module")
def raylets() -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """The address of a cluster, and its process."""
    pytest.importorskip("ray")
    cluster = subprocess.Popen(
        [sys.executable, str(HERE / "raylets.py")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=environment(),
    )
    assert cluster.stdin is not None
    assert cluster.stdout is not None
    address = cluster.stdout.readline().strip()
    assert ":" in address
    yield address, cluster
    cluster.stdin.close()
    cluster.stdout.close()
    cluster.wait(PATIENCE)


def kill_one(cluster: subprocess.Popen[str]) -> None:
    """Kills a raylet and adds another."""
    assert cluster.stdin is not None
    assert cluster.stdout is not None
    cluster.stdin.write("kill\n")
    cluster.stdin.flush()
    assert cluster.stdout.readline() == "killed\n"


def begun(folder: Path, on: str) -> subprocess.Popen[bytes]:
    """The command, in a process group of its own, which answers Ctrl-C as in a terminal.

    What a shell starts in the background ignores it, and so do its children.
    """
    program = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        f"sys.argv = 'maidenflight sweep study.toml --trust -o out --on {on}'.split()\n"
        "from maidenflight import __main__; __main__.main()"
    )
    return subprocess.Popen(
        [sys.executable, "-c", program],
        cwd=folder,
        env=environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )


def results(folder: Path) -> int:
    place = folder / "out" / "results"
    return sum(not path.name.startswith(".") for path in place.iterdir()) if place.exists() else 0


def wait_for(count: int, folder: Path, driver: subprocess.Popen[bytes]) -> None:
    """Until there are so many results, or all: on a busy machine, looks are far apart."""
    until = time.monotonic() + PATIENCE
    while results(folder) < count and (ended := driver.poll()) != 0:
        assert ended is None, (driver.communicate()[1] or b"").decode()
        assert time.monotonic() < until
        time.sleep(0.05)


def prepared(folder: Path, **settings: Any) -> bytes:
    """Writes a study, and gives the table that is expected of it."""
    (folder / "study.toml").write_text(tomlkit.dumps({"task": toy_kinds.study(**settings)}))
    mf.sweep(folder / "study.toml", folder / "expected", Here(), trust=True)
    (folder / "ran").unlink(missing_ok=True)
    return (folder / "expected" / "study.csv").read_bytes()


@pytest.mark.night
def test_nodes_and_drivers_that_are_killed_cost_what_was_under_way(
    raylets: tuple[str, subprocess.Popen[str]], tmp_path: Path
) -> None:
    address, cluster = raylets
    expected = prepared(tmp_path, count=8, more=1, seconds=0.7, ran=str(tmp_path / "ran"))
    moments, kills = random.Random(0), 0
    driver = begun(tmp_path, f"ray:{address}")
    wait_for(2, tmp_path, driver)
    time.sleep(moments.random())
    kill_one(cluster)
    kills += 1
    wait_for(5, tmp_path, driver)
    time.sleep(moments.random())
    there = results(tmp_path)
    os.killpg(driver.pid, signal.SIGKILL)
    driver.communicate()
    driver = begun(tmp_path, f"ray:{address}")
    wait_for(there + 1, tmp_path, driver)
    time.sleep(moments.random())
    kill_one(cluster)
    kills += 1
    assert driver.wait(PATIENCE) == 0, (driver.communicate()[1] or b"").decode()
    driver.communicate()
    assert (tmp_path / "out" / "study.csv").read_bytes() == expected
    places = (tmp_path / name / "results" for name in ("out", "expected"))
    assert len({frozenset(os.listdir(place)) for place in places}) == 1
    ran = Counter((tmp_path / "ran").read_text().splitlines())
    # A raylet has one task under way, and the driver one a raylet: as many may be done twice.
    assert sum(count - 1 for task, count in ran.items() if task.startswith("begun")) <= kills + 3
    assert all(ran[f"ended {value}"] >= 1 for value in range(1, 9))


@pytest.mark.night
def test_a_driver_of_this_machine_that_is_killed_or_interrupted_goes_on(tmp_path: Path) -> None:
    expected = prepared(tmp_path, count=16, more=1, seconds=0.4)
    driver = begun(tmp_path, "local")
    wait_for(1, tmp_path, driver)
    tasks = Path(f"/proc/{driver.pid}/task").glob("*/children")
    processes = [Path("/proc", child) for one in tasks for child in one.read_text().split()]
    assert processes
    os.kill(driver.pid, signal.SIGKILL)
    driver.communicate()
    until = time.monotonic() + PATIENCE
    while any(process.exists() for process in processes):  # they end by themselves
        assert time.monotonic() < until
        time.sleep(0.05)
    there = results(tmp_path)
    driver = begun(tmp_path, "local")
    wait_for(there + 1, tmp_path, driver)
    os.killpg(driver.pid, signal.SIGINT)
    _, said = driver.communicate(timeout=PATIENCE)
    if results(tmp_path) < 16:  # else a busy machine looked too late
        assert driver.returncode == 130
        again = "maidenflight sweep study.toml --trust -o out --on local"
        assert said.decode().splitlines()[-1].endswith(again)
    driver = begun(tmp_path, "local")
    assert driver.wait(PATIENCE) == 0
    driver.communicate()
    assert (tmp_path / "out" / "study.csv").read_bytes() == expected


@pytest.mark.night
def test_jobs_of_submitit_give_the_same_bytes_and_one_that_is_killed_is_begun_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("submitit")
    monkeypatch.setenv("PYTHONPATH", environment()["PYTHONPATH"])
    ran = {"ran": str(tmp_path / "ran")}
    entries: list[dict[str, Any]] = [
        {"name": "dying", "kind": "toy_kinds:Killed", "settings": ran},
        *toy_kinds.study(count=2, more=1),
    ]
    jobs = Slurm(Resources(workers=3, logs=str(tmp_path / "jobs")), cluster="local")
    mf.sweep(entries, tmp_path / "out", jobs, retries=0)
    assert (tmp_path / "ran").read_text() == "killed\nkilled\n"
    mf.sweep(entries, tmp_path / "expected", Here(), retries=0)
    places = (tmp_path / name / "study.csv" for name in ("out", "expected"))
    assert len({place.read_bytes() for place in places}) == 1


def test_pools_that_are_left_behind_add_no_words_to_the_last_ones() -> None:
    left = (
        "import multiprocessing as m; from maidenflight.cli import interruption; "
        "locks = [m.get_context('spawn').Lock()]; interruption.leave(3)"
    )
    ending = subprocess.run([sys.executable, "-c", left], capture_output=True, env=environment())
    assert (ending.returncode, ending.stderr) == (3, b"")
