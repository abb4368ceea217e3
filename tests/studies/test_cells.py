from pathlib import Path
from typing import Any

import jax
import pytest
from test_sweeping import Here

from maidenflight import policy, workflow
from maidenflight.errors import InputError
from maidenflight.experiments import matrix
from maidenflight.studies import cells

MATRIX = """
motor_time_constant = [0.04, 0.08]
latency = [0.0]
policies = 2
trials = 1
[control.pwm]
updates = 1
[control.attitude]
updates = 1
"""


@pytest.fixture
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A matrix whose training is short."""

    def untrained(asked: Any, cell: Any, *_: Any) -> list[policy.Policy]:
        seed = len(cell.name) + round(1e3 * cell.motor_time_constant)
        return [policy.untrained(key, (3,)) for key in jax.random.split(jax.random.key(seed), 2)]

    monkeypatch.setattr(matrix, "train_cell", untrained)
    path = tmp_path / "matrix.toml"
    path.write_text(MATRIX)
    return path


def test_cells_that_workers_train_are_those_that_the_matrix_takes(
    settings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, folder, here = matrix.read(settings), tmp_path / "out", Here()
    cells.train_cells(settings, asked, folder, here)
    assert len(here.submitted) == 4
    written = {path.parent.name: path for path in folder.glob("policies/*/policy_2.json")}
    assert written.keys() == {cell.name for cell in asked.cells}
    again = Here()
    cells.train_cells(settings, asked, folder, again)
    assert again.submitted == []
    trained: list[Any] = []
    monkeypatch.setattr(matrix, "train_cell", lambda *given: trained.append(given))
    for cell in asked.cells:
        kept = workflow.matrix_cell(asked, cell, folder / "policies" / cell.name)
        assert len(kept) == 2
    assert trained == []
    cells.forget(folder)
    assert not list(folder.glob("policies/*/*.json"))


def test_a_cell_that_fails_is_told(
    settings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any) -> None:
        raise InputError("no such drone")

    monkeypatch.setattr(matrix, "train_cell", fail)
    with pytest.raises(InputError, match="4 of 4 tasks failed"):
        cells.train_cells(settings, matrix.read(settings), tmp_path / "out", Here())
