"""The Mellinger controller as the Crazyflie's firmware has it: trajectory in, motor commands out.

Unlike the cascaded PID it takes a full state: position, velocity, acceleration and body rates of
the reference. All of it runs at 500 Hz. Its gains are in the firmware's units, newtons for the
desired force and counts for the torques. Of the drone it knows the platform's mass and 132,000
counts a newton, which stay what they are whatever flies.

Source: Mellinger and Kumar 2011, "Minimum snap trajectory generation and control for quadrotors",
sec. III; Crazyflie firmware 2021.10, src/modules/src/controller_mellinger.c. As in the firmware the
error of rotation has no factor 1/2, and the rates of roll and pitch have a derivative, which the
paper does not have. Unlike the PIDs it was not compared with the firmware's own traces. Its gains
are those that crazyflow 0.4.0 lists too, except 0.4 for 0.5 N s/m of the vertical velocity, which
changes the fastest circle within 10 cm by 1 %.
"""

from dataclasses import replace
from functools import cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from maidenflight.parameters.frames import Mixer
from maidenflight.parameters.platforms import Platform
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.controllers.firmware import USUAL, cut, mix
from maidenflight.simulator.controllers.pid import ATTITUDE_RATE, Generation, generation_of
from maidenflight.simulator.controllers.position_pid import EXCITATION
from maidenflight.simulator.physics import rotations
from maidenflight.simulator.physics.battery import COUNTS
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.tasks.trajectories import Trajectory

Vector = Float[Array, "3"]

COUNTS_PER_NEWTON = 132000.0
"""massThrust."""
GRAVITY = 9.81
POSITION: tuple[np.ndarray, ...] = tuple(
    np.array(row, np.float32) for row in ((0.4, 0.4, 1.25), (0.2, 0.2, 0.4), (0.05, 0.05, 0.05))
)
"""Proportional [N/m], derivative [N s/m] and integral [N/(m s)] gains of x, y, z."""
POSITION_LIMIT = np.array([2.0, 2.0, 0.4], np.float32)
"""Of the integrated error [m s]."""
ATTITUDE: tuple[np.ndarray, ...] = tuple(
    np.array(row, np.float32)
    for row in ((7e4, 7e4, 6e4), (2e4, 2e4, 1.2e4), (0.0, 0.0, 500.0), (200.0, 200.0, 0.0))
)
"""Gains of the error of rotation [counts], of the rates' [counts s], of the integral [counts/s] and
of the rates' derivative [counts s^2] of roll, pitch, yaw."""
ATTITUDE_LIMIT = np.array([1.0, 1.0, 1500.0], np.float32)
"""Of the integrated error of rotation [s]."""
TORQUE_LIMIT = 32000.0
"""[counts]."""
PERIOD = 1.0 / ATTITUDE_RATE


class FullState(NamedTuple):
    """Set-point; yaw is zero."""

    position: Vector
    velocity: Vector
    acceleration: Vector
    body_rates: Vector
    """In the body's axes [rad/s]."""


class Memory(NamedTuple):
    """What the controller remembers."""

    position: Vector
    """Integrated error [m s]."""
    rotation: Vector
    """Integrated error [s]."""
    rates: Vector
    """Error of the body rates at the last tick [rad/s]."""
    step: Int[Array, ""]
    """Ticks so far."""


def switched_on() -> Memory:
    """Returns the memory before the first tick."""
    zero = np.zeros(3, np.float32)
    return Memory(zero, zero, zero, np.int32(0))  # type: ignore[arg-type]


def full_state(reference: Trajectory, time: Float[Array, ""], position: Vector) -> FullState:
    """Returns the full state of a reference at a time; yaw is zero.

    Args:
        reference: of time [s] to position [m].
        time: [s].
        position: of the reference [m].

    Source: Mellinger and Kumar 2011, sec. III (body rates by differential flatness).
    """

    def along(function: Trajectory) -> Trajectory:
        return lambda time: jax.jvp(function, (time,), (jnp.ones_like(time),))[1]

    velocity = along(reference)
    acceleration = along(velocity)
    forces, jerk = acceleration(time), along(acceleration)(time)
    x, y, z = desired_axes(forces + jnp.array([0.0, 0.0, GRAVITY]))
    thrust = jnp.dot(forces, z) + GRAVITY * z[2]
    turning = (jerk - jnp.dot(z, jerk) * z) / thrust
    rates = jnp.stack([-jnp.dot(turning, y), jnp.dot(turning, x), jnp.zeros(())])
    return FullState(position, velocity(time), forces, rates)


def desired_axes(force: Vector) -> tuple[Vector, Vector, Vector]:
    """Returns the body's axes whose z axis is along a force, at a yaw of zero."""
    z = force / jnp.linalg.norm(force)
    y = jnp.cross(z, jnp.array([1.0, 0.0, 0.0]))
    y = y / jnp.linalg.norm(y)
    return jnp.cross(y, z), y, z


def tick(
    memory: Memory,
    target: FullState,
    state: Measurement,
    firmware: Generation = "2021.10",
    mixer: Mixer | None = None,
    platform: Platform = USUAL,
) -> tuple[Memory, Float[Array, "4"]]:
    """Returns one tick of 2 ms.

    Args:
        memory: of the tick before.
        target: the set-point.
        state: what is measured.
        firmware: generation of the mixer; static.
        mixer: of another frame than the firmware's X; static.
        platform: whose mass it takes for the drone's; static.

    Returns:
        Memory, and the four motors' commands [counts], not yet compensated for the battery.
    """
    error = target.position - state.position
    total = jnp.clip(memory.position + error * PERIOD, -POSITION_LIMIT, POSITION_LIMIT)
    lift = target.acceleration + jnp.array([0.0, 0.0, GRAVITY])
    p, d, i = POSITION
    force = platform.mass * lift + p * error + d * (target.velocity - state.velocity) + i * total
    x, y, z = (jnp.stack(axis) for axis in rotations.axes(state.quaternion))
    thrust = COUNTS_PER_NEWTON * jnp.dot(force, z)
    to_x, to_y, to_z = desired_axes(force)
    turned = jnp.stack(
        [
            jnp.dot(to_z, y) - jnp.dot(to_y, z),
            jnp.dot(to_x, z) - jnp.dot(to_z, x),
            jnp.dot(to_y, x) - jnp.dot(to_x, y),
        ]
    )
    rates = target.body_rates - state.body_rates
    change = jnp.where(memory.step > 0, (rates - memory.rates) / PERIOD, 0.0)
    rotation = jnp.clip(memory.rotation - turned * PERIOD, -ATTITUDE_LIMIT, ATTITUDE_LIMIT)
    p, d, i, dd = ATTITUDE
    torque = -p * turned + d * rates + i * rotation + dd * change
    torque = cut(jnp.clip(torque, -TORQUE_LIMIT, TORQUE_LIMIT))
    # Without thrust the motors stand still and the integrals begin anew.
    flies = thrust > 0.0
    motors = jnp.where(flies, mix(thrust, torque, firmware, mixer), 0.0)
    total, rotation = (jnp.where(flies, value, 0.0) for value in (total, rotation))
    return Memory(total, rotation, rates, memory.step + 1), motors


def mellinger(
    reference: Trajectory | None = None,
    firmware: str = "2021.10",
    full_scale_counts: float = COUNTS,
) -> Controller:
    """Returns a controller that holds a set-point, or follows a reference of which it knows all.

    As with `position_pid` the action is added to the four commands; zero is the plain
    controller.

    Args:
        reference: of the time since the flight began [s] to position [m], as a task's, for
            velocity, acceleration and body rates; by default they are zero, as in a set-point of
            position alone.
        firmware: generation of the mixer, `"2021.10"` or `"2026.08"`.
        full_scale_counts: see `ControlInterface`.

    Raises:
        InputError: there is no such firmware.
    """
    return _mellinger(reference, generation_of(firmware), full_scale_counts)


@cache
def _mellinger(
    reference: Trajectory | None,
    firmware: Generation,
    full_scale_counts: float,
    mixer: Mixer | None = None,
    platform: Platform = USUAL,
) -> Controller:
    interface = replace(EXCITATION, name="mellinger", full_scale_counts=full_scale_counts)

    def command(
        memory: Memory, action: Float[Array, "4"], measurement: Measurement, setpoint: Vector
    ) -> tuple[Memory, Float[Array, "4"]]:
        still = jnp.zeros(3)
        target = FullState(setpoint, still, still, still)
        if reference is not None:
            time = jnp.asarray(memory.step, jnp.float32) * PERIOD
            target = full_state(reference, time, setpoint)
        memory, motors = tick(memory, target, measurement, firmware, mixer, platform)
        return memory, jnp.maximum(motors / full_scale_counts + action, 0.0)

    fitted = partial(_mellinger, reference, firmware, full_scale_counts)
    return Controller(interface, switched_on, command, ATTITUDE_RATE, fitted)
