"""Proximal policy optimisation (Schulman et al. 2017), as in the paper and, with settings of our
own, faster.

Each update flies drones with noise on their actions, tells by a critic which actions did better
than expected, makes those more likely, though none by much, and fits the critic. Time that is up is
no failure: what would have come then is the critic's guess.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
import optax
from jax import lax, tree
from jaxtyping import Array, Bool, Float

from maidenflight.parameters import Parameters
from maidenflight.policy import Policy, untrained
from maidenflight.simulator import environment
from maidenflight.simulator.environment import ACTION_SIZE, Environment
from maidenflight.simulator.randomization import PAPER_FIELDS, Distribution
from maidenflight.simulator.rollout import EnvInstance, randomized_reset
from maidenflight.training.critic import (
    Critic,
    Moments,
    advantages,
    merged,
    moments_of,
    untrained_critic,
    worth,
)
from maidenflight.training.devices import DRONES, EVERYWHERE, LAID, advanced, begun, own

PERIODS_PER_FRESH_DRONE = 8
"""For every so many control periods a drone is prepared that takes over when another's episode
ends."""


@dataclass(frozen=True)
class PPO:
    """Settings of training by proximal policy optimisation; hashable, all static.

    The defaults are ours, `paper` has the paper's.
    """

    updates: int = 600
    """Epochs: flights, each followed by the passes over them."""
    drones: int = 512
    """Drones flown side by side, each with its own constants."""
    horizon: int = 32
    """Control periods that each drone flies an update; it goes on from where it was."""
    hidden: tuple[int, ...] = (50, 50)
    """Sizes of the actor's hidden layers, ReLU."""
    critic_hidden: tuple[int, ...] = (64, 64)
    """Sizes of the critic's hidden layers, tanh."""
    critic_sees_truth: bool = True
    """Whether the critic, which does not fly, also sees the true state and the drone's
    constants."""
    learning_rate: float = 2e-3
    """Adam's first step size of the actor; it falls linearly to 0."""
    critic_learning_rate: float = 1e-3
    """Adam's step size of the critic."""
    actor_passes: int = 4
    """How often the actor goes through an update's flights."""
    actor_minibatches: int = 8
    """Gradient steps a pass of the actor."""
    critic_passes: int = 4
    """How often the critic goes through them."""
    critic_minibatches: int = 8
    """Gradient steps a pass of the critic."""
    clip: float = 0.2
    """A step gains nothing by making an action more, or less, likely than by this share."""
    discount: float = 0.99
    """What a reward is worth one control period earlier."""
    trace: float = 0.95
    """Lambda of generalised advantage estimation: 0 trusts the critic, 1 the rewards."""
    standardised: bool = True
    """Whether an update's advantages are brought to mean 0 and deviation 1."""
    largest_reward: float = 3.0
    """Rewards, divided by the running standard deviation of discounted returns, are clipped to +-
    this."""
    first_noise: float = 0.4
    """Standard deviation of the noise on actions in the first update."""
    last_noise: float = 0.15
    """To what it falls, linearly."""
    evaluations: int = 15
    """How often the policy is scored; the best one is kept."""
    episodes: int = 128
    """Episodes a score."""

    @classmethod
    def paper(cls) -> Self:
        """The paper's settings: 500 epochs of 64,000 steps, as by 64 workers of 1,000.

        What differs: drones fly on from one epoch into the next, while workers began anew;
        minibatches are drawn from all drones together; the actor's last layer starts ten times
        smaller, and the first epoch normalises as `policy.untrained` does.

        Source: Gronauer et al. 2022, sec. Zero-Shot Experiments; reward scaling and the critic's
        passes are from the authors' code.
        """
        return cls(
            updates=500,
            drones=64,
            horizon=1000,
            critic_sees_truth=False,
            learning_rate=3e-4,
            critic_learning_rate=1e-3,
            actor_passes=80,
            actor_minibatches=1,
            critic_passes=5,
            critic_minibatches=16,
            standardised=False,
            largest_reward=10.0,
            first_noise=0.5,
            last_noise=0.01,
        )


class _Learner(NamedTuple):
    policy: Policy
    critic: Critic
    optimisers: tuple[optax.OptState, optax.OptState]
    """Of the actor and of the critic."""
    sights: Moments
    returns: Moments
    """Of discounted returns."""
    drones: EnvInstance
    discounted: Float[Array, "drones"]
    """Rewards of each drone's episode so far, older ones discounted."""


_LAID = _Learner(*[EVERYWHERE] * 5, *[LAID] * 2)  # type: ignore[arg-type]


class _Period(NamedTuple):
    """What a control period gave."""

    sight: Float[Array, "S"]
    sight_after: Float[Array, "S"]
    """At its end, before another drone takes over."""
    action: Float[Array, "4"]
    noise: Float[Array, "4"]
    """How many standard deviations the action was off the policy's."""
    reward: Float[Array, ""]
    discounted: Float[Array, ""]
    terminated: Bool[Array, ""]
    truncated: Bool[Array, ""]


@partial(jax.jit, static_argnums=(0, 1))
def begin(env: Environment, settings: PPO, box: Distribution, keys: Array) -> _Learner:
    """Learners that know nothing, one a key, stacked."""

    def one(key: Array) -> _Learner:
        policy_key, critic_key, key = jax.random.split(key, 3)
        policy = untrained(policy_key, settings.hidden, env.history, env.controller)
        drones = jax.vmap(partial(randomized_reset, env, box))(
            own(jax.random.split(key, settings.drones))
        )
        sights = jax.vmap(partial(_sight, env, settings, box.centre))(drones)
        unseen = jnp.zeros(sights.shape[1] - policy.observation_mean.size)
        mean = jnp.concatenate([policy.observation_mean, unseen])
        deviation = jnp.concatenate([policy.observation_std, unseen + 1.0])
        critic = untrained_critic(critic_key, (mean.size, *settings.critic_hidden, 1))
        optimisers = tuple(optax.adam(0.0).init(network) for network in (policy.network, critic))
        seen, returns = (
            Moments(jnp.zeros(()), mean, deviation**2),
            Moments(jnp.zeros(()), jnp.zeros(()), jnp.ones(())),
        )
        discounted = jnp.zeros(sights.shape[0])
        return _Learner(policy, critic, optimisers, seen, returns, drones, discounted)  # type: ignore[arg-type]

    return begun(one, _LAID, settings.drones, keys)


_TOLD = (*PAPER_FIELDS, "latency")
"""Constants of the drone that the critic sees."""


def _sight(
    env: Environment, settings: PPO, centre: Parameters, drone: EnvInstance
) -> Float[Array, "S"]:
    """What the critic sees: the policy's observation and, where it sees the truth, state and
    constants.
    """
    seen = environment.observation(drone.env_state)
    if not settings.critic_sees_truth:
        return seen
    state = drone.env_state.state
    relative = state._replace(position=state.position - env.task.reference(drone.env_state.time))
    own, middle = (
        [jnp.ravel(getattr(each, name)) for name in _TOLD] for each in (drone.parameters, centre)
    )
    constants = [
        value / jnp.where(nominal == 0, 1.0, nominal)
        for value, nominal in zip(own, middle, strict=True)
    ]
    return jnp.concatenate([seen, *relative, *constants])


def _fly(
    env: Environment,
    settings: PPO,
    box: Distribution,
    policy: Policy,
    deviation: Float[Array, ""],
    drone: EnvInstance,
    discounted: Float[Array, ""],
    key: Array,
) -> tuple[EnvInstance, Float[Array, ""], _Period]:
    """Flies one drone for a horizon with noise on its actions.

    Returns:
        The drone that flies in the end, its discounted return so far, and each period, stacked
        along a first axis.
    """
    fresh_key, noise_key, key = jax.random.split(key, 3)
    count = max(1, settings.horizon // PERIODS_PER_FRESH_DRONE)
    fresh = jax.vmap(partial(randomized_reset, env, box))(jax.random.split(fresh_key, count))
    sight = partial(_sight, env, settings, box.centre)

    def one(
        carry: tuple[EnvInstance, Array], now: tuple[Array, Array, Array]
    ) -> tuple[tuple[EnvInstance, Array], _Period]:
        (drone, discounted), (number, noise, key) = carry, now
        action = policy(environment.observation(drone.env_state)) + deviation * noise
        env_state, step_result = environment.step(
            env, drone.env_state, action, drone.parameters, key
        )
        after, discounted = (
            EnvInstance(env_state, drone.parameters),
            settings.discount * discounted + step_result.reward,
        )
        flown = (step_result.reward, discounted, step_result.terminated, step_result.truncated)
        over = step_result.terminated | step_result.truncated
        another = tree.map(lambda leaf: leaf[number % count], fresh)
        carry = tree.map(
            lambda new, old: jnp.where(over, new, old), (another, 0.0), (after, discounted)
        )
        return carry, _Period(sight(drone), sight(after), action, noise, *flown)

    noises = jax.random.normal(noise_key, (settings.horizon, ACTION_SIZE))
    periods = (jnp.arange(settings.horizon), noises, jax.random.split(key, settings.horizon))
    (drone, discounted), flown = lax.scan(one, (drone, discounted), periods)
    return drone, discounted, flown


def surrogate(
    ratio: Float[Array, "..."], advantage: Float[Array, "..."], clip: float
) -> Float[Array, "..."]:
    """What PPO maximises, of actions that are `ratio` times as likely as when they were flown.

    Source: Schulman et al. 2017, eq. 7.
    """
    return jnp.minimum(ratio * advantage, jnp.clip(ratio, 1.0 - clip, 1.0 + clip) * advantage)


def _fitted(
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

    Each device goes through its samples, and all take the mean of their gradients.

    Args:
        cost: (network, some samples) to their mean cost.
        network: what changes.
        optimiser: Adam's state.
        learning_rate: step size.
        samples: pytree with a common first axis; what is left over by the minibatches waits for
            another shuffle.
        passes: how often to go through them.
        minibatches: steps a pass.
        key: random key.
    """
    count = tree.leaves(samples)[0].shape[0]

    def step(carry: tuple[Any, Any], some: Any) -> tuple[tuple[Any, Any], None]:
        network, optimiser = carry
        gradient = lax.pmean(jax.grad(cost)(network, some), DRONES)
        with jax.numpy_dtype_promotion(
            "standard"
        ):  # optax mixes integers and floats, whatever its user has set
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


def _judged(
    settings: PPO, learner: _Learner, flown: _Period
) -> tuple[Float[Array, "drones T"], Float[Array, "drones T"]]:
    """Advantage of each action and what the critic should have guessed before it."""
    value = jax.vmap(jax.vmap(partial(worth, learner.sights, learner.critic)))
    values, values_after = value(flown.sight), value(flown.sight_after)
    rewards = jnp.clip(
        flown.reward / learner.returns.deviation, -settings.largest_reward, settings.largest_reward
    )
    estimate = jax.vmap(partial(advantages, discount=settings.discount, trace=settings.trace))
    gains = estimate(rewards, values, values_after, flown.terminated, flown.truncated)
    if not settings.standardised:
        return gains, gains + values
    spread = moments_of(gains.reshape(-1))
    return (gains - spread.mean) / spread.deviation, gains + values


def _update(
    env: Environment,
    settings: PPO,
    box: Distribution,
    learner: _Learner,
    key: Array,
    number: Array,
) -> _Learner:
    """One epoch of one policy; each device flies its drones."""
    flight_key, actor_key, critic_key = jax.random.split(key, 3)
    left = 1.0 - number / settings.updates
    deviation = settings.last_noise + (settings.first_noise - settings.last_noise) * left
    fly = jax.vmap(partial(_fly, env, settings, box, learner.policy, deviation))
    drones, discounted, flown = fly(
        learner.drones, learner.discounted, own(jax.random.split(flight_key, settings.drones))
    )
    judged = flown, *_judged(settings, learner, flown)
    flown, gains, targets = tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), judged)

    def actor_cost(network: Any, some: tuple[_Period, Array]) -> Float[Array, ""]:
        policy = learner.policy.with_network(network)

        def one(period: _Period, gain: Float[Array, ""]) -> Float[Array, ""]:
            noise = (
                period.action - policy(period.sight[: policy.observation_mean.size])
            ) / deviation
            return surrogate(
                jnp.exp(jnp.sum(period.noise**2 - noise**2) / 2.0), gain, settings.clip
            )

        return -jnp.mean(jax.vmap(one)(*some))

    def critic_cost(critic: Critic, some: tuple[Array, Array]) -> Float[Array, ""]:
        sights, targets = some
        return jnp.mean((jax.vmap(partial(worth, learner.sights, critic))(sights) - targets) ** 2)

    network, actor_optimiser = _fitted(
        actor_cost,
        learner.policy.network,
        learner.optimisers[0],
        settings.learning_rate * left,
        (flown, gains),
        settings.actor_passes,
        settings.actor_minibatches,
        actor_key,
    )
    critic, critic_optimiser = _fitted(
        critic_cost,
        learner.critic,
        learner.optimisers[1],
        settings.critic_learning_rate,
        (flown.sight, targets),
        settings.critic_passes,
        settings.critic_minibatches,
        critic_key,
    )
    sights = merged(learner.sights, moments_of(flown.sight))
    returns = merged(learner.returns, moments_of(flown.discounted))
    policy = _seeing(learner.policy.with_network(network), sights)
    return _Learner(
        policy, critic, (actor_optimiser, critic_optimiser), sights, returns, drones, discounted
    )


def _seeing(policy: Policy, sights: Moments) -> Policy:
    """A policy that normalises by the moments of sights, whose first part is the observation."""
    size = policy.observation_mean.size
    return replace(
        policy, observation_mean=sights.mean[:size], observation_std=sights.deviation[:size]
    )


@partial(jax.jit, static_argnums=(0, 1))
def learn(
    env: Environment,
    settings: PPO,
    box: Distribution,
    learners: _Learner,
    keys: Array,
    first: Array | int,
    end: Array | int,
) -> _Learner:
    """Stacked learners after the updates from `first` to before `end`."""
    return advanced(
        partial(_update, env, settings, box),
        _LAID,
        settings.drones,
        learners,
        keys,
        first,
        end,
    )
