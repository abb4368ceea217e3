"""The Crazyflie firmware's PID controllers: their rates and one update of them.

`firmware` runs them one after the other and tells how the two generations differ.
"""

from typing import NamedTuple, cast, get_args

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maidenflight.errors import InputError
from maidenflight.names import Firmware
from maidenflight.parameters.platforms import Gains
from maidenflight.simulator.physics.vectors import each

Generation = Firmware

ATTITUDE_RATE = 500
"""Attitude and rate PIDs [Hz]."""
POSITION_RATE = 100
"""Position and velocity PIDs [Hz]."""


class PIDMemory(NamedTuple):
    """Of three PID controllers."""

    integral: Float[Array, "3"]
    last: Float[Array, "3"]
    """The error (2021.10) or measurement (2026.08) before."""


def generation_of(firmware: str) -> Generation:
    """Returns the generation of that name.

    Raises:
        InputError: there is none.
    """
    if firmware not in get_args(Generation):
        raise InputError(
            f"firmware {firmware!r}: no such generation. Give one of "
            f"{', '.join(get_args(Generation))}."
        )
    return cast(Generation, firmware)


def wrap(angle: Float[Array, "..."]) -> Float[Array, "..."]:
    """Returns an angle within one and a half turns [deg] to +-180 deg. Source: num.c, capAngle."""
    return jnp.where(angle > 180.0, angle - 360.0, jnp.where(angle < -180.0, angle + 360.0, angle))


def pid(
    memory: PIDMemory,
    desired: Float[Array, "3"],
    measured: Float[Array, "3"],
    gains: Gains,
    firmware: Generation,
    rate: int = ATTITUDE_RATE,
    heading: bool = False,
) -> tuple[PIDMemory, Float[Array, "3"]]:
    """Returns one update of three PID controllers, or of one.

    The output is K_p e + K_d de/dt + K_i (limited integral of e), limited.

    Args:
        memory: of the last update.
        desired: set-point.
        measured: its counterpart.
        gains: of the three, the last of which is yaw's where there is one only.
        firmware: 2021.10 takes the derivative of the error, 2026.08 minus that of the measurement.
        rate: updates a second [Hz].
        heading: whether the third axis, or the only one, is an angle that wraps [deg].

    Source: pid.c, pidUpdate.
    """

    def wrapped(difference: Float[Array, "3"]) -> Float[Array, "3"]:
        if not heading:
            return difference
        return (
            wrap(difference)
            if jnp.ndim(difference) == 0
            else with_third(difference, wrap(difference[2]))
        )

    alone = heading and jnp.ndim(desired) == 0
    kp, ki, kd, limit, most = (np.array(row[2] if alone else row, np.float32) for row in gains)
    error, period = wrapped(desired - measured), 1 / rate
    change = wrapped(memory.last - measured) if firmware == "2026.08" else error - memory.last
    integral = each(jnp.clip, memory.integral + error * period, -limit, limit)
    output = error * kp + change / period * kd + integral * ki
    last = measured if firmware == "2026.08" else error
    return PIDMemory(integral, last), each(jnp.clip, output, -most, most)


def with_third(vector: Float[Array, "3"], value: Float[Array, ""]) -> Float[Array, "3"]:
    """Returns the vector with another third component."""
    return jnp.stack([vector[0], vector[1], value])
