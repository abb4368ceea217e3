"""Torques and forces that no command explains: processes as slow and as large as flights show."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maidenflight.parameters import Parameters
from maidenflight.simulator.physics import rotations
from maidenflight.simulator.physics.dynamics import State
from maidenflight.simulator.physics.vectors import like

SIZE = 6
"""Numbers of a disturbance: a torque about body x, y, z [N m] and a force along them [N]."""


def is_disturbed(parameters: Parameters) -> bool:
    """Tests whether any of that acts on a drone, or on one of several."""
    sizes = parameters.disturbance_torque, parameters.disturbance_force
    return any(bool(np.any(np.asarray(size) > 0)) for size in sizes)


def draw_disturbance(
    before: Float[Array, "D"],
    elapsed: Float[Array, ""] | float,
    parameters: Parameters,
    normal: Float[Array, "D"],
) -> Float[Array, "D"]:
    """Draws a disturbance after some time, of Gauss-Markov processes exact at any time step.

    Args:
        before: the disturbance before; an empty one stays so.
        elapsed: time between the two [s]; infinite for one that does not depend on it.
        parameters: uses `disturbance_torque`, `disturbance_torque_time` and those of force.
        normal: draws from the standard normal distribution.

    Source: Uhlenbeck and Ornstein 1930, On the theory of the Brownian motion; Gillespie 1996,
    Exact numerical simulation of the Ornstein-Uhlenbeck process.
    """
    if before.size == 0:
        return before
    drone = parameters
    size = jnp.concatenate([drone.disturbance_torque, drone.disturbance_force])
    times = jnp.stack([drone.disturbance_torque_time, drone.disturbance_force_time])
    age = elapsed / jnp.repeat(times, 3)
    return jnp.exp(-age) * before + size * jnp.sqrt(-jnp.expm1(-2 * age)) * normal


def kick(
    state: State,
    disturbance: Float[Array, "D"],
    elapsed: Float[Array, ""],
    parameters: Parameters,
) -> State:
    """Returns a state after what a disturbance alone does in some time.

    Half of a period before all else and half after is of second order in the period.

    Args:
        state: the drone.
        disturbance: of `draw_disturbance`; an empty one does nothing.
        elapsed: for which it acts [s].
        parameters: uses `mass` and `inertia`.

    Source: Strang 1968, On the construction and comparison of difference schemes.
    """
    if disturbance.size == 0:
        return state
    x, y, z = rotations.axes(state.quaternion)
    along_x, along_y, along_z = disturbance[3:] * (elapsed / parameters.mass)
    pushed = [x[i] * along_x + y[i] * along_y + z[i] * along_z for i in range(3)]
    turned = disturbance[:3] * (elapsed / parameters.inertia)
    return state._replace(
        velocity=state.velocity + like(state.velocity, pushed),
        body_rates=state.body_rates + turned,
    )
