"""Control structures: what turns an action, or a set-point, into four thrust commands.

A `Controller` is a NamedTuple of pure functions, so a cascade is a function that returns one.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from maidenflight.simulator import rotations
from maidenflight.simulator.sensors import Measurement


class Controller(NamedTuple):
    """A control structure."""

    name: str
    init: Callable[[], Any]
    """Memory at switch-on."""
    command: Callable[[Any, Float[Array, "4"], Measurement, Float[Array, "3"]], tuple[Any, Float[Array, "4"]]]
    """(memory, action, measurement, setpoint [m]) to (memory, thrust commands u in [0, 1])."""
    rate: int
    """Commands a second [Hz]."""


@cache
def pwm() -> Controller:
    """The policy's four actions are the motors' thrust commands: u = (clip(a, -1, 1) + 1) / 2, at 100 Hz.

    Source: Gronauer et al. 2022, sec. Motor Model and sec. Control Structures.
    """

    def command(
        memory: None, action: Float[Array, "4"], measurement: Measurement, setpoint: Float[Array, "3"]
    ) -> tuple[None, Float[Array, "4"]]:
        return memory, (jnp.clip(action, -1.0, 1.0) + 1.0) / 2.0

    return Controller("pwm", lambda: None, command, rate=100)


class PID(NamedTuple):
    """Gains of three PID controllers, one an axis, in the firmware's units (degrees, PWM counts)."""

    proportional: tuple[float, float, float]
    integral: tuple[float, float, float]
    derivative: tuple[float, float, float]
    integral_limit: tuple[float, float, float]


class PIDMemory(NamedTuple):
    """Integral and previous error of three PID controllers."""

    integral: Float[Array, "3"]
    error: Float[Array, "3"]


_FRESH = PIDMemory(np.zeros(3, np.float32), np.zeros(3, np.float32))  # type: ignore[arg-type]

# Crazyflie firmware, platform_defaults_cf2.h; the same in 2021.10 and 2026.08.
_POSITION = PID((2.0, 2.0, 2.0), (0.0, 0.0, 0.5), (0.0, 0.0, 0.0), (5000.0, 5000.0, 5000.0))
_VELOCITY = PID((25.0, 25.0, 25.0), (1.0, 1.0, 15.0), (0.0, 0.0, 0.0), (5000.0, 5000.0, 5000.0))
_ATTITUDE = PID((6.0, 6.0, 6.0), (3.0, 3.0, 1.0), (0.0, 0.0, 0.35), (20.0, 20.0, 360.0))
_RATE = PID((250.0, 250.0, 120.0), (500.0, 500.0, 16.7), (2.5, 2.5, 0.0), (33.3, 33.3, 166.7))
_FASTEST = 1.1
"""Limit of the position controller's output [m/s]."""
_STEEPEST = 20.0
"""Limit of roll and pitch [deg]."""
_FULL = 60000.0
"""PWM counts of u = 1."""


def pid(memory: PIDMemory, error: Float[Array, "3"], gains: PID, dt: float) -> tuple[PIDMemory, Float[Array, "3"]]:
    """One step of three PID controllers with limited integrals and the derivative of the error.

    Source: Crazyflie firmware 2021.10, src/modules/src/pid.c, pidUpdate.
    """
    limit = jnp.array(gains.integral_limit)
    total = jnp.clip(memory.integral + error * dt, -limit, limit)
    slope = (error - memory.error) / dt
    output = jnp.array(gains.proportional) * error + jnp.array(gains.integral) * total + jnp.array(gains.derivative) * slope
    return PIDMemory(total, error), output


class CascadeMemory(NamedTuple):
    """What the position PID remembers: four PIDs, the outer loops' last output and a counter of inner steps."""

    position: PIDMemory
    velocity: PIDMemory
    attitude: PIDMemory
    rate: PIDMemory
    target: Float[Array, "3"]
    thrust: Float[Array, ""]
    tick: Int[Array, ""]


@cache
def position_pid() -> Controller:
    """The firmware's cascaded PID, which holds a set-point: position and velocity at 100 Hz, attitude and rate at 500 Hz.

    The action is added to the four commands, so that flights can be excited for identification; zero is the plain PID. Yaw is
    held at zero.

    Source: Crazyflie firmware 2021.10, position_controller_pid.c, attitude_pid_controller.c, power_distribution_stock.c, with
    gains of platform_defaults_cf2.h; the mixer clips at u = 1.
    """
    inner, every = 500, 5

    def init() -> CascadeMemory:
        zero = np.zeros(3, np.float32)
        return CascadeMemory(_FRESH, _FRESH, _FRESH, _FRESH, zero, np.float32(36000.0), np.int32(0))  # type: ignore[arg-type]

    def outer(memory: CascadeMemory, measurement: Measurement, setpoint: Float[Array, "3"], yaw: Float[Array, ""]) -> CascadeMemory:
        dt = every / inner
        position, wanted = pid(memory.position, setpoint - measurement.position, _POSITION, dt)
        velocity, out = pid(memory.velocity, jnp.clip(wanted, -_FASTEST, _FASTEST) - measurement.velocity, _VELOCITY, dt)
        forward = out[0] * jnp.cos(yaw) + out[1] * jnp.sin(yaw)
        left = out[1] * jnp.cos(yaw) - out[0] * jnp.sin(yaw)
        # Nose down (positive pitch) flies forward, right side down (positive roll) flies right.
        target = jnp.clip(jnp.stack([-left, forward, jnp.zeros_like(yaw)]), -_STEEPEST, _STEEPEST)
        thrust = jnp.clip(36000.0 + 1000.0 * out[2], 20000.0, 65535.0)
        return memory._replace(position=position, velocity=velocity, target=target, thrust=thrust)

    def command(
        memory: CascadeMemory, action: Float[Array, "4"], measurement: Measurement, setpoint: Float[Array, "3"]
    ) -> tuple[CascadeMemory, Float[Array, "4"]]:
        attitude = rotations.to_attitude(measurement.quaternion)
        updated = outer(memory, measurement, setpoint, attitude[2])
        due = memory.tick % every == 0
        memory = CascadeMemory(*(_chosen(due, new, old) for new, old in zip(updated, memory, strict=True)))
        error = memory.target - jnp.degrees(attitude)
        error = error.at[2].set((error[2] + 180.0) % 360.0 - 180.0)
        attitude_memory, wanted = pid(memory.attitude, error, _ATTITUDE, 1 / inner)
        rate_memory, out = pid(memory.rate, wanted - jnp.degrees(measurement.body_rates), _RATE, 1 / inner)
        memory = memory._replace(attitude=attitude_memory, rate=rate_memory, tick=memory.tick + 1)
        return memory, jnp.clip(mix(memory.thrust, out) / _FULL + action, 0.0, 1.0)

    return Controller("position_pid", init, command, rate=inner)


def mix(thrust: Float[Array, ""], torque: Float[Array, "3"]) -> Float[Array, "4"]:
    """Motor commands from thrust and roll, pitch, yaw, all in PWM counts.

    Source: Crazyflie firmware 2021.10, power_distribution_stock.c, X formation, with pitch in our sign (nose down positive).
    """
    roll, pitch, yaw = torque[0] / 2, torque[1] / 2, torque[2]
    return jnp.stack([thrust - roll - pitch - yaw, thrust - roll + pitch + yaw, thrust + roll + pitch - yaw, thrust + roll - pitch + yaw])


def _chosen(condition: Array, new: Any, old: Any) -> Any:
    if isinstance(new, PIDMemory):
        return PIDMemory(*(jnp.where(condition, a, b) for a, b in zip(new, old, strict=True)))
    return jnp.where(condition, new, old)
