"""Learning curves: mean and range lie where the axes say, and odd scores draw something or are
refused."""

import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import polars
import pytest

from maidenflight.errors import InputError
from maidenflight.reporting import training_figures
from maidenflight.reporting.training_figures import learning_curves

SVG = "{http://www.w3.org/2000/svg}"


def training(returns, **changes):
    """Scores of policies: a row of `returns` a score, a column a policy."""
    rows = [
        {
            "update": 10 * score,
            "steps": 2e6 * score,
            "policy": policy,
            "episode_return": value,
            "survival": 0.5,
            "position_error": 0.1,
        }
        for score, values in enumerate(returns, 1)
        for policy, value in enumerate(values, 1)
    ]
    return polars.DataFrame(rows).with_columns(**changes)


def panels(picture):
    """Panels by name; that this parses is half of each test."""
    found = [
        part
        for part in ElementTree.fromstring(picture).iter(f"{SVG}svg")
        if "data-panel" in part.attrib
    ]
    return {part.attrib["data-panel"]: part for part in found}


def paths(panel, look):
    """Corners of the paths of a look [px]."""
    drawn = [part.attrib["d"] for part in panel.iter(f"{SVG}path") if part.attrib["class"] == look]
    return [
        np.array(
            [[float(number) for number in pair.split()] for pair in re.findall(r"[^MLZ]+", path)]
        )
        for path in drawn
    ]


def words(picture):
    return [part.text for part in ElementTree.fromstring(picture).iter(f"{SVG}text")]


def test_the_mean_lies_within_the_range_of_the_policies_and_all_are_drawn():
    returns = np.array([[-90.0, -60.0, -30.0], [-20.0, -20.0, -5.0], [-8.0, -9.0, -10.0]])
    panel = panels(learning_curves({"circle": training(returns)}))["circle episode_return"]
    (mean,), (band,), each = (
        paths(panel, "line"),
        paths(panel, "filled faint"),
        paths(panel, "line thin faded"),
    )
    assert len(each) == 3
    there, back = band[:3, 1], band[:2:-1, 1]
    np.testing.assert_array_equal(there, np.max([policy[:, 1] for policy in each], axis=0))
    np.testing.assert_array_equal(back, np.min([policy[:, 1] for policy in each], axis=0))
    np.testing.assert_allclose(
        mean[:, 1], np.mean([policy[:, 1] for policy in each], axis=0), atol=0.1
    )
    np.testing.assert_allclose(np.diff(mean[:, 0]), mean[0, 0], atol=0.11)
    assert np.all(np.diff(mean[:, 1]) < 0), "better is higher up"


def test_a_range_is_as_high_as_the_axis_says():
    picture = learning_curves(
        {"circle": training([[-80.0, -20.0], [-10.0, 0.0]])}, ["episode_return"]
    )
    (band,) = paths(panels(picture)["circle episode_return"], "filled faint")
    told = [
        part
        for part in ElementTree.fromstring(picture).findall(f"{SVG}text")
        if part.attrib["text-anchor"] == "end"
    ]
    levels = {
        float((part.text or "").replace("\N{MINUS SIGN}", "-")): float(part.attrib["y"])
        for part in told
    }
    pixels_a_unit = (levels[-60] - levels[-20]) / 40
    assert band[0, 1] - band[-1, 1] == pytest.approx(60 * pixels_a_unit, abs=0.2)


def test_a_score_that_is_not_finite_breaks_its_line_and_leaves_the_others():
    lost = training([[-9.0, float("nan")], [float("inf"), float("nan")], [-8.0, -7.0]])
    panel = panels(learning_curves({"circle": lost}))["circle episode_return"]
    (mean,), (band,) = paths(panel, "line"), paths(panel, "filled faint")
    assert len(mean) == 2
    assert len(band) == 4
    nothing = training([[float("nan"), float("nan")]])
    panel = panels(learning_curves({"circle": nothing}))["circle episode_return"]
    assert paths(panel, "line") == []


@pytest.mark.parametrize(("width", "columns"), [(343, 1), (720, 3), (1072, 4)])
def test_a_panel_a_recipe_as_many_side_by_side_as_fit(width, columns):
    trainings = {f"recipe {number}": training([[-9.0, -8.0], [-4.0, -6.0]]) for number in range(7)}
    picture = learning_curves(trainings, ["episode_return"], "update", width, "Recipes <all>")
    found = panels(picture)
    assert len(found) == 7
    assert len({panel.attrib["x"] for panel in found.values()}) == columns
    assert (
        max(float(panel.attrib["x"]) + float(panel.attrib["width"]) for panel in found.values())
        <= width
    )
    assert {"Recipes <all>", "recipe 6", "updates"} <= set(words(picture))


def test_one_policy_needs_no_range():
    picture = learning_curves({"circle": training([[-9.0], [-4.0]])})
    assert all(paths(panel, "filled faint") == [] for panel in panels(picture).values())
    assert {"the policy", "return", "episodes survived [%]"} <= set(words(picture))
    assert "each policy" not in words(picture)


def test_a_panel_is_told_by_training_and_score_where_there_are_several_of_both():
    both = {name: training([[-9.0], [-4.0]]) for name in ("circle", "hover")}
    assert {"circle: return", "hover: position error [cm]"} <= set(words(learning_curves(both)))
    assert len(panels(learning_curves(both))) == 2 * len(training_figures.SCORES)


@pytest.mark.parametrize(
    ("trainings", "message"),
    [
        ({}, "no learning curves"),
        (
            {"circle": training([[-9.0]]).drop("survival")},
            "circle: no learning curves to draw; no column survival",
        ),
        ({"circle": training([[-9.0]]).clear()}, "no rows"),
    ],
)
def test_what_holds_no_training_is_refused(trainings, message):
    with pytest.raises(InputError, match=message):
        learning_curves(trainings)
