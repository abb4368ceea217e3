"""Defines a scenario: task, duration, drones, and the states in which flights begin."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maidenflight.parameters import Parameters
from maidenflight.simulator.environment import Environment, EnvState
from maidenflight.simulator.physics import actuators, dynamics, rotations
from maidenflight.simulator.physics.balance import balanced_command
from maidenflight.simulator.tasks.tasks import Task

Change = Callable[[Parameters, Float[Array, ""]], Parameters]
"""(drone, time since the flight began [s]) to the drone as it is then; a pytree."""


@dataclass(frozen=True, eq=False)
class Scenario:
    """What pilots are to fly."""

    task: Task
    """Whose reference is followed."""
    duration: float
    """Of the longest flight [s]."""
    changing: bool = False
    """Whether virtual drones become what their `later` says; else such are refused."""
    drones: Sequence[Parameters] | None = None
    """Virtual drones of the flights, in their order; none: all are the reality's."""
    during: Change | None = None
    """What else changes of a virtual drone in the course of a flight."""


def near_reference(key: Array) -> tuple[Float[Array, "3"], Array, Array]:
    """Draws a start within 2 cm of the reference's, along each axis.

    Returns:
        Its offset [m], and keys of the first measurement and of the rest.
    """
    place_key, begin_key, key = jax.random.split(key, 3)
    offset = 0.02 * jax.random.uniform(place_key, (3,), minval=-1.0, maxval=1.0)
    return offset, begin_key, key


class Start(NamedTuple):
    """Spread of the state in which a policy takes over, about hover at the reference's start.

    A multivariate t distribution of four degrees of freedom: some drones are still on their way
    when they are handed over.
    """

    position: Float[Array, "3"]
    """Scale [m]."""
    velocity: Float[Array, "3"]
    """[m/s]."""
    attitude: Float[Array, "3"]
    """[rad]."""
    body_rates: Float[Array, "3"]
    """[rad/s]."""
    homeward: Float[Array, ""]
    """Minus the correlation of horizontal position and velocity: the PID that hands over moves
    towards the start."""
    above: Float[Array, ""]
    """Mean height above the start [m]."""

    def draw(self, env: Environment, drone: Parameters, key: Array) -> dynamics.State:
        """Draws a first state."""
        normal = jax.random.normal(key, (16,))
        # A chi-square of four degrees is the sum of four squares.
        farther = jnp.sqrt(4.0 / jnp.sum(normal[12:] ** 2))
        normal = farther * normal[:12].reshape(4, 3)
        above = self.above * jnp.array([0.0, 0.0, 1.0])
        hover = dynamics.at_hover(env.task.reference(jnp.zeros(())), drone)
        side = self.homeward * jnp.array([1.0, 1.0, 0.0])
        return hover._replace(
            position=hover.position + above + self.position * normal[0],
            velocity=self.velocity * (jnp.sqrt(1.0 - side * side) * normal[1] - side * normal[0]),
            quaternion=rotations.from_attitude(self.attitude * normal[2]),
            body_rates=self.body_rates * normal[3],
        )


def start_of(*numbers: tuple[float, ...] | float) -> Start:
    """Returns a spread of first states, its fields in their order."""
    return Start(*(np.array(number, np.float32) for number in numbers))  # type: ignore[arg-type]


HOVER = start_of(*((0.0, 0.0, 0.0),) * 4, 0.0, 0.0)
"""At rest at the reference's start."""


def after_hover(env: Environment, env_state: EnvState, drone: Parameters) -> EnvState:
    """Returns the beginning of a flight before which the firmware has hovered the drone.

    Its rotors balance the constant torques, and so do the integrals of PIDs that go on: in the
    published flights the yaw command of the first rows is that of the rest (paper/notes/
    flight-times.md).
    """
    hovers = balanced_command(drone)
    command = actuators.rotor_speed_command(hovers)
    taking_over = env.controller.taking_over
    return env_state._replace(
        state=env_state.state._replace(rotor_speed=command),
        delay_line=jnp.broadcast_to(command, env_state.delay_line.shape),
        controller=env_state.controller
        if taking_over is None
        else taking_over(hovers, env_state.measurement),
    )
