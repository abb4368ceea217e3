"""Checks `gymnasium.make`'s arguments, and makes an `Environment` and a distribution of drones."""

import os
from collections.abc import Callable
from inspect import signature
from math import isfinite
from typing import Any

from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.integrations.gym import rewards
from maidenflight.parameters import DRONES, Parameters, crazyflie, read_drone
from maidenflight.simulator.controllers import control
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.randomization import Distribution, relative_box
from maidenflight.simulator.tasks import failures, tasks, trajectories
from maidenflight.simulator.tasks import waypoints as way_points
from maidenflight.simulator.tasks.tasks import Task
from maidenflight.simulator.tasks.trajectories import Trajectory

Drones = Parameters | Distribution | StrPath | None
"""One drone, drones to draw from, a named drone, a TOML file, or the Crazyflie +-10 %."""

SHAPES: dict[str, Callable[..., Trajectory]] = {
    "circle": trajectories.circle,
    "figure_eight": trajectories.figure_eight,
    "pentagram": way_points.pentagram,
}
"""Closed curves by name."""


def world(
    task: str,
    control: str,
    parameters: Drones,
    firmware: str,
    spec: PolicySpec,
    reward: str,
    options: dict[str, Any],
) -> tuple[Environment, Distribution]:
    """Returns what to simulate and which drones to draw.

    Args:
        task: `"hover"`, `"circle"`, `"take_off"` or `"tracking"`.
        control: `"pwm"`, `"attitude_rate"` or `"attitude"`.
        parameters: see `Drones`; a file or a point is exactly that drone in every episode.
        firmware: generation of the PIDs, of no consequence to PWM.
        spec: what is observed.
        reward: `"task"` or `"shaped"`, see `rewards`.
        options: arguments of the task.

    Raises:
        InputError: one of them is not what it should be.
    """
    if not isinstance(spec, PolicySpec):
        raise InputError(f"spec = {spec!r}; expected such as PolicySpec(history=2).")
    if beyond := spec.beyond(*PolicySpec.OBSERVED, "hidden"):
        raise InputError(f"spec: {beyond}, which a learner's own network would have to have.")
    controller = _controller(control, firmware)
    drones = _drones(parameters, controller)
    chosen_task = _task(task, options)
    if rewards.check_reward(reward) == "shaped":
        chosen_task = rewards.shaped(chosen_task)
    return Environment.matching(drones.centre, chosen_task, controller, spec=spec), drones


def checked_render_mode(mode: str | None) -> str | None:
    """Returns the render mode, if it is one.

    Raises:
        InputError: it is not.
    """
    if mode not in (None, "rgb_array"):
        raise InputError(f"render_mode = {mode!r}; expected 'rgb_array' or None.")
    return mode


def _controller(name: str, firmware: str) -> Controller:
    make = control.CONTROLLERS.get(name)
    if make is None:
        raise InputError(
            f"control = {name!r}: no such control structure. Give one of "
            f"{', '.join(control.CONTROLLERS)}."
        )
    return make() if name == "pwm" else make(firmware)


def _drones(drones: Drones, controller: Controller) -> Distribution:
    if drones is None or (isinstance(drones, str) and drones in DRONES):
        named, width = (crazyflie(), 0.10) if drones is None else (read_drone(drones), 0.0)
        return relative_box(control.in_fitting_steps(named, controller), width)
    if isinstance(drones, str | os.PathLike):
        drones = read_drone(drones)
    if isinstance(drones, Parameters):
        return relative_box(drones, 0.0)
    if not callable(getattr(drones, "draw", None)):
        raise InputError(
            f"parameters = {drones!r}: no drone. Give Parameters, something to draw them from such "
            f"as relative_box(crazyflie()), a TOML file or one of: {', '.join(DRONES)}."
        )
    return drones


def _tracking(
    trajectory: str | Trajectory = "figure_eight",
    waypoints: StrPath | None = None,
    smooth: bool = False,
    duration: float | None = None,
    farthest: float = failures.MAX_POSITION_ERROR_M,
    latest_start: float = 0.0,
) -> Task:
    if waypoints is not None:
        last = way_points.read_waypoints(waypoints)[-1][0]
        path = way_points.waypoints(waypoints, smooth)
        return tasks.tracking(path, duration or last, farthest, latest_start)
    if isinstance(trajectory, str):
        if trajectory not in SHAPES:
            raise InputError(
                f"trajectory = {trajectory!r}: no such curve. Give one of {', '.join(SHAPES)}, or "
                "waypoints='file.csv'."
            )
        trajectory = SHAPES[trajectory]()
    if not callable(trajectory):
        raise InputError(
            f"trajectory = {trajectory!r}; expected a function of time, such as those of "
            "maidenflight.simulator.tasks.trajectories."
        )
    return tasks.tracking(trajectory, duration or trajectories.NORMAL, farthest, latest_start)


_TASKS: dict[str, Callable[..., Task]] = {
    "hover": tasks.hover,
    "circle": tasks.circle,
    "paper_circle": tasks.paper_circle,
    "take_off": tasks.take_off,
    "tracking": _tracking,
}


def _task(name: str, options: dict[str, Any]) -> Task:
    if name not in _TASKS:
        raise InputError(f"task = {name!r}: no such task. Give one of {', '.join(_TASKS)}.")
    task_parameters = signature(_TASKS[name]).parameters
    for option, value in options.items():
        if option not in task_parameters:
            raise InputError(
                f"{option} = {value!r}: the task {name} has no such option. It has "
                f"{', '.join(task_parameters)}."
            )
        if isinstance(task_parameters[option].default, float) or option == "duration":
            least = 0.0 if option in ("latest_start", "diameter") else 1e-3
            is_number = isinstance(value, float | int) and not isinstance(value, bool)
            if not is_number or not isfinite(value) or value < least:
                raise InputError(
                    f"{option} = {value!r}; expected a number of at least {least:g}. Units are m "
                    "and s."
                )
            options = options | {option: float(value)}
    return _TASKS[name](**options)
