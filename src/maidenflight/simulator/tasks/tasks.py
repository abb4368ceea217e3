"""Tasks: initial states, reference, reward and failure."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from maidenflight import names
from maidenflight.errors import InputError, check_traced
from maidenflight.parameters import Parameters
from maidenflight.registry import import_part
from maidenflight.simulator.physics import dynamics, rotations, sensors
from maidenflight.simulator.physics.dynamics import State
from maidenflight.simulator.tasks import courses, trajectories
from maidenflight.simulator.tasks.failures import (
    MAX_POSITION_ERROR_M,
    hover_failure,
    hover_margin,
    position_margin,
    strayed,
    take_off_failure,
    take_off_margin,
)
from maidenflight.simulator.tasks.rewards import (
    ACTION_PENALTY,
    ACTION_RATE_PENALTY,
    hover_reward,
    paper_reward,
    take_off_reward,
)
from maidenflight.simulator.tasks.trajectories import Trajectory, cached_by_arguments
from maidenflight.simulator.tasks.waypoints import read_reference

Reset = Callable[[Parameters, Array], tuple[State, Float[Array, ""]]]


class Task(NamedTuple):
    """A task of one drone."""

    name: str
    reference: Trajectory
    """Set-point [m] at a time [s]."""
    reset: Reset
    """(parameters, key) to a first state and the reference's time [s] at which the episode
    starts."""
    reward: Callable[
        [State, Float[Array, "3"], Float[Array, "4"], Float[Array, "4"]], Float[Array, ""]
    ]
    """(state, setpoint, action, previous action) to the reward of one step."""
    failure: Callable[[State, Float[Array, "3"]], Int[Array, ""]]
    """(state, setpoint) to why the drone has failed, an index of `END_REASONS`; 0: it has not."""
    duration: float
    """Time after which an episode is truncated [s]."""
    first_command: Callable[[Parameters], Float[Array, ""]] = dynamics.hover_command
    """(parameters) to the command u, in [0, 1], that the motors had before the episode."""
    floor: float | None = None
    """Height [m] at which the drone stands on a floor; `None`: there is no floor."""
    failure_margin: Callable[[State, Float[Array, "3"]], Float[Array, ""]] | None = None
    """(state, setpoint) to the differentiable margin to failure as a share of its limit: 1 where
    nothing is wrong, positive while safe, at most 0 where the drone has failed. `None`: training by
    gradients learns of failure from distance, tilt and body rates alone."""
    tilt_margin: float = 0.30
    """Sine of the tilt beyond which training by gradients penalises it: on the drone a guard ends
    the flight at 30 degrees, sine 0.5."""


STANDING_HEIGHT_M = 0.0125
"""Height [m] of a drone that stands on the ground (authors' code, take-off)."""
FASTEST = {"fast_circle": 2.5, "fast_figure_eight": 2.0}
"""Top speeds of fast tasks [m/s], near what the Crazyflie's thrust allows."""
STEEP = 0.94
"""Sine of the tilt, 70 degrees, beyond which fast tasks penalise it; ours."""


@dataclass(frozen=True)
class InitialStateRange:
    """Half widths of the uniform distributions that an episode's first state is drawn from."""

    position: tuple[float, float, float]
    """About the reference, world [m]."""
    attitude: tuple[float, float, float]
    """Roll, pitch, yaw [deg]."""
    velocity: float
    """Each world axis [m/s]."""
    body_rates: tuple[float, float, float]
    """[deg/s]."""
    rotor_speed: float = 0.02
    """Standard deviation of a normal distribution about hover [-] (authors' code, all tasks)."""


CIRCLE_START = InitialStateRange((0.05, 0.05, 0.05), (20.0, 20.0, 18.0), 0.1, (50.0, 50.0, 20.0))
"""Source: Gronauer et al. 2022, sec. Experimental Setup; the numbers are from the authors' code."""
HOVER_START = InitialStateRange((0.25, 0.25, 0.25), (30.0, 30.0, 180.0), 0.1, (200.0, 200.0, 20.0))
"""Source: authors' code; its yaw of +-360 deg is the same attitudes, but of both signs of the
quaternion."""
TAKE_OFF_START = InitialStateRange(
    (0.25, 0.25, 0.0), (0.0, 0.0, 180.0), 0.0, (0.0, 0.0, 0.0), rotor_speed=0.0
)
"""Source: authors' code."""


def _reset_near(
    reference: Trajectory, start_range: InitialStateRange, latest: float = 0.0, moving: bool = False
) -> Reset:
    """Makes a reset near a reference, up to the latest time on its clock [s], uniformly.

    The drone starts with the reference's velocity if it is moving, else about at rest.
    """
    tilt = np.radians(np.array(start_range.attitude, np.float32))
    spin = np.radians(np.array(start_range.body_rates, np.float32))
    box = np.array(start_range.position, np.float32)

    def reset(parameters: Parameters, key: Array) -> tuple[State, Float[Array, ""]]:
        normal, uniform = sensors.draw_noise(key, 4, 13)
        start, draws = latest * (uniform[12] + 1.0) / 2.0, uniform[:12].reshape(4, 3)
        hover = dynamics.at_hover(reference(start) + box * draws[0], parameters)
        velocity = start_range.velocity * draws[1]
        if moving:
            velocity = velocity + jax.jvp(reference, (start,), (jnp.ones_like(start),))[1]
        state = hover._replace(
            velocity=velocity,
            quaternion=rotations.from_attitude(jnp.asarray(tilt) * draws[2]),
            body_rates=spin * draws[3],
            rotor_speed=jnp.clip(hover.rotor_speed + start_range.rotor_speed * normal, 0.0, 1.0),
        )
        return state, start

    return reset


@cache
def with_yaw_penalty(task: Task, yaw_penalty: float, most_turned: float = 0.0) -> Task:
    """Returns the task with a cost of yaw.

    The paper's rewards do not depend on yaw, and its episodes last 5 s. Constant torques and the
    gyro's bias turn a drone further than in training, where the policy fails.

    Args:
        task: the task; its failures stay the same.
        yaw_penalty: cost of a radian of yaw, per control period.
        most_turned: episodes start turned by up to this [rad], half of them by up to an eighth.
    """

    def reset(parameters: Parameters, key: Array) -> tuple[State, Float[Array, ""]]:
        state, start = task.reset(parameters, key)
        _, (share,) = sensors.draw_noise(jax.random.fold_in(key, 1), 0, 1)
        quaternion = rotations.turn_heading(state.quaternion, most_turned * share**3)
        return state._replace(quaternion=quaternion), start

    def reward(
        state: State,
        setpoint: Float[Array, "3"],
        action: Float[Array, "4"],
        previous_action: Float[Array, "4"],
    ) -> Float[Array, ""]:
        return task.reward(state, setpoint, action, previous_action) - yaw_penalty * jnp.abs(
            rotations.heading(state.quaternion)
        )

    # A name of its own, so that training is not resumed with another penalty. Where episodes start
    # is no part of it, so that a training may go on with others.
    name = f"{task.name}, yaw penalty {yaw_penalty:g}"
    starts = {"reset": reset} if most_turned else {}
    return task._replace(name=name, reward=reward, **starts)


@cached_by_arguments
def circle(
    diameter: float = 0.5,
    period: float = 3.0,
    height: float = 1.0,
    ramp: float = trajectories.START_S,
) -> Task:
    """Follows a circle, clock-wise, that starts from rest; 5 s an episode.

    Args:
        diameter: [m].
        period: [s], once the ramp is over.
        height: [m].
        ramp: time in which the speed grows from zero [s].

    Source: the circle is that of Gronauer et al. 2022, sec. Experimental Setup; the ramp is ours.
    """
    return _closed("circle", trajectories.circle(diameter, period, height), period, 5.0, ramp)


@cached_by_arguments
def paper_circle(
    diameter: float = 0.5,
    period: float = 3.0,
    height: float = 1.0,
    action_penalty: float = ACTION_PENALTY,
    action_rate_penalty: float = ACTION_RATE_PENALTY,
) -> Task:
    """Follows the circle of the paper, clock-wise, at full speed from the first instant on.

    Episodes of 5 s start about rest at a random point on it. From hover such a start takes a jump,
    which studies of the paper and its authors' policies need and a real drone does not.

    Start values are uniform: +-5 cm about the reference, roll and pitch +-20 deg, yaw +-18 deg,
    velocity +-0.1 m/s a world axis, body rates +-50 deg/s (yaw 20); rotor speeds are normal about
    hover with a deviation of 0.02.

    Args:
        diameter: [m].
        period: [s].
        height: [m].
        action_penalty: weight of |a| in `paper_reward`.
        action_rate_penalty: weight of |a - a_previous| there.

    Source: Gronauer et al. 2022, sec. Experimental Setup; start values from the authors' code.
    """
    reference = trajectories.circle(diameter, period, height)
    reset = _reset_near(reference, CIRCLE_START, latest=period)
    reward = partial(
        paper_reward, action_penalty=action_penalty, action_rate_penalty=action_rate_penalty
    )
    return Task(
        *("paper_circle", reference, reset, reward, strayed),
        duration=5.0,
        failure_margin=position_margin,
    )


@cached_by_arguments
def hover(height: float = 1.0) -> Task:
    """Comes to rest above the origin, from up to 0.25 m away, tilted, turning, with any yaw.

    5 s an episode.

    Source: authors' code.
    """
    reference = trajectories.hold((0.0, 0.0, height))
    reset = _reset_near(reference, HOVER_START)
    return Task(
        "hover",
        reference,
        reset,
        hover_reward,
        hover_failure,
        duration=5.0,
        failure_margin=hover_margin,
    )


@cached_by_arguments
def take_off(height: float = 1.0, duration: float = 1.5) -> Task:
    """Rises from the ground, motors off, to a height [m] within a duration [s], and stays there.

    5 s an episode. The ground stops the drone without a bounce or a tilt; near it, thrust grows
    (`motion.near_ground`).

    Source: authors' code, there called "not yet working properly".
    """
    reference = trajectories.climb(height, duration)
    reset_on_ground = _reset_near(reference, TAKE_OFF_START)

    def reset(parameters: Parameters, key: Array) -> tuple[State, Float[Array, ""]]:
        state, start = reset_on_ground(parameters, key)
        return state._replace(
            position=state.position.at[2].set(STANDING_HEIGHT_M), rotor_speed=jnp.zeros(4)
        ), start

    def motors_off(parameters: Parameters) -> Float[Array, ""]:
        return jnp.zeros(())

    return Task(
        "take_off",
        reference,
        reset,
        take_off_reward,
        take_off_failure,
        duration=5.0,
        first_command=motors_off,
        floor=STANDING_HEIGHT_M,
        failure_margin=take_off_margin,
    )


@cached_by_arguments
def tracking(
    trajectory: Trajectory | None = None,
    duration: float = 5.0,
    farthest: float = MAX_POSITION_ERROR_M,
    latest_start: float = 0.0,
) -> Task:
    """Follows any trajectory, with the paper's reward, from near it and as fast as it.

    Args:
        trajectory: what to follow; by default a long random course, on which episodes start
            anywhere, for policies that follow any reference.
        duration: of an episode [s].
        farthest: distance from the set-point [m] at which an episode fails.
        latest_start: episodes start on the trajectory's clock uniformly up to this time [s]: a
            period, for a closed curve.

    Raises:
        InputError: the trajectory does not make three numbers of a time by functions of
            `jax.numpy`, or the duration is not above 0.

    Source: reward, failure and all start values but velocity as in `circle`.
    """
    if trajectory is None:
        trajectory, latest_start = courses.random_course(), courses.COURSE_S - duration
    if not duration > 0.0:
        raise InputError(f"duration = {duration} s of an episode; expected more than 0.")
    kind = "3 numbers, a position [m], of a time [s]"
    shape = check_traced("the trajectory", trajectory, kind, jnp.zeros(())).shape
    if shape != (3,):
        raise InputError(f"the trajectory gives an array of shape {shape}; expected {kind}.")
    reset = _reset_near(trajectory, CIRCLE_START, latest_start, moving=True)
    reward, failed, margin = (
        partial(rule, farthest=farthest) for rule in (paper_reward, strayed, position_margin)
    )
    return Task("tracking", trajectory, reset, reward, failed, duration, failure_margin=margin)


@cached_by_arguments
def figure_eight(period: float = trajectories.NORMAL) -> Task:
    """Flies a level figure-eight in a period [s], from rest, one period an episode."""
    return _closed("figure_eight", trajectories.figure_eight(period), period, period)


def _closed(
    name: str,
    curve: Trajectory,
    period: float,
    duration: float,
    ramp: float = trajectories.START_S,
) -> Task:
    """A task whose episodes start anywhere on a closed curve, or on its way from rest to speed."""
    reference = trajectories.accelerating(curve, ramp, smooth=True)
    return tracking(reference, duration, latest_start=ramp + period)._replace(name=name)


@cached_by_arguments
def fast_circle(fastest: float = FASTEST["fast_circle"]) -> Task:
    """Flies a level circle of 1 m at any speed up to the fastest [m/s]; 5 s an episode.

    At 2.5 m/s it takes a thrust of 1.6 times the weight and 52 degrees of tilt.
    """
    return _fast("fast_circle", trajectories.accelerating_circle(fastest), fastest)


@cached_by_arguments
def fast_figure_eight(fastest: float = FASTEST["fast_figure_eight"]) -> Task:
    """Flies a figure-eight, 2 m wide, at any top speed up to the fastest [m/s]; 5 s an episode.

    At 2 m/s its tips take a thrust of 1.6 times the weight.
    """
    return _fast("fast_figure_eight", trajectories.accelerating_figure_eight(fastest), fastest)


def _fast(name: str, reference: Trajectory, fastest: float) -> Task:
    """A task whose episodes start anywhere on a reference that grows faster."""
    task = tracking(reference, 5.0, latest_start=trajectories.RAMP_DURATION_S)
    usual = fastest == FASTEST[name]
    # Another name for another speed, so that training is not resumed with it.
    return task._replace(name=name if usual else f"{name} up to {fastest:g} m/s", tilt_margin=STEEP)


def find_task(name: str) -> Task:
    """Returns the task of a name.

    Args:
        name: one of `TASKS`; a CSV file, whose reference is followed from its start; or
            `MODULE:NAME` of a task or what makes one.

    Raises:
        InputError: there is no such task, or the file is wrong.
    """
    if name in TASKS:
        return TASKS[name]()
    if name.endswith(".csv"):
        return tracking(*read_reference(name))
    part = import_part(name, "task")
    try:
        task = part if isinstance(part, Task) or not callable(part) else part()
    except TypeError as error:
        raise InputError(
            f"{name}: {error}. Expected a Task, or a function without arguments that makes one; a "
            "reward of your own is task._replace(reward=...)."
        ) from error
    if not isinstance(task, Task):
        raise InputError(
            f"{name}: is a {type(task).__name__}; expected a Task, such as "
            "mf.simulator.tracking(TRAJECTORY, 5.0), or a function that makes one."
        )
    return task


TASKS: dict[str, Callable[[], Task]] = {name: globals()[name] for name in names.TASKS}
"""Tasks by name; each is a function of this module."""
