"""Validates the arguments of a training, and makes the fingerprint of it."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from maidenflight.errors import InputError, check_traced
from maidenflight.names import POSITION_PID
from maidenflight.parameters import Parameters
from maidenflight.policy import Policy
from maidenflight.simulator.controllers import control
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.randomization import Distribution, InSteps, stacked
from maidenflight.simulator.tasks.tasks import Task
from maidenflight.training import checkpoint
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.settings import PPO, Settings, recorded


class TrainingSpec(NamedTuple):
    """A training of P policies."""

    env: Environment
    """The program's: task, control structure, and what the policies see and remember."""
    settings: Settings
    """Of the method."""
    drones: Distribution
    """The P distributions of drones, stacked."""
    keys: Array
    """P random keys."""
    initial: Policy | None
    """Where training starts, instead of random weights."""

    def fingerprint(self) -> str:
        """Tells one training from another, but not from the same with more updates."""
        task, controller = self.env.task, self.env.controller
        words = {
            "method": type(self.settings).__name__,
            # Their number is in the checkpoint's stages.
            "settings": {
                name: value for name, value in recorded(self.settings).items() if name != "updates"
            },
            "task": [task.name, task.duration, task.floor],
            "control": [
                controller.interface.to_dict(),
                controller.command_rate,
                self.env.steps_per_command,
            ],
            **self.env.spec.to_dict(),
        }
        reference = jax.vmap(task.reference)(jnp.linspace(0.0, task.duration, 50))
        return checkpoint.fingerprint(
            words, (reference, jax.random.key_data(self.keys), self.drones, self.initial)
        )


def validate(
    task: Task,
    controller: Controller,
    distribution: Distribution | Sequence[Distribution],
    keys: Array,
    settings: Settings,
    policy: PolicySpec | Policy,
) -> TrainingSpec:
    """Validates the arguments of `train` of these names.

    Raises:
        InputError: see `train`; not for settings of no known method.
    """
    for argument, kind, way in (
        (task, Task, "mf.simulator.circle()"),
        (controller, Controller, "mf.simulator.pwm()"),
        (policy, PolicySpec | Policy, "mf.PolicySpec()"),
    ):
        if not isinstance(argument, kind):
            name = getattr(kind, "__name__", "PolicySpec or Policy")
            raise InputError(f"{str(argument)[:60]} is no {name}; expected what {way} gives.")
    if not (
        isinstance(keys, jax.Array)
        and jnp.issubdtype(keys.dtype, jax.dtypes.prng_key)
        and keys.ndim == 1
        and keys.size
    ):
        raise InputError(
            "keys must be random keys, one a policy: jax.random.split(jax.random.key(0), 3)."
        )
    boxes = [_in_fitting_steps(box, controller) for box in _one_each(distribution, len(keys))]
    if controller.interface.name == POSITION_PID:
        raise InputError(
            f"control structure {POSITION_PID} cannot be trained for: it flies by itself. Give "
            "what mf.simulator.pwm() gives."
        )
    initial = policy if isinstance(policy, Policy) else None
    if initial is not None:
        _check_initial(initial, controller, settings)
    spec = policy if isinstance(policy, PolicySpec) else policy.spec
    if isinstance(settings, PPO):
        spec.policy_form.check_method("ppo")
    env, *others = (Environment.matching(box.centre, task, controller, spec=spec) for box in boxes)
    if any(other != env for other in others):
        raise InputError(
            "distributions of drones of different frames or time steps; expected drones that one "
            "program simulates. Train them in calls of their own."
        )
    _check_reward(task, boxes[0].centre, keys[0])
    return TrainingSpec(env, settings, stacked(boxes), keys, initial)


def _check_reward(task: Task, parameters: Parameters, key: Array) -> None:
    """Refuses a reward that cannot be traced, before programs are compiled that hold it.

    Raises:
        InputError: it cannot, or it gives no single number.
    """
    state, _ = jax.eval_shape(task.reset, parameters, key)
    vectors = (np.zeros(3), np.zeros(4), np.zeros(4))
    expected = "a number of (state, setpoint of 3 [m], action of 4, previous action of 4)"
    name = f"the reward of task {task.name}"
    reward = check_traced(name, task.reward, expected, state, *vectors)
    if jnp.shape(reward) != ():
        raise InputError(f"{name} has shape {jnp.shape(reward)}; expected {expected}.")


def _one_each(box: Distribution | Sequence[Distribution], count: int) -> Sequence[Distribution]:
    """A distribution of drones for each of so many keys.

    Raises:
        InputError: there is another number of them, or one is none.
    """
    boxes = box if isinstance(box, Sequence) else [box] * count
    for distribution in boxes:
        if not hasattr(distribution, "centre"):
            raise InputError(
                f"{type(distribution).__name__} is no distribution of drones; expected what "
                "mf.simulator.relative_box(DRONE) gives."
            )
    if len(boxes) != count:
        raise InputError(
            f"{len(boxes)} distributions of drones for {count} keys; expected one for each key, or "
            "one for all."
        )
    return boxes


def _in_fitting_steps(drones: Distribution, controller: Controller) -> Distribution:
    """Returns drones in time steps that divide the period between two commands."""
    own = np.asarray(drones.centre.time_step)
    fitting = np.float32(control.time_step(controller, float(own)))
    return drones if np.isclose(own, fitting, rtol=1e-3) else InSteps(drones, fitting)


def _check_initial(initial: Policy, controller: Controller, settings: Settings) -> None:
    """Checks that training can start from a policy.

    PPO's running moments would change what the policy does before its first step.

    Raises:
        InputError: see `train`.
    """
    if type(settings) is not AnalyticGradient:
        raise InputError(
            f"training from a policy with {type(settings).__name__}; only training by gradients "
            "starts from one."
        )
    if initial.interface != controller.interface:
        raise InputError(
            f"the initial policy commands {initial.interface.name} at {initial.interface.rate} Hz "
            f"and not {controller.interface.name} at {controller.interface.rate} Hz of the same "
            "centre and span. Give the control structure that it was trained for."
        )
