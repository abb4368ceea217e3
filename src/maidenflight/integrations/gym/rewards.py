"""The rewards that an environment may give: the task's own, and one for methods without a model.

The tasks' own rewards are those of the paper and its authors: costs, and 100 for a failure. A
learner that cannot see through the simulator finds that falling soon costs less than flying badly
for long, and then learns to fall.
"""

from functools import cache

import jax.numpy as jnp
from jaxtyping import Array, Float

from maidenflight.errors import InputError
from maidenflight.simulator.physics.dynamics import State
from maidenflight.simulator.physics.vectors import norm
from maidenflight.simulator.tasks.tasks import Task

REWARDS = ("task", "shaped")
"""Names of rewards."""
HALF_AT_M = 0.1
"""Distance from the set-point [m] at which the shaped reward is half its largest value."""
BODY_RATE_COST = 0.01
"""Cost of a rad/s of body rate in the shaped reward, a control period."""
ACTION_CHANGE_COST = 0.02
"""Cost of the length of an action's change in the shaped reward, a control period."""


def check_reward(reward: str) -> str:
    """Returns a name in `REWARDS`.

    Raises:
        InputError: there is no such reward.
    """
    if reward not in REWARDS:
        raise InputError(f"reward = {reward!r}; expected {' or '.join(map(repr, REWARDS))}.")
    return reward


@cache
def shaped(task: Task) -> Task:
    """Returns the task with a reward of 0 to 1 for each control period, whatever the rate.

    max(0, 0.1 m / (0.1 m + |e|) - 0.01 s |omega| - 0.02 |a - a_previous|), and nothing for a
    failure: it costs the rewards that would have followed.

    Args:
        task: the task; its failures stay the same.
    """

    def reward(
        state: State,
        setpoint: Float[Array, "3"],
        action: Float[Array, "4"],
        previous_action: Float[Array, "4"],
    ) -> Float[Array, ""]:
        near = HALF_AT_M / (HALF_AT_M + norm(setpoint - state.position))
        costs = BODY_RATE_COST * norm(state.body_rates) + ACTION_CHANGE_COST * norm(
            action - previous_action
        )
        failed = task.failure(state, setpoint) > 0
        return jnp.where(failed, 0.0, jnp.maximum(near - costs, 0.0))

    return task._replace(name=f"{task.name}, shaped reward", reward=reward)
