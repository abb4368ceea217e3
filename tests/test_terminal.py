"""Progress bars, whose clock counts, and tables."""

import itertools
import re
from typing import Any

import laid_out
from maidenflight.terminal import Bar, Table, show


def test_the_clock_of_a_bar_counts_on_when_its_total_becomes_unknown(
    monkeypatch: Any, capsys: Any
) -> None:
    clock = itertools.count(0, 7)
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setattr("rich.console.monotonic", lambda: next(clock))
    with Bar("try", remaining=False) as bar:
        bar.move(5, 10, "half")
        bar.move(0, None, "unknown")
        bar.move(1, 2, "half again")
    shown = re.findall(r"\d:\d\d:\d\d", capsys.readouterr().err)
    assert shown == sorted(shown)
    assert shown[-1] > "0:00:07"


def test_cells_show_si_values_in_the_units_of_people(capsys: Any) -> None:
    columns = {"policy": "{name}", "error": "{error:.1f cm}", "time": "{time:.2f s}"}
    columns |= {"reached": "{done} of {flights}", "tilt": "{tilt:.0f deg}"}
    rows = [
        {"name": "a", "error": 0.013, "time": 19.2, "done": 8, "flights": 9, "tilt": 0.5},
        {"name": "b", "error": float("nan"), "time": None, "done": 0, "flights": 9, "tilt": 0.0},
    ]
    table = Table("Flights", columns, rows)
    assert table.cells == [
        ["a", "1.3 cm", "19.20 s", "8 of 9", "29 deg"],
        ["b", "none", "", "0 of 9", "0 deg"],
    ]
    show("first", table)
    lines = capsys.readouterr().out.splitlines()
    assert [line.strip() for line in lines[:3]] == ["first", "", "Flights"]
    assert re.search(r"a +1\.3 cm +19\.20 s +8 of 9 +29 deg", "\n".join(lines))


def test_a_narrow_terminal_leaves_out_rare_columns_and_folds_prose_between_words(
    monkeypatch: Any, capsys: Any
) -> None:
    columns = {"policy": "{name}", "mean duration": "{time}", "farthest": "{far}", "end": "{end}"}
    row = {"name": "runs/circle/policy_1", "time": 19.25, "far": "12 cm", "end": "a guard of tilt"}
    table = Table("Flights", columns, [row], rare=("farthest",))
    laid_out.check((table, "best: runs/circle/policy_1.json, which flies longest of all that flew"))
    monkeypatch.setenv("COLUMNS", "50")
    show(table)
    shown = capsys.readouterr().out
    assert "too narrow for: farthest." in shown
    assert "12 cm" not in shown
    assert all(word in shown for word in ("runs/circle/policy_1", "19.25"))
    monkeypatch.setenv("COLUMNS", "70")
    show(table)
    assert "12 cm" in capsys.readouterr().out


def test_lines_are_broken_only_where_there_are_columns_and_never_within_a_path(
    monkeypatch: Any, capsys: Any
) -> None:
    line = f"written: {'logs/' * 20}flight.csv and other files"
    show(line)
    assert capsys.readouterr().out == f"{line}\n", "a pipe has no columns"
    monkeypatch.setenv("COLUMNS", "40")
    show(line)
    assert line.split() == capsys.readouterr().out.split()
    with Bar("try") as bar:
        bar.note("a note of more than forty letters, that has to go into two lines")
    assert max(map(len, capsys.readouterr().err.splitlines())) <= 40
