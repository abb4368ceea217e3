"""The firmware's loops of body rates alone, as policies of attitude rate command them.

Source: as `firmware`, controller_pid.c and attitude_pid_controller.c.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import tree
from jaxtyping import Array, Bool, Float

from maidenflight.parameters.frames import CRAZYFLIE, Mixer
from maidenflight.parameters.platforms import Platform
from maidenflight.simulator.controllers.firmware import USUAL, choose, cut, mix
from maidenflight.simulator.controllers.pid import (
    ATTITUDE_RATE,
    Generation,
    PIDMemory,
    pid,
    wrap,
)
from maidenflight.simulator.physics.vectors import each, like


def balancing(
    motors: Float[Array, "4"], mixer: Mixer | None = None, platform: Platform = USUAL
) -> PIDMemory:
    """Returns the rate PIDs that have hovered a drone.

    Their integrals hold the torque that it takes.

    As far as their limits; the attitude PIDs hold the rest.

    Args:
        motors: commands that hover it [counts].
        mixer: see `mix`.
        platform: whose gains the PIDs have.
    """
    turning = np.linalg.pinv(np.array(CRAZYFLIE if mixer is None else mixer))[1:]
    rows = platform.rate.integral, platform.rate.integral_limit
    gains, limit = (np.array(row, np.float32) for row in rows)
    integral = (turning @ motors) / gains
    return PIDMemory(jnp.clip(integral, -limit, limit), jnp.zeros(3))


class RateMemory(NamedTuple):
    """Of the loops that run where body rates are commanded."""

    yaw: PIDMemory
    rate: PIDMemory
    heading: Float[Array, ""]
    """Desired yaw [deg]."""
    first: Bool[Array, ""]
    """Whether the first tick is still to come."""


def rates_switched_on() -> RateMemory:
    """Returns the memory before the first `rate_tick`."""
    zero, zeros = np.float32(0.0), np.zeros(3, np.float32)
    return RateMemory(PIDMemory(zero, zero), PIDMemory(zeros, zeros), zero, np.bool_(True))  # type: ignore[arg-type]


def rate_tick(
    memory: RateMemory,
    thrust: Float[Array, ""],
    setpoint: Float[Array, "3"],
    yaw: Float[Array, ""],
    body_rates: Float[Array, "3"],
    firmware: Generation,
    mixer: Mixer | None = None,
    platform: Platform = USUAL,
) -> tuple[RateMemory, Float[Array, "4"]]:
    """Runs `tick` for body rate set-points only, without the loops that do not matter then.

    Args:
        memory: of the tick before.
        thrust: commanded [counts].
        setpoint: commanded body rates [deg/s]; the third moves the desired yaw.
        yaw: measured [deg].
        body_rates: measured [deg/s]; `vectors.Entries`, where the memory's vectors are.
        firmware: generation; static.
        mixer: see `mix`.
        platform: whose gains the PIDs have; static.

    Returns:
        Memory, and the four motors' commands [counts]; vectors as `body_rates` is one.
    """
    none = tree.map(jnp.zeros_like, body_rates)
    last = yaw if firmware == "2026.08" else jnp.zeros_like(yaw)
    stopped = RateMemory(
        PIDMemory(jnp.zeros_like(yaw), last),
        PIDMemory(none, none),
        yaw,
        jnp.zeros_like(memory.first),
    )
    memory = choose(memory.first, stopped, memory)
    heading = wrap(memory.heading + setpoint[2] * (1 / ATTITUDE_RATE))
    turning, turn = pid(memory.yaw, heading, yaw, platform.attitude, firmware, heading=True)
    desired = like(body_rates, [setpoint[0], setpoint[1], turn])
    rate, motors = follow_rates(memory.rate, thrust, desired, body_rates, firmware, mixer, platform)
    after = RateMemory(turning, rate, heading, stopped.first)
    return choose(thrust == 0.0, stopped, after), motors


def follow_rates(
    memory: PIDMemory,
    thrust: Float[Array, ""],
    setpoint: Float[Array, "3"],
    body_rates: Float[Array, "3"],
    firmware: Generation,
    mixer: Mixer | None = None,
    platform: Platform = USUAL,
) -> tuple[PIDMemory, Float[Array, "4"]]:
    """Runs the rate PIDs alone; no thrust stops the motors and resets them.

    Args:
        memory: of the rate PIDs.
        thrust: commanded [counts].
        setpoint: body rates [deg/s].
        body_rates: measured [deg/s].
        firmware: generation; static.
        mixer: see `mix`.
        platform: whose gains the PIDs have; static.

    Returns:
        Memory, and the four motors' commands [counts].

    Source: controller_pid.c, controllerPid.
    """
    after, torque = pid(memory, setpoint, body_rates, platform.rate, firmware)
    off = thrust == 0.0
    memory = tree.map(lambda value: jnp.where(off, 0.0, value), after)
    torque = each(lambda about: jnp.where(off, 0.0, cut(about)), torque)
    return memory, mix(thrust, torque, firmware, mixer)
