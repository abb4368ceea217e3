"""A training that is small, and the same in many tests: with three policies, on the circle and by
PWM, its program is compiled once and then read from the cache."""

import pytest

from maidenflight.training import defaults, final_flights
from maidenflight.training.analytic_gradient import AnalyticGradient

QUICK = AnalyticGradient(
    updates=2, evaluations=1, num_envs=4, horizon=4, episodes=4, hidden_learning_rate=0.0
)


def make_training_quick(patch: pytest.MonkeyPatch) -> None:
    """Trains by `QUICK`, whatever is trained for, and flies half a second after it."""
    for structure in defaults.SETTINGS:
        patch.setitem(defaults.SETTINGS, structure, QUICK)
    patch.setattr(final_flights, "FLIGHT_S", 0.5)
