"""The Crazyflie firmware's cascaded PID: position, velocity, attitude, rate, mixer.

`"2021.10"` flew the paper's flights, `"2026.08"` is today's. Gains are the platform's
in both, behaviour is not the same:

| | 2021.10 | 2026.08 |
|---|---|---|
| derivative | of the error | of the measurement, yaw wrapped |
| position and velocity PIDs | world axes, output turned by yaw | axes turned by yaw |
| velocity set-point of the other frame | body turned to world | world turned to body |
| rate mode | attitude PID of the axis is reset | attitude PID runs on |
| another mode | nothing | all PIDs start anew, from the present tilt |
| thrust above 65535 | passes | clipped |
| a motor above 65535 | clipped | passes; capped after battery compensation |
| a disabled yaw | counts as absolute | the desired yaw stays |

Units are the firmware's: m, deg, deg/s and PWM counts in float32, computed in the firmware's order.
Signs are ours: pitch and pitch rate are positive nose down, which is the firmware's gyro and minus
its attitude. A count is cut off as an integer is, yet a gradient passes. Generations and mixers are
static.

Source: Crazyflie firmware 5ed999b6f953 (2021-10-29) and 2a18fc299d7b (2026-08-21), src/modules/src:
pid.c, controller_pid.c, attitude_pid_controller.c, position_controller_pid.c,
power_distribution_*.c; described from reading, not copied.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax, tree
from jaxtyping import Array, Bool, Float, Int

from maidenflight.parameters.frames import Mixer
from maidenflight.parameters.platforms import CRAZYFLIE, PLATFORMS, Platform
from maidenflight.simulator.controllers.pid import (
    ATTITUDE_RATE,
    POSITION_RATE,
    Generation,
    PIDMemory,
    pid,
    with_third,
    wrap,
)
from maidenflight.simulator.physics.battery import MOST_COUNTS
from maidenflight.simulator.physics.vectors import each, like

DISABLE, ABSOLUTE, VELOCITY = 0, 1, 2
"""Modes of an axis (stabilizer_types.h)."""


class StateEstimate(NamedTuple):
    """Output of the firmware's estimator and gyro."""

    position: Float[Array, "3"]
    velocity: Float[Array, "3"]
    attitude: Float[Array, "3"]
    """Roll, pitch, yaw [deg]."""
    body_rates: Float[Array, "3"]
    """[deg/s]."""


class Setpoint(NamedTuple):
    """Set-point of the PIDs."""

    position: Float[Array, "3"]
    velocity: Float[Array, "3"]
    attitude: Float[Array, "3"]
    """[deg]."""
    body_rates: Float[Array, "3"]
    """[deg/s]."""
    thrust: Float[Array, ""]
    """[counts], of use where z is disabled."""
    mode: Int[Array, "6"]
    """Of x, y, z, roll, pitch, yaw. A disabled yaw counts as absolute in 2021.10 and keeps the
    desired yaw in 2026.08, which would take that of the set-point's quaternion where it has one;
    here it has none."""
    velocity_body: Bool[Array, ""]
    """Whether velocity is in axes turned by yaw."""


class Memory(NamedTuple):
    """Of the cascade."""

    position: PIDMemory | None
    """None where these loops never run."""
    velocity: PIDMemory | None
    attitude: PIDMemory
    rate: PIDMemory
    desired: Float[Array, "3"]
    """Roll, pitch, yaw [deg]."""
    thrust: Float[Array, ""]
    """[counts]."""
    torque: Float[Array, "3"]
    """Roll, pitch, yaw [counts], whole numbers."""
    mode: Int[Array, "6"] | Int[Array, ""]
    """The last set-point's, or 0 where modes never change; -1 before the first."""


_MAX_TILT_DEG = 20.0
"""Limit of roll and pitch that the velocity PID asks for [deg]."""
_THRUST_SCALE = 1000.0
"""[counts per unit of the velocity PID's output]."""
USUAL = PLATFORMS[CRAZYFLIE]
"""The platform of drones that name none."""
LEAST_THRUST_COUNTS = 20000.0
"""Thrust that the velocity PID asks for at least [counts]."""


def switched_on(fixed: bool = False) -> Memory:
    """Returns the memory before the first tick.

    Args:
        fixed: whether set-points are for attitude or rate loops and always of one mode, known
            before compiling.
    """
    zero = np.zeros(3, np.float32)
    pid = PIDMemory(zero, zero)  # type: ignore[arg-type]
    outer, mode = (None, np.int32(-1)) if fixed else (pid, np.full(6, -1, np.int32))
    return Memory(outer, outer, pid, pid, zero, np.float32(0.0), zero, mode)  # type: ignore[arg-type]


def reset(memory: Memory, state: StateEstimate, firmware: Generation) -> Memory:
    """Returns all PIDs anew; in 2026.08 the present attitude becomes the last one.

    What was last of position and velocity is of no consequence: they have no derivative.

    Source: pid.c, pidReset; attitude_pid_controller.c, attitudeControllerResetAllPID.
    """
    none = jnp.zeros(3)
    fresh = PIDMemory(none, none)
    attitude = PIDMemory(none, state.attitude if firmware == "2026.08" else none)
    outer = None if memory.position is None else fresh
    return memory._replace(position=outer, velocity=outer, attitude=attitude, rate=fresh)


def position_loops(
    memory: Memory,
    setpoint: Setpoint,
    state: StateEstimate,
    firmware: Generation,
    platform: Platform,
) -> Memory:
    """Returns the position and velocity PIDs: what attitude and thrust to ask for.

    Source: position_controller_pid.c, positionController.
    """
    assert memory.position is not None
    assert memory.velocity is not None
    yaw, velocity_setpoint = state.attitude[2], setpoint.velocity
    target, actual, speed = setpoint.position, state.position, state.velocity
    if firmware == "2026.08":
        velocity_setpoint = jnp.where(
            setpoint.velocity_body, velocity_setpoint, _turn(velocity_setpoint, yaw)
        )
        target, actual, speed = (_turn(target, yaw), _turn(actual, yaw), _turn(speed, yaw))
    else:
        velocity_setpoint = jnp.where(
            setpoint.velocity_body, _turn(velocity_setpoint, -yaw), velocity_setpoint
        )
    position, reference = pid(
        memory.position, target, actual, platform.position, firmware, POSITION_RATE
    )
    absolute = setpoint.mode[:3] == ABSOLUTE
    position = choose(absolute, position, memory.position)
    velocity, out = pid(
        memory.velocity,
        jnp.where(absolute, reference, velocity_setpoint),
        speed,
        platform.velocity,
        firmware,
        POSITION_RATE,
    )
    if firmware == "2021.10":
        out = _turn(out, yaw)
    # Nose down (positive pitch) flies forward, right side down (positive roll) flies right.
    desired = jnp.stack(
        [
            jnp.clip(-out[1], -_MAX_TILT_DEG, _MAX_TILT_DEG),
            jnp.clip(out[0], -_MAX_TILT_DEG, _MAX_TILT_DEG),
            memory.desired[2],
        ]
    )
    most = MOST_COUNTS if firmware == "2026.08" else None
    thrust = jnp.clip(out[2] * _THRUST_SCALE + platform.thrust_base, LEAST_THRUST_COUNTS, most)
    return memory._replace(position=position, velocity=velocity, desired=desired, thrust=thrust)


def attitude_loops(
    memory: Memory,
    setpoint: Setpoint,
    state: StateEstimate,
    firmware: Generation,
    platform: Platform,
) -> Memory:
    """Returns the attitude and rate PIDs: what torque to ask for.

    Source: controller_pid.c; attitude_pid_controller.c.
    """
    mode = setpoint.mode
    by_hand = (mode[0] == DISABLE) | (mode[1] == DISABLE)
    tilt = jnp.where(by_hand, setpoint.attitude[:2], memory.desired[:2])
    desired = jnp.concatenate([tilt, memory.desired[2:]])
    thrust = jnp.where(mode[2] == DISABLE, setpoint.thrust, memory.thrust)
    attitude, reference = pid(
        memory.attitude, desired, state.attitude, platform.attitude, firmware, heading=True
    )
    # Only roll and pitch: a yaw rate has moved the desired yaw instead.
    by_rate = (mode[3:] == VELOCITY) & np.array([True, True, False])
    reference = jnp.where(by_rate, setpoint.body_rates, reference)
    if firmware == "2021.10":
        attitude = choose(by_rate, PIDMemory(jnp.zeros(3), jnp.zeros(3)), attitude)
    rate, torque = pid(memory.rate, reference, state.body_rates, platform.rate, firmware)
    return memory._replace(
        attitude=attitude, rate=rate, desired=desired, thrust=thrust, torque=cut(torque)
    )


def mix(
    thrust: Float[Array, ""],
    torque: Float[Array, "3"],
    firmware: Generation,
    mixer: Mixer | None = None,
) -> Float[Array, "4"]:
    """Returns the motor commands [counts] from thrust and roll, pitch, yaw [counts].

    In 2026.08 they end nowhere; `battery.motor_ratio` and `actuators.actuate` cap them.

    Args:
        thrust: of a motor.
        torque: about the three axes.
        firmware: generation; static.
        mixer: of another frame than the firmware's X; static.

    Source: power_distribution_stock.c (2021.10), power_distribution_quadrotor.c (2026.08), X
    formation; stabilizer.c for the order.
    """
    if mixer is None:
        roll, pitch, yaw = cut(torque[0] / 2), cut(torque[1] / 2), torque[2]
        right, left = thrust - roll, thrust + roll
        mixed = [right - pitch - yaw, right + pitch + yaw, left + pitch - yaw, left - pitch + yaw]
    else:
        roll, pitch, yaw = torque
        mixed = [lift * thrust + a * roll + b * pitch + c * yaw for lift, a, b, c in mixer]
    most = MOST_COUNTS if firmware == "2021.10" else None
    return each(lambda counts: jnp.clip(cut(counts), 0.0, most), like(torque, mixed))


def tick(
    memory: Memory,
    setpoint: Setpoint,
    state: StateEstimate,
    firmware: Generation,
    position_due: Bool[Array, ""] | bool,
    attitude_due: Bool[Array, ""] | bool = True,
    mixer: Mixer | None = None,
    platform: Platform = USUAL,
) -> tuple[Memory, Float[Array, "4"]]:
    """Returns one tick of the cascade.

    Thrust 0 stops the motors, resets the PIDs and makes the present yaw the desired one; so it is
    before the first tick.

    Args:
        memory: of the tick before.
        setpoint: the set-point.
        state: what is measured.
        firmware: generation; static.
        position_due: whether position and velocity PIDs run, as they do at 100 Hz.
        attitude_due: whether attitude and rate PIDs run, as they do at 500 Hz.
        mixer: see `mix`.
        platform: whose gains the PIDs have; static.

    Returns:
        Memory, and the four motors' commands [counts], not yet compensated for the battery.

    Source: controller_pid.c, controllerPid.
    """

    def stopped(memory: Memory) -> Memory:
        desired = jnp.concatenate([memory.desired[:2], state.attitude[2:]])
        return reset(memory, state, firmware)._replace(desired=desired, torque=jnp.zeros(3))

    fixed = jnp.ndim(memory.mode) == 0
    first = memory.mode < 0 if fixed else memory.mode[0] < 0
    memory = choose(first, stopped(memory), memory)
    if firmware == "2026.08":
        level = jnp.concatenate([state.attitude[:2], memory.desired[2:]])
        changed = first if fixed else jnp.any(memory.mode != setpoint.mode)
        memory = choose(changed, reset(memory, state, firmware)._replace(desired=level), memory)
    memory = memory._replace(mode=jnp.zeros_like(memory.mode) if fixed else setpoint.mode)
    heading = memory.desired[2] + setpoint.body_rates[2] * (1 / ATTITUDE_RATE)
    yaw_setpoint = setpoint.attitude[2]
    if firmware == "2026.08":
        yaw_setpoint = jnp.where(setpoint.mode[5] == DISABLE, memory.desired[2], yaw_setpoint)
    yaw = wrap(jnp.where(setpoint.mode[5] == VELOCITY, heading, yaw_setpoint))
    memory = choose(attitude_due, memory._replace(desired=with_third(memory.desired, yaw)), memory)
    if position_due is not False:
        memory = choose(
            position_due, position_loops(memory, setpoint, state, firmware, platform), memory
        )
    memory = choose(
        attitude_due, attitude_loops(memory, setpoint, state, firmware, platform), memory
    )
    memory = choose(memory.thrust == 0.0, stopped(memory), memory)
    return memory, mix(memory.thrust, memory.torque, firmware, mixer)


def _turn(vector: Float[Array, "3"], yaw: Float[Array, ""]) -> Float[Array, "3"]:
    """A vector of the world in axes turned by yaw [deg]."""
    angle = yaw * np.float32(np.pi) / 180.0
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack(
        [vector[0] * cos + vector[1] * sin, vector[1] * cos - vector[0] * sin, vector[2]]
    )


def cut(counts: Float[Array, "..."]) -> Float[Array, "..."]:
    """Truncates counts towards zero, with the derivative of the identity."""
    return counts + lax.stop_gradient(jnp.trunc(counts) - counts)


def choose(condition: Bool[Array, "..."] | bool, new: Any, old: Any) -> Any:
    """Returns one of two memories; a condition that Python knows leaves the other out."""
    if isinstance(condition, bool):
        return new if condition else old
    return tree.map(lambda new, old: jnp.where(condition, new, old), new, old)
