"""Rollouts: a policy for many control periods, with or without automatic resets.

Pure functions of one drone; `jax.vmap` batches them.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax, tree
from jaxtyping import Array, Float

from maidenflight.parameters import Parameters
from maidenflight.simulator.environment import Environment, EnvState, observation, reset
from maidenflight.simulator.randomization import Distribution
from maidenflight.simulator.stepping import StepResult, step

PolicyFunction = Callable[[Float[Array, "20H+3K"]], Float[Array, "4"]]


class EnvInstance(NamedTuple):
    """An environment's state, and the parameters of the drone that flies in it."""

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
        The last state, and the state before and the result of each period, stacked along a first
        axis of `steps`.
    """

    def one(env_state: EnvState, key: Array) -> tuple[EnvState, tuple[EnvState, StepResult]]:
        after, step_result = step(
            environment, env_state, policy(observation(environment, env_state)), parameters, key
        )
        return after, (env_state, step_result)

    return lax.scan(one, env_state, jax.random.split(key, steps))


def randomized_reset(
    environment: Environment, distribution: Distribution, key: Array
) -> EnvInstance:
    """Draws a drone's parameters and resets its episode."""
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
    """Flies a policy for a number of control periods; after an episode the next drone flies.

    Args:
        environment: what is simulated.
        policy: observation to action.
        drone: where to begin.
        fresh: F drones at the start of an episode, stacked along a first axis; a reset in period n
            takes number n modulo F.
        key: random key.
        steps: control periods; static.

    Returns:
        The last instance, and the state before and the result of each period, stacked along a first
        axis of `steps`.
    """
    count = fresh.env_state.time.shape[0]

    def one(
        drone: EnvInstance, now: tuple[Array, Array]
    ) -> tuple[EnvInstance, tuple[EnvState, StepResult]]:
        number, key = now
        env_state, step_result = step(
            environment,
            drone.env_state,
            policy(observation(environment, drone.env_state)),
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
