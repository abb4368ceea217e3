"""Pictures of an identification: what is marked is what was found, and odd data draw something
or are refused."""

import json
import re

import numpy as np
import polars
import pytest
from drawn import of, rows, titles

from maidenflight.errors import InputError
from maidenflight.identification.drone_file import Estimate
from maidenflight.identification.outcome import surrogate
from maidenflight.identification.replay.prediction import LOGGED, PERSISTENCE
from maidenflight.parameters import COMPONENTS
from maidenflight.reporting import svg, text
from maidenflight.reporting.corner_figure import MOST, corner
from maidenflight.reporting.delay_figures import delay_posterior, loss_landscape
from maidenflight.reporting.prediction_figures import horizons
from maidenflight.reporting.prediction_figures import windows as window_figure

BEST = np.array([1.7, 0.080, 0.014])
NAMES = ["thrust_to_weight", "motor_time_constant", "latency"]
HESSIAN = np.array([[9.0, 3.0, 1.0], [3.0, 6.0, 2.0], [1.0, 2.0, 4.0]]) / np.outer(
    [0.03, 0.004, 0.001], [0.03, 0.004, 0.001]
)
ESTIMATES = {
    name: Estimate(float(value), (float(0.98 * value), float(1.03 * value)), (float(value),), 0.0)
    for name, value in zip(NAMES, BEST, strict=True)
}


def search(count=200, wide=1.0):
    """Evaluations of a quadratic with its minimum, 60, at BEST."""
    points = BEST + np.random.default_rng(0).normal(size=(count, 3)) * wide * [0.01, 0.0015, 0.0004]
    points[0] = BEST
    rise = np.einsum("ni,ij,nj->n", points - BEST, HESSIAN, points - BEST) / 2
    return polars.DataFrame(
        {
            "trial": [0] * count,
            **dict(zip(NAMES, points.T, strict=True)),
            "objective": 60 * (1 + rise / 100),
        }
    )


def draws(names, count=150):
    mixed = np.random.default_rng(1).normal(size=(len(names), len(names)))
    values = mixed @ np.random.default_rng(2).normal(size=(len(names), count))
    return {name: 0.01 + 1e-4 * row for name, row in zip(names, values, strict=True)}


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


def cells(figure):
    """Cells of a corner plot, by row."""
    [panel] = figure.panels
    return [line["hconcat"] for line in panel["vconcat"]]


def test_the_optimum_its_interval_and_the_paper_are_marked():
    figure, note = loss_landscape(search(), ESTIMATES, [(0.08, 0.014), (0.1, 0.02)])
    [best] = of(figure, mark="identified")
    assert (best["x"], best["y"]) == pytest.approx((80.0, 14.0))
    [lag] = of(figure, bar="x")
    assert (lag["x"], lag["x2"], lag["y2"]) == pytest.approx((78.4, 82.4, 14.0))
    [paper] = of(figure, series="paper")
    assert (paper["x"], paper["y"]) == pytest.approx((88.0, 18.0))
    assert [row["x"] for row in of(figure, series="truth")] == pytest.approx([80.0, 100.0, 80.0])
    assert all(row["x"] + row["y"] == pytest.approx(94.0) for row in of(figure, series="total"))
    assert "fitted to the" in note
    assert sum(row["series"] in ("low", "middle", "high") for row in rows(figure)) == 200


def test_a_contour_is_where_the_objective_is_that_much_higher_with_the_others_at_their_best():
    found = surrogate.valley(
        search().select(NAMES).to_numpy(), search()["objective"].to_numpy(), [1, 2]
    )
    assert found is not None
    assert found.error < 1e-6
    assert abs(found.lowest) < 1e-6
    np.testing.assert_allclose(found.centre, BEST[1:], rtol=1e-6)
    for place in found.contour(BEST[1:], 1.0)[::10] - BEST[1:]:
        other = -HESSIAN[0, 1:] @ place / HESSIAN[0, 0]
        whole = np.array([other, *place])
        np.testing.assert_allclose(whole @ HESSIAN @ whole / 2, 1.0, rtol=1e-4)


@pytest.mark.parametrize(
    "rows",
    [
        search(12),
        search().with_columns(latency=polars.lit(0.018)),
        search().with_columns(objective=polars.lit(60.0)),
        search().with_columns(objective=120 - polars.col("objective").clip(0, 62)),
        search().with_columns(objective=60 + (polars.col("latency") - 0.014).abs() * 1e4),
        search(1),
    ],
    ids=["few", "on a line", "flat", "a hill", "a kink", "one"],
)
def test_no_contours_where_no_quadratic_fits(rows):
    figure, note = loss_landscape(rows)
    assert "No contours" in note
    assert of(figure, series="contours") == []
    assert len(of(figure, mark="best evaluation")) == 1


def test_a_table_without_a_valley_is_refused():
    with pytest.raises(InputError, match="no column latency"):
        loss_landscape(search().drop("latency"))
    with pytest.raises(InputError, match="finite objective"):
        loss_landscape(search().with_columns(objective=polars.lit(float("nan"))))
    with pytest.raises(InputError, match="likelihoods"):
        loss_landscape(search().with_columns(objective=polars.col("objective") - 61))


def test_the_ellipses_hold_their_shares_of_the_samples():
    drawn = dict(zip(NAMES, BEST[:, None] + draws(NAMES)["latency"] * 0.1, strict=True))
    spread = np.random.default_rng(3).normal(size=(2, 4000))
    drawn |= {"motor_time_constant": 0.08 + 1e-3 * spread[0], "latency": 0.014 + 1e-4 * spread[1]}
    figure = delay_posterior(drawn, ESTIMATES)
    points = np.array([[row["x"], row["y"]] for row in of(figure, series="sample")])
    centre = points.mean(axis=0)
    for share, name in ((0.5, "50 %"), (0.95, "95 %")):
        curve = np.array([[row["x"], row["y"]] for row in of(figure, curve=name)]) - centre
        axes = np.abs(curve).max(axis=0)
        inside = (((points - centre) / axes) ** 2).sum(axis=1) < 1
        assert inside.mean() == pytest.approx(share, abs=0.03)


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
    assert len(columns) == MOST
    assert {names[3], names[9]} <= columns.keys()
    assert len(columns[names[3]]) == 200, "of 300 draws"
    assert f"300 draws of {MOST} parameters, those of its 12" in figure.title


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


def test_ticks_are_round_within_the_range_and_few():
    for low, high in [(0, 1), (-3.7, 12), (64.31, 64.37), (1e-7, 3e-7), (-5e6, 1e6)]:
        for most in (2, 3, 6):
            places, names = svg.ticks(low, high, most)
            assert 1 <= len(places) <= most
            assert all(low - 1e-9 * abs(low) <= place <= high * (1 + 1e-9) for place in places)
            told = [float(name.replace("\N{MINUS SIGN}", "-")) for name in names]
            np.testing.assert_allclose(told, places, atol=1e-6 * (high - low))


def test_components_have_symbols_and_units_with_powers():
    assert text.symbol("inertia_x") == "I<sub>x</sub>"
    assert text.scale("inertia_x", [1.33e-5]) == (pytest.approx(1e6), "10⁻⁶ kg m²")
    assert text.scale("latency", [0.018]) == (1000.0, "ms")
    assert text.scale("thrust_to_weight", [1.7]) == (1.0, "")
