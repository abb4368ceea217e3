"""The examples run, with less work."""

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"


@pytest.mark.slow
def test_stable_baselines3_learns_on_the_environments_as_they_are(tmp_path):
    """A tenth of the example's steps keeps the drone up for longer than none."""
    pytest.importorskip(
        "stable_baselines3", reason="needs pip install stable-baselines3 torch==2.13.0"
    )
    command = [sys.executable, str(EXAMPLES / "train_with_stable_baselines3.py")]
    command += ["--steps", "245760", "--evaluations", "1", "--episodes", "32"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    header, first, *_, last = (tmp_path / "circle.csv").read_text().splitlines()
    before, after = (
        dict(zip(header.split(","), row.split(","), strict=True)) for row in (first, last)
    )
    assert float(after["duration"]) > 1.4 * float(before["duration"])
    assert (tmp_path / "circle.zip").exists()
