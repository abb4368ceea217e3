"""Rollouts: a policy for many control periods.

Pure functions of one drone; `jax.vmap` batches them.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
from jax import lax
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

    def advance(env_state: EnvState, key: Array) -> tuple[EnvState, tuple[EnvState, StepResult]]:
        after, step_result = step(
            environment, env_state, policy(observation(environment, env_state)), parameters, key
        )
        return after, (env_state, step_result)

    return lax.scan(advance, env_state, jax.random.split(key, steps))


def randomized_reset(
    environment: Environment, distribution: Distribution, key: Array
) -> EnvInstance:
    """Draws a drone's parameters and resets its episode."""
    drone_key, reset_key = jax.random.split(key)
    parameters = distribution.draw(drone_key)
    return EnvInstance(reset(environment, parameters, reset_key), parameters)
