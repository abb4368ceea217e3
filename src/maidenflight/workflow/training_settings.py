"""What policies are trained with and over unless told, by control structure and task."""

import dataclasses
from typing import Any

from maidenflight.errors import InputError
from maidenflight.policy import Policy
from maidenflight.simulator import raptor_form, tasks
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.training import distillation
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.distillation import Distillation
from maidenflight.training.ppo_settings import PPO
from maidenflight.training.settings import Settings
from maidenflight.workflow.drones import ANY_DAY, WIDE

SETTINGS: dict[str, AnalyticGradient] = {
    "pwm": AnalyticGradient(),
    "attitude_rate": AnalyticGradient(
        num_envs=160, horizon=36, failure_penalty=10.0, reset_fraction=0.5
    ),
    "attitude": AnalyticGradient(updates=800, num_envs=128, horizon=16),
}
"""Default settings by control structure. At a lower rate the same time ahead is fewer periods
(docs/studies/training.md#how-far-ahead). To separate initial states that can be saved from those
that cannot takes more environments."""

HIDDEN_BY_CONTROL = {"attitude_rate": (75, 75)}
"""Hidden layers of policies by gradients, by control structure, where they are not the usual ones.
At 50 Hz most episodes depend on separating initial states, which takes a larger network; it fits a
Crazyflie with up to four instants."""

DISTILLED_HIDDEN = (32, 32)
"""Hidden layers of policies by distillation (docs/studies/adaptation.md)."""

REMEMBERING_BY_CONTROL: dict[str, dict[str, int]] = {
    "attitude_rate": {"horizon": 32},
    "attitude": {"updates": 1200, "horizon": 32},
}
"""What further differs for policies with a memory, by control structure: they were measured with
these alone."""

REMEMBERING: dict[str, Any] = {
    "num_envs": 256,
    "learning_rate": 1e-3,
    "hidden_learning_rate": 0.006,
    "reset_fraction": 0.1,
}
"""What differs for policies with a memory. Resets are rarer, because memories begin empty; steps
are smaller, because with those of the others training over unlike drones gets worse after some
hundred updates."""

RAPTORS_FORM: dict[str, Any] = {**REMEMBERING, "learning_rate": 2e-3}
"""What differs in RAPTOR's form. Its few values bear no larger steps of their weights."""

FINE_TUNING: dict[str, Any] = {"updates": 200, "evaluations": 8}
"""What differs where training starts from a policy, beside learning rates of a quarter: the policy
flies already, and steps as large as from random weights would first undo what it knows."""

FASTEST_BOX = 0.1
"""Half width of the box that tasks at the limit of a drone are trained over unless the user says:
many drones of the wide box cannot fly them."""


def usual_training_box(task: str, structure: str) -> float | str:
    """What policies for a task and a control structure, by name, are trained over unless told.

    An attitude-rate policy turns slowly in flight, and falls after some seconds if it has not
    learned to fly turned: trims in yaw teach it (docs/studies/adaptation.md).
    """
    if task in tasks.FASTEST:
        return FASTEST_BOX
    return ANY_DAY if structure == "attitude_rate" else WIDE


def settings_for(
    structure: str,
    task: str,
    method: str | None = None,
    updates: int | None = None,
    initial: Policy | None = None,
    **given: Any,
) -> tuple[Settings, PolicySpec]:
    """Default settings and spec for a control structure, a task and a method, all by name.

    Args:
        structure: name of a control structure in `control.CONTROLLERS`.
        task: name in `tasks.TASKS`.
        method: `"gradient"`, `"distillation"` or `"ppo"`; unless given, distillation for policies
            with a memory that begin with random weights, and gradients for others and for those of
            RAPTOR's form, whose few values learn little from a teacher.
        updates: replaces the number of updates if given.
        initial: where training starts instead of random weights, if given; its spec replaces what
            is given.
        given: fields of `PolicySpec`; those that are missing or None are as usual.

    Raises:
        InputError: a field is out of range; or distillation of policies without a memory, or from a
            policy.
    """
    spec = PolicySpec(**{name: value for name, value in given.items() if value is not None})
    spec = spec if initial is None else initial.spec
    raptor = spec.form == raptor_form.RAPTOR
    if method is None:
        distilled = spec.memory and initial is None and not raptor
        method = "distillation" if distilled else "gradient"
    settings: Any = PPO() if method == "ppo" else _by_gradient(structure, task, bool(spec.memory))
    if method == "distillation":
        settings = _by_distillation(settings, spec.memory, initial)
    elif method == "gradient" and spec.memory:
        settings = dataclasses.replace(settings, **(RAPTORS_FORM if raptor else REMEMBERING))
    if initial is not None and method == "gradient":
        rates = {
            name: getattr(settings, name) / 4 for name in ("learning_rate", "hidden_learning_rate")
        }
        settings = dataclasses.replace(settings, **FINE_TUNING, **rates)
    if initial is None and given.get("hidden") is None and method != "ppo":
        usual = HIDDEN_BY_CONTROL.get(structure, spec.hidden)
        hidden = DISTILLED_HIDDEN if method == "distillation" else usual
        spec = dataclasses.replace(spec, hidden=hidden)
    return settings if updates is None else dataclasses.replace(settings, updates=updates), spec


def _by_distillation(like: AnalyticGradient, memory: int, initial: Policy | None) -> Distillation:
    if not memory or initial is not None:
        raise InputError(
            "distillation trains policies with a memory, from random weights: give a memory, such "
            "as 16, and no policy to start from; or train by gradients."
        )
    return Distillation(
        updates=len(distillation.PHASES) * like.updates,
        horizon=like.horizon,
        failure_penalty=like.failure_penalty,
        body_rate_margin=like.body_rate_margin,
    )


def _by_gradient(structure: str, task: str, remembering: bool) -> AnalyticGradient:
    settings = SETTINGS[structure]
    if remembering:
        settings = dataclasses.replace(settings, **REMEMBERING_BY_CONTROL.get(structure, {}))
    if task == "hover":  # which fails beyond 5.2 rad/s
        return dataclasses.replace(settings, updates=2 * settings.updates, body_rate_margin=4.0)
    if task in ("figure_eight", "fast_figure_eight"):  # far larger than the circle, and faster
        return dataclasses.replace(settings, updates=3 * settings.updates)
    return settings
