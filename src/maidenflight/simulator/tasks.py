"""Tasks: initial states, reference, reward, failure and the margin to failure."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial, reduce
from operator import add
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from maidenflight.errors import InputError
from maidenflight.parameters import Parameters
from maidenflight.simulator import dynamics, noise, rotations, trajectories
from maidenflight.simulator.dynamics import State
from maidenflight.simulator.trajectories import Trajectory, once

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


END_REASONS = ("", "time limit", "not finite", "body rate", "tilt", "position error", "height")
"""Why an episode ends. Where several hold at once, it is the first of these."""
TIME_LIMIT, NOT_FINITE = END_REASONS.index("time limit"), END_REASONS.index("not finite")
MAX_POSITION_ERROR_M = 0.25
"""Distance from the set-point [m] at which an episode fails (Gronauer et al. 2022, sec.
Experimental Setup)."""
MAX_TILT_RAD = np.radians(60.0)
"""Roll or pitch [rad] at which hover and take-off fail (authors' code, hover)."""
ACTION_PENALTY, ACTION_RATE_PENALTY = 1e-4, 1e-3
"""Cost of an action's length and of its change's length, a control period (Gronauer et al. 2022,
sec. Experimental Setup)."""
MAX_BODY_RATE_RAD_S = np.radians(300.0)
"""Body rate [rad/s] at which hover fails (authors' code)."""
MIN_HEIGHT_M = 0.2
"""Height [m] below which hover fails (authors' code)."""
TAKE_OFF_MAX_POSITION_ERROR_M = 0.5
"""Distance from the set-point [m] at which a take-off fails, and the set-point's height at which
the drone must have left; ours."""
STANDING_HEIGHT_M = 0.0125
"""Height [m] of a drone that stands on the ground (authors' code, take-off)."""
AIRBORNE_HEIGHT_M = 0.05
"""Height [m] that a drone has once it has left the ground; ours."""
FASTEST = {"fast_circle": 2.5, "fast_figure_eight": 2.0}
"""Top speeds of fast tasks [m/s], near what the Crazyflie's thrust allows."""
STEEP = 0.94
"""Sine of the tilt, 70 degrees, beyond which fast tasks penalise it; ours."""
LOW_HEIGHT_M = 0.08
"""Height [m] below which each step of a take-off costs 1 (authors' code)."""


@dataclass(frozen=True)
class Spread:
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


CIRCLE_START = Spread((0.05, 0.05, 0.05), (20.0, 20.0, 18.0), 0.1, (50.0, 50.0, 20.0))
"""Source: Gronauer et al. 2022, sec. Experimental Setup; the numbers are from the authors' code."""
HOVER_START = Spread((0.25, 0.25, 0.25), (30.0, 30.0, 180.0), 0.1, (200.0, 200.0, 20.0))
"""Source: authors' code; its yaw of +-360 deg is the same attitudes, but of both signs of the
quaternion."""
TAKE_OFF_START = Spread((0.25, 0.25, 0.0), (0.0, 0.0, 180.0), 0.0, (0.0, 0.0, 0.0), rotor_speed=0.0)
"""Source: authors' code."""


def _starting(
    reference: Trajectory, spread: Spread, latest: float = 0.0, moving: bool = False
) -> Reset:
    """A reset near a reference.

    Args:
        reference: set-point [m] at a time [s].
        spread: how near.
        latest: the start on the reference's clock is uniform up to it [s].
        moving: whether the drone starts with the reference's velocity, else about at rest.
    """
    tilt = np.radians(np.array(spread.attitude, np.float32))
    spin = np.radians(np.array(spread.body_rates, np.float32))
    box = np.array(spread.position, np.float32)

    def reset(parameters: Parameters, key: Array) -> tuple[State, Float[Array, ""]]:
        normal, uniform = noise.draw(key, 4, 13)
        start, draws = latest * (uniform[12] + 1.0) / 2.0, uniform[:12].reshape(4, 3)
        hover = dynamics.at_hover(reference(start) + box * draws[0], parameters)
        velocity = spread.velocity * draws[1]
        if moving:
            velocity = velocity + jax.jvp(reference, (start,), (jnp.ones_like(start),))[1]
        state = hover._replace(
            velocity=velocity,
            quaternion=rotations.from_attitude(jnp.asarray(tilt) * draws[2]),
            body_rates=spin * draws[3],
            rotor_speed=jnp.clip(hover.rotor_speed + spread.rotor_speed * normal, 0.0, 1.0),
        )
        return state, start

    return reset


def norm(vector: Float[Array, "n"]) -> Float[Array, ""]:
    """Euclidean norm whose gradient at zero is zero, not NaN."""
    square = squared(vector)
    return jnp.where(square == 0, 0.0, jnp.sqrt(jnp.where(square == 0, 1.0, square)))


def squared(vector: Float[Array, "n"]) -> Float[Array, ""]:
    """Sum of squares, written out as in `dynamics`."""
    return reduce(add, [entry * entry for entry in vector])


def paper_reward(
    state: State,
    setpoint: Float[Array, "3"],
    action: Float[Array, "4"],
    previous_action: Float[Array, "4"],
    farthest: float = MAX_POSITION_ERROR_M,
    action_penalty: float = ACTION_PENALTY,
    action_rate_penalty: float = ACTION_RATE_PENALTY,
) -> Float[Array, ""]:
    """The paper's reward with negative penalties.

    -(|e| + 1e-4 |a| + 1e-3 |a - a_previous| + 1e-3 |omega|) - 100 if |e| > 0.25 m. The paper prints
    the penalties with a plus sign and the terminal reward with a minus; their signs must agree.

    Args:
        state: the drone after the step.
        setpoint: desired position [m].
        action: of the step, not clipped.
        previous_action: of the step before.
        farthest: distance from the set-point [m] beyond which 100 is subtracted.
        action_penalty: weight of |a|.
        action_rate_penalty: weight of |a - a_previous|.

    Source: Gronauer et al. 2022, sec. Experimental Setup.
    """
    distance = norm(setpoint - state.position)
    penalties = (
        action_penalty * norm(action)
        + action_rate_penalty * norm(action - previous_action)
        + 1e-3 * norm(state.body_rates)
    )
    return -distance - penalties - jnp.where(distance > farthest, 100.0, 0.0)


@cache
def with_yaw_penalty(task: Task, yaw_penalty: float) -> Task:
    """The task with a cost of yaw.

    The paper's rewards do not depend on yaw, and its episodes last 5 s. Constant torques and the
    gyro's bias turn a drone further than training has seen, where the policy fails.

    Args:
        task: the task; its failures stay the same.
        yaw_penalty: cost of a radian of yaw, per control period.
    """

    def reward(
        state: State,
        setpoint: Float[Array, "3"],
        action: Float[Array, "4"],
        previous_action: Float[Array, "4"],
    ) -> Float[Array, ""]:
        return task.reward(state, setpoint, action, previous_action) - yaw_penalty * jnp.abs(
            rotations.heading(state.quaternion)
        )

    # A name of its own, so that training is not resumed with another penalty.
    return task._replace(name=f"{task.name}, yaw penalty {yaw_penalty:g}", reward=reward)


def too_far(
    state: State, setpoint: Float[Array, "3"], farthest: float = MAX_POSITION_ERROR_M
) -> Bool[Array, ""]:
    """The paper's termination: the drone is more than 0.25 m from its set-point."""
    return squared(setpoint - state.position) > farthest**2


def too_steep(state: State) -> Bool[Array, ""]:
    """Roll or pitch is beyond 60 deg, to either side."""
    roll, pitch, _ = jnp.abs(rotations.to_attitude(state.quaternion))
    return jnp.maximum(roll, pitch) > np.float32(MAX_TILT_RAD)


def reason(**failures: Bool[Array, ""]) -> Int[Array, ""]:
    """The index of the first of `END_REASONS` that holds, 0 if none does.

    Names have _ for a blank.
    """
    found = jnp.zeros((), jnp.int32)
    for index, name in reversed(list(enumerate(END_REASONS))):
        if name.replace(" ", "_") in failures:
            found = jnp.where(failures[name.replace(" ", "_")], index, found)
    return found


def strayed(
    state: State, setpoint: Float[Array, "3"], farthest: float = MAX_POSITION_ERROR_M
) -> Int[Array, ""]:
    """The paper's failure: the drone is more than 0.25 m from its set-point."""
    return reason(position_error=too_far(state, setpoint, farthest))


def position_margin(
    state: State, setpoint: Float[Array, "3"], farthest: float = MAX_POSITION_ERROR_M
) -> Float[Array, ""]:
    """1 less the distance from the set-point over the distance at which a task fails."""
    return 1.0 - norm(setpoint - state.position) / farthest


def _tilt_share(state: State) -> Float[Array, ""]:
    """1 where roll or pitch alone is 60 deg; where both are tilted it is reached earlier."""
    upright = rotations.body_z(state.quaternion)[2]
    return (1.0 - upright) / (1.0 - np.float32(np.cos(MAX_TILT_RAD)))


def hover_margin(state: State, setpoint: Float[Array, "3"]) -> Float[Array, ""]:
    """1 less the greatest of body rates, tilt and sinking, each over `hover_failure`'s limit."""
    p, q, r = jnp.abs(state.body_rates) / np.float32(MAX_BODY_RATE_RAD_S)
    sinking = (setpoint[2] - state.position[2]) / (setpoint[2] - MIN_HEIGHT_M)
    return 1.0 - reduce(jnp.maximum, [p, q, r, _tilt_share(state), sinking])


def take_off_margin(state: State, setpoint: Float[Array, "3"]) -> Float[Array, ""]:
    """The smaller of the margins of distance and tilt, each relative to `take_off_failure`.

    A drone that stays on the ground is far from the set-point too.
    """
    distance = position_margin(state, setpoint, TAKE_OFF_MAX_POSITION_ERROR_M)
    return jnp.minimum(distance, 1.0 - _tilt_share(state))


def hover_failure(state: State, setpoint: Float[Array, "3"]) -> Int[Array, ""]:
    """The authors' failure of hover.

    Roll or pitch beyond 60 deg, a body rate beyond 300 deg/s or a height below 0.2 m.
    """
    p, q, r = jnp.abs(state.body_rates)
    spinning = jnp.maximum(jnp.maximum(p, q), r) > np.float32(MAX_BODY_RATE_RAD_S)
    return reason(
        body_rate=spinning, tilt=too_steep(state), height=state.position[2] < MIN_HEIGHT_M
    )


def take_off_failure(state: State, setpoint: Float[Array, "3"]) -> Int[Array, ""]:
    """Failure of a take-off.

    Roll or pitch beyond 60 deg, 0.5 m from the set-point, or still on the ground when the set-point
    is 0.5 m above it.
    """
    height = state.position[2]
    left_behind = (setpoint[2] > TAKE_OFF_MAX_POSITION_ERROR_M) & (height < AIRBORNE_HEIGHT_M)
    return reason(
        tilt=too_steep(state),
        position_error=too_far(state, setpoint, TAKE_OFF_MAX_POSITION_ERROR_M),
        height=left_behind,
    )


def hover_reward(
    state: State,
    setpoint: Float[Array, "3"],
    action: Float[Array, "4"],
    previous_action: Float[Array, "4"],
) -> Float[Array, ""]:
    """-(|e| + 1e-4 |u| + 1e-4 |omega|) - 100 on failure, with u = (clip(a, -1, 1) + 1) / 2.

    Source: authors' code.
    """
    return _effort(state, setpoint, action) - jnp.where(
        hover_failure(state, setpoint) > 0, 100.0, 0.0
    )


def take_off_reward(
    state: State,
    setpoint: Float[Array, "3"],
    action: Float[Array, "4"],
    previous_action: Float[Array, "4"],
) -> Float[Array, ""]:
    """-(|e| + 1e-4 |u| + 1e-4 |omega| + 1e-4 |v|) - 1 if z < 0.08 m - 100 on failure.

    Source: authors' code; there a take-off never fails. Without the last term it would pay to fail
    early.
    """
    grounded = jnp.where(state.position[2] < LOW_HEIGHT_M, 1.0, 0.0)
    failure = jnp.where(take_off_failure(state, setpoint) > 0, 100.0, 0.0)
    return _effort(state, setpoint, action) - 1e-4 * norm(state.velocity) - grounded - failure


def _effort(
    state: State, setpoint: Float[Array, "3"], action: Float[Array, "4"]
) -> Float[Array, ""]:
    """-(|e| + 1e-4 |u| + 1e-4 |omega|), the part that the authors' hover and take-off share."""
    command = (jnp.clip(action, -1.0, 1.0) + 1.0) / 2.0
    return -norm(setpoint - state.position) - 1e-4 * norm(command) - 1e-4 * norm(state.body_rates)


@once
def circle(
    diameter: float = 0.5,
    period: float = 3.0,
    height: float = 1.0,
    action_penalty: float = ACTION_PENALTY,
    action_rate_penalty: float = ACTION_RATE_PENALTY,
) -> Task:
    """Follow a circle, clock-wise, from a random point on it; 5 s an episode.

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
    reset = _starting(reference, CIRCLE_START, latest=period)
    reward = partial(
        paper_reward, action_penalty=action_penalty, action_rate_penalty=action_rate_penalty
    )
    return Task(
        "circle", reference, reset, reward, strayed, duration=5.0, failure_margin=position_margin
    )


@once
def hover(height: float = 1.0) -> Task:
    """Come to rest above the origin, from up to 0.25 m away, tilted, turning, with any yaw.

    5 s an episode.

    Source: authors' code.
    """
    reference = trajectories.hold((0.0, 0.0, height))
    reset = _starting(reference, HOVER_START)
    return Task(
        "hover",
        reference,
        reset,
        hover_reward,
        hover_failure,
        duration=5.0,
        failure_margin=hover_margin,
    )


@once
def take_off(height: float = 1.0, duration: float = 1.5) -> Task:
    """Rise from the ground, motors off, to a height [m] within a duration [s], and stay there.

    5 s an episode.

    The ground stops the drone without a bounce or a tilt; near it, thrust grows
    (`dynamics.near_ground`).

    Source: authors' code, there called "not yet working properly".
    """
    reference = trajectories.climb(height, duration)
    near = _starting(reference, TAKE_OFF_START)

    def reset(parameters: Parameters, key: Array) -> tuple[State, Float[Array, ""]]:
        state, start = near(parameters, key)
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


@once
def tracking(
    trajectory: Trajectory,
    duration: float,
    farthest: float = MAX_POSITION_ERROR_M,
    latest_start: float = 0.0,
) -> Task:
    """Follow any trajectory, with the paper's reward, from near it and as fast as it.

    Args:
        trajectory: what to follow.
        duration: of an episode [s].
        farthest: distance from the set-point [m] at which an episode fails.
        latest_start: episodes start on the trajectory's clock uniformly up to this time [s]: a
            period, for a closed curve.

    Raises:
        InputError: the trajectory does not make three numbers of a time by functions of
            `jax.numpy`, or the duration is not above 0.

    Source: reward, failure and all start values but velocity as in `circle`.
    """
    if not duration > 0.0:
        raise InputError(f"duration = {duration} s of an episode; expected more than 0.")
    try:
        shape = jax.eval_shape(trajectory, jnp.zeros(())).shape
    except (TypeError, AttributeError, jax.errors.JAXTypeError) as error:
        raise InputError(
            "the trajectory is not a function of time that JAX can trace; write it with jax.numpy, "
            f"without if ({error})."
        ) from error
    if shape != (3,):
        raise InputError(
            f"the trajectory gives an array of shape {shape} at a time; expected 3 numbers, a "
            "position [m]."
        )
    reset = _starting(trajectory, CIRCLE_START, latest_start, moving=True)
    reward, failed, margin = (
        partial(rule, farthest=farthest) for rule in (paper_reward, strayed, position_margin)
    )
    return Task("tracking", trajectory, reset, reward, failed, duration, failure_margin=margin)


@once
def figure_eight(period: float = trajectories.NORMAL) -> Task:
    """Fly a horizontal figure-eight in a period [s], from anywhere on it, one period an episode."""
    return tracking(trajectories.figure_eight(period), period, latest_start=period)._replace(
        name="figure_eight"
    )


@once
def fast_circle(fastest: float = FASTEST["fast_circle"]) -> Task:
    """Fly a level circle of 1 m at any speed up to the fastest [m/s]; 5 s an episode.

    At 2.5 m/s it takes a thrust of 1.6 times the weight and 52 degrees of tilt.
    """
    return _fast("fast_circle", trajectories.quickening_circle(fastest), fastest)


@once
def fast_figure_eight(fastest: float = FASTEST["fast_figure_eight"]) -> Task:
    """Fly a level figure-eight, 2 m wide, at any top speed up to the fastest [m/s]; 5 s an episode.

    At 2 m/s its tips take a thrust of 1.6 times the weight.
    """
    return _fast("fast_figure_eight", trajectories.quickening_figure_eight(fastest), fastest)


def _fast(name: str, reference: Trajectory, fastest: float) -> Task:
    """A task whose episodes start anywhere on a reference that grows faster."""
    task = tracking(reference, 5.0, latest_start=trajectories.QUICKENING)
    usual = fastest == FASTEST[name]
    # Another name for another speed, so that training is not resumed with it.
    return task._replace(name=name if usual else f"{name} up to {fastest:g} m/s", tilt_margin=STEEP)


TASKS: dict[str, Callable[[], Task]] = {
    "circle": circle,
    "figure_eight": figure_eight,
    "fast_circle": fast_circle,
    "fast_figure_eight": fast_figure_eight,
    "hover": hover,
    "take_off": take_off,
}
"""Tasks by name, as the command line offers them."""
