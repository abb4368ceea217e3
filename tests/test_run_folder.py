"""Tables of a run folder read back as they were written, and damaged ones are refused."""

import dataclasses
import math

import polars
import pytest

from maidenflight import run_folder
from maidenflight.errors import InputError
from maidenflight.run_folder import Numbered, Table

TABLES = [value for value in vars(run_folder).values() if isinstance(value, Table)]
VALUES = {int: [3, 4], float: [0.5, math.nan], str: ["a, b", ""]}
RECORD = {"version": "0.1.0", "seed": 7, "settings": {"trials": 2}}


def rows_of(table: Table) -> polars.DataFrame:
    """Two rows; times are numbers, for a time is always known."""
    return polars.DataFrame(
        {
            name: [0.5, 1.5] if name in table.times else VALUES[kind]
            for name, kind in table.columns.items()
        }
    )


@pytest.mark.parametrize("table", TABLES, ids=lambda table: f"{table.name}-{len(table.columns)}")
def test_a_table_reads_back_as_it_was_written(table, tmp_path):
    written = rows_of(table)
    path = table.write(tmp_path / table.name, written, RECORD)
    rows, record = table.read(path)
    assert rows.fill_nan(None).equals(written.fill_nan(None))
    assert record == (RECORD if table.heading else {})


@pytest.mark.parametrize("table", TABLES, ids=lambda table: f"{table.name}-{len(table.columns)}")
def test_a_table_without_one_of_its_columns_is_neither_written_nor_read(table, tmp_path):
    first = next(iter(table.columns))
    rows = rows_of(table).with_columns(more=1).drop(first)
    with pytest.raises(ValueError, match=first):
        table.write(tmp_path / table.name, rows, {})
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(InputError, match=first):
        table.checked(rows, table.name)


@pytest.mark.parametrize(
    ("rows", "value"),
    [
        ("1,a\nx,b\n", "x"),
        ("1e16,a\n", "1e"),
        ("1,a,3\n", "a"),
        ("1,a\n2,b", "cut"),
        ("", "rows"),
    ],
)
def test_a_damaged_table_is_refused(tmp_path, rows, value):
    (tmp_path / "t.csv").write_text(f"size,name\n{rows}")
    with pytest.raises(InputError, match=value):
        Table("t.csv", {"size": float, "name": str}).read(tmp_path / "t.csv")


def test_a_time_is_not_negative(tmp_path):
    times = Table("t.csv", {"duration": float})
    with pytest.raises(InputError, match=r"-0\.5"):
        times.checked(polars.DataFrame({"duration": [1.0, -0.5]}), "t.csv")
    assert dataclasses.replace(times, times=()).checked(
        polars.DataFrame({"duration": [-0.5]}), "t.csv"
    )["duration"].to_list() == [-0.5]


def test_numbered_files_are_found_in_their_order(tmp_path):
    files = Numbered("flight", ".csv")
    for number in (10, 9, 1):
        files.path(tmp_path, number).write_text("")
    (tmp_path / "flights.csv").write_text("")
    assert [path.name for path in files.find(tmp_path)] == [
        "flight_1.csv",
        "flight_9.csv",
        "flight_10.csv",
    ]


@pytest.mark.parametrize(
    ("drone", "evaluations"),
    [("drone.toml", "identification.csv"), ("a/mine.toml", "a/mine_identification.csv")],
)
def test_evaluations_lie_beside_their_drone(drone, evaluations):
    assert run_folder.evaluations_path(drone).as_posix() == evaluations
