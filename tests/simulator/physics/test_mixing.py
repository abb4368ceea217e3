"""Mixers of frames: what their motors' commands do, and that PIDs hover them."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from maidenflight.parameters import (
    crazyflie,
    frames,
    h_frame,
    noiseless,
    plus_frame,
    replace,
    x_frame,
)
from maidenflight.parameters.frames import effectiveness
from maidenflight.simulator import environment
from maidenflight.simulator.controllers import control, firmware
from maidenflight.simulator.controllers.position_pid import position_pid
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.stepping import rollout
from maidenflight.simulator.tasks import tasks

UNEQUAL = {
    "rotor_x": (0.045, -0.03, -0.03, 0.045),
    "rotor_y": (-0.05, -0.03, 0.03, 0.05),
    "rotor_direction": (-1.0, 1.0, -1.0, 1.0),
}
FRAMES = {
    "props out": x_frame(0.0396, reversed_rotors=True),
    "+": plus_frame(0.0396),
    "unequal": UNEQUAL,
}
sides = st.floats(0.02, 0.5)


def on(frame):
    return replace(crazyflie(), **frame)


@given(sides, sides)
def test_an_x_and_every_rectangle_are_mixed_by_the_firmware(forward, sideways):
    assert frames.mixer_of(on(h_frame(forward, sideways))) is None
    np.testing.assert_allclose(
        frames.shares(on(h_frame(forward, sideways))), frames.CRAZYFLIE, atol=1e-5
    )


@pytest.mark.parametrize("name", FRAMES)
def test_each_column_makes_its_own_torque_only(name):
    drone = on(FRAMES[name])
    done = effectiveness(drone) @ frames.shares(drone)
    np.testing.assert_allclose(done, np.diag(np.diag(done)), atol=1e-6)
    assert np.all(np.diag(done) > 0)
    mixer = frames.mixer_of(drone)
    assert mixer is not None
    hash(mixer)
    np.testing.assert_allclose(np.mean(mixer, axis=0)[0], 1.0)


def test_the_mixer_of_a_plus_is_that_of_the_x_turned():
    x, plus = (frames.shares(on(frame)) for frame in (x_frame(0.05), plus_frame(0.05)))
    turn = np.array([[1.0, -1.0], [1.0, 1.0]]) / np.sqrt(2)
    np.testing.assert_allclose(plus[:, 1:3], x[:, 1:3] @ turn.T, atol=1e-6)
    np.testing.assert_allclose(plus[:, [0, 3]], x[:, [0, 3]], atol=1e-6)


def test_reversed_rotors_change_the_sign_of_yaw_alone():
    mixed = frames.shares(on(FRAMES["props out"]))
    np.testing.assert_allclose(mixed, np.array(frames.CRAZYFLIE) * [1, 1, 1, -1], atol=1e-6)


@given(st.tuples(*[st.integers(-8000, 8000)] * 3))
def test_the_firmwares_own_numbers_as_a_mixer_are_within_two_counts_of_its_whole_ones(asked):
    torque, thrust = jnp.array(asked, jnp.float32), jnp.float32(36000.0)
    own = firmware.mix(thrust, torque, "2026.08")
    np.testing.assert_allclose(
        firmware.mix(thrust, torque, "2026.08", frames.CRAZYFLIE), own, atol=2.0
    )


def test_controllers_are_the_same_object_for_the_same_frame_and_keep_their_rate():
    paper, plus = crazyflie(), on(FRAMES["+"])
    for kind, make in control.CONTROLLERS.items():
        assert make().on(paper) == make()
        assert make().on(plus) == make().on(plus)
        assert (make().on(plus) == make()) == (kind == "pwm")
    slower = control.attitude_rate().acting_at(25).on(plus)
    assert slower.interface.rate == 25
    assert position_pid().on(plus) == position_pid().on(plus)
    env = Environment.matching(replace(plus, time_step=0.002), controller=position_pid())
    assert env.controller == position_pid().on(plus)


@partial(jax.jit, static_argnums=0)
def flown(env, drone):
    """Four seconds of the position PID from a push in velocity and heading, 500 Hz."""
    start = dynamics.at_hover(jnp.array([0.1, -0.1, 1.0]), drone)
    start = start._replace(body_rates=jnp.array([0.0, 0.0, 1.0]))
    state = environment.begin(env, start, jnp.float32(0.0), drone, jax.random.key(0))
    steps = 4 * env.controller.interface.rate
    _, (moved, _) = rollout(env, lambda _: jnp.zeros(4), state, drone, jax.random.key(1), steps)
    return moved.state


@pytest.mark.parametrize("name", FRAMES)
def test_the_position_pid_hovers_every_frame(name):
    drone = replace(noiseless(on(FRAMES[name])), latency=0.005, time_step=0.002)
    env = Environment.matching(drone, tasks.hover(), position_pid())
    state = jax.tree.map(np.asarray, flown(env, drone))
    target = np.asarray(tasks.hover().reference(jnp.float32(0.0)))
    end = slice(-500, None)
    assert np.abs(state.position[end] - target).max() < 0.05
    assert np.abs(state.quaternion[end, :3]).max() < 0.03
    assert np.abs(state.body_rates[end]).max() < 0.2
