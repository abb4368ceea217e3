"""The examples run, with less work."""

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"


def test_stable_baselines3_trains_on_the_environments_as_they_are(tmp_path):
    pytest.importorskip(
        "stable_baselines3", reason="needs pip install stable-baselines3 torch==2.13.0"
    )
    command = [
        sys.executable,
        str(EXAMPLES / "train_with_stable_baselines3.py"),
        "--steps",
        "64",
        "--episodes",
        "2",
    ]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "return of 2 episodes: -" in done.stdout
    assert (tmp_path / "circle.zip").exists()
