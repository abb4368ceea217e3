"""Errors of predictions and predicted windows: what is drawn is what was predicted."""

import numpy as np
import polars
import pytest

from drawn import of, rows, titles
from maidenflight.identification.replay.prediction import LOGGED, PERSISTENCE
from maidenflight.reporting.figures.predictions import horizons
from maidenflight.reporting.figures.predictions import windows as window_figure


def errors():
    rows = []
    for horizon in (0.1, 0.5):
        for slope, name in enumerate(("mine <1>", PERSISTENCE), 1):
            each = dict.fromkeys(
                ("position", "velocity", "attitude", "body_rates"), slope * horizon
            )
            ends = {
                f"{column}{end}": value * k
                for column, value in each.items()
                for end, k in (("_low", 0.9), ("_high", 1.1))
            }
            rows.append({"model": name, "horizon": horizon, **each, **ends})
    return polars.DataFrame(rows)


def windows(count=4):
    columns = ("position_z", "roll", "pitch", "body_rate_x", "body_rate_y")
    time = np.arange(51) * 0.01
    parts = [
        polars.DataFrame(
            {
                "window": [window] * 51,
                "model": [model] * 51,
                "time": time,
                **dict.fromkeys(columns, 1 + size * time),
            }
        )
        for window in range(1, count + 1)
        for size, model in enumerate((LOGGED, "mine"))
    ]
    return polars.concat(parts)


def test_errors_grow_in_four_panels_and_names_cannot_become_markup():
    figure = horizons(errors())
    assert len(figure.panels) == 4
    assert "mine <1>" not in str(figure.json)
    for panel in range(4):
        mine, still = (
            {row["x"]: row["y"] for row in of(figure, panel, series=name)}
            for name in ("mine <1>", PERSISTENCE)
        )
        assert list(mine) == [0.0, 0.1, 0.5]
        for ahead in (0.1, 0.5):
            assert still[ahead] == pytest.approx(2 * mine[ahead], rel=1e-4)
        [row] = of(figure, panel, series="mine <1>", x=0.5)
        assert (row["low"], row["high"]) == pytest.approx((0.9 * row["y"], 1.1 * row["y"]))


def test_a_column_a_window_and_heights_from_its_start():
    figure = window_figure(windows())
    assert (len(figure.panels), figure.columns) == (5 * 4, 4)
    assert titles(figure)[0] == "roll [°]"
    heights = of(figure, 16, series="mine")
    assert heights[0]["y"] == 0.0
    assert heights[-1]["y"] == pytest.approx(50.0), "in cm"
    assert {row["series"] for row in rows(figure)} == {LOGGED, "mine"}
