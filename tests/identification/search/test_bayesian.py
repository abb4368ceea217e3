"""Bayesian optimisation: the box, the acquisition functions and the search."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from maidenflight.identification.search import bayesian
from maidenflight.identification.unknowns import PAPER_BOUNDS, Box

BOX = Box(tuple(PAPER_BOUNDS), *zip(*PAPER_BOUNDS.values(), strict=True))


@given(st.lists(st.floats(0, 1), min_size=3, max_size=3))
def test_the_box_leads_there_and_back(unit):
    np.testing.assert_allclose(BOX.unit(BOX.values(np.array(unit))), unit, atol=1e-9)


def test_the_corners_of_the_cube_are_the_bounds():
    np.testing.assert_allclose(BOX.values(np.zeros(3)), [low for low, _ in PAPER_BOUNDS.values()])
    np.testing.assert_allclose(BOX.values(np.ones(3)), [high for _, high in PAPER_BOUNDS.values()])


def test_limits_are_the_bounds_by_name():
    assert BOX.limits == PAPER_BOUNDS


def test_time_constants_are_searched_on_a_logarithmic_scale_and_the_rest_on_a_linear_one():
    np.testing.assert_allclose(BOX.values(np.full(3, 0.5)), [2.0, np.sqrt(0.01 * 0.5), 0.025])


def bowl(point):
    return (
        1.0
        + 40.0 * (point[0] - 0.3) ** 2
        + 10.0 * (point[1] - 0.72) ** 2
        + 20.0 * (point[2] - point[0] - 0.2) ** 2
    )


@pytest.fixture(scope="module")
def search():
    return bayesian.minimise(bowl, 3, 60, np.random.default_rng(3))


def test_the_minimum_of_a_known_function_is_found_in_sixty_evaluations(search):
    points, values = search
    np.testing.assert_allclose(points[np.argmin(values)], [0.3, 0.72, 0.5], atol=0.03)
    assert values.min() < 1.01


def test_the_kernel_is_fitted_ever_more_rarely(monkeypatch):
    asked = []

    def ask(points, values, kernel, fits, generator):
        asked.append(fits)
        return generator.random(points.shape[1]), kernel

    monkeypatch.setattr(bayesian, "_ask", ask)
    bayesian.minimise(bowl, 3, 250, np.random.default_rng(0))
    assert len(asked) == 240
    assert sum(asked) < 40
    assert all(any(asked[start : start + 25]) for start in range(0, 216, 24))


def test_every_evaluation_is_reported_in_order(search):
    points, values = search
    assert points.shape == (60, 3)
    assert ((points >= 0) & (points <= 1)).all()
    np.testing.assert_array_equal(values, [bowl(point) for point in points])


def test_the_process_does_better_than_its_even_start(search):
    _, values = search
    assert values[10:].min() - 1 < (values[:10].min() - 1) / 10
    assert np.median(values[40:]) < np.median(values[:10])


def test_the_same_generator_searches_the_same_points(search):
    calls = []
    again, _ = bayesian.minimise(bowl, 3, 13, np.random.default_rng(3), lambda: calls.append(1))
    other, _ = bayesian.minimise(bowl, 3, 13, np.random.default_rng(4))
    np.testing.assert_array_equal(again, search[0][:13])
    assert not np.array_equal(again[:10], other[:10])
    assert len(calls) == 13


@pytest.mark.parametrize("evaluations", [1, 4, 10])
def test_so_few_evaluations_that_no_process_is_asked_are_done_too(evaluations):
    points, values = bayesian.minimise(bowl, 3, evaluations, np.random.default_rng(0))
    assert (len(points), len(values)) == (evaluations, evaluations)


def test_a_flat_function_is_survived():
    points, values = bayesian.minimise(lambda point: 2.0, 2, 14, np.random.default_rng(0))
    assert np.isfinite(points).all()
    assert (values == 2.0).all()


@pytest.mark.parametrize("acquisition", bayesian.ACQUISITIONS)
def test_of_two_equally_uncertain_points_the_lower_is_preferred(acquisition):
    low, high = acquisition(np.array([-0.5, 0.5]), np.array([0.4, 0.4]), 0.0)
    assert low > high


@pytest.mark.parametrize("acquisition", bayesian.ACQUISITIONS)
def test_of_two_poor_points_the_more_uncertain_is_preferred(acquisition):
    known, unknown = acquisition(np.array([0.5, 0.5]), np.array([0.1, 0.9]), 0.0)
    assert unknown > known


def test_probability_prefers_a_small_sure_gain_expectation_and_bound_a_large_doubtful_one():
    mean, deviation = np.array([-0.1, 0.5]), np.array([0.01, 2.0])
    assert np.argmax(bayesian.probability_of_improvement(mean, deviation, 0.0)) == 0
    assert np.argmax(bayesian.expected_improvement(mean, deviation, 0.0)) == 1
    assert np.argmax(bayesian.lower_confidence_bound(mean, deviation, 0.0)) == 1


@pytest.mark.parametrize(
    ("mean", "deviation", "best"), [(0.3, 0.5, 0.0), (-0.7, 0.2, -0.5), (1.0, 1.0, 1.2)]
)
def test_acquisitions_are_what_their_names_say(mean, deviation, best):
    """Against 200,001 equally likely values of the normal distribution."""
    values = mean + deviation * norm.ppf((np.arange(200_001) + 0.5) / 200_001)
    arguments = (np.array([mean]), np.array([deviation]), best)
    assert bayesian.expected_improvement(*arguments)[0] == pytest.approx(
        np.maximum(best - values, 0).mean(), abs=1e-4
    )
    assert bayesian.probability_of_improvement(*arguments)[0] == pytest.approx(
        (values < best - 0.01).mean(), abs=1e-4
    )
    assert -bayesian.lower_confidence_bound(*arguments)[0] == pytest.approx(
        np.quantile(values, norm.cdf(-1.96)), abs=1e-3
    )
