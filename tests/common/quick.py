"""A training that is small, and the same in many tests: with three policies, on the circle and by
PWM, its program is compiled once and then read from the cache. So are those of an identification
from two flights of 4 s in coarse steps."""

from functools import partial

import pytest

from maidenflight.identification import identify, methods
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


def make_identification_quick(patch: pytest.MonkeyPatch) -> None:
    """Identifies by likelihood in physics steps of 5 ms, where a command makes the settings."""
    assert identify.Likelihood is methods.Likelihood
    patch.setattr(methods, "Likelihood", partial(methods.Likelihood, physics_step=0.005))
