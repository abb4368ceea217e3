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
from maidenflight.simulator.firmware import (
    ABSOLUTE,
    ATTITUDE_RATE,
    DISABLE,
    POSITION_RATE,
    VELOCITY,
    Generation,
    Memory,
    Setpoint,
    State,
    checked,
    switched_on,
    tick,
)
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
    action_rate: int
    """Actions a second [Hz]."""


@cache
def pwm() -> Controller:
    """The policy's four actions are the motors' thrust commands: u = (clip(a, -1, 1) + 1) / 2, at 100 Hz.

    Source: Gronauer et al. 2022, sec. Motor Model and sec. Control Structures.
    """

    def command(
        memory: None, action: Float[Array, "4"], measurement: Measurement, setpoint: Float[Array, "3"]
    ) -> tuple[None, Float[Array, "4"]]:
        return memory, (jnp.clip(action, -1.0, 1.0) + 1.0) / 2.0

    return Controller("pwm", lambda: None, command, rate=100, action_rate=100)


_FULL = 60000.0
"""Counts of u = 1 (authors' code and flights)."""
_ZERO = np.zeros(3, np.float32)
_NOTHING = Setpoint(_ZERO, _ZERO, _ZERO, _ZERO, np.float32(0.0), np.zeros(6, np.int32), np.bool_(False))  # type: ignore[arg-type]


def attitude_rate(firmware: str = "2026.08") -> Controller:
    """The policy asks for collective thrust and body rates at 50 Hz; the firmware's PIDs command the motors at 500 Hz.

    T = 30000 + 30000 a_0 counts of 60000; roll, pitch and yaw rate are 60 deg/s times a_1, a_2, a_3, with a clipped to [-1, 1].
    The firmware does not follow a yaw rate itself but the yaw that it leads to.

    Args:
        firmware: `"2021.10"` or `"2026.08"`.

    Raises:
        InputError: there is no such firmware.

    Source: Gronauer et al. 2022, sec. Control Structures; scales from the authors' code.
    """
    return _by_policy("attitude_rate", checked(firmware), 50, _rates)


def attitude(firmware: str = "2026.08") -> Controller:
    """The policy asks for collective thrust and attitude at 25 Hz; the firmware's PIDs command the motors at 500 Hz.

    T = 45000 + 10000 a_0 counts of 60000; roll, pitch and yaw are 10 deg times a_1, a_2, a_3, with a clipped to [-1, 1].

    Args:
        firmware: `"2021.10"` or `"2026.08"`.

    Raises:
        InputError: there is no such firmware.

    Source: Gronauer et al. 2022, sec. Control Structures; scales from the authors' code.
    """
    return _by_policy("attitude", checked(firmware), 25, _angles)


def _rates(action: Float[Array, "4"]) -> Setpoint:
    mode: Any = np.array([DISABLE] * 3 + [VELOCITY] * 3, np.int32)
    return _NOTHING._replace(mode=mode, body_rates=60.0 * action[1:], thrust=30000.0 + 30000.0 * action[0])


def _angles(action: Float[Array, "4"]) -> Setpoint:
    mode: Any = np.array([DISABLE] * 3 + [ABSOLUTE] * 3, np.int32)
    return _NOTHING._replace(mode=mode, attitude=10.0 * action[1:], thrust=45000.0 + 10000.0 * action[0])


@cache
def _by_policy(name: str, firmware: Generation, action_rate: int, ask: Callable[[Float[Array, "4"]], Setpoint]) -> Controller:
    """A controller whose action, clipped, is the set-point of the firmware's attitude PIDs."""

    def command(
        memory: Memory, action: Float[Array, "4"], measurement: Measurement, setpoint: Float[Array, "3"]
    ) -> tuple[Memory, Float[Array, "4"]]:
        wanted = ask(jnp.clip(action, -1.0, 1.0))
        memory, motors = tick(memory, wanted, _sensed(measurement), firmware, position_due=False)
        return memory, jnp.clip(motors / _FULL, 0.0, 1.0)

    return Controller(name, switched_on, command, rate=ATTITUDE_RATE, action_rate=action_rate)


class CascadeMemory(NamedTuple):
    """What the position PID remembers."""

    firmware: Memory
    step: Int[Array, ""]
    """Commands given so far, modulo the commands between two updates of the outer loops."""


def position_pid(firmware: str = "2021.10") -> Controller:
    """The firmware's cascaded PID, which holds a set-point: position and velocity at 100 Hz, attitude and rate at 500 Hz.

    The action is added to the four commands, so that flights can be excited for identification; zero is the plain PID. Yaw is
    held at zero.

    Args:
        firmware: `"2021.10"`, which the paper's flights had, or `"2026.08"`.

    Raises:
        InputError: there is no such firmware.
    """
    return _position_pid(checked(firmware))


@cache
def _position_pid(firmware: Generation) -> Controller:
    mode: Any = np.array([ABSOLUTE, ABSOLUTE, ABSOLUTE, DISABLE, DISABLE, ABSOLUTE], np.int32)
    every = ATTITUDE_RATE // POSITION_RATE

    def command(
        memory: CascadeMemory, action: Float[Array, "4"], measurement: Measurement, setpoint: Float[Array, "3"]
    ) -> tuple[CascadeMemory, Float[Array, "4"]]:
        wanted = _NOTHING._replace(mode=mode, position=setpoint)
        inner, motors = tick(memory.firmware, wanted, _sensed(measurement), firmware, position_due=memory.step == 0)
        return CascadeMemory(inner, (memory.step + 1) % every), jnp.clip(motors / _FULL + action, 0.0, 1.0)

    def init() -> CascadeMemory:
        return CascadeMemory(switched_on(), np.int32(0))  # type: ignore[arg-type]

    return Controller("position_pid", init, command, rate=ATTITUDE_RATE, action_rate=POSITION_RATE)


def _sensed(measurement: Measurement) -> State:
    """A measurement in the firmware's units."""
    attitude = rotations.to_attitude(measurement.quaternion)
    return State(measurement.position, measurement.velocity, jnp.degrees(attitude), jnp.degrees(measurement.body_rates))
