"""Pictures of an identification: what is marked lies where it should, and odd data draw something
or are refused."""

import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import polars
import pytest

from maidenflight.errors import InputError
from maidenflight.identification import surrogate
from maidenflight.identification.drone_file import Estimate
from maidenflight.identification.prediction import LOGGED, PERSISTENCE
from maidenflight.parameters import COMPONENTS
from maidenflight.reporting import svg, text
from maidenflight.reporting.corner_figure import MOST, corner
from maidenflight.reporting.delay_figures import loss_landscape
from maidenflight.reporting.prediction_figures import horizons
from maidenflight.reporting.prediction_figures import windows as window_figure
from maidenflight.reporting.sections import NARROW, WIDE

SVG = "{http://www.w3.org/2000/svg}"
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


def panels(picture):
    """Panels by name; that this parses is half of each test."""
    found = [
        part
        for part in ElementTree.fromstring(picture).iter(f"{SVG}svg")
        if "data-panel" in part.attrib
    ]
    return {part.attrib["data-panel"]: part for part in found}


def paths(panel, colour):
    return [
        part.attrib["d"]
        for part in panel.iter(f"{SVG}path")
        if f"--{colour})" in part.attrib.get("style", "")
    ]


def points(path):
    return np.array(
        [[float(number) for number in pair.split()] for pair in re.split("[ML]", path) if pair]
    )


def ticked(picture, panel, vertical):
    """Value and pixel within a panel of the numbers along one of its axes, as they are written."""
    left, top = (float(panel.attrib[name]) for name in "xy")
    found = []
    for part in ElementTree.fromstring(picture).findall(f"{SVG}text"):
        if "x" in part.attrib and re.fullmatch(r"-?[\d.]+", part.text or ""):
            x, y = float(part.attrib["x"]), float(part.attrib["y"])
            below = y > top + float(panel.attrib["height"])
            if below != vertical:
                found.append((float(part.text or ""), y - 4.5 - top if vertical else x - left))
    return np.array(found)


@pytest.mark.parametrize("width", [NARROW, WIDE])
def test_the_optimum_is_where_the_axes_say(width):
    picture = loss_landscape(search(), ESTIMATES, width=width)
    panel = panels(picture)["delays"]
    middle = (
        points(paths(panel, "orange")[0]).mean(axis=0),
        points(paths(panel, "orange")[1]).mean(axis=0),
    )
    for value, vertical in ((80 * 1.005, False), (14 * 1.005, True)):  # an interval's middle
        labels = ticked(picture, panel, vertical)
        assert len(labels) >= 3
        slope, offset = np.polyfit(labels[:, 0], labels[:, 1], 1)
        assert abs(slope * value + offset - middle[int(vertical)][int(vertical)]) < 1.5


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
    picture = loss_landscape(rows)
    assert "No contours" in picture
    assert "fitted" not in picture
    panels(picture)


def test_a_table_without_a_valley_is_refused():
    with pytest.raises(InputError, match="no column latency"):
        loss_landscape(search().drop("latency"))
    with pytest.raises(InputError, match="finite objective"):
        loss_landscape(search().with_columns(objective=polars.lit(float("nan"))))
    with pytest.raises(InputError, match="likelihoods"):
        loss_landscape(search().with_columns(objective=polars.col("objective") - 61))


@pytest.mark.parametrize("count", [1, 2, 3, 8])
def test_a_panel_for_each_pair_and_each_parameter(count):
    names = list(COMPONENTS)[:count]
    found = panels(corner(draws(names), width=WIDE))
    assert set(found) == {
        f"{across} {up}" for row, up in enumerate(names) for across in names[: row + 1]
    }


def test_a_large_posterior_is_cut_to_what_can_be_read():
    picture = corner(draws(list(COMPONENTS)[:15]), width=WIDE)
    found = panels(picture)
    assert len(found) == MOST * (MOST + 1) / 2
    assert min(float(panel.attrib["width"]) for panel in found.values()) > 100
    assert f"draws of {MOST} parameters, those of its 15" in picture


def test_the_posterior_marks_optimum_and_correlation():
    drawn = draws(NAMES)
    best = {name: float(np.median(values)) for name, values in drawn.items()}
    picture = corner(drawn, best)
    for row, upward in enumerate(NAMES):
        for across in NAMES[:row]:
            panel = panels(picture)[f"{across} {upward}"]
            upright, level = map(points, paths(panel, "orange"))
            dots = np.array(
                [
                    [float(n) for n in dot.split()]
                    for dot in re.findall(r"M([\d. ]+)h0", paths(panel, "blue")[0])
                ]
            )
            # The optimum is the median of both, so its lines halve the dots.
            np.testing.assert_allclose(
                [upright[0, 0], level[0, 1]], np.median(dots, axis=0), atol=0.3
            )
            told = "".join(panel.itertext()).replace("\N{MINUS SIGN}", "-")
            assert float(told) == pytest.approx(
                np.corrcoef(drawn[across], drawn[upward])[0, 1], abs=0.006
            )


def test_a_narrow_posterior_keeps_the_strongest_correlations_and_says_so():
    names = list(COMPONENTS)[:12]
    drawn = {
        name: np.random.default_rng(number).normal(size=200) for number, name in enumerate(names)
    }
    drawn[names[9]] = drawn[names[3]] + 0.1 * drawn[names[9]]
    picture = corner(drawn, width=NARROW)
    found = panels(picture)
    assert f"{names[3]} {names[9]}" in found
    assert len(found) == 10
    assert "200 draws of 4 parameters, those of its 12" in re.sub(
        r"</text><text[^>]*>", " ", picture
    )


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
def test_odd_draws_make_a_picture_without_nan(drawn):
    for optimum in (None, {"latency": 0.05}):
        picture = corner(drawn, optimum)
        panels(picture)
        assert not re.search(r"nan|inf\b", picture.split("</style>")[1])


def test_draws_that_do_not_belong_together_are_refused():
    for drawn in ({}, {"latency": np.empty(0)}, {"latency": np.ones(3), "mass": np.ones(2)}):
        with pytest.raises(InputError, match="as many draws"):
            corner(drawn)
    with pytest.raises(InputError, match="not finite"):
        corner({"latency": np.array([0.01, np.nan])})


def test_errors_grow_in_four_panels_and_names_cannot_become_markup():
    picture = horizons(errors())
    found = panels(picture)
    assert set(found) == {"position", "velocity", "attitude", "body_rates"}
    assert "mine &lt;1&gt;" in picture
    for panel in found.values():
        (mine,) = [
            points(path)
            for path in paths(panel, "orange")
            if not path.endswith("Z") and "L" in path
        ]
        (still,) = [
            points(path) for path in paths(panel, "soft") if not path.endswith("Z") and "L" in path
        ]
        ground = mine[0, 1]
        np.testing.assert_allclose((ground - still[1:, 1]) / (ground - mine[1:, 1]), 2.0, rtol=0.02)


def test_windows_as_many_as_fit():
    wide, narrow = (
        window_figure(windows(), WIDE),
        window_figure(windows(), NARROW),
    )
    assert len(panels(wide)) == 5 * 4
    assert len(panels(narrow)) == 5 * 2
    assert "Predicted windows, 2 of 4" in narrow
    heights = points(paths(panels(wide)["position_z 1"], "orange")[0])[:, 1]
    assert heights[0] > heights[-1], "what climbs goes up"


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
