"""Learning through the differentiable simulator: the gradient of the return with respect to the network, by backpropagation.

Each update flies a batch of drones for a short horizon from where they are, differentiates the mean reward through physics,
latency, sensors and network, and takes one Adam step; the drones fly on, and those that failed or whose time is up start anew,
each as another drone. Short horizons keep the gradients of a chaotic system small (Xu et al. 2022, SHAC, there with a critic).
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax import lax, tree
from jaxtyping import Array, Bool, Float

from maidenflight.errors import InputError
from maidenflight.policy import Policy, untrained
from maidenflight.simulator import environment, rotations
from maidenflight.simulator.control import Controller
from maidenflight.simulator.environment import Environment, Episode
from maidenflight.simulator.randomization import Distribution
from maidenflight.simulator.rollout import Drone, launch
from maidenflight.simulator.tasks import Task, norm, too_far
from maidenflight.training.evaluation import Evaluation, evaluate

LOST = 1.0
"""Distance from the set-point [m] beyond which a drone in training is given up."""

TRAINABLE = ("pwm",)
"""Control structures that policies can be trained for."""


@dataclass(frozen=True)
class AnalyticGradient:
    """Settings of training by analytic gradients; hashable, all static."""

    updates: int = 1500
    """Gradient steps."""
    drones: int = 64
    """Drones flown side by side, each with its own constants."""
    horizon: int = 64
    """Control periods through which one gradient is taken."""
    learning_rate: float = 3e-3
    """Adam's first step size; it falls to 2 % of that along a cosine."""
    gradient_norm: float = 1.0
    """Longer gradients are shortened to this norm."""
    hidden: tuple[int, ...] = (50, 50)
    """Sizes of the hidden layers (Gronauer et al. 2022, sec. Zero-Shot Experiments)."""
    margin: float = 0.15
    """Distance from the set-point [m] beyond which `barrier` pulls; the task's terminal penalty is a step and has no gradient."""
    barrier: float = 2.0
    """Cost per metre beyond the margin and control period."""
    tilt_margin: float = 0.30
    """Sine of the tilt beyond which `tilt_barrier` pulls: on the drone a guard ends the flight at 30 degrees, sine 0.5."""
    tilt_barrier: float = 2.0
    """Cost per sine of tilt beyond the margin and control period."""
    evaluations: int = 15
    """How often the policy is scored; the best one is kept."""
    episodes: int = 128
    """Episodes a score."""

    def settings(self) -> dict[str, Any]:
        """Plain values, for records."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}


class Progress(NamedTuple):
    """What a caller hears between two scores; arrays have one entry a policy."""

    update: int
    steps: int
    """Control periods simulated so far, all policies together."""
    score: Evaluation


class _Learner(NamedTuple):
    policy: Policy
    optimiser: optax.OptState
    drones: Drone


def _optimiser(settings: AnalyticGradient) -> optax.GradientTransformation:
    schedule = optax.cosine_decay_schedule(settings.learning_rate, settings.updates, alpha=0.02)
    return optax.chain(optax.clip_by_global_norm(settings.gradient_norm), optax.adam(schedule))


@partial(jax.jit, static_argnums=(0, 1))
def _begin(simulated: Environment, settings: AnalyticGradient, box: Distribution, keys: Array) -> _Learner:
    def one(key: Array) -> _Learner:
        policy_key, key = jax.random.split(key)
        policy = untrained(policy_key, settings.hidden, simulated.history)
        drones = jax.vmap(partial(launch, simulated, box))(jax.random.split(key, settings.drones))
        return _Learner(policy, _optimiser(settings).init(_network(policy)), drones)

    return jax.vmap(one)(keys)


def _network(policy: Policy) -> tuple[Any, Any]:
    """What training changes."""
    return policy.weights, policy.biases


def _with_network(policy: Policy, network: tuple[Any, Any]) -> Policy:
    weights, biases = network
    return replace(policy, weights=weights, biases=biases)


def _segment(
    simulated: Environment, settings: AnalyticGradient, policy: Policy, drone: Drone, key: Array
) -> tuple[Float[Array, ""], Episode]:
    """Mean cost of one drone over a horizon, and where it is then."""

    def one(episode: Episode, key: Array) -> tuple[Episode, Float[Array, ""]]:
        action = policy(environment.observation(episode))
        after, outcome = environment.step(simulated, episode, action, drone.parameters, key)
        tilt = norm(rotations.body_z(after.state.quaternion)[:2])
        guards = settings.barrier * jax.nn.relu(outcome.position_error - settings.margin)
        guards += settings.tilt_barrier * jax.nn.relu(tilt - settings.tilt_margin)
        cost = guards - outcome.reward
        # A drone that is far beyond failure stays where it is: its gradient says nothing of flying, and would overflow.
        lost = outcome.position_error > LOST
        return tree.map(lambda old, new: jnp.where(lost, old, new), episode, after), jnp.where(lost, 0.0, cost)

    episode, costs = lax.scan(one, drone.episode, jax.random.split(key, settings.horizon))
    return jnp.mean(costs), episode


def _update(simulated: Environment, settings: AnalyticGradient, box: Distribution, learner: _Learner, key: Array) -> tuple[_Learner, None]:
    """One gradient step of one policy."""
    flight_key, fresh_key = jax.random.split(key)
    flight_keys = jax.random.split(flight_key, settings.drones)

    def cost(network: tuple[Any, Any]) -> tuple[Float[Array, ""], Episode]:
        policy = _with_network(learner.policy, network)
        costs, episodes = jax.vmap(partial(_segment, simulated, settings, policy))(learner.drones, flight_keys)
        return jnp.mean(costs), episodes

    gradient, episodes = jax.grad(cost, has_aux=True)(_network(learner.policy))
    # A step whose gradient overflowed all the same is left out.
    usable = jnp.isfinite(optax.tree.norm(gradient))
    gradient = tree.map(lambda g: jnp.where(usable, g, 0.0), gradient)
    with jax.numpy_dtype_promotion("standard"):  # optax mixes integers and floats, whatever its user has set
        changes, optimiser = _optimiser(settings).update(gradient, learner.optimiser)
    policy = _with_network(learner.policy, optax.apply_updates(_network(learner.policy), changes))  # type: ignore[arg-type]

    setpoints = jax.vmap(simulated.task.reference)(episodes.time)
    over = (jax.vmap(simulated.task.failure)(episodes.state, setpoints) > 0) | (episodes.elapsed > simulated.task.duration)
    over |= ~jnp.isfinite(jnp.sum(episodes.state.position, axis=1))
    over |= jax.vmap(partial(too_far, farthest=LOST))(episodes.state, setpoints)
    fresh = jax.vmap(partial(launch, simulated, box))(jax.random.split(fresh_key, settings.drones))
    return _Learner(policy, optimiser, _chosen(over, fresh, Drone(episodes, learner.drones.parameters))), None


def _chosen(which: Bool[Array, "n"], new: Any, old: Any) -> Any:
    """Of two batches, the new entries where `which` holds and the old ones elsewhere."""
    return tree.map(lambda new, old: jnp.where(which.reshape(-1, *[1] * (new.ndim - 1)), new, old), new, old)


@partial(jax.jit, static_argnums=(0, 1, 5))
def _learn(
    simulated: Environment, settings: AnalyticGradient, box: Distribution, learners: _Learner, keys: Array, updates: int
) -> _Learner:
    def one(learner: _Learner, key: Array) -> _Learner:
        return lax.scan(partial(_update, simulated, settings, box), learner, jax.random.split(key, updates))[0]

    return jax.vmap(one)(learners, keys)


def train(
    task: Task,
    controller: Controller,
    box: Distribution,
    keys: Array,
    settings: AnalyticGradient | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> tuple[Policy, ...]:
    """Trains one policy a key, all in one call.

    Args:
        task: what to fly.
        controller: control structure that the policy acts on.
        box: distribution of drones; the policy must do well over its draws.
        keys: random keys, one a policy.
        settings: of the learner.
        on_progress: called after each of the scores.

    Returns:
        For each key the policy of the best score, in the keys' order. Cost grows linearly with keys, updates, drones and horizon;
        the defaults take about 30 s a policy on two cores.

    Raises:
        InputError: policies cannot be made for this control structure, or the drones' time step does not divide its period.
    """
    settings = AnalyticGradient() if settings is None else settings
    if controller.name not in TRAINABLE:
        raise InputError(f"control structure {controller.name} cannot be trained for; expected one of {', '.join(TRAINABLE)}.")
    simulated = Environment.matching(box.centre, task, controller)
    score = jax.jit(jax.vmap(partial(evaluate, simulated, episodes=settings.episodes), in_axes=(0, None, None)))
    learners = _begin(simulated, settings, box, keys)
    chunk = max(1, settings.updates // settings.evaluations)
    best, best_return = learners.policy, jnp.full(len(keys), -jnp.inf)
    for update in range(chunk, settings.updates + 1, chunk):
        learners = _learn(simulated, settings, box, learners, jax.vmap(partial(jax.random.fold_in, data=update))(keys), chunk)
        scores = score(learners.policy, box, jax.random.key(0))
        better = scores.episode_return > best_return
        best_return = jnp.where(better, scores.episode_return, best_return)
        best = _chosen(better, learners.policy, best)
        if on_progress is not None:
            on_progress(Progress(update, update * settings.drones * settings.horizon * len(keys), scores))
    return tuple(tree.map(lambda leaf: leaf[number], best) for number in range(len(keys)))  # noqa: B023
