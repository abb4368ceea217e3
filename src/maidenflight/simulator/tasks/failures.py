"""Why flights end: guards, the failures of tasks, and the differentiable margins to those.

Guards and reasons are of JAX or NumPy, as their arguments are.
"""

from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from maidenflight.simulator.physics import rotations
from maidenflight.simulator.physics.dynamics import State
from maidenflight.simulator.physics.vectors import norm, squared

REACHED = "time limit"
"""End reason of a flight that lasts as long as it may."""
END_REASONS = ("", REACHED, "not finite", "body rate", "tilt", "position error", "height")
"""Why a flight ends. Where several hold at once, it is the first of these."""
TIME_LIMIT, NOT_FINITE = END_REASONS.index(REACHED), END_REASONS.index("not finite")
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


class End(NamedTuple):
    """How a flight ended, or many did."""

    steps: Int[Any, "..."]
    """Rows up to the end."""
    reason: Int[Any, "..."]
    """Index of `END_REASONS`; 0 while it flies."""


class Excursion(NamedTuple):
    """How far a drone is from hover at its set-point, in what guards look at."""

    tilt: Float[Any, "..."]
    """The larger of roll and pitch [rad]."""
    body_rate: Float[Any, "..."]
    """The larger of their rates [rad/s]."""
    position_error: Float[Any, "..."]
    """Distance from the set-point [m]."""


def excursion(
    position: Float[ArrayLike, "... 3"],
    attitude: Float[ArrayLike, "... 3"],
    body_rates: Float[ArrayLike, "... 3"],
    setpoint: Float[ArrayLike, "... 3"],
) -> Excursion:
    """Returns how far a drone is from hover at its set-point.

    Args:
        position: [m].
        attitude: roll, pitch, yaw [rad].
        body_rates: [rad/s].
        setpoint: [m].
    """
    values: list[Any] = [setpoint, position, attitude, body_rates]
    library: Any = jnp
    if not isinstance(position, jax.Array):
        library, values = np, [np.asarray(part, np.float64) for part in values]
    wanted, actual, angles, rates = values
    x, y, z = (wanted[..., axis] - actual[..., axis] for axis in range(3))
    tilt, rate = (
        library.maximum(library.abs(part[..., 0]), library.abs(part[..., 1]))
        for part in (angles, rates)
    )
    return Excursion(tilt, rate, library.sqrt(x * x + y * y + z * z))


ERRORS = ("position_error", "estimated_error")
"""Columns of mean distances from the set-point, of the true position and of the drone's estimate,
which is all that a policy can follow [m]."""
LARGEST = ("largest_tilt", "largest_body_rate", "largest_distance")
"""Columns of the largest values of flights, in SI units."""


def largest(excursions: Excursion) -> dict[str, Any]:
    """Returns the largest of each part along its last axis, by columns of a table of flights."""
    worst = (np.max(np.asarray(part, np.float64), axis=-1).round(6) for part in excursions)
    return dict(zip(LARGEST, worst, strict=True))


class Guard(NamedTuple):
    """Limits at which a flight is ended; what is None may be anything, but finite."""

    tilt: Float[Any, ""] = np.inf
    """Roll or pitch [rad]."""
    body_rate: Float[Any, ""] = np.inf
    """Roll or pitch rate [rad/s]."""
    position_error: Float[Any, ""] = np.inf
    """Distance from the set-point [m]."""

    def trips(self, now: Excursion) -> dict[str, Any]:
        """Returns which limits are exceeded, as `reason` takes them."""
        total: Any = sum(now)
        library: Any = jnp if isinstance(total, jax.Array) else np
        return {
            "not_finite": ~library.isfinite(total),
            **{name: getattr(now, name) > limit for name, limit in self._asdict().items()},
        }


BACKUP = Guard(float(np.radians(30.0)), float(np.radians(800.0)))
"""At which the firmware's PID takes over from a policy (Gronauer et al. 2022, sec. Zero-Shot
Experiments)."""
ZERO_SHOT = BACKUP._replace(position_error=MAX_POSITION_ERROR_M)
"""Of zero-shot flights: the same, and the distance at which an episode fails."""
APP = BACKUP._replace(position_error=0.6)
"""Of the exported app by default."""
LOST = Guard(position_error=MAX_POSITION_ERROR_M)
"""Of flights at any speed, whose tilt is no failure."""


def too_far(
    state: State, setpoint: Float[Array, "3"], farthest: float = MAX_POSITION_ERROR_M
) -> Bool[Array, ""]:
    """Returns the paper's termination: the drone is more than 0.25 m from its set-point."""
    return squared(setpoint - state.position) > farthest**2


def too_steep(state: State) -> Bool[Array, ""]:
    """Tests whether roll or pitch is beyond 60 deg, to either side."""
    roll, pitch, _ = jnp.abs(rotations.to_attitude(state.quaternion))
    return jnp.maximum(roll, pitch) > np.float32(MAX_TILT_RAD)


def reason(**failures: Bool[ArrayLike, "..."]) -> Int[Any, "..."]:
    """Returns the index of the first of `END_REASONS` that holds, 0 if none; _ is a blank."""
    of_jax = any(isinstance(holds, jax.Array) for holds in failures.values())
    library: Any = jnp if of_jax else np
    reason_index = library.zeros((), library.int32)
    for index, name in reversed(list(enumerate(END_REASONS))):
        if name.replace(" ", "_") in failures:
            reason_index = library.where(failures[name.replace(" ", "_")], index, reason_index)
    return reason_index


def first_end(reasons: Int[np.ndarray, "N"]) -> End:
    """Returns how a flight ended, of the reasons after each row: the first, or the time limit."""
    ended = np.flatnonzero(reasons)
    if not len(ended):
        return End(len(reasons), TIME_LIMIT)
    return End(int(ended[0]) + 1, int(reasons[ended[0]]))


def strayed(
    state: State, setpoint: Float[Array, "3"], farthest: float = MAX_POSITION_ERROR_M
) -> Int[Array, ""]:
    """Returns the paper's failure: the drone is more than 0.25 m from its set-point."""
    return reason(position_error=too_far(state, setpoint, farthest))


def hover_failure(state: State, setpoint: Float[Array, "3"]) -> Int[Array, ""]:
    """Returns the authors' failure of hover.

    Roll or pitch beyond 60 deg, a body rate beyond 300 deg/s or a height below 0.2 m.
    """
    p, q, r = jnp.abs(state.body_rates)
    spinning = jnp.maximum(jnp.maximum(p, q), r) > np.float32(MAX_BODY_RATE_RAD_S)
    return reason(
        body_rate=spinning, tilt=too_steep(state), height=state.position[2] < MIN_HEIGHT_M
    )


def take_off_failure(state: State, setpoint: Float[Array, "3"]) -> Int[Array, ""]:
    """Tests the failures of a take-off.

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
    """Returns 1 less the distance from the set-point over that at which a task fails."""
    return 1.0 - norm(setpoint - state.position) / farthest


def _tilt_share(state: State) -> Float[Array, ""]:
    """1 where roll or pitch alone is 60 deg; where both are tilted it is reached earlier."""
    upright = rotations.body_z(state.quaternion)[2]
    return (1.0 - upright) / (1.0 - np.float32(np.cos(MAX_TILT_RAD)))


def hover_margin(state: State, setpoint: Float[Array, "3"]) -> Float[Array, ""]:
    """Returns 1 less the greatest of body rates, tilt and sinking over their limits."""
    p, q, r = jnp.abs(state.body_rates) / np.float32(MAX_BODY_RATE_RAD_S)
    sinking = (setpoint[2] - state.position[2]) / (setpoint[2] - MIN_HEIGHT_M)
    return 1.0 - reduce(jnp.maximum, [p, q, r, _tilt_share(state), sinking])


def take_off_margin(state: State, setpoint: Float[Array, "3"]) -> Float[Array, ""]:
    """Returns the smaller of the margins of distance and tilt, each relative to `take_off_failure`.

    A drone that stays on the ground is far from the set-point too.
    """
    distance = position_margin(state, setpoint, TAKE_OFF_MAX_POSITION_ERROR_M)
    return jnp.minimum(distance, 1.0 - _tilt_share(state))
