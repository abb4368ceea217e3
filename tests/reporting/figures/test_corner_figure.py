"""The corner plot: what is marked is what was found, odd draws are drawn or refused."""

import json
import re

import numpy as np
import pytest

from maidenflight.errors import InputError
from maidenflight.parameters import COMPONENTS
from maidenflight.reporting import text
from maidenflight.reporting.figures.corner import MAX_PARAMETERS, corner

NAMES = ["thrust_to_weight", "motor_time_constant", "latency"]


def draws(names, count=150):
    mixed = np.random.default_rng(1).normal(size=(len(names), len(names)))
    values = mixed @ np.random.default_rng(2).normal(size=(len(names), count))
    return {name: 0.01 + 1e-4 * row for name, row in zip(names, values, strict=True)}


def cells(figure):
    """Cells of a corner plot, by row."""
    [panel] = figure.panels
    return [line["hconcat"] for line in panel["vconcat"]]


@pytest.mark.parametrize("count", [1, 2, 3, 8])
def test_a_cell_for_each_pair_and_each_parameter(count):
    names = list(COMPONENTS)[:count]
    figure = corner(draws(names))
    assert [len(line) for line in cells(figure)] == list(range(1, count + 1))
    assert list(figure.panels[0]["data"]["columns"]) == names
    assert {len(column) for column in figure.panels[0]["data"]["columns"].values()} == {150}


def test_of_a_large_posterior_the_strongest_correlations_are_shown():
    names = list(COMPONENTS)[:12]
    drawn = {
        name: np.random.default_rng(number).normal(size=300) for number, name in enumerate(names)
    }
    drawn[names[9]] = drawn[names[3]] + 0.1 * drawn[names[9]]
    figure = corner(drawn)
    columns = figure.panels[0]["data"]["columns"]
    assert len(columns) == MAX_PARAMETERS
    assert {names[3], names[9]} <= columns.keys()
    assert len(columns[names[3]]) == 200, "of 300 draws"
    assert f"300 draws of {MAX_PARAMETERS} parameters, those of its 12" in figure.title


def test_the_posterior_marks_optimum_and_correlation():
    drawn = draws(NAMES)
    best = {name: float(np.median(values)) for name, values in drawn.items()}
    for row, line in enumerate(cells(corner(drawn, best))):
        for across, cell in enumerate(line[:-1]):
            _, upright, level, words = cell["layer"]
            scale, _ = text.scale(NAMES[across], drawn[NAMES[across]])
            [place] = upright["data"]["columns"][NAMES[across]]
            assert place == pytest.approx(scale * best[NAMES[across]], rel=1e-5)
            assert NAMES[row] in level["data"]["columns"]
            told = float(words["mark"]["text"].replace("\N{MINUS SIGN}", "-"))
            correlation = np.corrcoef(drawn[NAMES[across]], drawn[NAMES[row]])[0, 1]
            assert told == pytest.approx(correlation, abs=0.006)
            assert (words["mark"]["fontWeight"] == "bold") == (abs(correlation) >= 0.5)
        bars = line[-1]["layer"][1]["data"]["columns"]
        assert sum(bars["count"]) == 150


@pytest.mark.parametrize(
    "drawn",
    [
        {"latency": np.full(100, np.float32(0.018))},
        {"latency": np.array([0.0])},
        {"latency": np.zeros(100), "thrust_offset": np.linspace(-1, 1, 100)},
        {
            "motor_time_constant": np.linspace(0.08, 0.09, 100),
            "latency": 0.1 - np.linspace(0.08, 0.09, 100),
        },
        {"inertia_x": np.array([1e-5, np.float32(1e-5)]), "inertia_z": np.array([1e-5, 9e3])},
    ],
    ids=["all equal", "one draw of zero", "one fixed", "on a line", "far apart"],
)
def test_odd_draws_make_a_figure_without_nan(drawn):
    for optimum in (None, {"latency": 0.05}):
        text = str(corner(drawn, optimum).json)
        assert json.loads(text)["panels"]
        assert not re.search(r"NaN|Infinity", text)


def test_draws_that_do_not_belong_together_are_refused():
    for drawn in ({}, {"latency": np.empty(0)}, {"latency": np.ones(3), "mass": np.ones(2)}):
        with pytest.raises(InputError, match="as many draws"):
            corner(drawn)
    with pytest.raises(InputError, match="not finite"):
        corner({"latency": np.array([0.01, np.nan])})
