"""The Gauss-Newton loop ends where SciPy's least squares does, and within its evaluations."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from maidenflight.identification.search.gauss_newton import NormalEquations, Rules, descend, inside

START = np.array([0.15, 0.7])


def bent(unit):
    """Residuals of a curved valley in the unit cube, and their Jacobian: Rosenbrock's, its lowest
    point at (0.6, 0.4)."""
    x, y = 2.5 * (np.asarray(unit) - [0.2, 0.4 - 1 / 2.5])
    return np.array([10 * (y - x**2), 1 - x]), 2.5 * np.array([[-20 * x, 10], [-1, 0]])


def descended(most, damping, **rules):
    """Where the loop ends, and the values that it evaluated."""
    values = []

    def equations(unit):
        residuals, jacobian = bent(unit)
        curvature = jacobian.T @ jacobian
        values.append(0.5 * float(residuals @ residuals))
        return NormalEquations(values[-1], jacobian.T @ residuals, curvature, curvature)

    return descend(equations, START, Rules(1, most, **rules), inside, damping), values


@pytest.mark.parametrize("damping", [0.0, 1.0])
@pytest.mark.parametrize("rules", [{"small_gain": 1e-9}, {"small_step": 1e-5}])
def test_it_ends_where_scipys_least_squares_does(damping, rules):
    found, values = descended(199, damping, **rules)
    expected = least_squares(lambda unit: bent(unit)[0], START, bounds=(0, 1), xtol=1e-12)
    np.testing.assert_allclose(expected.x, [0.6, 0.4], atol=1e-6)
    np.testing.assert_allclose(found.point, expected.x, atol=1e-3)
    assert found.equations.loss == min(values) < 1e-7
    assert len(values) < 100


@pytest.mark.parametrize("most", [0, 2])
def test_it_makes_no_more_steps_than_it_may(most):
    assert len(descended(most, 0.0)[1]) == most + 1


def test_a_face_of_the_cube_is_not_crossed():
    """The optimum of x^2 + (y + 1)^2 lies outside."""

    def equations(unit):
        return NormalEquations(
            float(unit[0] ** 2 + (unit[1] + 1) ** 2),
            2 * np.array([unit[0], unit[1] + 1]),
            2 * np.eye(2),
            2 * np.eye(2),
        )

    found = descend(equations, START, Rules(1, 20, small_gain=1e-9), inside, 0.0)
    np.testing.assert_allclose(found.point, [0, 0], atol=1e-6)
    assert (found.point > 0).all()
