"""Proximal policy optimisation (Schulman et al. 2017); `settings` has its settings.

Each update simulates environments with noise on the actions, estimates advantages with a critic,
maximises the clipped surrogate and fits the critic. The time limit is a truncation, not a failure:
the critic's value stands for the return after it.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax import lax, tree
from jaxtyping import Array, Bool, Float

from maidenflight.parameters import Parameters
from maidenflight.policy import Policy, untrained_policy
from maidenflight.simulator import environment, stepping
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.policy_spec import ACTION_SIZE
from maidenflight.simulator.randomization import PAPER_FIELDS, Distribution
from maidenflight.simulator.stepping import EnvInstance, randomized_reset
from maidenflight.training.critic import (
    Critic,
    Moments,
    advantages,
    merged,
    moments_of,
    untrained_critic,
    value_of,
)
from maidenflight.training.devices import DRONES, REPLICATED, SHARDED, begun, learning, own
from maidenflight.training.settings import PPO

PERIODS_PER_RESET = 8
"""Control periods for which one initial state is prepared; episodes that end continue from the
prepared states."""


class _Learner(NamedTuple):
    policy: Policy
    critic: Critic
    optimisers: tuple[optax.OptState, optax.OptState]
    """Of the actor and of the critic."""
    observation_moments: Moments
    """Of what the critic sees."""
    returns: Moments
    """Of discounted returns."""
    instances: EnvInstance
    discounted: Float[Array, "num_envs"]
    """Discounted sum of the rewards of each episode so far."""


SHARDING = _Learner(*[REPLICATED] * 5, *[SHARDED] * 2)  # type: ignore[arg-type]


class _Period(NamedTuple):
    """One control period of a rollout."""

    critic_observation: Float[Array, "S"]
    next_critic_observation: Float[Array, "S"]
    """At its end, before a reset."""
    action: Float[Array, "4"]
    noise: Float[Array, "4"]
    """Of the action, in standard deviations."""
    reward: Float[Array, ""]
    discounted: Float[Array, ""]
    terminated: Bool[Array, ""]
    truncated: Bool[Array, ""]


@partial(jax.jit, static_argnums=0)
def init(env: Environment, settings: PPO, boxes: Distribution, keys: Array) -> _Learner:
    """Returns untrained learners, one per key and distribution of drones, all stacked."""

    def init_learner(box: Distribution, key: Array) -> _Learner:
        policy_key, critic_key, key = jax.random.split(key, 3)
        policy = untrained_policy(policy_key, env.controller.interface, env.spec)
        instances = jax.vmap(partial(randomized_reset, env, box))(
            own(jax.random.split(key, settings.num_envs))
        )
        observations = jax.vmap(partial(_critic_observation, env, settings, box.centre))(instances)
        hidden = jnp.zeros(observations.shape[1] - policy.observation_mean.size)
        mean = jnp.concatenate([policy.observation_mean, hidden])
        deviation = jnp.concatenate([policy.observation_std, hidden + 1.0])
        critic = untrained_critic(critic_key, (mean.size, *settings.critic_hidden, 1))
        optimisers = tuple(optax.adam(0.0).init(network) for network in (policy.network, critic))
        moments, returns = (
            Moments(jnp.zeros(()), mean, deviation**2),
            Moments(jnp.zeros(()), jnp.zeros(()), jnp.ones(())),
        )
        discounted = jnp.zeros(observations.shape[0])
        return _Learner(policy, critic, optimisers, moments, returns, instances, discounted)  # type: ignore[arg-type]

    return begun(init_learner, SHARDING, settings.num_envs, boxes, keys)


_CRITIC_PARAMETERS = (*PAPER_FIELDS, "latency")
"""Parameters of the drone that the critic sees."""


def _critic_observation(
    env: Environment, settings: PPO, centre: Parameters, drone: EnvInstance
) -> Float[Array, "S"]:
    """The policy's observation and, with `critic_sees_truth`, true state and parameters."""
    observation = environment.observation(env, drone.env_state)
    if not settings.critic_sees_truth:
        return observation
    state = drone.env_state.state
    relative = state._replace(position=state.position - env.task.reference(drone.env_state.time))
    own, middle = (
        [jnp.ravel(getattr(each, name)) for name in _CRITIC_PARAMETERS]
        for each in (drone.parameters, centre)
    )
    constants = [
        value / jnp.where(nominal == 0, 1.0, nominal)
        for value, nominal in zip(own, middle, strict=True)
    ]
    return jnp.concatenate([observation, *relative, *constants])


def _rollout(
    env: Environment,
    settings: PPO,
    box: Distribution,
    policy: Policy,
    deviation: Float[Array, ""],
    drone: EnvInstance,
    discounted: Float[Array, ""],
    key: Array,
) -> tuple[EnvInstance, Float[Array, ""], _Period]:
    """Simulates one environment for a horizon with noise on the actions.

    Returns:
        Its final instance, its discounted return so far, and each period, stacked along a first
        axis.
    """
    reset_key, noise_key, key = jax.random.split(key, 3)
    count = max(1, settings.horizon // PERIODS_PER_RESET)
    resets = jax.vmap(partial(randomized_reset, env, box))(jax.random.split(reset_key, count))
    observe = partial(_critic_observation, env, settings, box.centre)

    def advance(
        carry: tuple[EnvInstance, Array], now: tuple[Array, Array, Array]
    ) -> tuple[tuple[EnvInstance, Array], _Period]:
        (drone, discounted), (number, noise, key) = carry, now
        action, memory = jnp.split(
            policy(environment.observation(env, drone.env_state)), [ACTION_SIZE]
        )
        action += deviation * noise
        env_state, step_result = stepping.step(
            env, drone.env_state, jnp.concatenate([action, memory]), drone.parameters, key
        )
        after, discounted = (
            EnvInstance(env_state, drone.parameters),
            settings.discount * discounted + step_result.reward,
        )
        outcome = (step_result.reward, discounted, step_result.terminated, step_result.truncated)
        done = step_result.terminated | step_result.truncated
        reset = tree.map(lambda leaf: leaf[number % count], resets)
        carry = tree.map(
            lambda new, old: jnp.where(done, new, old), (reset, 0.0), (after, discounted)
        )
        return carry, _Period(observe(drone), observe(after), action, noise, *outcome)

    noises = jax.random.normal(noise_key, (settings.horizon, ACTION_SIZE))
    periods = (jnp.arange(settings.horizon), noises, jax.random.split(key, settings.horizon))
    (drone, discounted), rollout = lax.scan(advance, (drone, discounted), periods)
    return drone, discounted, rollout


def surrogate(
    ratio: Float[Array, "..."], advantage: Float[Array, "..."], clip: float
) -> Float[Array, "..."]:
    """Computes PPO's clipped objective of actions `ratio` times as likely as in the rollout.

    Source: Schulman et al. 2017, eq. 7.
    """
    return jnp.minimum(ratio * advantage, jnp.clip(ratio, 1.0 - clip, 1.0 + clip) * advantage)


def _fit(
    cost: Callable[[Any, Any], Float[Array, ""]],
    network: Any,
    optimiser: optax.OptState,
    learning_rate: Float[Array, ""] | float,
    samples: Any,
    passes: int,
    minibatches: int,
    key: Array,
) -> tuple[Any, optax.OptState]:
    """Adam over shuffled minibatches.

    Each device uses its own samples; gradients are averaged over devices.

    Args:
        cost: (network, some samples) to their mean cost.
        network: weights and biases.
        optimiser: Adam's state.
        learning_rate: step size.
        samples: pytree with a common first axis; a remainder that fills no minibatch is left out
            of that pass.
        passes: over all samples.
        minibatches: steps per pass.
        key: random key.
    """
    count = tree.leaves(samples)[0].shape[0]

    def step(carry: tuple[Any, Any], some: Any) -> tuple[tuple[Any, Any], None]:
        network, optimiser = carry
        gradient = lax.pmean(jax.grad(cost)(network, some), DRONES)
        # optax mixes integers and floats.
        with jax.numpy_dtype_promotion("standard"):
            changes, optimiser = optax.adam(learning_rate).update(gradient, optimiser)
        return (optax.apply_updates(network, changes), optimiser), None

    def once(carry: tuple[Any, Any], key: Array) -> tuple[tuple[Any, Any], None]:
        if minibatches == 1:
            return step(carry, samples)
        order = jax.random.permutation(key, count)[: count // minibatches * minibatches].reshape(
            minibatches, -1
        )
        return lax.scan(
            lambda carry, rows: step(carry, tree.map(lambda leaf: leaf[rows], samples)),
            carry,
            order,
        )

    return lax.scan(once, (network, optimiser), jax.random.split(key, passes))[0]


def _advantages_and_targets(
    settings: PPO, learner: _Learner, period: _Period
) -> tuple[Float[Array, "num_envs T"], Float[Array, "num_envs T"]]:
    """Advantage of each action and the critic's target for its observation."""
    value = jax.vmap(jax.vmap(partial(value_of, learner.observation_moments, learner.critic)))
    values, values_after = value(period.critic_observation), value(period.next_critic_observation)
    rewards = jnp.clip(
        period.reward / learner.returns.deviation, -settings.reward_clip, settings.reward_clip
    )
    estimate = jax.vmap(
        partial(advantages, discount=settings.discount, gae_lambda=settings.gae_lambda)
    )
    gains = estimate(rewards, values, values_after, period.terminated, period.truncated)
    if not settings.normalize_advantages:
        return gains, gains + values
    moments = moments_of(gains.reshape(-1))
    return (gains - moments.mean) / moments.deviation, gains + values


def _update(
    env: Environment,
    settings: PPO,
    box: Distribution,
    learner: _Learner,
    key: Array,
    number: Array,
) -> _Learner:
    """One epoch of one policy; each device simulates its environments."""
    flight_key, actor_key, critic_key = jax.random.split(key, 3)
    remaining = 1.0 - number / settings.updates
    deviation = (
        settings.final_noise_std
        + (settings.initial_noise_std - settings.final_noise_std) * remaining
    )
    fly = jax.vmap(partial(_rollout, env, settings, box, learner.policy, deviation))
    instances, discounted, rollout = fly(
        learner.instances, learner.discounted, own(jax.random.split(flight_key, settings.num_envs))
    )
    samples = rollout, *_advantages_and_targets(settings, learner, rollout)
    # A memory's gradient goes through the periods of a rollout; else each stands for itself.
    length = settings.horizon if env.spec.memory else 1
    sequences = tree.map(lambda leaf: leaf.reshape(-1, length, *leaf.shape[2:]), samples[:2])
    rollout, _, targets = tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), samples)

    def actor_cost(network: Any, some: tuple[_Period, Array]) -> Float[Array, ""]:
        policy = learner.policy.with_network(network)

        def cost(periods: _Period, gains: Float[Array, "L"]) -> Float[Array, "L"]:
            noises = (periods.action - _actions(policy, periods)) / deviation
            return surrogate(
                jnp.exp(jnp.sum(periods.noise**2 - noises**2, axis=1) / 2.0), gains, settings.clip
            )

        return -jnp.mean(jax.vmap(cost)(*some))

    def critic_cost(critic: Critic, some: tuple[Array, Array]) -> Float[Array, ""]:
        observations, targets = some
        return jnp.mean(
            (
                jax.vmap(partial(value_of, learner.observation_moments, critic))(observations)
                - targets
            )
            ** 2
        )

    network, actor_optimiser = _fit(
        actor_cost,
        learner.policy.network,
        learner.optimisers[0],
        settings.learning_rate * remaining,
        sequences,
        settings.actor_passes,
        settings.actor_minibatches,
        actor_key,
    )
    critic, critic_optimiser = _fit(
        critic_cost,
        learner.critic,
        learner.optimisers[1],
        settings.critic_learning_rate,
        (rollout.critic_observation, targets),
        settings.critic_passes,
        settings.critic_minibatches,
        critic_key,
    )
    moments = merged(learner.observation_moments, moments_of(rollout.critic_observation))
    returns = merged(learner.returns, moments_of(rollout.discounted))
    policy = _normalizing(learner.policy.with_network(network), moments)
    return _Learner(
        policy, critic, (actor_optimiser, critic_optimiser), moments, returns, instances, discounted
    )


def _actions(policy: Policy, periods: _Period) -> Float[Array, "L 4"]:
    """What a policy does in L consecutive periods; its memory is empty after a reset."""
    size = policy.observation_mean.size

    def act(memory: Float[Array, "M"], period: _Period) -> tuple[Array, Float[Array, "4"]]:
        observation = jnp.concatenate([period.critic_observation[:size], memory])
        action, memory = jnp.split(policy(observation), [ACTION_SIZE])
        return jnp.where(period.terminated | period.truncated, 0.0, memory), action

    first = periods.critic_observation[0, size : size + policy.spec.memory]
    return lax.scan(act, first, periods)[1]


def _normalizing(policy: Policy, moments: Moments) -> Policy:
    """The policy with these moments, whose first part is the policy's observation."""
    size = policy.observation_mean.size
    return replace(
        policy, observation_mean=moments.mean[:size], observation_std=moments.deviation[:size]
    )


update = learning(_update, SHARDING)
"""Stacked learners after updates `first` to `end` - 1; see `learning`."""
