"""Commands at which a drone with constant torques and unequal rotors neither moves nor turns."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from maidenflight.parameters import Parameters
from maidenflight.simulator.physics import dynamics


def balanced_shares(parameters: Parameters) -> Float[Array, "4"]:
    """Returns the share of its own full thrust that each rotor gives in hover [-].

    In still air; above 1 where the drone cannot carry its weight and balance the torques.
    """
    each = jax.vmap(
        lambda forces: jnp.stack([jnp.sum(forces), *dynamics.torque(forces, parameters)])
    )
    offset = each(jnp.zeros((1, 4)))[0]
    wrench = jnp.concatenate(
        [jnp.reshape(parameters.mass * parameters.gravity, (1,)), -parameters.torque_bias]
    )
    forces = jnp.linalg.solve((each(jnp.eye(4)) - offset[None]).T, wrench - offset)
    full = parameters.mass * parameters.gravity / 4 * parameters.thrust_to_weight
    return forces / (full * parameters.rotor_thrust)


def balanced_command(parameters: Parameters) -> Float[Array, "4"]:
    """Returns the thrust commands u at which rotors carry the weight and balance the torques.

    Within [0, 1]; without torques and weak rotors each is `hover_command`.
    """
    excess_share = jnp.maximum(balanced_shares(parameters) - parameters.thrust_offset, 0.0)
    return jnp.clip(dynamics.speed_for(excess_share, parameters), 0.0, 1.0) ** 2
