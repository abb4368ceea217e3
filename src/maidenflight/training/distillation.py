"""Distillation: a policy with a memory learns from a teacher that knows the drone.

Three like shares of the updates. In the first a teacher, a network without a memory that also sees
what the drone is, learns by analytic gradients. In the second the policy imitates it, in the states
that the policy itself reaches and with the memory it has there. In the third the policy goes on by
analytic gradients alone: what it cannot find out in flight it must fly without.

Source: imitation in the learner's own states: Ross et al. 2011 (DAgger); of a teacher with
privileged knowledge: Chen et al. 2020, "Learning by Cheating"; for quadrotors of any make: Eschmann
et al. 2025 (RAPTOR), there with one teacher for each drone.
"""

import dataclasses
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax import lax
from jaxtyping import Array, Float

from maidenflight.parameters import Parameters
from maidenflight.policy import Policy, untrained_policy
from maidenflight.simulator import environment, stepping
from maidenflight.simulator.environment import Environment, EnvState
from maidenflight.simulator.physics.vectors import squared
from maidenflight.simulator.policy_spec import ACTION_SIZE, INSTANTS
from maidenflight.simulator.randomization import Distribution
from maidenflight.simulator.stepping import EnvInstance
from maidenflight.training import analytic_gradient
from maidenflight.training.analytic_gradient import AnalyticGradient, Learner, Segment, optimiser_of
from maidenflight.training.devices import REPLICATED, SHARDED, begun, learning
from maidenflight.training.settings import STATIC

PHASES = ("the teacher learns", "the policy imitates it", "the policy goes on alone")
"""What is done in each third of the updates."""
_DRAWN = 256
"""Drones that tell how far each number of `known` reaches."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Distillation(AnalyticGradient):
    """Settings of distillation: those of training by analytic gradients, for each third.

    Learning rates and resets were chosen by returns over drones of any make
    (paper/notes/adaptation.md).
    """

    updates: int = 4500
    """Gradient steps of all three thirds."""
    learning_rate: float = 2e-3
    hidden_learning_rate: float = field(default=0.012, metadata=STATIC)
    reset_fraction: float = 0.1
    """Resets are rarer than without a memory, because memories begin empty."""
    going_on: float = field(default=0.5, metadata=STATIC)
    """Share of the learning rates in the last third, whose policy flies already."""
    teacher_hidden: tuple[int, ...] = field(default=(50, 50), metadata=STATIC)
    """Sizes of the teacher's hidden layers."""


def phase(update: int, updates: int) -> str:
    """Returns what led to the policy after an update, one of `PHASES`.

    Args:
        update: number of the update, from 1 on.
        updates: in all.
    """
    return PHASES[min(len(PHASES) * max(update - 1, 0) // updates, len(PHASES) - 1)]


def known(drone: Parameters) -> Float[Array, "19"]:
    """Returns a teacher's input about a drone, in numbers that do not depend on its size.

    Logarithms of thrust-to-weight ratio, lag and what the rotors can turn the body by; delays;
    trims and wind; thrust of each rotor; drag.
    """
    thrust = drone.thrust_to_weight * drone.mass * drone.gravity
    arms = jnp.stack([jnp.mean(jnp.abs(drone.rotor_y)), jnp.mean(jnp.abs(drone.rotor_x))])
    torques = thrust * jnp.concatenate([arms, jnp.atleast_1d(drone.torque_to_thrust)])
    logarithms = jnp.log(
        jnp.stack([drone.thrust_to_weight, drone.motor_time_constant, drone.spin_down_ratio])
    )
    return jnp.concatenate(
        [
            logarithms,
            jnp.log(torques / drone.inertia),
            jnp.stack([drone.latency, drone.estimator_delay]),
            drone.torque_bias / torques,
            drone.rotor_thrust,
            drone.drag[:2],
            drone.wind[:2],
        ]
    )


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Teacher:
    """A policy without a memory that also sees what it flies."""

    policy: Policy
    known_weights: Float[Array, "first 19"]
    """Weights of `known` in the first layer."""
    mean: Float[Array, "19"]
    deviation: Float[Array, "19"]

    def __call__(
        self, drone: Parameters, observation: Float[Array, "20H+3K+M"]
    ) -> Float[Array, "4+M"]:
        """Action for an observation of a drone; a memory in it is handed on as it is."""
        first, *others = self.policy.biases
        first = first + self.known_weights @ ((known(drone) - self.mean) / self.deviation)
        weights, _, none = self.policy.network
        return self.policy.with_network((weights, (first, *others), none))(observation)

    @property
    def network(self) -> Any:
        """What a gradient changes: weights, biases, and weights of what is known."""
        weights, biases, _ = self.policy.network
        return weights, biases, self.known_weights

    def with_network(self, network: Any) -> "Teacher":
        """Returns the same teacher with another network."""
        weights, biases, known_weights = network
        policy = self.policy.with_network((weights, biases, None))
        return dataclasses.replace(self, policy=policy, known_weights=known_weights)


class _Learner(NamedTuple):
    policy: Policy
    optimiser: optax.OptState
    instances: EnvInstance
    teacher: Teacher
    teaching: optax.OptState
    imitating: optax.OptState


_PARTS = dict.fromkeys(_Learner._fields, REPLICATED) | {"instances": SHARDED}
SHARDING = _Learner(**_PARTS)  # type: ignore[arg-type]


@partial(jax.jit, static_argnums=0)
def init(env: Environment, settings: Distillation, boxes: Distribution, keys: Array) -> _Learner:
    """Returns untrained learners with teachers, one per key and distribution of drones."""

    def init_learner(box: Distribution, key: Array) -> _Learner:
        learner = analytic_gradient.init_learner(env, settings, box, key)
        teacher = _teacher(env, settings, box, learner.instances, jax.random.fold_in(key, 1))
        teaching = optimiser_of(settings).init(teacher.network)
        return _Learner(*learner, teacher, teaching, learner.optimiser)

    return begun(init_learner, SHARDING, settings.num_envs, boxes, keys)


def _teacher(
    env: Environment, settings: Distillation, box: Distribution, drones: EnvInstance, key: Array
) -> Teacher:
    """An untrained teacher, which does not heed its extra input yet."""
    samples = jax.vmap(lambda key: known(box.draw(key)))(jax.random.split(key, _DRAWN))
    spec = dataclasses.replace(env.spec, memory=0, hidden=settings.teacher_hidden, form=INSTANTS)
    policy = untrained_policy(key, env.controller.interface, spec)
    spread = jnp.std(samples, axis=0)
    return Teacher(
        analytic_gradient.hovering(policy, drones.parameters),
        jnp.zeros((settings.teacher_hidden[0], samples.shape[1])),
        jnp.mean(samples, axis=0),
        # What does not differ between drones stays zero up to rounding.
        jnp.where(spread > 1e-5, spread, 1.0),
    )


def _imitation(
    env: Environment,
    settings: Distillation,
    teacher: Teacher,
    policy: Policy,
    drone: EnvInstance,
    key: Array,
) -> tuple[Float[Array, ""], tuple[EnvState, Array]]:
    """Mean squared difference of one policy from the teacher while it flies for a horizon.

    Its gradient goes through the memory, not through the drone.
    """

    def advance(env_state: EnvState, key: Array) -> tuple[EnvState, tuple[Array, Array]]:
        observation = environment.observation(env, env_state)
        output = policy(observation)
        target = lax.stop_gradient(teacher(drone.parameters, observation))
        # A teacher's action beyond the range of commands is as good as its end.
        difference = output[:ACTION_SIZE] - jnp.clip(target[:ACTION_SIZE], -1.0, 1.0)
        action = jnp.concatenate([lax.stop_gradient(output[:ACTION_SIZE]), output[ACTION_SIZE:]])
        after, step_result = stepping.step(env, env_state, action, drone.parameters, key)
        next_state, lost = analytic_gradient.unless_lost(env_state, after, step_result)
        return next_state, (jnp.where(lost, 0.0, squared(difference)), lost)

    env_state, (costs, lost) = lax.scan(
        advance, drone.env_state, jax.random.split(key, settings.horizon)
    )
    return jnp.mean(costs), (env_state, jnp.any(lost))


def _update(
    env: Environment,
    settings: Distillation,
    box: Distribution,
    learner: _Learner,
    key: Array,
    number: Array,
) -> _Learner:
    """One gradient step of a teacher, or of a policy that imitates it, or of the policy alone."""
    share = settings.updates / len(PHASES)

    def descended(learned: str, optimiser: str, segment: Segment, rates: float = 1.0) -> _Learner:
        third = dataclasses.replace(
            settings,
            updates=share,
            learning_rate=rates * settings.learning_rate,
            hidden_learning_rate=rates * settings.hidden_learning_rate,
        )
        before = Learner(getattr(learner, learned), getattr(learner, optimiser), learner.instances)
        after = analytic_gradient.take_step(env, third, box, segment, before, key)
        changed = {learned: after.policy, optimiser: after.optimiser, "instances": after.instances}
        return learner._replace(**changed)

    fly_segment = partial(analytic_gradient.segment, env, settings)

    def teach() -> _Learner:
        def fly_teacher(teacher: Teacher, drone: EnvInstance, key: Array) -> Any:
            return fly_segment(partial(teacher, drone.parameters), drone, key)

        return descended("teacher", "teaching", fly_teacher)

    def imitate() -> _Learner:
        imitated = partial(_imitation, env, settings, learner.teacher)
        return descended("policy", "imitating", imitated)

    def alone() -> _Learner:
        return descended("policy", "optimiser", fly_segment, settings.going_on)

    phase = jnp.minimum(number // share, len(PHASES) - 1).astype(jnp.int32)
    return lax.switch(phase, [teach, imitate, alone])


update = learning(_update, SHARDING)
"""Stacked learners after updates `first` to `end` - 1; see `learning`."""
