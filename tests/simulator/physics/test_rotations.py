"""Quaternions, matrices and roll-pitch-yaw are one rotation in three forms."""

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given
from scipy.spatial.transform import Rotation

from arrays import float32, float64
from maidenflight.simulator.physics import rotations

to_matrix = jax.jit(rotations.to_matrix)
to_attitude = jax.jit(rotations.to_attitude)
from_attitude = jax.jit(rotations.from_attitude)
derivative = jax.jit(rotations.quaternion_derivative)
normalise = jax.jit(rotations.normalise)
body_z = jax.jit(rotations.body_z)
turn_heading = jax.jit(rotations.turn_heading)
arctan2 = jax.jit(rotations.arctan2)
turning = jax.jit(jax.grad(rotations.arctan2, argnums=(0, 1)))

angle = st.floats(-3, 3, width=16)
attitudes = st.tuples(angle, st.floats(-1.5, 1.5, width=16), angle).map(float32)
vectors = st.tuples(*[st.floats(-10, 10, width=16)] * 3).map(float32)


def scipy_rotation(attitude):
    return Rotation.from_euler("ZYX", float64(attitude)[::-1])


@given(attitudes)
def test_the_matrix_is_that_of_scipys_intrinsic_zyx(attitude):
    np.testing.assert_allclose(
        to_matrix(from_attitude(attitude)), scipy_rotation(attitude).as_matrix(), atol=1e-6
    )


@given(attitudes)
def test_the_quaternion_is_scipys_up_to_its_sign(attitude):
    ours, theirs = np.asarray(from_attitude(attitude)), scipy_rotation(attitude).as_quat()
    np.testing.assert_allclose(ours * np.sign(ours @ theirs), theirs, atol=1e-6)


@given(attitudes)
def test_attitude_to_quaternion_and_back_is_the_same_attitude(attitude):
    np.testing.assert_allclose(to_attitude(from_attitude(attitude)), attitude, atol=5e-5)


@given(attitudes)
def test_both_signs_of_a_quaternion_are_the_same_attitude(attitude):
    quaternion = from_attitude(attitude)
    np.testing.assert_allclose(to_matrix(-quaternion), to_matrix(quaternion), atol=1e-7)
    np.testing.assert_allclose(to_attitude(-quaternion), to_attitude(quaternion), atol=1e-6)


@given(attitudes, angle)
def test_a_turned_heading_is_a_rotation_about_the_worlds_z_axis_before_the_attitude(attitude, turn):
    ours = to_matrix(turn_heading(from_attitude(attitude), np.float32(turn)))
    about_z = Rotation.from_euler("z", turn)
    np.testing.assert_allclose(ours, (about_z * scipy_rotation(attitude)).as_matrix(), atol=2e-6)


@given(attitudes)
def test_the_body_z_axis_is_the_matrix_last_column(attitude):
    quaternion = from_attitude(attitude)
    np.testing.assert_allclose(body_z(quaternion), to_matrix(quaternion)[:, 2], atol=1e-7)


@given(st.tuples(*[st.floats(-1e3, 1e3, width=16)] * 2).filter(any))
def test_the_angle_of_a_point_is_numpys(point):
    found, expected = arctan2(*float32(point)), np.arctan2(*float64(point))
    # The sign of a zero is not told apart: the angles pi and -pi are one.
    np.testing.assert_allclose(np.cos(found - expected), 1, atol=1e-7)
    np.testing.assert_allclose(np.sin(found - expected), 0, atol=4e-7)
    assert abs(found) <= np.float32(np.pi)


@given(
    st.tuples(*[st.floats(-10, 10, width=16)] * 2).filter(lambda point: max(map(abs, point)) > 0.01)
)
def test_the_angle_of_a_point_turns_as_the_point_does(point):
    y, x = float64(point)
    slopes = turning(*float32(point))
    np.testing.assert_allclose(slopes, np.array([x, -y]) / (x * x + y * y), rtol=1e-5)


def test_no_point_has_the_angle_zero_and_what_is_no_number_has_none():
    assert arctan2(jnp.zeros(()), jnp.zeros(())) == 0
    assert np.isnan(arctan2(jnp.float32(np.nan), jnp.ones(())))


def test_straight_up_and_down_are_quarter_turns_of_pitch():
    for pitch in (-np.pi / 2, np.pi / 2):
        quaternion = from_attitude(jnp.array([0.0, pitch, 0.0]))
        np.testing.assert_allclose(to_attitude(quaternion)[1], pitch, atol=1e-3)


def test_positive_pitch_is_nose_down_and_positive_roll_is_left_side_up():
    nose = to_matrix(from_attitude(jnp.array([0.0, 0.3, 0.0]))) @ jnp.array([1.0, 0.0, 0.0])
    left = to_matrix(from_attitude(jnp.array([0.3, 0.0, 0.0]))) @ jnp.array([0.0, 1.0, 0.0])
    assert nose[2] < -0.29
    assert left[2] > 0.29


@given(attitudes, vectors)
def test_the_derivative_is_the_slope_of_a_rotation_about_body_axes(attitude, rates):
    turn, h = scipy_rotation(attitude), 1e-4
    before, after = (
        (turn * Rotation.from_rotvec(sign * h * float64(rates))).as_quat() for sign in (-1, 1)
    )
    after *= np.sign(before @ after)
    quaternion = np.asarray(from_attitude(attitude))
    slope = (after - before) / (2 * h) * np.sign(before @ quaternion)
    np.testing.assert_allclose(derivative(quaternion, rates), slope, atol=1e-4)


@given(attitudes, st.floats(0.125, 10, width=16))
def test_normalise_keeps_the_direction_and_makes_the_length_one(attitude, length):
    quaternion = from_attitude(attitude)
    np.testing.assert_allclose(normalise(float32(length) * quaternion), quaternion, atol=1e-6)
