"""Training by analytic gradients: backpropagation of the return through the simulator.

Each update simulates a batch of environments for a short horizon from their current states,
differentiates the mean reward through physics, latency, sensors and network, and takes one
optimiser step: Muon for the weights of hidden layers, Adam for the rest. Environments continue in
the next update; those that failed or reached the time limit are reset, each with another drone.
Short horizons keep the gradients of a chaotic system small (Xu et al. 2022, SHAC, there with a
critic).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from operator import attrgetter
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import lax, tree
from jaxtyping import Array, Bool, Float

from maidenflight.parameters import Parameters
from maidenflight.policy import Policy, untrained_policy
from maidenflight.simulator import environment, stepping
from maidenflight.simulator.environment import Environment, EnvState
from maidenflight.simulator.physics import dynamics, rotations
from maidenflight.simulator.physics.vectors import norm, squared
from maidenflight.simulator.policy_spec import ACTION_SIZE
from maidenflight.simulator.randomization import Distribution
from maidenflight.simulator.stepping import (
    EnvInstance,
    PolicyFunction,
    StepResult,
    randomized_reset,
)
from maidenflight.training import devices
from maidenflight.training.devices import DRONES, REPLICATED, SHARDED, begun, learning, own
from maidenflight.training.settings import STATIC, check_counts

LOST_DISTANCE_M = 1.0
"""Distance from the set-point [m] beyond which an environment is frozen until its reset."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class AnalyticGradient:
    """Settings of training by analytic gradients.

    A pytree of numbers that are traced, so that another number of updates or another weight uses
    the compiled program again; only sizes and the choice of Muon are part of it.
    """

    updates: int = 1500
    """Gradient steps."""
    num_envs: int = field(default=64, metadata=STATIC)
    """Environments simulated in parallel, each with a drone of its own."""
    horizon: int = field(default=64, metadata=STATIC)
    """Control periods per update, through which the gradient is propagated."""
    learning_rate: float = 3e-3
    """Adam's initial learning rate; it decays to 2 % of that along a cosine."""
    hidden_learning_rate: float = field(default=0.02, metadata=STATIC)
    """Muon's initial learning rate, with the same decay, for the weights of the hidden layers
    (Jordan et al. 2024); 0: Adam for them too."""
    gradient_norm: float = 1.0
    """Gradients are clipped to this global norm."""
    largest_gradient: float = field(default=0.0, metadata=STATIC)
    """Largest norm of one environment's gradient, in medians of all; 0: any. Gradients along drones
    that no policy can hold grow without bound, and their mean has no other direction
    (paper/notes/training.md#no-environment-outweighs-the-others)."""
    position_margin: float = 0.15
    """Distance from the set-point [m] beyond which `position_penalty` acts; the task's terminal
    penalty is a step and has no gradient."""
    position_penalty: float = 2.0
    """Cost per metre beyond `position_margin`, per control period."""
    tilt_penalty: float = 2.0
    """Cost per sine of tilt beyond the task's `tilt_margin`, per control period."""
    body_rate_margin: float = 10.0
    """Body rate [rad/s] about any axis beyond which `body_rate_penalty` acts; on the drone a guard
    ends the flight at 14 rad/s."""
    body_rate_penalty: float = 0.3
    """Cost per rad/s beyond `body_rate_margin`, per control period."""
    action_excess_penalty: float = 0.01
    """Cost of the squared part of an action beyond [-1, 1], which the control structure clips:
    without it a clipped action has no gradient."""
    action_change_penalty: float = 0.02
    """Cost of the length of an action's change, beside the task's own. Policies that answer noise
    less keep the motors calm and tolerate more latency, at the same distance from the circle
    (paper/notes/training.md)."""
    failure_penalty: float = 5.0
    """Cost of a horizon with a failure: a sigmoid of the task's smallest `failure_margin`. It is
    flat far beyond failure, so that the gradient comes from drones that can still be saved."""
    failure_width: float = 0.2
    """Width of that sigmoid, in units of the margin."""
    reset_fraction: float = 0.3
    """Share of the environments that are reset after each update: initial states are the hard
    part of an episode."""
    evaluations: int = 15
    """How often the policy is evaluated; the best one counts."""
    episodes: int = 128
    """Episodes per evaluation."""

    def __post_init__(self) -> None:
        check_counts(self)

    def with_paper_reward(self) -> Self:
        """Returns these settings with the paper's reward alone as cost, without costs of ours.

        Its terminal penalty has no gradient, so that a failure ends an episode and costs nothing.
        """
        ours = (
            *("position_penalty", "tilt_penalty", "body_rate_penalty"),
            *("action_excess_penalty", "action_change_penalty", "failure_penalty"),
        )
        return replace(self, **dict.fromkeys(ours, 0.0))


class Learner(NamedTuple):
    """What an update changes."""

    policy: Any
    """A `Policy`, or what has a `network` and `with_network` as it has."""
    optimiser: optax.OptState
    instances: EnvInstance


Segment = Callable[[Any, EnvInstance, Array], tuple[Float[Array, ""], tuple[EnvState, Array]]]
"""(policy, drone, key) to the mean cost of a horizon, the last state, and whether it is lost."""


NEWTON_SCHULZ = ((3.4445, -4.7750, 2.0315),) * 5
"""Coefficients of Muon's five iterations (Jordan et al. 2024). By a row each optax loops over them;
with one row for all it writes them out, which takes a tenth of what training has to compile."""
_MATRIX = optax.contrib.MuonDimensionNumbers()


def optimiser_of(settings: AnalyticGradient) -> optax.GradientTransformation:
    """Makes Muon for weights of hidden layers and Adam for the rest, with rates along a cosine."""

    # `optax.cosine_decay_schedule` takes no traced number of steps.
    def decaying(initial: float) -> optax.Schedule:
        def rate(count: Any) -> Any:
            turn = jnp.pi * jnp.minimum(count, settings.updates) / settings.updates
            return initial * (0.02 + 0.98 * 0.5 * (1.0 + jnp.cos(turn)))

        return rate

    def muon_weights(network: Any) -> Any:
        # Not the last layer: its weights start small, and Muon's steps of equal size in all
        # directions drive the actions far out of their range.
        (*hidden, _), biases, gru = network
        of_gru = tree.map(lambda leaf: _MATRIX if leaf.ndim == 2 else None, gru)
        return (*[_MATRIX for _ in hidden], None), (None,) * len(biases), of_gru

    adam_rate = decaying(settings.learning_rate)
    if settings.hidden_learning_rate > 0:
        rule = optax.contrib.muon(
            decaying(settings.hidden_learning_rate),
            ns_coeffs=NEWTON_SCHULZ,
            adam_learning_rate=adam_rate,
            muon_weight_dimension_numbers=muon_weights,
        )
    else:
        rule = optax.adam(adam_rate)
    return optax.chain(optax.clip_by_global_norm(settings.gradient_norm), rule)


SHARDING = Learner(REPLICATED, REPLICATED, SHARDED)  # type: ignore[arg-type]


@partial(jax.jit, static_argnums=0)
def init(env: Environment, settings: AnalyticGradient, boxes: Distribution, keys: Array) -> Learner:
    """Returns untrained learners, one per key and distribution of drones, all stacked."""
    return begun(partial(init_learner, env, settings), SHARDING, settings.num_envs, boxes, keys)


def init_learner(
    env: Environment, settings: AnalyticGradient, box: Distribution, key: Array
) -> Learner:
    """Returns one untrained learner, with this device's share of the environments."""
    policy_key, key = jax.random.split(key)
    instances = jax.vmap(partial(randomized_reset, env, box))(
        own(jax.random.split(key, settings.num_envs))
    )
    policy = hovering(
        untrained_policy(policy_key, env.controller.interface, env.spec), instances.parameters
    )
    return Learner(policy, optimiser_of(settings).init(policy.network), instances)


def hovering(policy: Policy, drones: Parameters) -> Policy:
    """Returns a policy with last biases that hover the mean of some drones.

    Strong drones hover far from the middle of the range of commands, at which they would leave the
    task's bounds before a gradient tells anything.
    """
    share = lax.pmean(jnp.mean(jax.vmap(dynamics.hover_command)(drones)), DRONES)
    weights, (*biases, last), gru = policy.network
    level = policy.interface.level(jnp.clip(share, 0.0, 1.0))
    level = policy.spec.policy_form.output_of(level)
    return policy.with_network((weights, (*biases, last + level), gru))


def segment(
    env: Environment,
    settings: AnalyticGradient,
    policy: PolicyFunction,
    drone: EnvInstance,
    key: Array,
) -> tuple[Float[Array, ""], tuple[EnvState, Bool[Array, ""]]]:
    """Returns an environment's mean cost over a horizon, final state, and whether it was lost."""
    added = np.zeros((settings.horizon, ACTION_SIZE + env.spec.memory), np.float32)
    cost, (env_state, lost, _) = segment_with(env, settings, policy, drone, key, added)
    return cost, (env_state, lost)


def segment_with(
    env: Environment,
    settings: AnalyticGradient,
    policy: PolicyFunction,
    drone: EnvInstance,
    key: Array,
    added: Float[Any, "T 4+M"],
) -> tuple[Float[Array, ""], tuple[EnvState, Bool[Array, ""], Float[Array, "T I"]]]:
    """Returns what `segment` does and all observations, with numbers added to policy outputs."""
    task = env.task

    def advance(
        env_state: EnvState, now: tuple[Array, Array]
    ) -> tuple[EnvState, tuple[Array, Array, Array, Array]]:
        key, more = now
        observation = environment.observation(env, env_state)
        output = policy(observation) + more
        after, step_result = stepping.step(env, env_state, output, drone.parameters, key)
        action = after.action
        tilt = norm(rotations.body_z(after.state.quaternion)[:2])
        guards = settings.position_penalty * jax.nn.relu(
            step_result.position_error - settings.position_margin
        )
        guards += settings.tilt_penalty * jax.nn.relu(tilt - task.tilt_margin)
        guards += settings.body_rate_penalty * jnp.sum(
            jax.nn.relu(jnp.abs(after.state.body_rates) - settings.body_rate_margin)
        )
        cost = (
            guards
            - step_result.reward
            + settings.action_excess_penalty * squared(jax.nn.relu(jnp.abs(action) - 1.0))
            + settings.action_change_penalty * norm(action - env_state.action)
        )
        margin = (
            jnp.ones(())
            if task.failure_margin is None
            else task.failure_margin(after.apparent_state, step_result.setpoint)
        )
        next_state, lost = unless_lost(env_state, after, step_result)
        return next_state, (jnp.where(lost, 0.0, cost), lost, margin, observation)

    env_state, (costs, lost, margins, observations) = lax.scan(
        advance, drone.env_state, (jax.random.split(key, settings.horizon), added)
    )
    failed = (
        0.0
        if task.failure_margin is None
        else jax.nn.sigmoid(-jnp.min(margins) / settings.failure_width)
    )
    ends = env_state, jnp.any(lost), observations
    return jnp.mean(costs) + settings.failure_penalty * failed, ends


def gradient_by_outputs(
    env: Environment, settings: AnalyticGradient, policy: Policy, drone: EnvInstance, key: Array
) -> tuple[Any, tuple[EnvState, Bool[Array, ""]]]:
    """Returns the gradient of `segment` by the network, and what else it returns.

    First by outputs, then by weights for all periods at once: one environment's gradient by weights
    is so large that to add to it every period took a quarter of an update.
    """
    added = jnp.zeros((settings.horizon, ACTION_SIZE + env.spec.memory))
    by_outputs, (env_state, lost, observations) = jax.grad(
        partial(segment_with, env, settings, policy, drone, key), has_aux=True
    )(added)

    def weighted(network: Any) -> Float[Array, ""]:
        return jnp.sum(by_outputs * jax.vmap(policy.with_network(network))(observations))

    return jax.grad(weighted)(policy.network), (env_state, lost)


def unless_lost(
    before: EnvState, after: EnvState, step_result: StepResult
) -> tuple[EnvState, Bool[Array, ""]]:
    """Returns an environment after a step, or as before where it is far beyond failure.

    And whether it is.

    Its gradient is of no use there and would overflow.
    """
    lost = step_result.position_error > LOST_DISTANCE_M
    return tree.map(lambda old, new: jnp.where(lost, old, new), before, after), lost


def take_step(
    env: Environment,
    settings: AnalyticGradient,
    box: Distribution,
    flying: Segment,
    learner: Learner,
    key: Array,
    each_gradient: Callable[..., tuple[Any, Any]] | None = None,
) -> Learner:
    """Returns a learner after one gradient step of one policy.

    Each device simulates its environments; gradients are averaged over devices.

    Args:
        env: what is simulated.
        settings: of the training.
        box: drones of new episodes.
        flying: cost of one environment, such as `segment`.
        learner: before the step.
        key: random key.
        each_gradient: `jax.grad` of `flying`, from (policy, drone, key), where largest gradients
            are limited; JAX's own by default.
    """
    flight_key, reset_key, done_key = jax.random.split(key, 3)
    flight_keys = own(jax.random.split(flight_key, settings.num_envs))

    def cost(
        network: tuple[Any, Any], drone: EnvInstance, key: Array
    ) -> tuple[Float[Array, ""], tuple[EnvState, Bool[Array, ""]]]:
        return flying(learner.policy.with_network(network), drone, key)

    def mean_cost(
        network: tuple[Any, Any],
    ) -> tuple[Float[Array, ""], tuple[EnvState, Bool[Array, "n"]]]:
        costs, segments = jax.vmap(partial(cost, network))(learner.instances, flight_keys)
        return jnp.mean(costs), segments

    if settings.largest_gradient:
        grad_of = partial(jax.grad(cost, has_aux=True), learner.policy.network)
        grad_of = grad_of if each_gradient is None else partial(each_gradient, learner.policy)
        gradients, (env_states, lost) = jax.vmap(grad_of)(learner.instances, flight_keys)
        gradient = devices.limited_mean(gradients, settings.largest_gradient)
    else:
        gradient, (env_states, lost) = jax.grad(mean_cost, has_aux=True)(learner.policy.network)
    gradient = lax.pmean(gradient, DRONES)
    # A step whose gradient overflowed nevertheless is skipped.
    usable = jnp.isfinite(optax.tree.norm(gradient))
    gradient = tree.map(lambda g: jnp.where(usable, g, 0.0), gradient)
    # optax mixes integers and floats.
    with jax.numpy_dtype_promotion("standard"):
        changes, optimiser = optimiser_of(settings).update(
            gradient, learner.optimiser, learner.policy.network
        )
    policy = learner.policy.with_network(optax.apply_updates(learner.policy.network, changes))  # type: ignore[arg-type]

    setpoints = jax.vmap(env.task.reference)(env_states.time)
    apparent = jax.vmap(attrgetter("apparent_state"))(env_states)
    done = (
        (jax.vmap(env.task.failure)(apparent, setpoints) > 0)
        | (env_states.elapsed > env.task.duration)
        | lost
    )
    done |= ~jnp.isfinite(jnp.sum(env_states.state.position, axis=1))
    done |= own(jax.random.uniform(done_key, (settings.num_envs,))) < settings.reset_fraction
    resets = jax.vmap(partial(randomized_reset, env, box))(
        own(jax.random.split(reset_key, settings.num_envs))
    )
    return Learner(
        policy,
        optimiser,
        _where(done, resets, EnvInstance(env_states, learner.instances.parameters)),
    )


def _where(condition: Bool[Array, "n"], new: Any, old: Any) -> Any:
    """Of two batches, the new entries where the condition holds and the old ones elsewhere."""
    return tree.map(
        lambda new, old: jnp.where(condition.reshape(-1, *[1] * (new.ndim - 1)), new, old), new, old
    )


def _fly_segment(
    env: Environment,
    settings: AnalyticGradient,
    box: Distribution,
    learner: Learner,
    key: Array,
    _: Array,
) -> Learner:
    """One gradient step along what flights cost."""
    flying, each = (partial(function, env, settings) for function in (segment, gradient_by_outputs))
    return take_step(env, settings, box, flying, learner, key, each)


update = learning(_fly_segment, SHARDING)
"""Stacked learners after updates `first` to `end` - 1; see `learning`."""
