"""Frames of any geometry: torques, symmetries of the physics, and what every picture takes."""

import itertools
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from maidenflight import parameters
from maidenflight.flights import log
from maidenflight.parameters import (
    arm_length,
    crazyflie,
    h_frame,
    levers,
    plus_frame,
    replace,
    rotors,
    x_frame,
)
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.physics.dynamics import State

FRAMES = {
    "x": x_frame(0.05),
    "props out": x_frame(0.05, reversed_rotors=True),
    "+": plus_frame(0.05),
    "h": h_frame(0.03, 0.07),
    "unequal": {
        "rotor_x": (0.06, -0.04, -0.04, 0.06),
        "rotor_y": (-0.07, -0.03, 0.03, 0.07),
        "rotor_direction": (-1.0, 1.0, -1.0, 1.0),
    },
}
WHOLE = replace(
    crazyflie(),
    rotor_momentum=7e-5,
    flapping_moment=(3e-4, 3e-4),
    rotational_damping=2e-6,
    drag=(0.3, 0.3, 0.1),
    inertia=(1.5e-5, 1.5e-5, 2.6e-5),
    time_step=0.002,
)
"""Round about z, with every effect on torque."""
number = st.floats(-1.0, 1.0, width=32)
forces = st.tuples(*[st.floats(0.0, 0.25, width=32)] * 4)
places = st.tuples(*[st.floats(-0.25, 0.25, width=32)] * 4)
turns = st.sampled_from(list(itertools.product((-1.0, 1.0), repeat=4)))
torque = jax.jit(lambda thrust, drone: jnp.stack(dynamics.torque(thrust, drone)))


@jax.jit
def derivative(state, command, drone):
    return dynamics.derivative(state, command, drone)


def rotated(vector, angle):
    cos, sin = np.cos(angle), np.sin(angle)
    x, y, z = vector
    return np.array([cos * x - sin * y, sin * x + cos * y, z], np.float32)


@st.composite
def flights(draw):
    """A level heading, anything else: position, velocities and rotor speeds, with a command."""
    three = st.tuples(number, number, number)
    speeds = st.tuples(*[st.floats(0.25, 1.0, width=32)] * 4)
    arrays = [np.array(draw(three), np.float32) for _ in range(3)]
    tilt = np.array([*draw(st.tuples(number, number)), 0.0]) * 0.3
    return *arrays, tilt, *(np.array(draw(speeds), np.float32) for _ in range(2))


def state_of(moving, tilt, speed):
    """A drone by position, velocity and body rates, turned by the rotation vector `tilt` from
    level."""
    place, velocity, rates = moving
    angle = np.linalg.norm(tilt)
    axis = tilt / angle if angle else tilt
    quaternion = np.array([*(np.sin(angle / 2) * axis), np.cos(angle / 2)], np.float32)
    return State(*map(jnp.asarray, (place, velocity, quaternion, rates, speed)))


@given(forces, places, places, turns)
def test_torque_is_that_of_forces_at_their_places_and_of_the_rotors_turn(thrust, x, y, turn):
    drone = replace(
        crazyflie(),
        rotor_x=np.float32(x),
        rotor_y=np.float32(y),
        rotor_direction=np.float32(turn),
    )
    arms, lift = np.stack([x, y, np.zeros(4)], 1), np.outer(thrust, [0.0, 0.0, 1.0])
    reaction = float(drone.torque_to_thrust) * np.array(thrust) + float(drone.torque_offset)
    expected = np.cross(arms, lift).sum(0)
    expected[2] += reaction @ np.array(turn)
    np.testing.assert_allclose(torque(np.float32(thrust), drone), expected, atol=2e-8)
    np.testing.assert_allclose(levers(drone)[:, :2], np.cross(arms, [0, 0, 1])[:, :2])


@pytest.mark.parametrize("name", ["x", "props out", "+", "h"])
def test_equal_thrust_does_not_turn_a_symmetric_frame(name):
    drone = replace(crazyflie(), **FRAMES[name])
    assert np.abs(torque(np.full(4, 0.07, np.float32), drone)).max() < 1e-9
    assert np.abs(levers(drone).sum(axis=0)).max() < 1e-9


@given(flights(), st.sampled_from(sorted(FRAMES)), st.integers(1, 3))
def test_a_frame_turned_by_quarters_is_the_same_drone_with_its_motors_renumbered(
    flown, name, quarters
):
    """Rotor i of a frame turned to the left in its body stands where another one was; a drone
    flown with everything else turned likewise feels what the first feels, turned.
    """
    turn = partial(rotated, angle=quarters * np.pi / 2)
    drone = replace(WHOLE, **FRAMES[name])
    hubs = np.array([turn(hub) for hub in rotors(drone)], np.float32)
    other = replace(drone, rotor_x=hubs[:, 0], rotor_y=hubs[:, 1])
    *first, tilt, speed, command = flown
    here = derivative(state_of(first, tilt, speed), command, drone)
    there = derivative(state_of(map(turn, first), turn(tilt), speed), command, other)
    for part in ("velocity", "body_rates"):
        expected = turn(np.asarray(getattr(here, part)))
        np.testing.assert_allclose(getattr(there, part), expected, rtol=2e-4, atol=2e-3)
    if name == "x":
        order = np.roll(np.arange(4), quarters)
        x, y = (np.asarray(getattr(drone, one))[order] for one in ("rotor_x", "rotor_y"))
        np.testing.assert_allclose(np.stack([x, y], 1), hubs[:, :2], atol=1e-8)


@given(flights())
def test_a_plus_frame_is_the_x_turned_in_the_body_by_an_eighth(flown):
    turn = partial(rotated, angle=np.pi / 4)
    *first, tilt, speed, command = flown
    x, plus = (replace(WHOLE, **FRAMES[name]) for name in ("x", "+"))
    np.testing.assert_allclose(rotors(plus), [turn(hub) for hub in rotors(x)], atol=1e-7)
    here = derivative(state_of(first, tilt, speed), command, x)
    there = derivative(state_of(map(turn, first), turn(tilt), speed), command, plus)
    for part in ("velocity", "body_rates"):
        expected = turn(np.asarray(getattr(here, part)))
        np.testing.assert_allclose(getattr(there, part), expected, rtol=2e-4, atol=2e-3)


@given(flights(), st.sampled_from(sorted(FRAMES)))
def test_a_frame_seen_in_a_mirror_flies_as_the_mirror_image(flown, name):
    """Mirrored left to right: y, and all that turns about x and z, change their signs."""
    drone = replace(WHOLE, **FRAMES[name])
    other = replace(
        drone,
        rotor_y=-np.asarray(drone.rotor_y),
        rotor_direction=-np.asarray(drone.rotor_direction),
    )
    place, velocity, rates, tilt, speed, command = flown
    across, about = np.array([1, -1, 1], np.float32), np.array([-1, 1, -1], np.float32)
    here = derivative(state_of((place, velocity, rates), tilt, speed), command, drone)
    there = derivative(
        state_of((place * across, velocity * across, rates * about), tilt * about, speed),
        command,
        other,
    )
    np.testing.assert_allclose(there.velocity, here.velocity * across, rtol=2e-4, atol=1e-4)
    np.testing.assert_allclose(there.body_rates, here.body_rates * about, rtol=2e-4, atol=2e-3)


@given(flights(), st.permutations(range(4)))
def test_how_the_motors_are_numbered_does_not_matter(flown, order):
    *first, tilt, speed, command = flown
    drone = replace(WHOLE, **FRAMES["unequal"])
    names = (*parameters.GEOMETRY, "rotor_thrust")
    other = replace(drone, **{name: np.asarray(getattr(drone, name))[order] for name in names})
    here = derivative(state_of(first, tilt, speed), command, drone)
    there = derivative(state_of(first, tilt, speed[order]), command[order], other)
    np.testing.assert_allclose(there.velocity, here.velocity, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(there.body_rates, here.body_rates, rtol=2e-4, atol=2e-3)


def test_what_knows_no_drone_has_a_crazyflies_geometry():
    drone = crazyflie()
    np.testing.assert_allclose(rotors(drone) / arm_length(drone), log.ROTORS, rtol=1e-6)
    np.testing.assert_array_equal(np.sign(levers(drone)), log.TORQUES)
    np.testing.assert_array_equal(drone.rotor_direction, log.YAW)
