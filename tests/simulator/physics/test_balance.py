import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given

from arrays import float32
from maidenflight.parameters import crazyflie, replace
from maidenflight.simulator.physics import balance, dynamics
from maidenflight.simulator.physics.dynamics import State

PAPER = crazyflie()
angular_acceleration = jax.jit(dynamics.angular_acceleration)
linear_acceleration = jax.jit(dynamics.linear_acceleration)
balanced_command = jax.jit(balance.balanced_command)
trims = st.tuples(*[st.floats(-2e-4, 2e-4)] * 2, st.floats(-1e-4, 1e-4))


@given(
    trims.map(float32),
    st.tuples(*[st.floats(0.85, 1.1)] * 4).map(float32),
    st.floats(0, 0.1),
    st.floats(0, 0.3),
)
def test_balanced_rotors_neither_lift_nor_turn_the_drone(bias, thrusts, offset, linear):
    drone = replace(
        PAPER, torque_bias=bias, rotor_thrust=thrusts, thrust_offset=offset, thrust_linear=linear
    )
    level = jnp.array([0.0, 0.0, 0.0, 1.0])
    still = State(
        jnp.zeros(3), jnp.zeros(3), level, jnp.zeros(3), jnp.sqrt(balanced_command(drone))
    )
    np.testing.assert_allclose(linear_acceleration(still, drone), 0.0, atol=1e-4)
    np.testing.assert_allclose(angular_acceleration(still, jnp.zeros(4), drone), 0.0, atol=2e-2)


def test_balanced_rotors_of_a_drone_without_trims_hover_it():
    np.testing.assert_allclose(balanced_command(PAPER), dynamics.hover_command(PAPER), rtol=1e-5)
