"""What signals say by themselves, against estimates that are known in closed form."""

from typing import Any

import numpy as np
import pytest
import scipy
from hypothesis import given
from hypothesis import strategies as st

from maidenflight.identification.uncertainty import (
    DELAY,
    Evidence,
    agreements,
    of_samples,
    of_scores,
)
from maidenflight.parameters import component, crazyflie, replace


def says(value: float, error: float, **more: Any) -> Evidence:
    return Evidence("gyro", value, (value - 1.96 * error, value + 1.96 * error), **more)


@given(st.floats(-1.0, 1.0), st.floats(0.01, 1.0))
def test_two_signals_are_apart_by_their_difference(apart: float, error: float) -> None:
    """Of two, chi-square is the squared difference over the sum of variances."""
    (found,) = agreements([says(0.0, error), says(apart, 2 * error)]).values()
    assert found.degrees == 1
    assert found.chi_square == pytest.approx(apart**2 / (5 * error**2), rel=1e-6, abs=1e-9)
    assert found.chance == pytest.approx(scipy.stats.chi2.sf(found.chi_square, 1))


def test_what_is_taken_is_no_signal_of_its_own() -> None:
    assert agreements([says(0.0, 1.0), says(0.0, 1.0, is_taken=True)]) == {}
    assert agreements([says(0.0, 1.0), says(9.0, np.inf), says(0.0, 1.0, parameter="mass")]) == {}
    assert list(agreements([says(0.0, 1.0), says(1.0, 1.0)])) == [DELAY]


def test_samples_say_their_median() -> None:
    (one,) = of_samples("gyro", {"latency": np.linspace(0.0, 1.0, 1001)})
    assert (one.value, one.parameter) == (0.5, "latency")
    assert one.interval == pytest.approx((0.025, 0.975))


GENERATOR = np.random.default_rng(0)
X = np.stack([GENERATOR.normal(size=2000), np.ones(2000)], axis=1)
Y = X @ [0.4, 0.2] + 0.1 * GENERATOR.normal(size=2000)


def step_from(*drag: float) -> list[Evidence]:
    """What rows y = a x + b with errors of 0.1 say of two drags, from a drone's."""
    drone = replace(crazyflie(), drag_x=np.float32(drag[0]), drag_y=np.float32(drag[1]))
    names = ("drag_x", "drag_y")
    here = np.array([float(component(drone, name)) for name in names])
    scores = (-X * (Y - X @ here)[:, None] / 0.01).reshape(20, 100, 2).sum(axis=1)
    return of_scores("rows", drone, names, scores, X.T @ X / 0.01)


def test_a_step_of_a_quadratic_likelihood_is_least_squares() -> None:
    expected, *_ = np.linalg.lstsq(X, Y, rcond=None)
    np.testing.assert_allclose([one.value for one in step_from(0.0, 0.0)], expected, rtol=1e-5)


def test_its_error_is_that_of_the_estimate() -> None:
    error = 0.1 / np.sqrt(len(Y))
    assert [one.error for one in step_from(0.4, 0.2)] == pytest.approx([error, error], rel=0.5)
