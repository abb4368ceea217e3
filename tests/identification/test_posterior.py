"""The bootstrap: where each block of data has an optimum of its own, the interval is that of the blocks' mean."""

import numpy as np
import pytest

from maidenflight.identification import posterior

ANYWHERE = (np.full(2, -10.0), np.full(2, 10.0))


def problem(spread, blocks, seed, centre=(0.45, 0.6)):
    """Quadratic losses of blocks whose optima scatter about a centre, and those optima."""
    optima = np.array(centre) + spread * np.random.default_rng(seed).normal(size=(blocks, 2))
    return optima, lambda point: 10.0 * (1.0 + np.sum(np.array([3.0, 1.0]) * (np.asarray(point) - optima) ** 2, axis=1))


def redrawn(spread, blocks, seed, radius=0.08, limits=ANYWHERE, beside=0.0, on_evaluation=None):
    optima, losses = problem(spread, blocks, seed)
    best = optima.mean(axis=0) + beside
    generator = np.random.default_rng([seed, 1])
    return optima, posterior.bootstrap(losses, np.full(blocks, 10.0), best, np.full(2, radius), limits, generator, on_evaluation)


@pytest.mark.parametrize(("spread", "blocks"), [(0.03, 100), (0.1, 30), (0.3, 100), (0.5, 60)])
def test_an_interval_is_1_96_standard_errors_of_the_blocks_mean(spread, blocks):
    optima, drawn = redrawn(spread, blocks, seed=blocks)
    low, high = drawn.interval()
    expected = 1.96 * optima.std(axis=0, ddof=1) / np.sqrt(blocks)
    np.testing.assert_allclose((high - low) / 2, expected, rtol=0.15)
    np.testing.assert_allclose((high + low) / 2, optima.mean(axis=0), atol=0.4 * expected.max())


@pytest.mark.parametrize("radius", [0.02, 0.3])
def test_the_first_neighbourhood_may_be_too_small_or_too_large(radius):
    optima, drawn = redrawn(0.3, 50, seed=2, radius=radius, beside=0.02)
    low, high = drawn.interval()
    np.testing.assert_allclose((high - low) / 2, 1.96 * optima.std(axis=0, ddof=1) / np.sqrt(50), rtol=0.5)


def test_intervals_hold_the_truth_about_as_often_as_they_promise():
    held = []
    for seed in range(40):
        _, drawn = redrawn(0.3, 30, seed)
        low, high = drawn.interval()
        held.append((low <= [0.45, 0.6]) & (high >= [0.45, 0.6]))
    assert 0.8 <= np.mean(held) <= 1.0


def test_four_times_the_data_halve_the_interval():
    few, many = (np.subtract(*redrawn(0.3, blocks, seed=7)[1].interval()[::-1]) for blocks in (40, 160))
    assert np.mean(few / many) == pytest.approx(2.0, rel=0.3)


def test_no_redrawn_optimum_leaves_the_limits():
    """A limit at the very optimum: half of the redrawn optima stop there."""
    optima, losses = problem(0.4, 30, 5)
    best = optima.mean(axis=0)
    limits = (np.array([best[0], -10.0]), np.array([10.0, best[1]]))
    drawn = posterior.bootstrap(losses, np.full(30, 10.0), best, np.full(2, 0.08), limits, np.random.default_rng(5))
    for points in (drawn.optima, drawn.points):
        assert ((points >= limits[0]) & (points <= limits[1])).all()
    at_limit = np.abs(drawn.optima - best) < 0.1 * 0.4 / np.sqrt(30)
    np.testing.assert_allclose(at_limit.mean(axis=0), 0.5, atol=0.15)


def test_every_evaluation_is_kept_with_its_mean_loss():
    calls = []
    optima, drawn = redrawn(0.1, 20, seed=4, on_evaluation=lambda: calls.append(1))
    assert len(drawn.points) == len(drawn.losses) == len(calls) == 3 * posterior.DESIGN
    expected = [1.0 + np.mean((point - optima) ** 2 @ [3.0, 1.0]) for point in drawn.points]
    np.testing.assert_allclose(drawn.losses, expected, rtol=1e-9)


def test_the_same_generator_redraws_the_same_data():
    one, two = redrawn(0.1, 20, seed=4)[1], redrawn(0.1, 20, seed=4)[1]
    np.testing.assert_array_equal(one.optima, two.optima)
