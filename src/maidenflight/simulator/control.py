"""Control structures: what turns an action, or a set-point, into four thrust commands.

A `Controller` is a NamedTuple of pure functions, so a cascade is a function that returns one.
"""

from collections.abc import Callable
from functools import cache, partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from maidenflight.errors import InputError
from maidenflight.parameters import Parameters, replace
from maidenflight.simulator import rotations
from maidenflight.simulator.battery import COUNTS
from maidenflight.simulator.firmware import (
    ABSOLUTE,
    ATTITUDE_RATE,
    DISABLE,
    POSITION_RATE,
    Generation,
    Memory,
    RateMemory,
    Setpoint,
    State,
    checked,
    rate_tick,
    rates_switched_on,
    switched_on,
    tick,
)
from maidenflight.simulator.sensors import Measurement


class Controller(NamedTuple):
    """A control structure."""

    name: str
    init: Callable[[], Any]
    """Memory at switch-on."""
    command: Callable[
        [Any, Float[Array, "4"], Measurement, Float[Array, "3"]], tuple[Any, Float[Array, "4"]]
    ]
    """(memory, action, measurement, setpoint [m]) to (memory, thrust commands u in [0, 1])."""
    rate: int
    """Commands a second [Hz]."""
    action_rate: int
    """Actions a second [Hz]."""
    level: Callable[[Float[Array, ""]], Float[Array, "4"]]
    """The action that asks for a level drone whose motors all have the command u, in [0, 1]."""


def time_step(controller: Controller, longest: float = 0.005) -> float:
    """The longest physics step [s] that divides the period between two commands, but is no longer
    than one of one's choice.
    """
    period = 1.0 / controller.rate
    return period / np.ceil(period / longest - 1e-6)


def in_fitting_steps(drone: Parameters, controller: Controller) -> Parameters:
    """The drone in steps that divide the period between two commands, no longer than its own."""
    return replace(drone, time_step=np.float32(time_step(controller, float(drone.time_step))))


@cache
def pwm() -> Controller:
    """The policy's four actions are the motors' thrust commands: u = (clip(a, -1, 1) + 1) / 2, at
    100 Hz.

    Source: Gronauer et al. 2022, sec. Motor Model and sec. Control Structures.
    """

    def command(
        memory: None,
        action: Float[Array, "4"],
        measurement: Measurement,
        setpoint: Float[Array, "3"],
    ) -> tuple[None, Float[Array, "4"]]:
        return memory, (jnp.clip(action, -1.0, 1.0) + 1.0) / 2.0

    def level(command: Float[Array, ""]) -> Float[Array, "4"]:
        return jnp.broadcast_to(2.0 * command - 1.0, (4,))

    return Controller("pwm", lambda: None, command, rate=100, action_rate=100, level=level)


HIGHEST_RATE = 60.0
"""Body rate [deg/s] that attitude-rate control can ask for (Gronauer et al. 2022, sec.
Discussion)."""
_ZERO: Any = np.zeros(3, np.float32)
_MODE: Any = np.zeros(6, np.int32)
_NO_FORCE: Any = np.float32(0.0)
_IN_WORLD: Any = np.bool_(False)
NOTHING = Setpoint(_ZERO, _ZERO, _ZERO, _ZERO, _NO_FORCE, _MODE, _IN_WORLD)
"""A set-point that asks for nothing, to be filled in."""


def attitude_rate(
    firmware: str = "2026.08", action_rate: int = 50, highest_rate: float = HIGHEST_RATE
) -> Controller:
    """The policy asks for collective thrust and body rates at 50 Hz.

    The firmware's PIDs command the motors at 500 Hz.

    T = 30000 + 30000 a_0 counts of 60000; roll, pitch and yaw rate are 60 deg/s times a_1, a_2,
    a_3, with a clipped to [-1, 1]. The firmware does not follow a yaw rate itself but the yaw that
    it leads to.

    Args:
        firmware: `"2021.10"` or `"2026.08"`.
        action_rate: actions a second [Hz]; the authors trained at 100 and flew at 50.
        highest_rate: body rate [deg/s] that an action of 1 asks for. A policy's file does not tell
            it: fly it with the same one.

    Raises:
        InputError: there is no such firmware, the action rate does not divide 500 Hz, or the
            highest rate is not positive and finite.

    Source: Gronauer et al. 2022, sec. Control Structures; scales from the authors' code; +-360
    deg/s from sec. Discussion.
    """
    if not 0.0 < highest_rate < np.inf:
        raise InputError(
            f"highest_rate = {highest_rate} deg/s; expected a positive number. The paper's is "
            f"{HIGHEST_RATE:g}."
        )
    return _attitude_rate(checked(firmware), action_rate, float(highest_rate))


def attitude(firmware: str = "2026.08", action_rate: int = 25) -> Controller:
    """The policy asks for collective thrust and attitude at 25 Hz.

    The firmware's PIDs command the motors at 500 Hz.

    T = 45000 + 10000 a_0 counts of 60000; roll, pitch and yaw are 10 deg times a_1, a_2, a_3, with
    a clipped to [-1, 1]. The least thrust, 35000 counts, lifts a drone whose thrust-to-weight ratio
    is above 1.71: it cannot descend.

    Args:
        firmware: `"2021.10"` or `"2026.08"`.
        action_rate: actions a second [Hz]; the authors trained at 100 and flew at 25.

    Raises:
        InputError: there is no such firmware, or the action rate does not divide 500 Hz.

    Source: Gronauer et al. 2022, sec. Control Structures; scales from the authors' code.
    """
    return _attitude(checked(firmware), action_rate)


CONTROLLERS: dict[str, Callable[..., Controller]] = {
    "pwm": pwm,
    "attitude_rate": attitude_rate,
    "attitude": attitude,
}
"""The paper's control structures by name; those of the firmware take `firmware` and
`action_rate`."""


@cache
def _attitude_rate(firmware: Generation, action_rate: int, highest_rate: float) -> Controller:
    def command(
        memory: RateMemory,
        action: Float[Array, "4"],
        measurement: Measurement,
        setpoint: Float[Array, "3"],
    ) -> tuple[RateMemory, Float[Array, "4"]]:
        asked = jnp.clip(action, -1.0, 1.0)
        yaw, rates = (
            jnp.degrees(rotations.heading(measurement.quaternion)),
            jnp.degrees(measurement.body_rates),
        )
        memory, motors = rate_tick(
            memory, 30000.0 + 30000.0 * asked[0], highest_rate * asked[1:], yaw, rates, firmware
        )
        return memory, _command(motors)

    def level(command: Float[Array, ""]) -> Float[Array, "4"]:
        return _upright(2.0 * command - 1.0)

    return Controller(
        "attitude_rate", rates_switched_on, command, ATTITUDE_RATE, _dividing(action_rate), level
    )


@cache
def _attitude(firmware: Generation, action_rate: int) -> Controller:
    mode: Any = np.array([DISABLE] * 3 + [ABSOLUTE] * 3, np.int32)

    def command(
        memory: Memory,
        action: Float[Array, "4"],
        measurement: Measurement,
        setpoint: Float[Array, "3"],
    ) -> tuple[Memory, Float[Array, "4"]]:
        asked = jnp.clip(action, -1.0, 1.0)
        wanted = NOTHING._replace(
            mode=mode, attitude=10.0 * asked[1:], thrust=45000.0 + 10000.0 * asked[0]
        )
        memory, motors = tick(memory, wanted, sensed(measurement), firmware, position_due=False)
        return memory, _command(motors)

    def level(command: Float[Array, ""]) -> Float[Array, "4"]:
        return _upright(6.0 * command - 4.5)

    return Controller(
        "attitude",
        partial(switched_on, fixed=True),
        command,
        ATTITUDE_RATE,
        _dividing(action_rate),
        level,
    )


def _upright(thrust: Float[Array, ""]) -> Float[Array, "4"]:
    """The action that asks for collective thrust and nothing else."""
    none = jnp.zeros_like(thrust)
    return jnp.stack([thrust, none, none, none])


def _command(motors: Float[Array, "4"]) -> Float[Array, "4"]:
    """Motor commands [counts] as u."""
    return jnp.clip(motors * (1.0 / COUNTS), 0.0, 1.0)


def _dividing(action_rate: int) -> int:
    if action_rate < 1 or ATTITUDE_RATE % action_rate:
        raise InputError(
            f"action_rate = {action_rate} Hz does not divide the PIDs' {ATTITUDE_RATE} Hz. Give "
            "25, 50 or 100."
        )
    return action_rate


class CascadeMemory(NamedTuple):
    """What the position PID remembers."""

    firmware: Memory
    step: Int[Array, ""]
    """Commands given so far, modulo the commands between two updates of the outer loops."""


def position_pid(firmware: str = "2021.10") -> Controller:
    """The firmware's cascaded PID, which holds a set-point: position and velocity at 100 Hz,
    attitude and rate at 500 Hz.

    The action is added to the four commands, so that flights can be excited for identification;
    zero is the plain PID. Yaw is held at zero.

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
        memory: CascadeMemory,
        action: Float[Array, "4"],
        measurement: Measurement,
        setpoint: Float[Array, "3"],
    ) -> tuple[CascadeMemory, Float[Array, "4"]]:
        wanted = NOTHING._replace(mode=mode, position=setpoint)
        inner, motors = tick(
            memory.firmware, wanted, sensed(measurement), firmware, position_due=memory.step == 0
        )
        return CascadeMemory(inner, (memory.step + 1) % every), jnp.clip(
            motors / COUNTS + action, 0.0, 1.0
        )

    def init() -> CascadeMemory:
        return CascadeMemory(switched_on(), np.int32(0))  # type: ignore[arg-type]

    def level(command: Float[Array, ""]) -> Float[Array, "4"]:
        return jnp.zeros(4)

    return Controller(
        "position_pid", init, command, rate=ATTITUDE_RATE, action_rate=POSITION_RATE, level=level
    )


def sensed(measurement: Measurement) -> State:
    """A measurement in the firmware's units."""
    attitude = rotations.to_attitude(measurement.quaternion)
    return State(
        measurement.position,
        measurement.velocity,
        jnp.degrees(attitude),
        jnp.degrees(measurement.body_rates),
    )
