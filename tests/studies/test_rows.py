from pathlib import Path
from typing import Any

import jax
import pytest
from test_sweeping import Here

from maidenflight import policy, workflow
from maidenflight.errors import InputError
from maidenflight.experiments import matrix, matrix_file
from maidenflight.experiments.matrix import Cell
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.studies import rows

MATRIX = """
motor_time_constant = [0.04, 0.08]
latency = [0.0, 0.015]
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

    def untrained(asked: Any, given: list[Cell], *_: Any) -> dict[Cell, list[policy.Policy]]:
        made = {}
        for number, cell in enumerate(given):
            seed = len(cell.name) + round(1e3 * cell.motor_time_constant) + 1000 * number
            keys = jax.random.split(jax.random.key(seed), 2)
            made[cell] = [policy.untrained(key, spec=PolicySpec(hidden=(3,))) for key in keys]
        return made

    monkeypatch.setattr(matrix, "train_cells", untrained)
    path = tmp_path / "matrix.toml"
    path.write_text(MATRIX)
    return path


def test_rows_that_workers_train_are_those_that_the_matrix_takes(
    settings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, folder, here = matrix_file.read(settings), tmp_path / "out", Here()
    rows.train_rows(settings, asked, folder, here)
    assert len(here.submitted) == 4
    written = {path.parent.name: path for path in folder.glob("policies/*/policy_2.json")}
    assert written.keys() == {cell.name for cell in asked.cells}
    again = Here()
    rows.train_rows(settings, asked, folder, again)
    assert again.submitted == []
    trained: list[Any] = []
    monkeypatch.setattr(matrix, "train_cells", lambda *given: trained.append(given))
    for row in asked.rows:
        kept = workflow.matrix_row(asked, row, folder / "policies")
        assert [(cell, len(own)) for cell, own in kept.items()] == [(cell, 2) for cell in row.cells]
    assert trained == []
    rows.forget(folder)
    assert not list(folder.glob("policies/*/*.json"))


def test_a_row_that_fails_is_told(
    settings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any) -> None:
        raise InputError("no such drone")

    monkeypatch.setattr(matrix, "train_cells", fail)
    with pytest.raises(InputError, match="4 of 4 tasks failed"):
        rows.train_rows(settings, matrix_file.read(settings), tmp_path / "out", Here())
