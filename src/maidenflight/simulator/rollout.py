"""Flying a policy for many control periods; pure functions of one drone, of which `jax.vmap` makes many."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax, tree
from jaxtyping import Array, Float

from maidenflight.parameters import Parameters
from maidenflight.simulator.environment import Environment, Episode, Outcome, observation, reset, step
from maidenflight.simulator.randomization import Distribution

PolicyFunction = Callable[[Float[Array, "20H"]], Float[Array, "4"]]


class Drone(NamedTuple):
    """A drone in flight."""

    episode: Episode
    parameters: Parameters


def rollout(
    environment: Environment, policy: PolicyFunction, episode: Episode, parameters: Parameters, key: Array, steps: int
) -> tuple[Episode, tuple[Episode, Outcome]]:
    """Flies a policy for a number of control periods; a finished episode goes on.

    Args:
        environment: what is simulated.
        policy: observation to action.
        episode: where to begin.
        parameters: the drone.
        key: random key.
        steps: control periods; static.

    Returns:
        The last episode state, and each period's episode (before it) and outcome, stacked along a first axis of `steps`.
    """

    def one(episode: Episode, key: Array) -> tuple[Episode, tuple[Episode, Outcome]]:
        after, outcome = step(environment, episode, policy(observation(episode)), parameters, key)
        return after, (episode, outcome)

    return lax.scan(one, episode, jax.random.split(key, steps))


def launch(environment: Environment, distribution: Distribution, key: Array) -> Drone:
    """Draws a drone and an episode that starts where the task starts it."""
    drone_key, reset_key = jax.random.split(key)
    parameters = distribution.draw(drone_key)
    return Drone(reset(environment, parameters, reset_key), parameters)


def practise(
    environment: Environment, policy: PolicyFunction, drone: Drone, fresh: Drone, key: Array, steps: int
) -> tuple[Drone, tuple[Episode, Outcome]]:
    """Flies a policy for a number of control periods; after a finished episode the next of the prepared drones takes over.

    Args:
        environment: what is simulated.
        policy: observation to action.
        drone: where to begin.
        fresh: F prepared drones, stacked along a first axis; the one that takes over is that of the period's number modulo F.
        key: random key.
        steps: control periods; static.

    Returns:
        The drone that flies in the end, and each period's episode (before it) and outcome, stacked along a first axis of `steps`.
    """
    count = fresh.episode.time.shape[0]

    def one(drone: Drone, now: tuple[Array, Array]) -> tuple[Drone, tuple[Episode, Outcome]]:
        number, key = now
        episode, outcome = step(environment, drone.episode, policy(observation(drone.episode)), drone.parameters, key)
        over = outcome.terminated | outcome.truncated
        after, new = Drone(episode, drone.parameters), tree.map(lambda leaf: leaf[number % count], fresh)
        return tree.map(lambda old, new: jnp.where(over, new, old), after, new), (drone.episode, outcome)

    return lax.scan(one, drone, (jnp.arange(steps), jax.random.split(key, steps)))
