"""A training that is small, and the same in many tests: with three policies, on the circle and by
PWM, its program is compiled once and then read from the cache. So are those of an identification
from two flights of 4 s in coarse steps."""

from functools import partial

import jax
import numpy as np
import pytest
from jaxtyping import Array

from maidenflight.identification import identify, methods
from maidenflight.policy import Policy, untrained_policy
from maidenflight.simulator import environment, stepping
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.randomization import Distribution
from maidenflight.simulator.tasks.tasks import Task
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


def traced_training(
    task: Task,
    controller: Controller,
    box: Distribution,
    keys: Array,
    *,
    policy: PolicySpec = PolicySpec(),
) -> list[Policy]:
    """In the place of training: the slope of a control period is traced, not compiled, and policies
    that know nothing come back."""
    env = Environment.matching(box.centre, task, controller, spec=policy)

    def value(action: Array, key: Array) -> Array:
        return stepping.step(
            env, environment.reset(env, box.draw(key), key), action, box.draw(key), key
        )[1].reward

    jax.eval_shape(jax.grad(value), np.zeros(4, np.float32), keys[0])
    return [untrained_policy(key, controller.interface, policy) for key in keys]
