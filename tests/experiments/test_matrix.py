"""The matrix: it goes on where it was, and policies fly at their structure's own rate."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import polars
import pytest

from maidenflight import parameters, policy_file, results, workflow
from maidenflight.errors import InputError
from maidenflight.experiments import matrix, matrix_file
from maidenflight.experiments.matrix import Cell
from run_listing import entries, unlisted

pytestmark = pytest.mark.usefixtures("without_optimizations")

PAPER = Path(__file__).parents[2] / "paper"
TINY = """
realities = ["near:7", "far:7"]
motor_time_constant = [0.04, 0.08]
latency = [0.0]
policies = 2
trials = 2
duration = 1
[control.attitude]
rate = 100
updates = 2
num_envs = 2
horizon = 2
evaluations = 1
episodes = 2
hidden = [8]
hidden_learning_rate = 0
"""


def put(folder: Path, text: str) -> Path:
    return results.write(folder / "matrix.toml", text)


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, polars.DataFrame, list[str]]:
    folder, said = tmp_path_factory.mktemp("matrix"), []
    asked = matrix_file.read(put(folder, TINY))
    return (
        folder,
        workflow.transfer_matrix(
            asked, folder / "made", lambda done, of, what: said.append(f"{done}/{of} {what}")
        ),
        said,
    )


def test_the_papers_matrices_are_the_papers() -> None:
    paper, authors = (matrix_file.read(PAPER / f"zero_shot{name}.toml") for name in ("", "_100hz"))
    assert len(paper.cells) * paper.policies == 81
    assert len(paper.cells) * paper.policies * paper.trials == 243
    assert paper.rates == {"pwm": 100, "attitude_rate": 50, "attitude": 25}
    assert authors.rates == {"attitude_rate": 100, "attitude": 100}
    # As far ahead in time, whatever the rate.
    assert (
        paper.controls["attitude_rate"].horizon / 50
        == authors.controls["attitude_rate"].horizon / 100
    )
    assert {cell._replace(control="") for cell in paper.cells} == {
        cell._replace(control="") for cell in authors.cells
    }


@pytest.mark.slow
def test_a_row_a_flight(flown: Any) -> None:
    _, table, said = flown
    assert table.height == 2 * 2 * 2 * 2
    assert set(table["reality"]) == {"near-7", "far-7"}
    assert set(table["training_rate"]) == {100}
    assert (
        table.group_by("motor_time_constant", "number", "reality").len()["len"].to_list() == [2] * 8
    )
    # At 25 Hz a flight lasts a whole number of 40 ms.
    periods = table["duration"].to_numpy() / 0.04
    np.testing.assert_allclose(periods, np.round(periods), atol=1e-6)
    assert said == [
        "0/2 training attitude_40ms",
        "1/2 training attitude_80ms",
        "2/2 flying",
    ]


@pytest.mark.slow
def test_policies_are_kept_as_they_were_trained(flown: Any) -> None:
    folder, _, _ = flown
    files = sorted((folder / "made" / "policies").glob("*/*.json"))
    assert len(files) == 4
    kept = [policy_file.read(file).policy for file in files]
    assert {(one.interface.name, one.interface.rate, one.layer_sizes) for one in kept} == {
        ("attitude", 100, (40, 8, 4))
    }
    assert len({np.asarray(one.weights[0]).tobytes() for one in kept}) == 4
    assert policy_file.read(files[0]).record["settings"]["training_rate"] == 100


@pytest.mark.slow
def test_what_was_interrupted_goes_on_to_the_same_table(
    flown: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, _, _ = flown
    asked, table = matrix_file.read(folder / "matrix.toml"), folder / "made" / "flights.csv"
    before = table.read_bytes()
    trained: list[Cell] = []
    train_cells = matrix.train_cells

    def counted(asked: Any, cells: list[Cell], *rest: Any) -> Any:
        trained.extend(cells)
        return train_cells(asked, cells, *rest)

    monkeypatch.setattr(matrix, "train_cells", counted)
    workflow.transfer_matrix(asked, folder / "made")
    assert trained == [], "the table is there"
    table.unlink()
    (folder / "made" / "policies" / "attitude_80ms_0ms" / "policy_2.json").unlink()
    workflow.transfer_matrix(asked, folder / "made")
    assert trained == [Cell("attitude", 0.08, 0.0)]
    assert table.read_bytes() == before
    assert unlisted(folder, but=["matrix.toml"]) == set()
    assert entries(folder) == {("transfer", "made"): {"flights", "policies"}}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("policies = 2", "policies = 1"),
        ("updates = 2", "updates = 3"),
        ("policies", "drone = 'd.toml'\npolicies"),
    ],
)
def test_other_settings_in_the_same_folder_are_refused(
    flown: Any, monkeypatch: pytest.MonkeyPatch, old: str, new: str
) -> None:
    folder, _, _ = flown
    monkeypatch.chdir(folder)
    parameters.write("d.toml", parameters.crazyflie(), {})
    asked = matrix_file.read(put(folder / "other", TINY.replace(old, new)))
    with pytest.raises(InputError, match=r"policy_1\.json: from a run with other settings"):
        workflow.transfer_matrix(asked, "made")


def test_the_cells_of_a_table() -> None:
    table = polars.DataFrame(
        {
            "reality": ["x"] * 4,
            "control": ["pwm"] * 4,
            "motor_time_constant": [0.04] * 4,
            "latency": [0.0] * 4,
            "number": [1, 1, 2, 2],
            "duration": [20.0, 1.0, 2.0, 3.0],
        }
    )
    (row,) = matrix.by_cell(table).to_dicts()
    assert (row["policies"], row["flights"], row["mean"], row["median"], row["share"]) == (
        2,
        4,
        6.5,
        2.5,
        0.25,
    )


def test_a_sketch_is_shorter_and_a_cell_says_what_it_depends_on() -> None:
    paper = matrix_file.read(PAPER / "zero_shot.toml")
    small = paper.sketch()
    assert small.policies == 1
    assert {kind: one.updates for kind, one in small.controls.items()} == {
        "pwm": 266,
        "attitude_rate": 200,
        "attitude": 200,
    }
    cell = paper.cells[4]
    assert cell.name == "pwm_80ms_15ms"
    assert json.loads(json.dumps(paper.said(cell))) == paper.said(cell)
    assert small.said(cell) != paper.said(cell)
