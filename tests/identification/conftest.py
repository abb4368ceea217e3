"""Fixtures: the authors' data, where this machine has it."""

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared_data():
    """The folder shared/data beside the repository."""
    folder = Path(__file__).parents[2].parent / "shared" / "data"
    if not (folder / "authors" / "flights" / "pwm").is_dir():
        pytest.skip(f"the authors' flight logs are not at {folder}")
    return folder
