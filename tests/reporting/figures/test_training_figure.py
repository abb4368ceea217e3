"""Learning curves: mean and range are those of the policies, and odd scores draw something or are
refused."""

import numpy as np
import polars
import pytest

from drawn import of, rows, titles
from maidenflight.errors import InputError
from maidenflight.reporting.figures.training import SCORES, learning_curves


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


def test_the_mean_lies_within_the_range_of_the_policies_and_all_are_drawn():
    returns = [[-9.0, -7.0, -8.0], [-5.0, -1.0, -3.0]]
    figure = learning_curves(training(returns))
    assert titles(figure) == [label for label, _ in SCORES.values()]
    for place, values in enumerate(returns):
        x = 2.0 * (place + 1)
        [mean], [span] = of(figure, series="mean", x=x), of(figure, series="range", x=x)
        assert mean["y"] == np.mean(values)
        assert (span["y"], span["high"]) == (min(values), max(values))
        assert [row["y"] for row in of(figure, series="each", x=x)] == values
    assert {row["y"] for row in of(figure, 1, series="mean")} == {50.0}, "in per cent"


def test_a_score_that_is_not_finite_is_left_out_of_the_mean():
    figure = learning_curves(training([[1.0, float("nan")], [float("nan"), float("nan")]]))
    assert [(row["x"], row["y"]) for row in of(figure, series="mean")] == [(2.0, 1.0)]
    assert [row["y"] for row in of(figure, series="each")] == [1.0, None, None, None]


def test_one_policy_needs_no_range():
    figure = learning_curves(training([[1.0], [2.0]]))
    assert {row["series"] for row in rows(figure)} == {"mean"}
    assert [entry.name for entry in figure.legend] == ["the policy"]


def test_what_holds_no_training_is_refused():
    with pytest.raises(InputError, match="no column survival"):
        learning_curves(training([[1.0]]).drop("survival"))
    with pytest.raises(InputError, match="no rows"):
        learning_curves(training([[1.0]]).clear())


@pytest.mark.parametrize("survival", [0.0, 0.3, 1.0])
def test_the_axis_of_survival_ends_where_shares_do(survival):
    figure = learning_curves(training([[1.0], [2.0]], survival=polars.lit(survival)))
    up = figure.panels[1]["layer"][0]["encoding"]["y"]["scale"]["domain"]
    assert -1.0 < up[0] <= 100 * survival <= up[1] < 101.0
    assert up[1] - up[0] >= 20.0
