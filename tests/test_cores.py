"""How many cores there are, and that JAX sees each as a device where it has not begun."""

import os
import subprocess
import sys

import pytest

from maidenflight import cores


def test_the_cores_are_those_that_this_process_may_use(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3, 5, 7}, raising=False)
    assert cores.count() == 3
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert cores.count() == 1


@pytest.mark.slow
def test_each_core_becomes_a_device_and_a_jax_that_runs_is_left_alone() -> None:
    program = (
        "from maidenflight import cores\nimport jax\ncores.count = lambda: "
        "3\n{}cores.as_devices()\nprint(jax.device_count())"
    )
    found = [
        subprocess.run(
            [sys.executable, "-c", program.format(first)],
            capture_output=True,
            text=True,
            check=True,
        ).stdout.strip()
        for first in ("", "jax.device_count()\n")
    ]
    assert found[0] == "3"
    assert found[1] == "1"
