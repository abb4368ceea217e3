"""A training that is small, and the same in many tests: with three policies, on the circle and by
PWM, its program is compiled once and then read from the cache. So are those of an identification
from two flights of 4 s in coarse steps."""

from collections.abc import Callable
from functools import partial
from typing import Any

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
from maidenflight.training import checkpoint as checkpoints
from maidenflight.training import defaults, final_flights
from maidenflight.training import train as training
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.evaluation import Evaluation

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


def replace_training(patch: pytest.MonkeyPatch, make: Callable[..., list[Policy]]) -> None:
    """Tells of one update, leaves a checkpoint and gives the policies that a function makes, where
    a verb would train, which takes longest to compile."""

    def train(
        *given: Any, policy: PolicySpec, on_progress: Any, checkpoint: Any, **_: Any
    ) -> tuple[Policy, ...]:
        scores = Evaluation(*np.zeros((len(Evaluation._fields), len(given[3]))))
        on_progress(training.Progress(1, 1, scores))
        checkpoints.save(checkpoint.path, (), "", (1,))
        return tuple(make(*given[:4], policy=policy))

    patch.setattr(training, "train", train)
