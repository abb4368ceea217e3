"""The paper's circle: where it starts, where it leads, what it pays and when it is over."""

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arrays import float32
from hypothesis import given

from maidenflight.parameters import crazyflie, replace
from maidenflight.simulator import dynamics, rotations, tasks, trajectories

PAPER = crazyflie()
CIRCLE = tasks.circle()
SETPOINT = float32([0.1, 0.2, 1.0])
reward = jax.jit(tasks.paper_reward)
too_far = jax.jit(tasks.too_far)
vectors = st.tuples(*[st.floats(-2, 2, width=16)] * 3).map(float32)
actions = st.tuples(*[st.floats(-2, 2, width=16)] * 4).map(float32)


def away(offset, body_rates=(0, 0, 0)):
    return dynamics.at_hover(jnp.asarray(SETPOINT + float32(offset)), PAPER)._replace(body_rates=jnp.asarray(float32(body_rates)))


@given(vectors, vectors, actions, actions)
def test_the_reward_is_the_papers_with_its_penalties_negative(offset, rates, action, previous):
    distance = np.linalg.norm(offset)
    if abs(distance - 0.25) < 1e-5:
        return
    expected = -(distance + 1e-4 * np.linalg.norm(action) + 1e-3 * np.linalg.norm(action - previous) + 1e-3 * np.linalg.norm(rates))
    expected -= 100 * (distance > 0.25)
    np.testing.assert_allclose(reward(away(offset, rates), SETPOINT, action, previous), expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("direction", [(1, 0, 0), (0, -1, 0), (0, 0, 1), (0.6, 0, -0.8)])
@pytest.mark.parametrize(("distance", "over"), [(0.249, False), (0.251, True)])
def test_an_episode_fails_a_quarter_metre_from_the_setpoint_and_that_costs_a_hundred(direction, distance, over):
    state = away(distance * float32(direction))
    assert bool(too_far(state, SETPOINT)) is over
    assert (float(reward(state, SETPOINT, np.zeros(4, np.float32), np.zeros(4, np.float32))) < -100) is over


def test_a_perfect_flight_pays_nothing_and_has_a_finite_slope():
    state, still = away((0, 0, 0)), jnp.zeros(4)
    assert float(reward(state, SETPOINT, still, still)) == 0
    slope = jax.grad(lambda state: tasks.paper_reward(state, jnp.asarray(SETPOINT), still, still))(state)
    assert all(bool(jnp.all(jnp.isfinite(leaf))) for leaf in slope)


def test_starts_fill_their_box_and_never_leave_it():
    parameters = replace(PAPER, thrust_to_weight=2.0)
    state, time = jax.jit(jax.vmap(CIRCLE.reset, (None, 0)))(parameters, jax.random.split(jax.random.key(0), 1000))
    reference = jax.vmap(CIRCLE.reference)(time)
    attitude = jax.vmap(rotations.to_attitude)(state.quaternion)
    boxes = {
        "position": (state.position - reference, [0.05] * 3),
        "velocity": (state.velocity, [0.1] * 3),
        "attitude": (attitude, np.radians([20, 20, 18])),
        "body rates": (state.body_rates, np.radians([50, 50, 20])),
        "time": (time[:, None] - 1.5, [1.5]),
    }
    for name, (values, half_width) in boxes.items():
        largest, smallest = np.max(values, axis=0), np.min(values, axis=0)
        for extreme in (largest, -smallest):
            assert np.all(extreme <= np.multiply(half_width, 1 + 1e-5)), name
            assert np.all(extreme > 0.95 * np.asarray(half_width)), name
    np.testing.assert_allclose(np.mean(state.rotor_speed, axis=0), np.sqrt(0.5), atol=0.003)
    np.testing.assert_allclose(np.std(state.rotor_speed, axis=0), 0.02, rtol=0.1)


def test_the_circle_runs_clockwise_seen_from_above_and_starts_at_the_origin():
    time = jnp.linspace(0.0, 3.0, 301)
    points = np.asarray(jax.vmap(CIRCLE.reference)(time))
    np.testing.assert_allclose(points[0], [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(points[-1], points[0], atol=1e-5)
    arm = points[:, :2] - [0.25, 0]
    np.testing.assert_allclose(np.linalg.norm(arm, axis=1), 0.25, rtol=1e-5)
    np.testing.assert_allclose(points[:, 2], 1)
    step = np.diff(points[:, :2], axis=0)
    turn = arm[:-1, 0] * step[:, 1] - arm[:-1, 1] * step[:, 0]
    assert np.all(turn < 0), "the cross product of a clockwise turn points down"
    np.testing.assert_allclose(np.linalg.norm(step, axis=1) / 0.01, 2 * np.pi * 0.25 / 3, rtol=1e-3)


def test_a_circle_has_the_size_period_and_height_it_was_asked_for():
    reference = trajectories.circle(diameter=1.0, period=4.0, height=0.7)
    np.testing.assert_allclose(reference(jnp.float32(1.0)), [0.5, 0.5, 0.7], atol=1e-6)
    np.testing.assert_allclose(reference(jnp.float32(2.0)), [1.0, 0.0, 0.7], atol=1e-6)


def test_the_same_task_is_the_same_object_so_that_nothing_compiles_twice():
    assert tasks.circle() is CIRCLE
    assert hash(tasks.circle(diameter=1.0)) != hash(CIRCLE)
