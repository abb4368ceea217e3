"""Learning through the differentiable simulator: the gradient of the return with respect to the
network, by backpropagation.

Each update flies a batch of drones for a short horizon from where they are, differentiates the mean
reward through physics, latency, sensors and network, and takes one step, Muon's for the weights of
hidden layers and Adam's for the rest; the drones fly on, and those that failed or whose time is up
start anew, each as another drone. Short horizons keep the gradients of a chaotic system small (Xu
et al. 2022, SHAC, there with a critic).
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax import lax, tree
from jaxtyping import Array, Bool, Float

from maidenflight.policy import Policy, untrained
from maidenflight.simulator import environment, rotations
from maidenflight.simulator.environment import Environment, EnvState
from maidenflight.simulator.randomization import Distribution
from maidenflight.simulator.rollout import EnvInstance, randomized_reset
from maidenflight.simulator.tasks import norm, squared
from maidenflight.training.devices import DRONES, EVERYWHERE, LAID, advanced, begun, own

LOST = 1.0
"""Distance from the set-point [m] beyond which a drone in training is given up."""


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
    hidden_rate: float = 0.02
    """Muon's first step size, which falls alike, for the weights of the hidden layers (Jordan et
    al. 2024); 0: Adam learns them too."""
    gradient_norm: float = 1.0
    """Longer gradients are shortened to this norm."""
    hidden: tuple[int, ...] = (50, 50)
    """Sizes of the hidden layers (Gronauer et al. 2022, sec. Zero-Shot Experiments)."""
    margin: float = 0.15
    """Distance from the set-point [m] beyond which `barrier` pulls; the task's terminal penalty is
    a step and has no gradient."""
    barrier: float = 2.0
    """Cost per metre beyond the margin and control period."""
    tilt_margin: float = 0.30
    """Sine of the tilt beyond which `tilt_barrier` pulls: on the drone a guard ends the flight at
    30 degrees, sine 0.5."""
    tilt_barrier: float = 2.0
    """Cost per sine of tilt beyond the margin and control period."""
    spin_margin: float = 10.0
    """Body rate [rad/s] about any axis beyond which `spin_barrier` pulls: on the drone a guard ends
    the flight at 14 rad/s."""
    spin_barrier: float = 0.3
    """Cost per rad/s beyond the margin and control period."""
    excess: float = 0.01
    """Cost of the squared part of an action beyond [-1, 1], which the control structure cuts off:
    there is no other way back from it."""
    failure: float = 5.0
    """Cost of a horizon with a failure, softened to a sigmoid of the task's `danger` at its
    greatest: what is lost anyway pulls no more, so that the gradient is of the drones that can be
    saved."""
    failure_width: float = 0.2
    """How far about its limit, as a share of it, danger counts."""
    restart: float = 0.3
    """Share of the drones that start anew after each update: starts are what is hard, and a drone
    that flies has them behind it."""
    evaluations: int = 15
    """How often the policy is scored; the best one is kept."""
    episodes: int = 128
    """Episodes a score."""


class _Learner(NamedTuple):
    policy: Policy
    optimiser: optax.OptState
    drones: EnvInstance


def _optimiser(settings: AnalyticGradient) -> optax.GradientTransformation:
    def falling(first: float) -> optax.Schedule:
        return optax.cosine_decay_schedule(first, settings.updates, alpha=0.02)

    def orthogonalised(network: Any) -> Any:
        # Not the last layer: it begins small, and steps of one size in all directions throw the
        # actions far out of their range.
        (*hidden, _), biases = network
        return (*[optax.contrib.MuonDimensionNumbers() for _ in hidden], None), (None,) * len(
            biases
        )

    adams = falling(settings.learning_rate)
    if settings.hidden_rate > 0:
        rule = optax.contrib.muon(
            falling(settings.hidden_rate),
            adam_learning_rate=adams,
            muon_weight_dimension_numbers=orthogonalised,
        )
    else:
        rule = optax.adam(adams)
    return optax.chain(optax.clip_by_global_norm(settings.gradient_norm), rule)


_LAID = _Learner(EVERYWHERE, EVERYWHERE, LAID)  # type: ignore[arg-type]


@partial(jax.jit, static_argnums=(0, 1))
def begin(env: Environment, settings: AnalyticGradient, box: Distribution, keys: Array) -> _Learner:
    """Learners that know nothing, one a key, stacked."""

    def one(key: Array) -> _Learner:
        policy_key, key = jax.random.split(key)
        policy = untrained(policy_key, settings.hidden, env.history, env.controller)
        drones = jax.vmap(partial(randomized_reset, env, box))(
            own(jax.random.split(key, settings.drones))
        )
        return _Learner(policy, _optimiser(settings).init(policy.network), drones)

    return begun(one, _LAID, settings.drones, keys)


def _segment(
    env: Environment, settings: AnalyticGradient, policy: Policy, drone: EnvInstance, key: Array
) -> tuple[Float[Array, ""], tuple[EnvState, Bool[Array, ""]]]:
    """Mean cost of one drone over a horizon, where it is then, and whether it was lost on the
    way.
    """
    task = env.task

    def one(
        env_state: EnvState, key: Array
    ) -> tuple[EnvState, tuple[Float[Array, ""], Bool[Array, ""], Float[Array, ""]]]:
        action = policy(environment.observation(env_state))
        after, step_result = environment.step(env, env_state, action, drone.parameters, key)
        tilt = norm(rotations.body_z(after.state.quaternion)[:2])
        guards = settings.barrier * jax.nn.relu(step_result.position_error - settings.margin)
        guards += settings.tilt_barrier * jax.nn.relu(tilt - settings.tilt_margin)
        guards += settings.spin_barrier * jnp.sum(
            jax.nn.relu(jnp.abs(after.state.body_rates) - settings.spin_margin)
        )
        cost = (
            guards
            - step_result.reward
            + settings.excess * squared(jax.nn.relu(jnp.abs(action) - 1.0))
        )
        danger = (
            jnp.zeros(()) if task.danger is None else task.danger(after.state, step_result.setpoint)
        )
        # A drone that is far beyond failure stays where it is: its gradient says nothing of flying,
        # and would overflow.
        lost = step_result.position_error > LOST
        return tree.map(lambda old, new: jnp.where(lost, old, new), env_state, after), (
            jnp.where(lost, 0.0, cost),
            lost,
            danger,
        )

    env_state, (costs, lost, dangers) = lax.scan(
        one, drone.env_state, jax.random.split(key, settings.horizon)
    )
    failed = (
        0.0
        if task.danger is None
        else jax.nn.sigmoid((jnp.max(dangers) - 1.0) / settings.failure_width)
    )
    return jnp.mean(costs) + settings.failure * failed, (env_state, jnp.any(lost))


def _update(
    env: Environment,
    settings: AnalyticGradient,
    box: Distribution,
    learner: _Learner,
    key: Array,
    _: Array,
) -> _Learner:
    """One gradient step of one policy.

    Each device flies its drones, and all take the mean of their gradients.
    """
    flight_key, fresh_key, restart_key = jax.random.split(key, 3)
    flight_keys = own(jax.random.split(flight_key, settings.drones))

    def cost(
        network: tuple[Any, Any],
    ) -> tuple[Float[Array, ""], tuple[EnvState, Bool[Array, "n"]]]:
        policy = learner.policy.with_network(network)
        costs, flown = jax.vmap(partial(_segment, env, settings, policy))(
            learner.drones, flight_keys
        )
        return jnp.mean(costs), flown

    gradient, (episodes, lost) = jax.grad(cost, has_aux=True)(learner.policy.network)
    gradient = lax.pmean(gradient, DRONES)
    # A step whose gradient overflowed all the same is left out.
    usable = jnp.isfinite(optax.tree.norm(gradient))
    gradient = tree.map(lambda g: jnp.where(usable, g, 0.0), gradient)
    with jax.numpy_dtype_promotion(
        "standard"
    ):  # optax mixes integers and floats, whatever its user has set
        changes, optimiser = _optimiser(settings).update(
            gradient, learner.optimiser, learner.policy.network
        )
    policy = learner.policy.with_network(optax.apply_updates(learner.policy.network, changes))  # type: ignore[arg-type]

    setpoints = jax.vmap(env.task.reference)(episodes.time)
    over = (
        (jax.vmap(env.task.failure)(episodes.state, setpoints) > 0)
        | (episodes.elapsed > env.task.duration)
        | lost
    )
    over |= ~jnp.isfinite(jnp.sum(episodes.state.position, axis=1))
    over |= own(jax.random.uniform(restart_key, (settings.drones,))) < settings.restart
    fresh = jax.vmap(partial(randomized_reset, env, box))(
        own(jax.random.split(fresh_key, settings.drones))
    )
    return _Learner(
        policy, optimiser, _chosen(over, fresh, EnvInstance(episodes, learner.drones.parameters))
    )


def _chosen(which: Bool[Array, "n"], new: Any, old: Any) -> Any:
    """Of two batches, the new entries where `which` holds and the old ones elsewhere."""
    return tree.map(
        lambda new, old: jnp.where(which.reshape(-1, *[1] * (new.ndim - 1)), new, old), new, old
    )


@partial(jax.jit, static_argnums=(0, 1))
def learn(
    env: Environment,
    settings: AnalyticGradient,
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
