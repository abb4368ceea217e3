"""What a look-ahead shows is where the reference will be, relative to the drone."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight.errors import InputError
from maidenflight.parameters import crazyflie, noiseless
from maidenflight.simulator import environment
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.stepping import rollout
from maidenflight.simulator.tasks import tasks, waypoints
from maidenflight.simulator.tasks.look_ahead import LookAhead

KEY = jax.random.key(0)
POINTS = LookAhead(3, 0.15)
LINE = ((0.0, 0.0, 0.0, 1.0), (0.1, 0.05, 0.0, 1.0), (0.2, 0.05, 0.1, 1.2))


def circle_at(time):
    """The paper's circle in NumPy: diameter 0.5 m, 3 s, clock-wise from the origin."""
    angle = 2 * np.pi * time / 3.0
    return np.stack(
        [0.25 - 0.25 * np.cos(angle), 0.25 * np.sin(angle), np.ones_like(angle)], axis=-1
    )


def line_at(time):
    """`LINE`, its last point held, by `numpy.interp`."""
    table = np.array(LINE)
    return np.stack(
        [np.interp(time, table[:, 0], table[:, column]) for column in (1, 2, 3)], axis=-1
    )


def held_at(time):
    return np.broadcast_to([0.0, 0.0, 1.0], (*np.shape(time), 3))


def expected(where, time, position):
    times = np.asarray(time, np.float64)[..., None] + [0.15, 0.30, 0.45]
    return where(times) - np.asarray(position)[..., None, :]


@pytest.mark.parametrize(
    ("task", "where"), [(tasks.paper_circle(), circle_at), (tasks.hover(), held_at)]
)
@pytest.mark.parametrize("time", [0.0, 1.234, 40.0])
def test_an_observation_ends_with_the_reference_to_come(task, where, time):
    env, place = (
        Environment(task=task, spec=PolicySpec(look_ahead=POINTS)),
        jnp.array([0.1, -0.2, 0.9]),
    )
    state = dynamics.at_hover(place, noiseless(crazyflie()))
    begun = environment.begin(env, state, jnp.float32(time), noiseless(crazyflie()), KEY)
    seen = np.asarray(environment.observation(env, begun))
    np.testing.assert_allclose(
        seen[40:].reshape(3, 3), expected(where, time, place), rtol=0, atol=1e-5
    )


@pytest.mark.slow
def test_in_flight_it_is_relative_to_what_is_measured_and_stays_at_a_trajectory_s_last_point():
    env = Environment(
        task=tasks.tracking(waypoints.zigzag(LINE), 0.2),
        spec=PolicySpec(look_ahead=POINTS, history=3),
    )
    drone = crazyflie()
    first = environment.reset(env, drone, KEY)
    fly = jax.jit(lambda key: rollout(env, lambda seen: jnp.full(4, 0.15), first, drone, key, 12))
    _, (states, _) = fly(KEY)
    seen = np.asarray(jax.jit(jax.vmap(partial(environment.observation, env)))(states))
    assert seen.shape == (12, 3 * 20 + 9)
    np.testing.assert_array_equal(seen[:, :60], np.asarray(states.history).reshape(12, 60))
    points = expected(line_at, states.time, states.measurement.position)
    np.testing.assert_allclose(seen[:, 60:].reshape(12, 3, 3), points, rtol=0, atol=2e-6)
    np.testing.assert_array_equal(seen[:, 63:66], seen[:, 66:69])


def test_no_look_ahead_adds_nothing_and_changes_nothing():
    """Bit by bit, and a look-ahead does not change what flies."""
    plain, ahead = Environment(), Environment(spec=PolicySpec(look_ahead=POINTS))
    assert plain.spec.look_ahead.points == 0
    first = environment.reset(plain, crazyflie(), KEY)
    seen = environment.observation(plain, first)
    np.testing.assert_array_equal(seen, first.history.reshape(-1))
    longer = environment.observation(ahead, environment.reset(ahead, crazyflie(), KEY))
    np.testing.assert_array_equal(longer[:40], seen)
    assert longer.shape == (49,)


def test_numbers_of_a_look_ahead():
    np.testing.assert_allclose(POINTS.times, [0.15, 0.3, 0.45], rtol=1e-6)
    assert (POINTS.size, POINTS.times.dtype) == (9, np.float32)
    assert POINTS.deviations.shape == (9,)
    assert LookAhead.from_dict(POINTS.to_dict()) == POINTS
    assert LookAhead(2, 1).spacing == 1.0
    for wrong in ({}, None, {"points": 3}, {"points": 3, "spacing": 0.1, "more": 1}):
        with pytest.raises(InputError, match="look-ahead"):
            LookAhead.from_dict(wrong)


@pytest.mark.parametrize(
    ("points", "spacing"),
    [(-1, 0.1), (51, 0.1), (2.0, 0.1), (True, 0.1), (3, 0.0), (3, float("nan")), (3, "0.1")],
)
def test_what_is_no_look_ahead_is_refused(points, spacing):
    with pytest.raises(InputError, match="look-ahead"):
        LookAhead(points, spacing)
