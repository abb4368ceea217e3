"""Tasks: where they start, where they lead, what they pay and when they are over."""

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given

from arrays import float32
from maidenflight.errors import InputError
from maidenflight.parameters import crazyflie, replace
from maidenflight.simulator.physics import dynamics, rotations
from maidenflight.simulator.tasks import failures, rewards, tasks, trajectories, waypoints

PAPER = crazyflie()
CIRCLE = tasks.paper_circle()
SETPOINT = float32([0.1, 0.2, 1.0])
reward = jax.jit(rewards.paper_reward)
too_far = jax.jit(failures.too_far)
HOVER, TAKE_OFF = tasks.hover(), tasks.take_off()
EIGHT = trajectories.figure_eight(period=4.0)
TRACKING = tasks.tracking(EIGHT, duration=8.0, farthest=0.4, latest_start=4.0)
STILL = jnp.zeros(4)
CIRCLE_OF_KEY_3 = [
    0.4768084,
    -0.0143698,
    0.9606506,
    -0.0236868,
    -0.0578172,
    -0.0744075,
    0.0743896,
    -0.1242290,
    -0.0519709,
    0.9880953,
    -0.4242334,
    0.8183934,
    -0.2737668,
    0.7324618,
    0.7921746,
    0.7690371,
    0.8008010,
    1.5433438,
]
"""Drawn before there were other tasks; recorded policies depend on it."""
vectors = st.tuples(*[st.floats(-2, 2, width=16)] * 3).map(float32)
actions = st.tuples(*[st.floats(-2, 2, width=16)] * 4).map(float32)


def away(offset, body_rates=(0, 0, 0)):
    return dynamics.at_hover(jnp.asarray(SETPOINT + float32(offset)), PAPER)._replace(
        body_rates=jnp.asarray(float32(body_rates))
    )


@given(vectors, vectors, actions, actions)
def test_the_reward_is_the_papers_with_its_penalties_negative(offset, rates, action, previous):
    distance = np.linalg.norm(offset)
    if abs(distance - 0.25) < 1e-5:
        return
    expected = -(
        distance
        + 1e-4 * np.linalg.norm(action)
        + 1e-3 * np.linalg.norm(action - previous)
        + 1e-3 * np.linalg.norm(rates)
    )
    expected -= 100 * (distance > 0.25)
    np.testing.assert_allclose(
        reward(away(offset, rates), SETPOINT, action, previous), expected, rtol=1e-5, atol=1e-6
    )


def test_a_circles_penalties_of_actions_are_the_papers_unless_others_are_asked_for():
    state, action, previous = (
        away((0.1, 0, 0), (1, 2, 2)),
        jnp.array([1.0, 1.0, 1.0, -1.0]),
        jnp.array([1.0, 1.0, -2.0, 3.0]),
    )
    assert float(CIRCLE.reward(state, SETPOINT, action, previous)) == float(
        rewards.paper_reward(state, SETPOINT, action, previous)
    )
    for rates, paid in (
        ((0.0, 1e-3), 0.108),
        ((1e-4, 0.0), 0.1032),
        ((0.0, 0.0), 0.103),
        ((0.1, 0.2), 1.303),
    ):
        task = tasks.paper_circle(action_penalty=rates[0], action_rate_penalty=rates[1])
        np.testing.assert_allclose(task.reward(state, SETPOINT, action, previous), -paid, rtol=1e-5)
        assert task is tasks.paper_circle(0.5, 3.0, 1.0, *rates), "nothing compiles twice"
        assert hash(task) != hash(CIRCLE)
    assert tasks.paper_circle(action_penalty=1e-4, action_rate_penalty=1e-3) is CIRCLE


@pytest.mark.parametrize("direction", [(1, 0, 0), (0, -1, 0), (0, 0, 1), (0.6, 0, -0.8)])
@pytest.mark.parametrize(("distance", "over"), [(0.249, False), (0.251, True)])
def test_an_episode_fails_a_quarter_metre_from_the_setpoint_and_that_costs_a_hundred(
    direction, distance, over
):
    state = away(distance * float32(direction))
    assert bool(too_far(state, SETPOINT)) is over
    assert (
        float(reward(state, SETPOINT, np.zeros(4, np.float32), np.zeros(4, np.float32))) < -100
    ) is over


def test_a_perfect_flight_pays_nothing_and_has_a_finite_slope():
    state, still = away((0, 0, 0)), jnp.zeros(4)
    assert float(reward(state, SETPOINT, still, still)) == 0
    slope = jax.grad(
        lambda state: rewards.paper_reward(state, jnp.asarray(SETPOINT), still, still)
    )(state)
    assert all(bool(jnp.all(jnp.isfinite(leaf))) for leaf in slope)


def starts(task, parameters=PAPER):
    """A thousand first states, and how far they are from the reference."""
    state, time = jax.jit(jax.vmap(task.reset, (None, 0)))(
        parameters, jax.random.split(jax.random.key(0), 1000)
    )
    away_from = state.position - jax.jit(jax.vmap(task.reference))(time)
    return state, time, away_from, jax.jit(jax.vmap(rotations.to_attitude))(state.quaternion)


def fills(values, half_width):
    """Whether values reach all over their interval about zero, and not beyond."""
    half_width = np.asarray(half_width)
    extremes = np.stack([np.max(values, axis=0), -np.min(values, axis=0)])
    return bool(
        np.all(extremes <= half_width * (1 + 1e-5) + 2e-7) and np.all(extremes >= 0.95 * half_width)
    )


def test_starts_fill_their_box_and_never_leave_it():
    state, time, position, attitude = starts(CIRCLE, replace(PAPER, thrust_to_weight=2.0))
    assert fills(position, [0.05] * 3)
    assert fills(state.velocity, [0.1] * 3)
    assert fills(attitude, np.radians([20, 20, 18]))
    assert fills(state.body_rates, np.radians([50, 50, 20]))
    assert fills(time - 1.5, 1.5)
    np.testing.assert_allclose(np.mean(state.rotor_speed, axis=0), np.sqrt(0.5), atol=0.003)
    np.testing.assert_allclose(np.std(state.rotor_speed, axis=0), 0.02, rtol=0.1)


def test_a_key_gives_the_circle_the_start_that_it_always_gave():
    state, time = CIRCLE.reset(PAPER, jax.random.key(3))
    drawn = np.concatenate(
        [
            state.position,
            state.velocity,
            state.quaternion,
            state.body_rates,
            state.rotor_speed,
            time[None],
        ]
    )
    np.testing.assert_allclose(drawn, CIRCLE_OF_KEY_3, atol=1e-6)


@pytest.mark.parametrize("name", tasks.TASKS)
def test_a_task_has_the_name_that_it_is_offered_under_and_is_one_object(name):
    assert tasks.TASKS[name]().name == name
    assert tasks.TASKS[name]() is tasks.TASKS[name]()


def test_hover_starts_anywhere_near_and_facing_anywhere():
    state, time, position, attitude = starts(HOVER)
    assert fills(position, [0.25] * 3)
    assert fills(state.velocity, [0.1] * 3)
    assert fills(attitude, np.radians([30, 30, 180]))
    assert fills(state.body_rates, np.radians([200, 200, 20]))
    np.testing.assert_array_equal(time, 0)
    np.testing.assert_allclose(np.std(state.rotor_speed, axis=0), 0.02, rtol=0.1)
    assert not np.any(jax.jit(jax.vmap(HOVER.failure))(state, jnp.zeros((1000, 3)))), (
        "no start has failed already"
    )


def test_a_take_off_starts_at_rest_on_the_ground_with_motors_off():
    state, time, position, attitude = starts(TAKE_OFF)
    assert fills(position[:, :2], [0.25] * 2)
    np.testing.assert_allclose(state.position[:, 2], 0.0125)
    assert fills(attitude, [0, 0, np.pi])
    for resting in (state.velocity, state.body_rates, state.rotor_speed, time):
        np.testing.assert_array_equal(resting, 0)
    assert not np.any(
        jax.jit(jax.vmap(TAKE_OFF.failure))(state, jax.jit(jax.vmap(TAKE_OFF.reference))(time))
    )
    assert float(TAKE_OFF.first_command(PAPER)) == 0
    np.testing.assert_allclose(TAKE_OFF.reference(jnp.float32(1.5)), [0, 0, 1], atol=1e-6)


@pytest.mark.parametrize("task", [CIRCLE, HOVER, TRACKING])
def test_other_tasks_start_with_the_motors_at_hover(task):
    np.testing.assert_allclose(task.first_command(replace(PAPER, thrust_to_weight=2.0)), 0.5)


def test_tracking_starts_near_its_reference_and_as_fast_as_it():
    state, time, position, attitude = starts(TRACKING)
    assert fills(time - 2.0, 2.0)
    assert fills(position, [0.05] * 3)
    assert fills(attitude, np.radians([20, 20, 18]))
    ahead, behind = (jax.jit(jax.vmap(EIGHT))(time + shift) for shift in (0.01, -0.01))
    assert float(jnp.abs(state.velocity).max()) > 1, "the reference is fast"
    np.testing.assert_array_less(np.abs(state.velocity - (ahead - behind) / 0.02), 0.105)


def test_tracking_without_a_latest_start_starts_where_the_trajectory_does():
    path = waypoints.zigzag(((0.0, 0.0, 0.0, 1.0), (1.0, 0.8, 0.0, 1.0), (2.0, 0.0, 0.0, 1.0)))
    state, time, position, _ = starts(tasks.tracking(path, 2.0))
    np.testing.assert_array_equal(time, 0)
    assert fills(position, [0.05] * 3)
    assert fills(state.velocity - jnp.array([[0.8, 0.0, 0.0]]), [0.1] * 3)


def test_tracking_a_circle_follows_the_circles_reference_and_pays_and_fails_as_it():
    tracked = tasks.tracking(trajectories.circle(), duration=5.0)
    assert tracked.reference is CIRCLE.reference
    for offset in (0.1, 0.249, 0.251):
        state = away((0, offset, 0), (1, 2, 3))
        assert float(tracked.reward(state, SETPOINT, STILL, STILL + 1)) == float(
            CIRCLE.reward(state, SETPOINT, STILL, STILL + 1)
        )
        assert bool(tracked.failure(state, SETPOINT)) == bool(CIRCLE.failure(state, SETPOINT))


@pytest.mark.parametrize(("distance", "over"), [(0.399, False), (0.401, True)])
def test_tracking_fails_as_far_away_as_it_was_asked_to(distance, over):
    state = away((0, 0, distance))
    assert bool(TRACKING.failure(state, SETPOINT)) is over
    assert (float(TRACKING.reward(state, SETPOINT, STILL, STILL)) < -100) is over


def at(height=1.0, roll=0.0, pitch=0.0, yaw=0.0, rates=(0, 0, 0), x=0.0, velocity=(0, 0, 0)):
    attitude = rotations.from_attitude(jnp.asarray(float32(np.radians([roll, pitch, yaw]))))
    state = dynamics.at_hover(jnp.asarray(float32([x, 0, height])), PAPER)
    return state._replace(
        quaternion=attitude,
        body_rates=jnp.asarray(float32(np.radians(rates))),
        velocity=jnp.asarray(float32(velocity)),
    )


@pytest.mark.parametrize(
    ("inside", "outside"),
    [
        (at(roll=59.9), at(roll=60.1)),
        (at(roll=-59.9, yaw=170), at(roll=-60.1, yaw=170)),
        (at(pitch=59.9, yaw=90), at(pitch=60.1, yaw=90)),
        (at(pitch=-59.9), at(roll=180)),
        (at(rates=(299, 0, 0)), at(rates=(301, 0, 0))),
        (at(rates=(0, -299, 0)), at(rates=(0, -301, 0))),
        (at(rates=(0, 0, 299)), at(rates=(0, 0, 301))),
        (at(height=0.201), at(height=0.199)),
        (at(x=50.0), at(height=-1.0)),
    ],
)
def test_hover_fails_when_steep_spinning_or_low_and_that_costs_a_hundred(inside, outside):
    setpoint = HOVER.reference(jnp.float32(0))
    for state, over in ((inside, False), (outside, True)):
        assert bool(HOVER.failure(state, setpoint)) is over
        gap = float(
            HOVER.reward(state, setpoint, STILL, STILL) + jnp.linalg.norm(setpoint - state.position)
        )
        assert gap == pytest.approx(-100 * over, abs=0.01)


@pytest.mark.parametrize(
    ("state", "setpoint", "over"),
    [
        (at(height=0.0125), 0.49, False),
        (at(height=0.049), 0.499, False),
        (at(height=0.049), 0.501, True),
        (at(height=0.051), 0.501, False),
        (at(height=0.5), 0.999, False),
        (at(height=0.5), 1.001, True),
        (at(height=1.0, x=0.501), 1.0, True),
        (at(roll=59.9), 1.0, False),
        (at(pitch=-60.1), 1.0, True),
        (at(rates=(0, 0, 900)), 1.0, False),
    ],
)
def test_a_take_off_fails_when_steep_far_or_left_behind(state, setpoint, over):
    setpoint = jnp.asarray(float32([0, 0, setpoint]))
    assert bool(TAKE_OFF.failure(state, setpoint)) is over
    assert (float(TAKE_OFF.reward(state, setpoint, STILL, STILL)) < -100) is over


def test_rewards_of_hover_and_take_off_are_the_authors():
    # |e| = 0.3, u = (1, 0.5, 0.5, 0) after clipping, |omega| = 5 rad/s, |v| = 3 m/s; the previous
    # action does not count.
    action, previous = jnp.array([3.0, 0.0, 0.0, -2.0]), jnp.array([9.0, 9.0, 9.0, 9.0])
    state = at(height=0.7, rates=np.degrees([3, 0, -4]), velocity=(1, 2, 2))
    setpoint = HOVER.reference(jnp.float32(0))
    effort = 0.3 + 1e-4 * np.sqrt(1.5) + 1e-4 * 5
    np.testing.assert_allclose(HOVER.reward(state, setpoint, action, previous), -effort, rtol=1e-6)
    np.testing.assert_allclose(
        TAKE_OFF.reward(state, setpoint, action, previous), -effort - 3e-4, rtol=1e-6
    )
    low, setpoint = (
        state._replace(position=jnp.array([0.0, 0.0, 0.079])),
        jnp.array([0.0, 0.0, 0.379]),
    )
    np.testing.assert_allclose(
        TAKE_OFF.reward(low, setpoint, action, previous), -effort - 3e-4 - 1, rtol=1e-6
    )


@pytest.mark.parametrize("task", [HOVER, TAKE_OFF, TRACKING])
def test_rewards_have_finite_slopes_where_nothing_is_wrong(task):
    setpoint = jnp.array([0.0, 0.0, 1.0])
    slope = jax.grad(lambda state: task.reward(state, setpoint, STILL - 1, STILL - 1))(at())
    assert all(bool(jnp.all(jnp.isfinite(leaf))) for leaf in slope)


def test_the_circle_runs_clockwise_seen_from_above_and_starts_at_the_origin():
    time = jnp.linspace(0.0, 3.0, 301)
    points = np.asarray(jax.jit(jax.vmap(CIRCLE.reference))(time))
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
    assert tasks.paper_circle() is tasks.paper_circle(0.5, period=3.0) is CIRCLE
    assert hash(tasks.paper_circle(diameter=1.0)) != hash(CIRCLE)
    for make in (
        tasks.hover,
        tasks.take_off,
        lambda: tasks.tracking(EIGHT, duration=8.0, farthest=0.4, latest_start=4.0),
    ):
        assert make() is make()
    assert (
        tasks.tracking(
            trajectories.figure_eight(period=4.0), duration=8.0, farthest=0.4, latest_start=4.0
        )
        is TRACKING
    )
    assert len({hash(task) for task in (CIRCLE, HOVER, TAKE_OFF, TRACKING)}) == 4


def test_episodes_start_facing_anywhere_if_they_are_to_and_else_as_without():
    starts = [
        jax.vmap(task.reset, (None, 0))(PAPER, jax.random.split(jax.random.key(3), 200))[0]
        for task in (CIRCLE, tasks.with_yaw_penalty(CIRCLE, 0.1, np.pi))
    ]
    without, turned = (jax.vmap(rotations.to_attitude)(start.quaternion) for start in starts)
    yaw = np.asarray(turned[:, 2] - without[:, 2] + np.pi) % (2 * np.pi) - np.pi
    assert yaw.min() < -2.5
    assert yaw.max() > 2.5
    # Of 200, 100 are expected, with a standard deviation of 7.
    assert 70 < np.sum(np.abs(yaw) < np.pi / 8) < 130
    np.testing.assert_allclose(turned[:, :2], without[:, :2], atol=1e-5)
    for name in ("position", "velocity", "body_rates", "rotor_speed"):
        assert (getattr(starts[0], name) == getattr(starts[1], name)).all()


@pytest.mark.parametrize("yaw", [-2.0, 0.0, 0.7])
@pytest.mark.parametrize("task", [CIRCLE, HOVER])
def test_a_task_with_a_price_on_turning_away_pays_so_much_less_and_is_one_object(task, yaw):
    state = dynamics.at_hover(SETPOINT, PAPER)._replace(
        quaternion=rotations.from_attitude(float32([0.1, -0.2, yaw]))
    )
    penalised = tasks.with_yaw_penalty(task, 0.1)
    lost = task.reward(state, SETPOINT, STILL, STILL) - penalised.reward(
        state, SETPOINT, STILL, STILL
    )
    assert lost == pytest.approx(0.1 * abs(yaw), abs=1e-6)
    assert penalised is tasks.with_yaw_penalty(task, 0.1)
    assert penalised.name not in (task.name, tasks.with_yaw_penalty(task, 0.2).name)
    assert (penalised.failure, penalised.failure_margin, penalised.duration) == (
        task.failure,
        task.failure_margin,
        task.duration,
    )


def test_a_reason_is_the_first_of_the_list_that_holds():
    true, false = jnp.array(True), jnp.array(False)
    told = failures.END_REASONS[int(failures.reason(position_error=true, tilt=true, height=true))]
    assert told == "tilt"
    assert (
        failures.END_REASONS[int(failures.reason(position_error=true, tilt=false))]
        == "position error"
    )
    assert int(failures.reason(body_rate=false)) == 0


def test_each_task_says_why_it_failed():
    level = dynamics.at_hover(jnp.array([0.0, 0.0, 1.0]), PAPER)
    tilted = level._replace(quaternion=rotations.from_attitude(jnp.array([1.2, 0.0, 0.0])))
    low = level._replace(position=jnp.array([0.0, 0.0, 0.1]))
    spinning = level._replace(body_rates=jnp.array([0.0, 6.0, 0.0]))
    far = level._replace(position=jnp.array([2.0, 0.0, 1.0]))
    here = level.position
    for task, state, expected in [
        (HOVER, tilted, "tilt"),
        (HOVER, low, "height"),
        (HOVER, spinning, "body rate"),
        (CIRCLE, far, "position error"),
        (TAKE_OFF, far, "position error"),
        (TAKE_OFF, level._replace(position=jnp.array([0.0, 0.0, 0.0125])), "position error"),
    ]:
        assert failures.END_REASONS[int(task.failure(state, here))] == expected


@pytest.mark.slow
@pytest.mark.parametrize("task", [CIRCLE, HOVER, TAKE_OFF, TRACKING], ids=lambda task: task.name)
def test_the_failure_margin_is_positive_only_while_safe_and_has_a_finite_gradient_everywhere(task):
    sizes = float32([0.4] * 3 + [1.5, 1.5, 3.0] + [6.0] * 3)
    draws = sizes * np.random.default_rng(4).uniform(-1.0, 1.0, (2000, 9)).astype(np.float32)
    wild = dynamics.State(
        position=jnp.asarray(SETPOINT + draws[:, :3]),
        velocity=jnp.asarray(draws[:, :3]),
        quaternion=jax.jit(jax.vmap(rotations.from_attitude))(draws[:, 3:6]),
        body_rates=jnp.asarray(draws[:, 6:]),
        rotor_speed=jnp.ones((2000, 4)),
    )
    calm = jax.tree.map(lambda leaf: leaf[None], dynamics.at_hover(SETPOINT, PAPER))
    states = jax.tree.map(lambda *parts: jnp.concatenate(parts), calm, wild)
    margin_of = jax.value_and_grad(lambda state: task.failure_margin(state, SETPOINT))
    margin, slope = jax.jit(jax.vmap(margin_of))(states)
    failed = np.asarray(jax.jit(jax.vmap(lambda state: task.failure(state, SETPOINT)))(states)) > 0
    # Whoever stays on the ground fails by that alone, wherever the set-point is.
    failed &= np.asarray(states.position[:, 2] >= failures.AIRBORNE_HEIGHT_M) | (
        task is not TAKE_OFF
    )
    assert 100 < failed.sum() < 1990
    assert np.all(margin[failed] <= 1e-6)
    if task in (CIRCLE, TRACKING):
        assert np.all(margin[~failed] >= -1e-6)
    assert float(margin[0]) == 1.0
    for leaf in jax.tree.leaves(slope):
        assert np.all(np.isfinite(leaf))


@pytest.mark.parametrize(
    ("trajectory", "duration", "words"),
    [
        (
            lambda time: jnp.stack([time, time]),
            1.0,
            r"gives an array of shape \(2,\); expected 3 numbers",
        ),
        (
            lambda time: np.array([np.sin(time), 0.0, 1.0]),
            1.0,
            "not a function that JAX can trace",
        ),
        (
            lambda time: jnp.zeros(3) if time > 1 else jnp.ones(3),
            1.0,
            "not a function that JAX can trace",
        ),
        (lambda time: jnp.zeros(3), -1.0, "duration = -1.0 s of an episode; expected more than 0"),
    ],
    ids=["two numbers", "numpy", "if", "duration"],
)
def test_a_trajectory_that_cannot_be_flown_is_refused_at_once(trajectory, duration, words):
    with pytest.raises(InputError, match=words):
        tasks.tracking(trajectory, duration)
