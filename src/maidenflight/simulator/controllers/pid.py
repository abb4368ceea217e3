"""The Crazyflie firmware's PID controllers: their rates, their gains and one update of them.

`firmware` runs them one after the other and tells how the two generations differ.
"""

from typing import NamedTuple, cast, get_args

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maidenflight.errors import InputError
from maidenflight.names import Firmware
from maidenflight.simulator.physics.vectors import each

Generation = Firmware

ATTITUDE_RATE = 500
"""Attitude and rate PIDs [Hz]."""
POSITION_RATE = 100
"""Position and velocity PIDs [Hz]."""


class Gains(NamedTuple):
    """Three PID controllers, one an axis."""

    proportional: np.ndarray
    integral: np.ndarray
    derivative: np.ndarray
    integral_limit: np.ndarray
    output_limit: np.ndarray
    period: float
    """Time between two updates [s]."""


class PIDMemory(NamedTuple):
    """Of three PID controllers."""

    integral: Float[Array, "3"]
    last: Float[Array, "3"]
    """The error (2021.10) or measurement (2026.08) before."""


def _gains(*rows: tuple[float, float, float], period: float) -> Gains:
    return Gains(*(np.array(row, np.float32) for row in rows), period=period)


# platform_defaults_cf2.h; rows are kp, ki, kd, limit of the integral, limit of the output.
_INT16 = 32767.0
POSITION_GAINS = _gains(
    (2, 2, 2), (0, 0, 0.5), (0, 0, 0), (5000, 5000, 5000), (1.1, 1.1, 1.1), period=1 / POSITION_RATE
)
"""Gains of the position PID."""
VELOCITY_GAINS = _gains(
    (25, 25, 25),
    (1, 1, 15),
    (0, 0, 0),
    (5000, 5000, 5000),
    (22, 22, 32.767),
    period=1 / POSITION_RATE,
)
"""Gains of the velocity PID."""
ATTITUDE_GAINS = _gains(
    (6, 6, 6),
    (3, 3, 1),
    (0, 0, 0.35),
    (20, 20, 360),
    (np.inf, np.inf, np.inf),
    period=1 / ATTITUDE_RATE,
)
"""Gains of the attitude PID."""
RATE_GAINS = _gains(
    (250, 250, 120),
    (500, 500, 16.7),
    (2.5, 2.5, 0),
    (33.3, 33.3, 166.7),
    (_INT16, _INT16, _INT16),
    period=1 / ATTITUDE_RATE,
)
"""Gains of the rate PID."""
YAW_GAINS = ATTITUDE_GAINS._replace(
    **{name: getattr(ATTITUDE_GAINS, name)[2] for name in Gains._fields if name != "period"}
)
"""Gains of the attitude PID's yaw alone."""


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
    heading: bool = False,
) -> tuple[PIDMemory, Float[Array, "3"]]:
    """Returns one update of three PID controllers, or of one.

    The output is K_p e + K_d de/dt + K_i (limited integral of e), limited.

    Args:
        memory: of the last update.
        desired: set-point.
        measured: its counterpart.
        gains: of the three.
        firmware: 2021.10 takes the derivative of the error, 2026.08 minus that of the measurement.
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

    error = wrapped(desired - measured)
    change = wrapped(memory.last - measured) if firmware == "2026.08" else error - memory.last
    summed, limit = memory.integral + error * gains.period, gains.integral_limit
    integral = each(jnp.clip, summed, -limit, limit)
    output = (
        error * gains.proportional
        + change / gains.period * gains.derivative
        + integral * gains.integral
    )
    last, most = measured if firmware == "2026.08" else error, gains.output_limit
    return PIDMemory(integral, last), each(jnp.clip, output, -most, most)


def with_third(vector: Float[Array, "3"], value: Float[Array, ""]) -> Float[Array, "3"]:
    """Returns the vector with another third component."""
    return jnp.stack([vector[0], vector[1], value])
