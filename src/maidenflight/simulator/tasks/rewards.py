"""Rewards of tasks: the paper's, and the authors' of hover and take-off."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from maidenflight.simulator.physics.dynamics import State
from maidenflight.simulator.physics.vectors import norm
from maidenflight.simulator.tasks.failures import (
    MAX_POSITION_ERROR_M,
    hover_failure,
    take_off_failure,
)

ACTION_PENALTY, ACTION_RATE_PENALTY = 1e-4, 1e-3
"""Cost of an action's length and of its change's length, a control period (Gronauer et al. 2022,
sec. Experimental Setup)."""
LOW_HEIGHT_M = 0.08
"""Height [m] below which each step of a take-off costs 1 (authors' code)."""


def paper_reward(
    state: State,
    setpoint: Float[Array, "3"],
    action: Float[Array, "4"],
    previous_action: Float[Array, "4"],
    farthest: float = MAX_POSITION_ERROR_M,
    action_penalty: float = ACTION_PENALTY,
    action_rate_penalty: float = ACTION_RATE_PENALTY,
) -> Float[Array, ""]:
    """Returns the paper's reward with negative penalties.

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


def hover_reward(
    state: State,
    setpoint: Float[Array, "3"],
    action: Float[Array, "4"],
    previous_action: Float[Array, "4"],
) -> Float[Array, ""]:
    """Returns -(|e| + 1e-4 |u| + 1e-4 |omega|) - 100 on failure.

    With u = (clip(a, -1, 1) + 1) / 2.

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
    """Returns -(|e| + 1e-4 (|u| + |omega| + |v|)) - 1 if z < 0.08 m - 100 on failure.

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
