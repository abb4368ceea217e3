"""From thrust command to rotor speed command: actuator noise, optional battery, square root."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from maidenflight.parameters import Parameters
from maidenflight.simulator.physics import battery
from maidenflight.simulator.physics.battery import Supply
from maidenflight.simulator.physics.vectors import each


class Actuators(NamedTuple):
    """State of the actuators from one command to the next."""

    noise: Float[Array, "4"]
    """Ornstein-Uhlenbeck noise added to u [-]."""
    charge_drawn: Float[Array, ""]
    """Time at full ratio that the battery has delivered [s]."""
    ratio: Float[Array, "4"]
    """Motor ratio after battery compensation; the command where no battery is simulated."""
    voltage: Float[Array, ""]
    """Battery voltage [V]."""


def switched_on(command: Float[Array, ""], parameters: Parameters, supply: Supply) -> Actuators:
    """Actuators at a steady command, with a fresh battery and no noise yet."""
    steady = jnp.broadcast_to(command, (4,))
    fresh = jnp.zeros(())
    ratio = battery.motor_ratio(steady, parameters.battery_voltage, supply)
    return Actuators(jnp.zeros(4), fresh, ratio, battery.voltage(fresh, ratio, parameters))


def ornstein_uhlenbeck(
    noise: Float[Array, "4"],
    elapsed: Float[Array, ""],
    parameters: Parameters,
    normal: Float[Array, "4"],
) -> Float[Array, "4"]:
    """Draws the next actuator noise, an Ornstein-Uhlenbeck process, exact at any time step.

    Source: the process of Gronauer et al. 2022, sec. Simulation Environment; Molchanov et al. 2019.
    """
    age = parameters.actuator_noise_rate * elapsed
    return (
        jnp.exp(-age) * noise + parameters.actuator_noise * jnp.sqrt(-jnp.expm1(-2 * age)) * normal
    )


def rotor_speed_command(command: Float[Array, "4"]) -> Float[Array, "4"]:
    """Returns sqrt(u), with a zero instead of an infinite gradient at u = 0.

    Source: Gronauer et al. 2022, eq:motor-dynamics.
    """

    def rotor_command(command: Array) -> Array:
        is_off = command <= 0
        return jnp.where(is_off, 0.0, jnp.sqrt(jnp.where(is_off, 1.0, command)))

    return each(rotor_command, command)


def actuate(
    actuators: Actuators,
    command: Float[Array, "4"],
    period: Float[Array, ""],
    parameters: Parameters,
    normal: Float[Array, "4"],
    supply: Supply,
) -> tuple[Actuators, Float[Array, "4"]]:
    """Turns a thrust command into the rotor speed command that enters the delay line.

    Args:
        actuators: state before.
        command: u, from 0; a firmware's PID may ask for more than 1.
        period: time for which the command holds [s].
        parameters: uses the noise and `battery` fields.
        normal: draws from the standard normal distribution.
        supply: what becomes of the command before the motors.

    Returns:
        New state and sqrt(u) of the noisy command, within what the supply allows.
    """
    noise = ornstein_uhlenbeck(actuators.noise, period, parameters, normal)
    ratio = battery.motor_ratio(command, actuators.voltage, supply)
    actuators, most = actuators._replace(noise=noise, ratio=ratio), supply.most
    if supply.battery:
        volts = battery.voltage(actuators.charge_drawn, ratio, parameters)
        drawn = actuators.charge_drawn + period * jnp.mean(ratio)
        actuators = actuators._replace(charge_drawn=drawn, voltage=volts)
        # The thrust follows the voltage at the motor now, which sags after the ratio was chosen.
        ratio, most = battery.thrust_command(ratio, volts, supply), None
    return actuators, rotor_speed_command(jnp.clip(ratio + noise, 0.0, most))
