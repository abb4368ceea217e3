"""Evaluation of policies: return, survival and position error over randomized episodes.

With noise and randomization, as in the paper.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from maidenflight import compiler
from maidenflight.policy import Policy
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.randomization import Distribution
from maidenflight.simulator.stepping import EnvInstance, randomized_reset, rollout
from maidenflight.training.devices import over_devices


class Evaluation(NamedTuple):
    """Means over episodes."""

    episode_return: Float[Any, ""]
    """Sum of rewards until failure or the time limit."""
    survival: Float[Any, ""]
    """Share of episodes that reach the time limit."""
    position_error: Float[Any, ""]
    """Distance from the set-point [m], over all steps before failure."""
    duration: Float[Any, ""]
    """Time until failure or the time limit [s]."""

    def beats(self, other: "Evaluation") -> Bool[Any, ""]:
        """Returns whether it is better: by survival, to the nearest twentieth, then by return.

        By return alone a drone that crashes at once, and so collects little cost, could beat one
        that flies. Where none survives, the longer flights are better, which collect more of it.
        """
        mine, others = (np.round(20 * score.survival) for score in (self, other))
        rewarded = (mine > 0) & (self.episode_return > other.episode_return)
        longer = (mine <= 0) & (self.duration > other.duration)
        return (mine > others) | ((mine == others) & (rewarded | longer))


@partial(jax.jit, static_argnums=(0, 4, 5))
def evaluate(
    env: Environment,
    policy: Policy,
    box: Distribution,
    key: Array,
    episodes: int = 256,
    steps: int | None = None,
) -> Evaluation:
    """Evaluates a policy without exploration noise.

    Args:
        env: task and control structure; static.
        policy: the policy.
        box: distribution of drones; one is drawn for each episode.
        key: random key; the same key gives the same episodes.
        episodes: number of episodes; static.
        steps: control periods of an episode, by default the task's duration; static.
    """
    starts = _starts(env, box, jax.random.split(key, episodes))
    return _means(env, _fly_episode(env, policy, starts, steps))


class Starts(NamedTuple):
    """Beginnings of episodes; each part has an axis of episodes, the last before its own."""

    instances: EnvInstance
    keys: Array
    """Of the flights' noise."""


@partial(jax.jit, static_argnums=(0, 1), compiler_options=compiler.once())
def starts_of(env: Environment, episodes: int, boxes: Distribution) -> Starts:
    """Returns what `evaluate_together` flies from.

    The same episodes for every evaluation of a training.

    With an axis of policies before that of episodes. A program of its own, so that what flies them
    has less to compile.

    Args:
        env: task and control structure; static.
        episodes: number of episodes; static.
        boxes: distribution of drones of each policy, stacked; a drone is drawn for each episode.
    """
    keys = jax.random.split(jax.random.key(0), episodes)
    return jax.vmap(lambda box: _starts(env, box, keys))(boxes)


@partial(jax.jit, static_argnums=(0, 1))
def evaluate_together(
    env: Environment, num_envs: int, policies: Policy, starts: Starts
) -> Evaluation:
    """Evaluates P policies, each on episodes of its own, which devices share.

    Args:
        env: task and control structure; static.
        num_envs: environments of each learner, which decide the devices; static.
        policies: stacked along a first axis of P.
        starts: where the episodes begin, from `starts_of`.
    """

    def fly(policies: Policy, starts: Starts) -> _Episode:
        return jax.vmap(partial(_fly_episode, env))(policies, starts)

    episodes = over_devices(fly, num_envs, starts.keys.shape[1])(policies, starts)
    return jax.vmap(partial(_means, env))(episodes)


class _Episode(NamedTuple):
    """What one episode adds to an `Evaluation`; stacked along a first axis where there are many."""

    total: Float[Array, ""]
    survived: Bool[Array, ""]
    distance: Float[Array, ""]
    """Sum of the distances from the set-point [m] before failure."""
    periods: Float[Array, ""]
    """Number of control periods before failure."""


def _starts(env: Environment, box: Distribution, keys: Array) -> Starts:
    """The beginning of an episode for each key, each of another drone."""
    launch_keys, keys = jax.vmap(jax.random.split, out_axes=1)(keys)
    return Starts(jax.vmap(partial(randomized_reset, env, box))(launch_keys), keys)


def _fly_episode(
    env: Environment, policy: Policy, starts: Starts, steps: int | None = None
) -> _Episode:
    """Flies each episode; `env`, `policy` and `steps` as for `evaluate`."""
    periods = round(env.task.duration * env.controller.interface.rate) if steps is None else steps

    def fly_start(start: Starts) -> _Episode:
        first, drone = start.instances
        _, (_, step_result) = rollout(env, policy, first, drone, start.keys, periods)
        failed = jnp.cumsum(step_result.terminated) > 0
        counted = jnp.concatenate(
            [jnp.array([True]), ~failed[:-1]]
        )  # the step that fails still counts, with its penalty
        return _Episode(
            jnp.sum(jnp.where(counted, step_result.reward, 0.0)),
            ~failed[-1],
            jnp.sum(jnp.where(failed, 0.0, step_result.position_error)),
            jnp.sum(~failed, dtype=jnp.float32),
        )

    return jax.vmap(fly_start)(starts)


def _means(env: Environment, episodes: _Episode) -> Evaluation:
    """Means over episodes, which are stacked along a first axis."""
    return Evaluation(
        jnp.mean(episodes.total),
        jnp.mean(episodes.survived),
        jnp.sum(episodes.distance) / jnp.maximum(jnp.sum(episodes.periods), 1.0),
        jnp.mean(episodes.periods) / env.controller.interface.rate,
    )
