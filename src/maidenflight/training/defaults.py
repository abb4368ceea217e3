"""What policies are trained with and over by default, by control structure and task."""

import dataclasses
from typing import Any

import numpy as np

from maidenflight.errors import InputError
from maidenflight.names import ANY_DAY, TRACKING, WIDE
from maidenflight.parameters import Parameters
from maidenflight.policy import Policy
from maidenflight.simulator.controllers import control
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.physics import battery, dynamics
from maidenflight.simulator.physics.battery import COUNTS
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.tasks import tasks
from maidenflight.simulator.tasks.tasks import Task
from maidenflight.training import distillation
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.distillation import Distillation
from maidenflight.training.settings import PPO, Settings

SETTINGS: dict[str, AnalyticGradient] = {
    "pwm": AnalyticGradient(),
    "attitude_rate": AnalyticGradient(
        num_envs=160,
        horizon=36,
        failure_penalty=10.0,
        reset_fraction=0.5,
        largest_gradient=1.0,
    ),
    "attitude": AnalyticGradient(updates=800, num_envs=128, horizon=16, largest_gradient=1.0),
}
"""Default settings by control structure. At a lower rate the same time ahead is fewer periods
(paper/notes/training.md#how-far-ahead). To separate initial states that can be saved from those
that cannot takes more environments."""

FIRST_SHARE = {"attitude_rate": 0.4}
"""Share of the default updates after which policies by gradients fly first, by control structure;
those that fall are trained on (paper/notes/training.md#attitude-rate-by-default)."""

HIDDEN_BY_CONTROL: dict[str, tuple[int, ...]] = {"attitude_rate": (75, 75)}
"""Hidden layers of policies by gradients, by control structure, where they are not the usual ones.
At 50 Hz most episodes depend on separating initial states, which takes a larger network; it fits a
Crazyflie with up to four instants."""

DISTILLED_HIDDEN = (32, 32)
"""Hidden layers of policies by distillation (paper/notes/adaptation.md)."""

REMEMBERING_BY_CONTROL: dict[str, dict[str, int]] = {
    "attitude_rate": {"horizon": 32, "largest_gradient": 0},
    "attitude": {"updates": 1200, "horizon": 32, "largest_gradient": 0},
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

FINE_TUNING: dict[str, Any] = {"updates": 200, "evaluations": 8}
"""What differs where training starts from a policy, beside learning rates of a quarter: the policy
flies already, and steps as large as from random weights would first undo what it knows."""

AHEAD = 5
"""Points ahead that policies which follow any reference look at."""
AHEAD_HIDDEN = (44, 44)
"""Hidden layers of policies that look ahead: a step takes as long as without, behind 50 and 50."""

YAW_PENALTY = 0.1
"""Of attitude-rate policies by methods of ours (paper/notes/training.md)."""
FASTEST_BOX = 0.1
"""Half width of the box for tasks at the limit of a drone: many drones of the wide box cannot fly
them."""

HOVER_STEP = 0.05
"""Shares at which drones hover are rounded to this for ranges of thrust, so that drones alike have
one range and one compiled program."""
HEADROOM = 1.5
"""Least range of PWM over what hovers the drone: trims and turns take motors far beyond it. Flights
of a Crazyflie that hovers at 0.9 command 1.3 and get it (paper/notes/training.md)."""
LOWEST_VOLTS = 3.5
"""Under load [V]; with more a battery gives what policies may ask for."""


def choose_randomization(task: str, structure: str) -> float | str:
    """Returns what policies for a task and a control structure are trained over by default.

    An attitude-rate policy turns slowly in flight, and falls after some seconds if it has not
    learned to fly turned: trims in yaw teach it (paper/notes/adaptation.md).
    """
    if task in tasks.FASTEST:
        return FASTEST_BOX
    return ANY_DAY if structure == "attitude_rate" else WIDE


def choose_yaw_penalty(structure: str, method: str) -> float:
    """Returns what a radian of yaw costs by default, a control period.

    The paper's reward does not depend on yaw, and drones of a training fly on for two updates in
    the mean. Policies of attitude rate then turn away at 25 to 50 deg/s, and fall where no episode
    has been (paper/notes/training.md#attitude-rate-by-default).

    Args:
        structure: a control structure, in `names.CONTROLS`.
        method: a name in `names.METHODS`.
    """
    return YAW_PENALTY if structure == "attitude_rate" and not method.endswith("paper") else 0.0


def choose_task(task: Task, structure: str, yaw_penalty: float, *, fell: bool) -> Task:
    """Returns a task as policies train on it, with what yaw costs.

    Attitude-rate policies that fell train on from facing anywhere: they had turned by 130 deg,
    whence none had started (paper/notes/training.md#attitude-rate-by-default).

    Args:
        task: the task.
        structure: a control structure, in `names.CONTROLS`.
        yaw_penalty: see `tasks.with_yaw_penalty`.
        fell: whether the policies fell in the flights at the end of training.
    """
    if not yaw_penalty:
        return task
    turned = np.pi if fell and structure == "attitude_rate" else 0.0
    return tasks.with_yaw_penalty(task, yaw_penalty, turned)


def choose_method(spec: PolicySpec, initial: bool) -> str:
    """Returns the default method, a name in `names.METHODS`.

    Policies with a memory are distilled, except from a policy or if their form says otherwise.
    """
    return spec.policy_form.methods[0] if spec.memory and not initial else "gradient"


def choose_points(task: str) -> int:
    """Returns at how many points ahead policies for a task look by default."""
    return AHEAD if task == TRACKING else 0


def choose_hidden(structure: str, method: str, points: int = 0) -> tuple[int, ...]:
    """Returns the default sizes of hidden layers.

    Args:
        structure: a control structure, in `names.CONTROLS`.
        method: a name in `names.METHODS`.
        points: of a look-ahead.
    """
    if method == "distillation":
        return DISTILLED_HIDDEN
    usual = PolicySpec().hidden if points == 0 else AHEAD_HIDDEN
    return HIDDEN_BY_CONTROL.get(structure, usual) if method.startswith("gradient") else usual


def choose_settings(
    structure: str, task: str, method: str, spec: PolicySpec, initial: bool = False
) -> Settings:
    """Returns the default settings of a method.

    Args:
        structure: a control structure, in `names.CONTROLS`.
        task: a name in `names.TASKS`.
        method: a name in `names.METHODS`.
        spec: of the policies.
        initial: whether training starts from a policy.

    Raises:
        InputError: policies of a form that the method does not train; or distillation of policies
            without a memory, or from a policy.
    """
    spec.policy_form.check_method(method.removesuffix("-paper"))
    if method.startswith("ppo"):
        return PPO() if method == "ppo" else PPO.paper()
    settings = _by_gradient(structure, task, bool(spec.memory))
    if method == "gradient-paper":
        settings = settings.with_paper_reward()
    if method == "distillation":
        return _by_distillation(settings, spec, initial)
    if spec.memory:
        settings = dataclasses.replace(settings, **{**REMEMBERING, **spec.policy_form.learning})
    if initial:
        rates = {
            name: getattr(settings, name) / 4 for name in ("learning_rate", "hidden_learning_rate")
        }
        settings = dataclasses.replace(settings, **FINE_TUNING, **rates)
    return settings


def choose_first_updates(structure: str, method: str, updates: int) -> int:
    """Returns after how many of the default updates policies fly first.

    Args:
        structure: a control structure, in `names.CONTROLS`.
        method: a name in `names.METHODS`.
        updates: by default, of those that fall.
    """
    return round(FIRST_SHARE.get(structure, 1.0) * updates) if method == "gradient" else updates


def _by_distillation(like: AnalyticGradient, spec: PolicySpec, initial: bool) -> Distillation:
    if not spec.memory or initial:
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
    settings = SETTINGS.get(structure, SETTINGS["pwm"])
    if remembering:
        settings = dataclasses.replace(settings, **REMEMBERING_BY_CONTROL.get(structure, {}))
    if task == "hover":  # which fails beyond 5.2 rad/s
        return dataclasses.replace(settings, updates=2 * settings.updates, body_rate_margin=4.0)
    # Far larger than the circle, and faster; or of many shapes.
    if task in ("figure_eight", "fast_figure_eight", TRACKING):
        return dataclasses.replace(settings, updates=3 * settings.updates)
    return settings


def choose_controller(
    structure: str,
    drone: Parameters,
    full_scale_counts: float = COUNTS,
    initial: Policy | None = None,
    paper_scales: bool = False,
    rate: int | None = None,
) -> Controller:
    """Returns the control structure that policies are trained for.

    The paper's range of thrust in attitude control lifts drones whose thrust-to-weight ratio is
    above 1.71, so unless `paper_scales` it is set about the share at which the drone hovers. That
    of PWM grows beyond full scale for weak drones of today's firmware, whose batteries allow it.

    Args:
        structure: a name in `names.CONTROLS`, or `MODULE:NAME` of your own.
        drone: to train for.
        full_scale_counts: of the drone; see `ControlInterface`.
        initial: where training starts, if set; the range of thrust is then its own.
        paper_scales: whether all actions are scaled as the paper does.
        rate: actions a second [Hz]; the structure's own by default.
    """
    at: dict[str, Any] = {} if rate is None else {"action_rate": rate}
    papers = control.find_controller(structure, full_scale_counts=full_scale_counts, **at)
    if structure not in ("attitude", "pwm") or paper_scales:
        return papers
    if initial is not None and initial.interface.name == structure:
        theirs = initial.interface
        return control.controller_for(
            dataclasses.replace(papers.interface, centre=theirs.centre, span=theirs.span)
        )
    share = float(dynamics.hover_command(drone))
    if structure == "pwm":
        # Only today's firmware caps after compensation for the battery.
        highest = float(battery.PLUS.counts(np.float64(LOWEST_VOLTS))) / battery.MOST_COUNTS
        highest = highest if full_scale_counts == battery.MOST_COUNTS else 1.0
        most = _in_steps(HEADROOM * share, 1.0, highest)
        return control.pwm(full_scale_counts=full_scale_counts, most=most, **at)
    hover = _in_steps(share, HOVER_STEP, 1.0)
    return control.attitude(full_scale_counts=full_scale_counts, hover=hover, **at)


def _in_steps(share: float, least: float, most: float) -> float:
    return round(min(max(round(share / HOVER_STEP) * HOVER_STEP, least), most), 6)
