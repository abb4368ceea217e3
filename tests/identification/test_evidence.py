"""What signals say by themselves, against estimates that are known in closed form."""

from typing import Any

import numpy as np
import pytest
import scipy
from hypothesis import given
from hypothesis import strategies as st

from maidenflight.identification.evidence import (
    DELAY,
    Evidence,
    agreements,
    of_likelihood,
    of_samples,
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


class Line:
    """Rows y = a x + b with errors, as a likelihood of two parameters."""

    def __init__(self) -> None:
        generator = np.random.default_rng(0)
        self.x = np.stack([generator.normal(size=2000), np.ones(2000)], axis=1)
        self.y = self.x @ [0.4, 0.2] + 0.1 * generator.normal(size=2000)
        self.rows = 2000.0

    def derivatives(self, drone: Any, names: Any) -> tuple[float, np.ndarray, np.ndarray]:
        here = np.array([float(component(drone, name)) for name in names])
        slopes = -self.x * (self.y - self.x @ here)[:, None] / 0.01
        scores = slopes.reshape(20, 100, 2).sum(axis=1) / self.rows
        curvature = (self.x.T @ self.x) / 0.01 / self.rows
        return 0.0, scores, np.tile(curvature / 20, (20, 1, 1))


def test_a_step_of_a_quadratic_likelihood_is_least_squares() -> None:
    """From anywhere, with the parameters' covariance by ordinary least squares."""
    line: Any = Line()
    found = of_likelihood("rows", line, crazyflie(), ("drag_x", "drag_y"))
    expected, *_ = np.linalg.lstsq(line.x, line.y, rcond=None)
    np.testing.assert_allclose([one.value for one in found], expected, rtol=1e-5)


def test_its_error_is_that_of_the_estimate() -> None:
    line: Any = Line()
    drone = replace(crazyflie(), drag_x=np.float32(0.4), drag_y=np.float32(0.2))
    near = of_likelihood("rows", line, drone, ("drag_x", "drag_y"))
    error = 0.1 / np.sqrt(line.rows)
    assert [one.error for one in near] == pytest.approx([error, error], rel=0.5)
