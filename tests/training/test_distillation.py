from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

from maidenflight.errors import InputError
from maidenflight.parameters import crazyflie, replace
from maidenflight.policy import Policy, untrained_policy
from maidenflight.policy_file import PolicyFile
from maidenflight.simulator.any_drone import GenericQuadrotor
from maidenflight.simulator.environment import Environment, observation
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.randomization import stacked
from maidenflight.simulator.stepping import randomized_reset
from maidenflight.training import distillation
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.distillation import Distillation, Teacher, known
from maidenflight.verbs.train import Train

BOX = GenericQuadrotor(crazyflie())
WORLD = Environment.matching(crazyflie(), spec=PolicySpec(memory=4, hidden=(8, 8)))
SETTINGS = Distillation(updates=120, num_envs=4, horizon=4, learning_rate=0.02)


@pytest.mark.slow
def test_what_a_teacher_knows_is_all_that_differs_between_drones_of_any_make() -> None:
    drones = jax.vmap(BOX.draw)(jax.random.split(jax.random.key(0), 64))
    numbers = np.asarray(jax.vmap(known)(drones))
    assert np.isfinite(numbers).all()
    assert (numbers.std(axis=0) > 1e-3).all()


def test_what_a_teacher_knows_does_not_depend_on_the_weight_of_a_drone() -> None:
    # Twice the mass, turned as fast by rotors twice as strong: every acceleration stays.
    drone = crazyflie()
    heavy = replace(
        drone,
        mass=2 * drone.mass,
        inertia=2 * drone.inertia,
        torque_bias=2 * np.asarray(drone.torque_bias),
    )
    np.testing.assert_allclose(known(heavy), known(drone), rtol=1e-6)
    trimmed = replace(drone, torque_bias=np.array([1e-4, 0, 0], np.float32))
    changed = np.flatnonzero(np.asarray(known(trimmed) != known(drone)))
    assert changed.tolist() == [8]


@pytest.mark.slow
def test_a_teacher_heeds_the_drone_and_hands_the_memory_on() -> None:
    drones = [replace(crazyflie(), motor_time_constant=np.float32(lag)) for lag in (0.03, 0.09)]
    policy = untrained_policy(jax.random.key(1), spec=PolicySpec(hidden=(8, 8)))
    told = jax.random.normal(jax.random.key(2), (8, len(known(drones[0]))))
    teacher = Teacher(policy, told, jnp.zeros(told.shape[1]), jnp.ones(told.shape[1]))
    seen = observation(WORLD, randomized_reset(WORLD, BOX, jax.random.key(3)).env_state)
    seen = seen.at[-4:].set(jnp.arange(4.0))
    fast, slow = (teacher(drone, seen) for drone in drones)
    assert not np.allclose(fast[:4], slow[:4], atol=1e-3)
    np.testing.assert_array_equal(fast[4:], np.arange(4.0))
    # One that is told nothing is the policy.
    deaf = teacher.with_network((policy.weights, policy.biases, jnp.zeros_like(told)))
    np.testing.assert_array_equal(deaf(drones[0], seen), policy(seen))


@pytest.mark.night
def test_the_teacher_learns_first_then_the_policy_imitates_it_and_goes_on_alone() -> None:
    keys = jax.random.split(jax.random.key(5), 2)
    boxes = stacked([BOX, BOX])
    begun = distillation.init(WORLD, SETTINGS, boxes, keys)

    def after(learners: object, first: int, end: int) -> distillation._Learner:
        return distillation.update(WORLD, SETTINGS, boxes, learners, keys, first, end)  # type: ignore[arg-type]

    def same(one: object, other: object) -> bool:
        pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
        return all(np.array_equal(a, b) for a, b in pairs)

    taught = after(begun, 0, 40)
    assert same(taught.policy, begun.policy)
    assert not same(taught.teacher, begun.teacher)
    assert np.abs(taught.teacher.known_weights).min(axis=(1, 2)).max() > 0

    # Of a teacher that climbs: what is learnt of one so little trained would not show.
    weights, (*biases, last), told = begun.teacher.network
    climbing = begun.teacher.with_network((weights, (*biases, last + 0.4), told))
    taught = begun._replace(teacher=climbing)
    imitating = after(taught, 40, 80)
    assert same(imitating.teacher, climbing)
    assert _difference(imitating.policy, taught) < 0.5 * _difference(taught.policy, taught)

    alone = after(imitating, 80, 120)
    assert same(alone.teacher, climbing)
    assert same(alone.imitating, imitating.imitating)
    assert not same(alone.policy, imitating.policy)
    assert same(after(after(begun, 0, 50), 50, 120), after(begun, 0, 120))


@jax.jit
def _difference(policies: Policy, learners: distillation._Learner) -> Array:
    """Mean squared difference of the first policy from its teacher over a horizon of a drone."""
    policy, learner = jax.tree.map(lambda leaf: leaf[0], (policies, learners))
    key, drone = jax.random.key(7), jax.tree.map(lambda leaf: leaf[0], learner.instances)
    return distillation._imitation(WORLD, SETTINGS, learner.teacher, policy, drone, key)[0]


def chosen(**settings: Any) -> tuple[Any, PolicySpec]:
    """Settings of the learner and spec that the command would take."""
    verb = Train(**settings)
    return verb.learner_settings, verb.spec


def started(start: PolicyFile, **settings: Any) -> Train:
    """A training that begins with a policy that is in no file."""
    verb = Train(**settings)
    vars(verb)["start"] = start
    return verb


def test_settings_by_name_are_of_each_third_those_of_gradients() -> None:
    settings, spec = chosen(method="distillation", memory=16)
    assert isinstance(settings, Distillation)
    assert spec == PolicySpec(memory=16, hidden=(32, 32))
    assert settings.updates == 3 * AnalyticGradient().updates
    assert chosen(method="distillation", updates=300, memory=16)[0].updates == 300
    # Without a word of it, what has a memory is distilled, unless it begins with a policy.
    assert chosen(memory=16) == (settings, spec)
    assert type(chosen(form="raptor")[0]) is AnalyticGradient
    assert isinstance(chosen(method="distillation", form="raptor")[0], Distillation)
    start = PolicyFile(untrained_policy(jax.random.key(0), spec=PolicySpec(memory=4)))
    begun = started(start).learner_settings
    assert type(begun) is type(chosen()[0]) is AnalyticGradient


def test_distillation_needs_a_memory_and_starts_from_random_weights() -> None:
    with pytest.raises(InputError):
        chosen(method="distillation")
    start = PolicyFile(untrained_policy(jax.random.key(0), spec=PolicySpec(memory=4)))
    with pytest.raises(InputError):
        _ = started(start, method="distillation").learner_settings
