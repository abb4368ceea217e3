"""The linear regulator by which attitude control is bounded."""

import numpy as np
import pytest

from scripts import script

bound = script("attitude_bound")


@pytest.mark.parametrize("pole", [1.1, 1.28])
def test_a_regulator_that_pays_most_for_actions_mirrors_a_pole_and_has_its_margins(
    pole: float,
) -> None:
    """Its sensitivity (z - a) / (z - 1 / a) is `a` at all frequencies."""
    step, drive = np.array([[pole]]), np.array([[2.0]])
    gain = bound.regulator(step, drive, np.array([[1e-4]]))
    assert float((step - drive @ gain)[0, 0]) == pytest.approx(1.0 / pole, rel=1e-6)
    times, phase = bound.margins(step, drive, gain)
    assert times == pytest.approx(pole / (pole - 1.0), rel=1e-5)
    assert phase == pytest.approx(np.degrees(2.0 * np.arcsin(0.5 / pole)), rel=1e-5)


def test_what_no_action_reaches_is_left_out() -> None:
    chain = np.diag([1.0, 1.0], -1)
    alone = np.diag([0.5, 0.5, 0.5])
    step = np.block([[chain, np.zeros((3, 3))], [np.zeros((3, 3)), alone]])
    drive = np.eye(6)[:, :1]
    basis = bound.reachable(step, drive)
    assert basis.shape == (6, 3)
    assert np.abs(basis[3:]).max() < 1e-12
