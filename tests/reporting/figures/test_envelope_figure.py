"""The picture of an envelope: what is drawn is what was flown."""

import math

import polars
import pytest

from drawn import of
from maidenflight.reporting.figures.envelope import envelope

ROW = {"policy": "one", "reality": "virtual:7", "hardest": 3.0, "limit": 2.0}


def test_a_panel_an_axis_with_what_is_flown_and_what_does_not_fly() -> None:
    summary = polars.DataFrame(
        [
            {**ROW, "axis": "circle", "envelope": 1.0, "low": 0.9, "high": 1.1},
            {**ROW, "axis": "latency", "envelope": math.nan, "low": math.nan, "high": math.nan},
        ]
    )
    figure = envelope(summary)
    assert len(figure.panels) == 2
    [bar], [interval], [limit] = (of(figure, kind=kind) for kind in ("bar", "whisker", "line"))
    assert (bar["x"], bar["x2"]) == (0.0, 1.0)
    assert (interval["x"], interval["x2"]) == (0.9, 1.1)
    assert limit["x"] == 2.0
    assert bar["key"].endswith("one in virtual:7\t1 [0.9, 1.1], 50%")
    [limit] = of(figure, 1)
    assert limit["key"].endswith("does not fly")
    assert limit["x"] == pytest.approx(2000.0), "in ms"
