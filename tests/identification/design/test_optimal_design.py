"""Optimal designs: the equivalence theorem, a known optimum, and what rounding keeps."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings

from maidenflight.identification.design import optimal_design

TOTAL = 60.0


def parts(seed: int, many: int = 6, size: int = 4) -> np.ndarray:
    roots = np.random.default_rng(seed).normal(size=(many, size, 2))
    return roots @ np.swapaxes(roots, 1, 2)


def best(seed: int, of: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    some, before = parts(seed), np.eye(4)
    return some, before, optimal_design.optimal(some, before, TOTAL, of)


SUBSETS = ((0, 1, 2, 3), (0, 2), (1,))


@settings(max_examples=30)
@given(st.integers(0, 1000), st.sampled_from(SUBSETS))
def test_at_the_optimum_no_manoeuvre_gains_more_than_those_that_are_flown(seed, of):
    some, before, seconds = best(seed, of)
    assert seconds.sum() == pytest.approx(TOTAL)
    assert (seconds >= 0).all()
    assert optimal_design.excess(some, before, seconds, of) <= 2 * optimal_design.CLOSE
    gains = optimal_design.gains(some, before, seconds, of)
    flown = seconds > 1.0
    np.testing.assert_allclose(gains[flown], gains.max(), rtol=0.05)


@pytest.mark.parametrize("seed", range(6))
def test_a_fortieth_of_the_steps_suffices(seed, monkeypatch):
    some, before = parts(seed, many=35, size=14), 12.0 * np.eye(14)
    monkeypatch.setattr(optimal_design, "MOST_STEPS", optimal_design.MOST_STEPS // 40)
    seconds = optimal_design.optimal(some, before, TOTAL, range(2 + 2 * seed))
    assert optimal_design.excess(some, before, seconds, range(2 + 2 * seed)) <= optimal_design.CLOSE


@settings(max_examples=30)
@given(st.integers(0, 1000), st.sampled_from(SUBSETS))
def test_no_other_seconds_do_better(seed, of):
    some, before, seconds = best(seed, of)
    least = optimal_design.loss(before + np.tensordot(seconds, some, 1), of)
    others = np.random.default_rng(seed).dirichlet(np.ones(len(some)), 50) * TOTAL
    for other in (*others, *(TOTAL * np.eye(len(some)))):
        there = optimal_design.loss(before + np.tensordot(other, some, 1), of)
        # By concavity the loss is at most the excess gain over all seconds above the least.
        assert there >= least - 2 * optimal_design.CLOSE * len(of)


@given(st.integers(0, 1000), st.sampled_from(SUBSETS), st.integers(0, 5))
def test_more_seconds_never_tell_less_and_gains_are_the_slope(seed, of, which):
    some, before, seconds = parts(seed), np.eye(4), np.full(6, 10.0)
    here = optimal_design.loss(before + np.tensordot(seconds, some, 1), of)
    step = 1e-4 * np.eye(6)[which]
    ahead = optimal_design.loss(before + np.tensordot(seconds + step, some, 1), of)
    assert ahead <= here + 1e-12
    gain = optimal_design.gains(some, before, seconds, of)[which]
    assert (here - ahead) / 1e-4 == pytest.approx(gain, rel=1e-2, abs=1e-6)


def test_of_manoeuvres_that_tell_one_parameter_each_all_last_as_long():
    """D-optimal designs do not depend on scale, so each has T / d (Pukelsheim 2006)."""
    some = np.stack([np.diag(row) for row in (np.eye(3) * [1.0, 20.0, 400.0])])
    seconds = optimal_design.optimal(some, 1e-9 * np.eye(3), TOTAL, range(3))
    np.testing.assert_allclose(seconds, TOTAL / 3, rtol=1e-2)


@given(
    st.lists(st.floats(0.0, 30.0), min_size=1, max_size=12).filter(lambda some: max(some) > 1.0),
    st.floats(8.0, 120.0),
)
def test_rounded_seconds_are_chunks_that_fit(wanted, total):
    seconds = np.array(wanted)
    found = optimal_design.rounded(seconds, 2.0, 1.0, total)
    flown = np.count_nonzero(found)
    assert 1 <= flown <= np.count_nonzero(seconds)
    np.testing.assert_allclose(found % 2.0, 0.0, atol=1e-9)
    assert total - 3.0 < found.sum() + flown <= total + 1e-6
    assert (found[seconds == 0.0] == 0.0).all()


def test_a_time_without_room_for_a_chunk_is_refused():
    with pytest.raises(ValueError):
        optimal_design.rounded(np.ones(2), 2.0, 1.0, 2.5)
