"""The scripts that redo the paper's tables run, on little."""

import importlib.util
from pathlib import Path
from typing import Any

import polars
import pytest

from maidenflight.flights import log

PAPER = Path(__file__).parents[1] / "paper"


@pytest.fixture(scope="module")
def table_2() -> Any:
    specification = importlib.util.spec_from_file_location("table_2", PAPER / "table_2.py")
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def test_table_2_stands_beside_the_papers_and_the_truth(table_2: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Virtual flights and, from files, others in two folders, of which one is called as a control structure is."""
    (flight,) = table_2.virtual_flights(7, 1, 6.0)
    log.write(tmp_path / "logs" / "pwm" / "flight.csv", flight, {})
    small = ["--small", "--lengths", "30", "--trials", "1", "--flights", "1", "--evaluations", "12"]
    table_2.main([*small, "--logs", str(tmp_path / "logs"), "-o", str(tmp_path / "made")])
    told = capsys.readouterr().out
    data = polars.read_csv(tmp_path / "made" / "table_2.csv", comment_prefix="#")
    assert data.height == 2 * 2 * 3
    assert set(data["flights"]) == {"virtual", "pwm"}
    assert data.filter(polars.col("flights") == "virtual")["truth"].null_count() == 0
    assert data.filter(polars.col("flights") == "pwm")["truth"].null_count() == 6
    assert (data["low"] <= data["value"]).all()
    assert (data["objective_at_paper"] > 0).all()
    text = (tmp_path / "made" / "table_2.md").read_text()
    for words in ("1.725 +- 0.0018", "88.0 +- 0.60", "18.0 +- 0.30", "paper's lies", "28 g"):
        assert words in told
        assert words in text


def test_a_value_lies_below_inside_or_above_an_interval(table_2: Any) -> None:
    assert [table_2.where(value, 1.0, 2.0) for value in (0.9, 1.0, 1.5, 2.0, 2.1)] == ["below", "inside", "inside", "inside", "above"]
