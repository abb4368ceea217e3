"""Motion over one command period: of the rotors alone, of the drone, and near the ground.

A physics step ends where a command arrives; see `latency`.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from maidenflight.parameters import Parameters, replace
from maidenflight.simulator.physics import dynamics, latency, vectors
from maidenflight.simulator.physics.dynamics import Integrator, State
from maidenflight.simulator.physics.latency import DelayLine


def spin(
    speed: Float[Array, "4"],
    line: DelayLine,
    steps: int | Int[Array, ""],
    parameters: Parameters,
) -> Float[Array, "4"]:
    """Returns the rotor speeds after one command period, without the rest of the drone.

    Args:
        speed: of the rotors at the newest command.
        line: rotor speed commands.
        steps: physics steps in the period; as an argument of the program at least two.
        parameters: the drone.
    """

    def turn(number: Array, speed: Array) -> Array:
        command, time_step = latency.in_step(line, parameters, steps, number)
        motors = replace(parameters, time_step=time_step)
        return speed + time_step * dynamics.spin_up(speed, command, motors)

    return lax.fori_loop(0, steps, turn, speed)


def drive(
    integrator: Integrator,
    state: State,
    line: DelayLine,
    steps: int,
    parameters: Parameters,
    floor: float | None = None,
) -> State:
    """Integrates the physics over one command period.

    Args:
        integrator: `dynamics.midpoint`, `dynamics.euler` or `dynamics.rk4`.
        state: the drone at the newest command.
        line: rotor speed commands.
        steps: physics steps in the period.
        parameters: the drone.
        floor: height at which the drone stands [m], if there is a floor; the ground is at height 0.
    """
    command, length = latency.in_step(line, parameters, steps, jnp.arange(steps))

    def advance(state: State, now: tuple[Array, Array]) -> tuple[State, None]:
        command, time_step = now
        here = replace(parameters, time_step=time_step)
        if floor is None:
            return integrator(state, command, here), None
        after = integrator(state, command, near_ground(here, state.position[2]))
        return floor_reaction(after, floor), None

    return lax.scan(advance, state, (command, length), length=steps)[0]


def drive_entries(
    integrator: Integrator,
    state: State,
    line: DelayLine,
    steps: int | Int[Array, ""],
    parameters: Parameters,
) -> State:
    """Integrates the physics over one command period, of a state of `Entries` and without a floor.

    Faster than `drive` for many states of one drone, and one program serves any number of steps.
    Each step finds its command anew: those of all states and steps, with derivatives, would be
    larger than all the rest.

    Args:
        integrator: as of `drive`.
        state: the drone at the newest command, as `vectors.entries` gives it.
        line: as of `drive`; of `Entries` it is faster.
        steps: as of `spin`.
        parameters: the drone.
    """
    drone = vectors.entries(parameters)

    def advance(number: Array, state: State) -> State:
        command, time_step = latency.in_step(line, parameters, steps, number)
        here = replace(drone, time_step=time_step)
        return integrator(state, vectors.Entries(command), here)  # type: ignore[arg-type]

    return lax.fori_loop(0, steps, advance, state)


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
