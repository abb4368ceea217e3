"""Progress bars, whose clock counts, and tables."""

import itertools
import re
from typing import Any

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
