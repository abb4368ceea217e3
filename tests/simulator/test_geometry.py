"""The drone's geometry is that of its dynamics, and every picture has it."""

import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight import parameters
from maidenflight.simulator import dynamics, geometry


@pytest.mark.parametrize("rotor", range(4))
def test_a_rotors_torque_is_that_of_its_place_and_its_turn(rotor):
    drone = parameters.crazyflie()
    forces = np.eye(4)[rotor] * 0.07
    lever = np.cross(float(drone.arm_length) * geometry.ROTORS[rotor], [0.0, 0.0, 0.07])
    reaction = geometry.YAW[rotor] * (
        float(drone.torque_to_thrust) * 0.07 + float(drone.torque_offset)
    )
    others = float(drone.torque_offset) * (sum(geometry.YAW) - geometry.YAW[rotor])
    torque = np.array(dynamics.torque(jnp.asarray(forces), drone), np.float64)
    np.testing.assert_allclose(torque, [*lever[:2], reaction + others], rtol=1e-5, atol=1e-12)
    np.testing.assert_array_equal(geometry.TORQUES[rotor], np.sign([*lever[:2], reaction]))


def test_rotors_are_on_a_circle_of_the_arm_and_those_in_front_are_before_the_centre():
    np.testing.assert_allclose(np.linalg.norm(geometry.ROTORS, axis=1), 1.0)
    np.testing.assert_array_equal(geometry.ROTORS[:, 0] > 0, geometry.FRONT)
    assert len(np.unique(geometry.ROTORS, axis=0)) == 4
