"""Tasks: where an episode starts, what the drone shall follow, what that is worth and when it has failed."""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from maidenflight.parameters import Parameters
from maidenflight.simulator import dynamics, rotations, trajectories
from maidenflight.simulator.dynamics import State
from maidenflight.simulator.trajectories import Trajectory


class Task(NamedTuple):
    """A task of one drone."""

    name: str
    reference: Trajectory
    """Set-point [m] at a time [s]."""
    reset: Callable[[Parameters, Array], tuple[State, Float[Array, ""]]]
    """(parameters, key) to a first state and the reference's time [s] at which the episode starts."""
    reward: Callable[[State, Float[Array, "3"], Float[Array, "4"], Float[Array, "4"]], Float[Array, ""]]
    """(state, setpoint, action, previous action) to the reward of one step."""
    terminated: Callable[[State, Float[Array, "3"]], Bool[Array, ""]]
    """(state, setpoint) to whether the drone has failed."""
    duration: float
    """Time after which an episode is truncated [s]."""


FARTHEST = 0.25
"""Distance from the set-point [m] at which an episode fails (Gronauer et al. 2022, sec. Experimental Setup)."""


def _norm(vector: Float[Array, "n"]) -> Float[Array, ""]:
    """Euclidean norm whose gradient at zero is zero, not NaN."""
    square = jnp.sum(vector**2)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)


def paper_reward(
    state: State, setpoint: Float[Array, "3"], action: Float[Array, "4"], previous_action: Float[Array, "4"]
) -> Float[Array, ""]:
    """The paper's reward, its penalties negative: -(|e| + 1e-4 |a| + 1e-3 |a - a_previous| + 1e-3 |omega|) - 100 if |e| > 0.25 m.

    The paper prints the penalties with a plus sign and the terminal reward with a minus; one of them must turn.

    Source: Gronauer et al. 2022, sec. Experimental Setup.
    """
    distance = _norm(setpoint - state.position)
    penalties = 1e-4 * _norm(action) + 1e-3 * _norm(action - previous_action) + 1e-3 * _norm(state.body_rates)
    return -distance - penalties - jnp.where(distance > FARTHEST, 100.0, 0.0)


def too_far(state: State, setpoint: Float[Array, "3"]) -> Bool[Array, ""]:
    """The paper's termination: the drone is more than 0.25 m from its set-point."""
    return jnp.sum((setpoint - state.position) ** 2) > FARTHEST**2


@cache
def circle(diameter: float = 0.5, period: float = 3.0, height: float = 1.0) -> Task:
    """Follow a circle, clock-wise, from a random point on it; 5 s an episode.

    Start values are uniform: +-5 cm about the reference, roll and pitch +-20 deg, yaw +-18 deg, velocity +-0.1 m/s a world axis,
    body rates +-50 deg/s (yaw 20); rotor speeds are normal about hover with a deviation of 0.02.

    Source: Gronauer et al. 2022, sec. Experimental Setup; start values from the authors' code.
    """
    reference = trajectories.circle(diameter, period, height)
    tilt = np.radians(np.array([20.0, 20.0, 18.0], np.float32))
    spin = np.radians(np.array([50.0, 50.0, 20.0], np.float32))

    def reset(parameters: Parameters, key: Array) -> tuple[State, Float[Array, ""]]:
        time_key, uniform_key, rotor_key = jax.random.split(key, 3)
        start = period * jax.random.uniform(time_key)
        draws = jax.random.uniform(uniform_key, (4, 3), minval=-1.0, maxval=1.0)
        hover = dynamics.at_hover(reference(start) + 0.05 * draws[0], parameters)
        state = hover._replace(
            velocity=0.1 * draws[1],
            quaternion=rotations.from_attitude(jnp.asarray(tilt) * draws[2]),
            body_rates=spin * draws[3],
            rotor_speed=jnp.clip(hover.rotor_speed + 0.02 * jax.random.normal(rotor_key, (4,)), 0.0, 1.0),
        )
        return state, start

    return Task("circle", reference, reset, paper_reward, too_far, duration=5.0)
