"""The bootstrap: where each block of data has an optimum of its own, the interval is that of the
blocks' mean."""

import numpy as np
import pytest

from maidenflight.identification import uncertainty

ANYWHERE = (np.full(2, -10.0), np.full(2, 10.0))


def problem(spread, blocks, seed, centre=(0.45, 0.6)):
    """Quadratic losses of blocks whose optima scatter about a centre, and those optima."""
    optima = np.array(centre) + spread * np.random.default_rng(seed).normal(size=(blocks, 2))
    return (
        optima,
        lambda point: (
            10.0 * (1.0 + np.sum(np.array([3.0, 1.0]) * (np.asarray(point) - optima) ** 2, axis=1))
        ),
    )


def redrawn(spread, blocks, seed, radius=0.08, limits=ANYWHERE, beside=0.0, on_evaluation=None):
    optima, losses = problem(spread, blocks, seed)
    best = optima.mean(axis=0) + beside
    generator = np.random.default_rng([seed, 1])
    return optima, uncertainty.bootstrap(
        losses, np.full(blocks, 10.0), best, np.full(2, radius), limits, generator, on_evaluation
    )


@pytest.mark.parametrize(("spread", "blocks"), [(0.03, 100), (0.1, 30), (0.3, 100), (0.5, 60)])
def test_an_interval_is_1_96_standard_errors_of_the_segments_mean(spread, blocks):
    optima, drawn = redrawn(spread, blocks, seed=blocks)
    low, high = drawn.interval()
    expected = 1.96 * optima.std(axis=0, ddof=1) / np.sqrt(blocks)
    np.testing.assert_allclose((high - low) / 2, expected, rtol=0.15)
    np.testing.assert_allclose((high + low) / 2, optima.mean(axis=0), atol=0.4 * expected.max())


@pytest.mark.parametrize("radius", [0.02, 0.3])
def test_the_first_neighbourhood_may_be_too_small_or_too_large(radius):
    optima, drawn = redrawn(0.3, 50, seed=2, radius=radius, beside=0.02)
    low, high = drawn.interval()
    np.testing.assert_allclose(
        (high - low) / 2, 1.96 * optima.std(axis=0, ddof=1) / np.sqrt(50), rtol=0.5
    )


@pytest.mark.slow
def test_intervals_hold_the_truth_about_as_often_as_they_promise():
    held = []
    for seed in range(40):
        _, drawn = redrawn(0.3, 30, seed)
        low, high = drawn.interval()
        held.append((low <= [0.45, 0.6]) & (high >= [0.45, 0.6]))
    assert 0.8 <= np.mean(held) <= 1.0


def test_four_times_the_data_halve_the_interval():
    few, many = (
        np.subtract(*redrawn(0.3, blocks, seed=7)[1].interval()[::-1]) for blocks in (40, 160)
    )
    assert np.mean(few / many) == pytest.approx(2.0, rel=0.3)


def test_no_redrawn_optimum_leaves_the_limits():
    """A limit at the very optimum: half of the redrawn optima stop there."""
    optima, losses = problem(0.4, 30, 5)
    best = optima.mean(axis=0)
    limits = (np.array([best[0], -10.0]), np.array([10.0, best[1]]))
    drawn = uncertainty.bootstrap(
        losses, np.full(30, 10.0), best, np.full(2, 0.08), limits, np.random.default_rng(5)
    )
    for points in (drawn.optima, drawn.points):
        assert ((points >= limits[0]) & (points <= limits[1])).all()
    at_limit = np.abs(drawn.optima - best) < 0.1 * 0.4 / np.sqrt(30)
    np.testing.assert_allclose(at_limit.mean(axis=0), 0.5, atol=0.15)


def test_every_evaluation_is_kept_with_its_mean_loss():
    calls = []
    optima, drawn = redrawn(0.1, 20, seed=4, on_evaluation=lambda: calls.append(1))
    assert len(drawn.points) == len(drawn.losses) == len(calls) == 3 * uncertainty.DESIGN
    expected = [1.0 + np.mean((point - optima) ** 2 @ [3.0, 1.0]) for point in drawn.points]
    np.testing.assert_allclose(drawn.losses, expected, rtol=1e-9)


def test_the_same_generator_redraws_the_same_data():
    one, two = redrawn(0.1, 20, seed=4)[1], redrawn(0.1, 20, seed=4)[1]
    np.testing.assert_array_equal(one.optima, two.optima)


STEEP = np.array([[4e6, 30.0, -200.0], [30.0, 2e-3, 0.001], [-200.0, 0.001, 0.05]])
"""A curvature of parameters in units far apart, such as a torque and a time."""


def drawn_scores(generator, covariance, count):
    return generator.normal(size=(count, len(covariance))) @ np.linalg.cholesky(covariance).T


def relative(covariance, expected):
    """A covariance in units of the expected one, which then is the identity."""
    root = np.linalg.inv(np.linalg.cholesky(expected))
    return root @ covariance @ root.T


def test_the_sandwich_of_a_right_model_is_the_inverse_of_the_curvature():
    """Scores of covariance H in all, as Fisher's identity has it."""
    found = uncertainty.sandwich(
        drawn_scores(np.random.default_rng(0), STEEP / 40_000, 40_000), STEEP
    )
    np.testing.assert_allclose(relative(found, np.linalg.inv(STEEP)), np.eye(3), atol=0.04)


@pytest.mark.parametrize("rows", [2, 5])
def test_the_sandwich_grows_as_rows_of_a_stretch_say_the_same(rows):
    """Where so many rows are one and the same the data are so many times fewer."""
    alone = drawn_scores(np.random.default_rng(1), STEEP / 40_000, 40_000 // rows)
    found = uncertainty.sandwich(rows * alone, STEEP)
    np.testing.assert_allclose(
        relative(found, np.linalg.inv(STEEP)), rows * np.eye(3), atol=0.05 * rows
    )


def test_the_sandwich_of_a_mean_is_its_textbook_variance():
    """Numbers of unit variance under a model that takes their deviation for half of it: the
    sample's own s^2 / n comes out."""
    numbers = np.random.default_rng(2).normal(3.0, 1.0, 50)
    scores, curvature = (numbers.mean() - numbers)[:, None] / 0.5**2, np.array([[50 / 0.5**2]])
    np.testing.assert_allclose(
        uncertainty.sandwich(scores, curvature), [[numbers.var(ddof=1) / 50]], rtol=1e-6
    )


def segments(generator, spread, count=600, noise=1.0):
    """Scores and curvatures of segments whose parameters differ by so much, some segments longer
    than others."""
    curvatures = STEEP * generator.uniform(0.9, 1.1, (count, 1, 1))
    apart = np.asarray(spread) * generator.normal(size=(count, 3))
    own = noise * np.einsum(
        "bij,bj->bi", np.linalg.cholesky(curvatures), generator.normal(size=(count, 3))
    )
    return np.einsum("bij,bj->bi", curvatures, apart) + own, curvatures


@pytest.mark.parametrize("size", [2.0, 5.0])
def test_how_much_segments_differ_is_recovered_beyond_their_noise(size):
    own = np.sqrt(np.diag(np.linalg.inv(STEEP)))
    found = uncertainty.between_segments(*segments(np.random.default_rng(3), size * own))[0]
    np.testing.assert_allclose(found, size * own, rtol=0.2)


def test_segments_that_differ_by_their_noise_alone_have_no_spread():
    own = np.sqrt(np.diag(np.linalg.inv(STEEP)))
    found = uncertainty.between_segments(*segments(np.random.default_rng(4), np.zeros(3)))[0]
    assert (found < 0.4 * own).all()
    quiet, _ = uncertainty.between_segments(
        *segments(np.random.default_rng(5), np.zeros(3), noise=0.5)
    )
    np.testing.assert_array_equal(quiet, 0.0)


def test_what_segments_agree_about_stays_known():
    """Two parameters that differ together, as full thrust and its curve, have one sum."""
    generator, count = np.random.default_rng(6), 400
    away = np.stack([one := 5.0 * generator.normal(size=count), -one, np.zeros(count)], axis=1)
    scores = away + generator.normal(size=(count, 3))
    curvatures = np.tile(np.eye(3), (count, 1, 1))
    deviation, correlation = uncertainty.between_segments(scores, curvatures)
    np.testing.assert_allclose(deviation[:2], 5.0, rtol=0.1)
    assert correlation[0, 1] == pytest.approx(-1.0, abs=0.05)
    assert abs(correlation[0, 2]) < 0.3 or deviation[2] < 0.5
    np.testing.assert_array_equal(np.diag(correlation), 1.0)
