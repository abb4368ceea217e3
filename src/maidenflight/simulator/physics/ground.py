"""What the ground does to a drone: it stands there, and its rotors lift more near it."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from maidenflight.parameters import Parameters, replace
from maidenflight.simulator.physics.dynamics import State


def floor_reaction(state: State, height: float) -> State:
    """Stops a drone on a floor that it would sink below, at once and without a bounce; ours.

    Args:
        state: the drone.
        height: of its centre when it stands [m].
    """
    sunk = state.position[2] < height
    return state._replace(
        position=state.position.at[2].max(height),
        velocity=jnp.where(sunk, 0.0, state.velocity),
        body_rates=jnp.where(sunk, 0.0, state.body_rates),
    )


MOST_GROUND_EFFECT = 4.0 / 15.0
"""Largest gain of thrust near the ground [-] (gym-pybullet-drones, which limits the height in its
formula to this end)."""


def near_ground(parameters: Parameters, height: Float[Array, ""]) -> Parameters:
    """Returns the drone near the ground, where the same rotor speed lifts more.

    F (1 + min(c_g / z^2, 4/15)).

    Args:
        parameters: uses `ground_effect` c_g [m2].
        height: of the rotors above the ground [m].

    Source: Shi et al. 2019 and Danjun et al. 2015, c_g = 11.37 (r / 4)^2, as in
    gym-pybullet-drones.
    """
    unlimited = parameters.ground_effect / jnp.maximum(height, 1e-3) ** 2
    gain = jnp.minimum(unlimited, MOST_GROUND_EFFECT)
    return replace(parameters, thrust_to_weight=parameters.thrust_to_weight * (1.0 + gain))
