import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from one_of_many import BOX, SPEC, TINY

from maidenflight.parameters import crazyflie, noiseless, replace
from maidenflight.policy import Policy, untrained_policy
from maidenflight.simulator import environment
from maidenflight.simulator.controllers import control
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.randomization import relative_box, stacked
from maidenflight.simulator.stepping import EnvInstance
from maidenflight.simulator.tasks import tasks
from maidenflight.training import analytic_gradient, devices
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.devices import DRONES


@pytest.mark.slow
@pytest.mark.parametrize(
    ("structure", "rate"),
    [("pwm", 100), pytest.param("attitude_rate", 50, marks=pytest.mark.night)],
)
def test_an_update_changes_the_network_and_nothing_else_of_a_policy(
    structure: str, rate: int
) -> None:
    controller = control.CONTROLLERS[structure]()
    largest = float(structure != "pwm")
    settings = dataclasses.replace(TINY, learning_rate=0.01, largest_gradient=largest)
    drone = replace(BOX.centre, time_step=np.float32(control.time_step(controller)))
    world = Environment.matching(drone, tasks.circle(), controller, spec=SPEC)
    boxes, keys = stacked([relative_box(drone)] * 2), jax.random.split(jax.random.key(5), 2)
    # As training lays it out, so that `test_train` has compiled it.
    before = analytic_gradient.init(world, settings, boxes, keys)
    before = devices.placed(before, analytic_gradient.SHARDING, settings.num_envs)
    after = analytic_gradient.update(world, settings, boxes, before, keys, 0, 1)
    policy = after.policy
    assert (policy.interface.name, policy.interface.rate) == (structure, rate)
    assert policy.spec == SPEC
    np.testing.assert_array_equal(policy.observation_mean, before.policy.observation_mean)
    *hidden, last = [
        np.asarray(new - old)
        for old, new in zip(before.policy.weights, policy.weights, strict=True)
    ]
    # Adam's first step is 1 to 1.5 times its rate in every weight, Muon's its rate in every
    # direction, times the root of inputs an output, as well as five iterations tell.
    moved = [
        (
            np.linalg.norm(step, ord=2, axis=(1, 2)),
            settings.hidden_learning_rate * max(1.0, step.shape[2] / step.shape[1]) ** 0.5,
        )
        for step in hidden
    ]
    for far, expected in [*moved, (np.abs(last).max(axis=(1, 2)), settings.learning_rate)]:
        assert ((far > 0.5 * expected) & (far < 1.6 * expected)).all(), far
    again = analytic_gradient.update(world, settings, boxes, before, keys, 0, 1)
    for one, other in zip(jax.tree.leaves(after), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.slow
@pytest.mark.parametrize("thrust_to_weight", [1.725, 6.0])
def test_an_untrained_policy_hovers_its_drones(thrust_to_weight: float) -> None:
    drone = replace(crazyflie(), thrust_to_weight=thrust_to_weight)
    world, boxes = Environment.matching(drone), stacked([relative_box(drone, 0.0)])
    settings = AnalyticGradient(num_envs=2, horizon=2)
    learner = analytic_gradient.init(world, settings, boxes, jax.random.split(jax.random.key(5), 1))
    policy = jax.tree.map(lambda leaf: leaf[0], learner.policy)
    action = policy(policy.observation_mean)  # the network's input is zero
    np.testing.assert_allclose((action + 1) / 2, 1 / thrust_to_weight, rtol=1e-5)


def test_muons_iterations_as_a_loop_are_those_that_optax_writes_out() -> None:
    slope = [jax.random.normal(jax.random.key(0), (40, 8))]
    axes = [optax.contrib.MuonDimensionNumbers()]
    with jax.numpy_dtype_promotion("standard"):
        found, expected = (
            jax.tree.leaves(rule.update(slope, rule.init(slope))[0])
            for rule in (
                optax.contrib.scale_by_muon(
                    analytic_gradient.NEWTON_SCHULZ, weight_dimension_numbers=axes
                ),
                optax.contrib.scale_by_muon(weight_dimension_numbers=axes),
            )
        )
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_without_a_rate_for_hidden_layers_adam_steps_everywhere_and_its_steps_shrink() -> None:
    settings = AnalyticGradient(updates=50, learning_rate=0.01, hidden_learning_rate=0.0)
    network = untrained_policy(jax.random.key(0), spec=PolicySpec(history=2, hidden=(8, 8))).network
    rule = analytic_gradient.optimiser_of(settings)
    with jax.numpy_dtype_promotion("standard"):
        state, steps, update = rule.init(network), [], jax.jit(rule.update)
        slope = jax.tree.map(jnp.ones_like, network)
        for _ in range(settings.updates + 1):
            step, state = update(slope, state, network)
            steps.append(step)
    # Of a constant slope Adam's every step is its rate (Kingma and Ba 2015, sec. 2.1): here a
    # cosine from the first to 2 % of it.
    for leaf in jax.tree.leaves(steps[0]):
        np.testing.assert_allclose(leaf, -0.01, rtol=1e-3)
    for leaf in jax.tree.leaves(steps[-1]):
        np.testing.assert_allclose(leaf, -0.0002, rtol=1e-3)


SIMULATED, DRONE = Environment(), noiseless(crazyflie())


SHORT = AnalyticGradient(horizon=12)


@jax.jit
def gradient_of_segment(
    network: Any, policy: Policy, env_state: Any, away: Any, settings: Any
) -> Any:
    """The cost of twelve periods from a distance along x [m], where they lead, and the cost's
    gradient by the network and by the distance."""

    def segment(network: Any, away: Any) -> Any:
        position = env_state.state.position + away * jnp.array([1.0, 0.0, 0.0])
        moved = env_state._replace(state=env_state.state._replace(position=position))
        flying = EnvInstance(moved, DRONE)
        changed = policy.with_network(network)
        return analytic_gradient.segment(SIMULATED, settings, changed, flying, jax.random.key(3))

    return jax.value_and_grad(segment, (0, 1), has_aux=True)(network, jnp.float32(away))


@pytest.mark.slow
def test_gradient_through_the_simulator_is_the_slope_of_the_cost() -> None:
    policy = untrained_policy(jax.random.key(1))
    env_state = environment.reset(SIMULATED, DRONE, jax.random.key(2))
    direction = jax.tree.map(
        lambda leaf: jax.random.normal(jax.random.key(leaf.size), leaf.shape), policy.network
    )

    def cost(scale: float) -> float:
        moved = jax.tree.map(
            lambda leaf, step: leaf + np.float32(scale) * step, policy.network, direction
        )
        return float(gradient_of_segment(moved, policy, env_state, 0.0, SHORT)[0][0])

    gradient, _ = gradient_of_segment(policy.network, policy, env_state, 0.0, SHORT)[1]
    pairs = zip(jax.tree.leaves(gradient), jax.tree.leaves(direction), strict=True)
    slope = sum(float(jnp.sum(one * other)) for one, other in pairs)
    numeric = [(cost(step) - cost(-step)) / (2 * step) for step in (1e-3, 2e-3)]
    assert abs(slope) > 1e-3
    assert slope == pytest.approx(np.mean(numeric), rel=0.05)


@pytest.mark.slow
def test_the_gradient_by_outputs_and_then_weights_is_that_by_weights() -> None:
    simulated, drone = Environment(spec=PolicySpec(hidden=(8, 8), memory=3)), crazyflie()
    settings = AnalyticGradient(horizon=4)
    env_state = environment.reset(simulated, drone, jax.random.key(2))
    policy = untrained_policy(jax.random.key(1), simulated.controller.interface, simulated.spec)
    rest = EnvInstance(env_state, drone), jax.random.key(3)

    @jax.jit
    def both(policy: Policy) -> tuple[Any, Any]:
        def cost(network: Any) -> Any:
            changed = policy.with_network(network)
            return analytic_gradient.segment(simulated, settings, changed, *rest)

        by_weights = jax.grad(cost, has_aux=True)(policy.network)
        return by_weights, analytic_gradient.gradient_by_outputs(simulated, settings, policy, *rest)

    expected, found = (jax.tree.leaves(one) for one in both(policy))
    assert any(np.any(leaf) for leaf in expected[:4])
    for one, other in zip(expected, found, strict=True):
        np.testing.assert_allclose(one, other, rtol=2e-4, atol=1e-6)


@pytest.mark.slow
def test_a_lost_drone_is_held_and_gives_no_gradient() -> None:
    env_state = environment.reset(SIMULATED, DRONE, jax.random.key(2))
    policy = untrained_policy(jax.random.key(1))
    segment = policy.network, policy, env_state, 50.0, SHORT
    (_, (after, was_lost)), gradient = gradient_of_segment(*segment)
    assert all(not np.any(leaf) for leaf in jax.tree.leaves(gradient))
    assert was_lost
    begun = env_state.state.position + jnp.array([50.0, 0.0, 0.0])
    np.testing.assert_array_equal(after.state.position, begun)


@pytest.mark.slow
def test_a_failure_costs_most_and_what_is_lost_anyway_pulls_no_more() -> None:
    """The slope of the cost of a failure is that of a sigmoid of the smallest margin."""
    env_state = environment.reset(SIMULATED, DRONE, jax.random.key(2))
    policy = untrained_policy(jax.random.key(1))

    def cost_and_slope(away: float, penalty: float) -> Any:
        settings = dataclasses.replace(SHORT, failure_penalty=penalty)
        segment = policy.network, policy, env_state, away, settings
        (cost, _), (_, slope) = gradient_of_segment(*segment)
        return np.array([cost, slope])

    near, edge, lost = (
        cost_and_slope(away, 5.0) - cost_and_slope(away, 0.0) for away in (0.0, 0.25, 0.8)
    )
    assert float(near[0]) < 0.5
    assert 1.0 < float(edge[0]) < 4.9 < float(lost[0]) <= 5.0
    assert float(edge[1]) > 10 * abs(float(lost[1]))


def test_no_environment_outweighs_the_others_by_more_than_it_may_on_any_device() -> None:
    # Norms on two devices: 5, 1, 10, 2 and not finite, 3, 1000, 4; of medians of 4.5.
    slopes = [[[3, 4], [0, 1], [-8, 6], [2, 0]], [[np.nan, 0], [0, 3], [1000, 0], [0, -4]]]
    gradients = jnp.array(slopes, jnp.float32)[:, :, None]
    means = jax.vmap(lambda gradient: devices.limited_mean([gradient], 1.0)[0], axis_name=DRONES)(
        gradients
    )
    expected = [[2.7 - 3.6 + 2, 3.6 + 1 + 2.7], [4.5, 3 - 4]]
    np.testing.assert_allclose(4 * means[:, 0], expected, rtol=1e-6)


@pytest.mark.night
def test_a_share_of_the_drones_starts_anew_after_each_update() -> None:
    keys, drones = jax.random.split(jax.random.key(5), 1), 64
    drone = crazyflie()
    world = Environment.matching(drone, spec=PolicySpec(hidden=(8,)))
    boxes = stacked([relative_box(drone)])
    settings = AnalyticGradient(num_envs=drones, horizon=2, reset_fraction=0.3)
    learners = analytic_gradient.update(
        world, settings, boxes, analytic_gradient.init(world, settings, boxes, keys), keys, 0, 1
    )
    assert 8 <= int(jnp.sum(learners.instances.env_state.elapsed == 0.0)) <= 30
