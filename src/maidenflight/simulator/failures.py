"""Why episodes end: the failures of tasks, and the differentiable margins to them."""

from functools import reduce

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from maidenflight.simulator import rotations
from maidenflight.simulator.dynamics import State
from maidenflight.simulator.vectors import norm, squared

END_REASONS = ("", "time limit", "not finite", "body rate", "tilt", "position error", "height")
"""Why an episode ends. Where several hold at once, it is the first of these."""
TIME_LIMIT, NOT_FINITE = END_REASONS.index("time limit"), END_REASONS.index("not finite")
MAX_POSITION_ERROR_M = 0.25
"""Distance from the set-point [m] at which an episode fails (Gronauer et al. 2022, sec.
Experimental Setup)."""
MAX_TILT_RAD = np.radians(60.0)
"""Roll or pitch [rad] at which hover and take-off fail (authors' code, hover)."""
MAX_BODY_RATE_RAD_S = np.radians(300.0)
"""Body rate [rad/s] at which hover fails (authors' code)."""
MIN_HEIGHT_M = 0.2
"""Height [m] below which hover fails (authors' code)."""
TAKE_OFF_MAX_POSITION_ERROR_M = 0.5
"""Distance from the set-point [m] at which a take-off fails, and the set-point's height at which
the drone must have left; ours."""
AIRBORNE_HEIGHT_M = 0.05
"""Height [m] that a drone has once it has left the ground; ours."""


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
