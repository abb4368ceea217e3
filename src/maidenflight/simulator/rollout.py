"""Flying a policy for many control periods.

Pure functions of one drone, of which `jax.vmap` makes many.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax, tree
from jaxtyping import Array, Float

from maidenflight.parameters import Parameters
from maidenflight.simulator.environment import (
    Environment,
    EnvState,
    StepResult,
    observation,
    reset,
    step,
)
from maidenflight.simulator.randomization import Distribution

PolicyFunction = Callable[[Float[Array, "20H"]], Float[Array, "4"]]


class EnvInstance(NamedTuple):
    """A drone in flight."""

    env_state: EnvState
    parameters: Parameters


def rollout(
    environment: Environment,
    policy: PolicyFunction,
    env_state: EnvState,
    parameters: Parameters,
    key: Array,
    steps: int,
) -> tuple[EnvState, tuple[EnvState, StepResult]]:
    """Flies a policy for a number of control periods; a finished episode goes on.

    Args:
        environment: what is simulated.
        policy: observation to action.
        env_state: where to begin.
        parameters: the drone.
        key: random key.
        steps: control periods; static.

    Returns:
        The last episode state, and each period's episode (before it) and outcome, stacked along a
        first axis of `steps`.
    """

    def one(env_state: EnvState, key: Array) -> tuple[EnvState, tuple[EnvState, StepResult]]:
        after, step_result = step(
            environment, env_state, policy(observation(env_state)), parameters, key
        )
        return after, (env_state, step_result)

    return lax.scan(one, env_state, jax.random.split(key, steps))


def randomized_reset(
    environment: Environment, distribution: Distribution, key: Array
) -> EnvInstance:
    """Draws a drone and an episode that starts where the task starts it."""
    drone_key, reset_key = jax.random.split(key)
    parameters = distribution.draw(drone_key)
    return EnvInstance(reset(environment, parameters, reset_key), parameters)


def rollout_with_auto_reset(
    environment: Environment,
    policy: PolicyFunction,
    drone: EnvInstance,
    fresh: EnvInstance,
    key: Array,
    steps: int,
) -> tuple[EnvInstance, tuple[EnvState, StepResult]]:
    """Flies a policy for a number of control periods.

    After a finished episode the next of the prepared drones takes over.

    Args:
        environment: what is simulated.
        policy: observation to action.
        drone: where to begin.
        fresh: F prepared drones, stacked along a first axis; the one that takes over is that of the
            period's number modulo F.
        key: random key.
        steps: control periods; static.

    Returns:
        The drone that flies in the end, and each period's episode (before it) and outcome, stacked
        along a first axis of `steps`.
    """
    count = fresh.env_state.time.shape[0]

    def one(
        drone: EnvInstance, now: tuple[Array, Array]
    ) -> tuple[EnvInstance, tuple[EnvState, StepResult]]:
        number, key = now
        env_state, step_result = step(
            environment,
            drone.env_state,
            policy(observation(drone.env_state)),
            drone.parameters,
            key,
        )
        over = step_result.terminated | step_result.truncated
        after, new = (
            EnvInstance(env_state, drone.parameters),
            tree.map(lambda leaf: leaf[number % count], fresh),
        )
        return tree.map(lambda old, new: jnp.where(over, new, old), after, new), (
            drone.env_state,
            step_result,
        )

    return lax.scan(one, drone, (jnp.arange(steps), jax.random.split(key, steps)))
