"""The firmware's cascaded PID as a controller that holds a set-point, or turns while it does."""

from dataclasses import replace
from functools import cache, partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from maidenflight.names import POSITION_PID
from maidenflight.parameters.frames import Mixer
from maidenflight.parameters.platforms import Platform
from maidenflight.simulator.controllers.control import NOTHING, Controller, Heading, sensed
from maidenflight.simulator.controllers.firmware import (
    ABSOLUTE,
    DISABLE,
    USUAL,
    Memory,
    switched_on,
    tick,
)
from maidenflight.simulator.controllers.interface import ControlInterface
from maidenflight.simulator.controllers.pid import (
    ATTITUDE_RATE,
    POSITION_RATE,
    Generation,
    generation_of,
)
from maidenflight.simulator.physics.battery import COUNTS
from maidenflight.simulator.physics.sensors import Measurement


class CascadeMemory(NamedTuple):
    """What the position PID remembers."""

    firmware: Memory
    step: Int[Array, ""]
    """Commands so far."""


_ADDED = "added share of full thrust"
EXCITATION = ControlInterface(
    POSITION_PID,
    (0.0, 0.0, 0.0, 0.0),
    (1.0, 1.0, 1.0, 1.0),
    (_ADDED, _ADDED, _ADDED, _ADDED),
    ATTITUDE_RATE,
)
"""What is added to the motors' commands while the position PID flies."""


def position_pid(firmware: str = "2021.10", full_scale_counts: float = COUNTS) -> Controller:
    """Returns the firmware's cascaded PID, which holds a set-point.

    Position and velocity loops run at 100 Hz, attitude and rate loops at 500 Hz.

    The action is added to the four commands, so that flights can be excited for identification;
    zero is the plain PID. Yaw stays at zero, but by its `turning`.

    Args:
        firmware: `"2021.10"`, which the paper's flights had, or `"2026.08"`.
        full_scale_counts: see `ControlInterface`.

    Raises:
        InputError: there is no such firmware.
    """
    return _position_pid(
        generation_of(firmware), replace(EXCITATION, full_scale_counts=full_scale_counts)
    )


@cache
def _position_pid(
    firmware: Generation,
    interface: ControlInterface,
    mixer: Mixer | None = None,
    platform: Platform = USUAL,
) -> Controller:
    cascade = partial(_cascade, firmware, interface, mixer, platform)
    fitted = partial(_position_pid, firmware, interface)
    return cascade(None)._replace(fitted=fitted, turning=cascade)


def _cascade(
    firmware: Generation,
    interface: ControlInterface,
    mixer: Mixer | None,
    platform: Platform,
    heading: Heading | None,
) -> Controller:
    mode: Any = np.array([ABSOLUTE, ABSOLUTE, ABSOLUTE, DISABLE, DISABLE, ABSOLUTE], np.int32)
    every = ATTITUDE_RATE // POSITION_RATE

    def command(
        memory: CascadeMemory,
        action: Float[Array, "4"],
        measurement: Measurement,
        setpoint: Float[Array, "3"],
    ) -> tuple[CascadeMemory, Float[Array, "4"]]:
        target = NOTHING._replace(mode=mode, position=setpoint)
        if heading is not None:
            yaw = jnp.degrees(heading(memory.step))
            target = target._replace(attitude=jnp.zeros(3).at[2].set(yaw))
        due = memory.step % every == 0
        inner, motors = tick(
            memory.firmware, target, sensed(measurement), firmware, due, True, mixer, platform
        )
        added = jnp.maximum(motors / interface.full_scale_counts + action, 0.0)
        return CascadeMemory(inner, memory.step + 1), added

    def init() -> CascadeMemory:
        return CascadeMemory(switched_on(), np.int32(0))  # type: ignore[arg-type]

    return Controller(interface, init, command, ATTITUDE_RATE)
