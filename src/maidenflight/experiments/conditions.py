"""Conditions of predicted flights: a drone's firmware, where its flights begin, and its guard.

`CURRENT` are today's: firmware 2026.08, from hover, the guard of the exported app. A TOML file has
others, such as those of the published flights, paper/settings/gronauer_2021.toml. Their drone ran
firmware 2021.10, whose control structures are here as its logs show them.

Source: Gronauer et al. 2022, sec. Zero-Shot Experiments; logs of the authors' flights.
"""

import math
from collections.abc import Callable
from functools import cache, partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maidenflight import inputs
from maidenflight.flying.scenario import HOVER, Start, start_of
from maidenflight.inputs import Fields, StrPath
from maidenflight.names import FIRMWARES
from maidenflight.simulator.controllers import control, firmware, rate_loops
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.controllers.interface import ControlInterface
from maidenflight.simulator.controllers.pid import Generation, PIDMemory
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.tasks.failures import APP, Guard

FIRMWARE: Generation = "2021.10"
"""What the authors' drone ran."""
AS_FLOWN = f"{FIRMWARE} as flown"


class Conditions(NamedTuple):
    """How a drone flies."""

    controller_for: Callable[[ControlInterface], Controller] = control.controller_for
    """The controller of a policy's interface."""
    start: Start = HOVER
    """Spread of first states."""
    guard: Guard = APP
    """At which flights end."""


CURRENT = Conditions()
"""Of today's firmware and of the exported app."""


def read_conditions(path: StrPath | None) -> Conditions:
    """Reads conditions; `CURRENT` without a file, and where it has no such entry.

    Raises:
        InputError: no file that can be read, or something in it is no condition.
    """
    if path is None:
        return CURRENT
    cure = "Copy paper/settings/gronauer_2021.toml of the repository, and change it."
    document = inputs.toml_file(path, "conditions of flights", cure)
    table = Fields(document, str(path), "conditions", cure)
    if table.count("conditions") != 1:
        raise table.refused("conditions", "1, those of this version")
    generation = table.choice("firmware", (*FIRMWARES, AS_FLOWN), FIRMWARES[-1])
    conditions = CURRENT._replace(
        controller_for=controller_as_flown
        if generation == AS_FLOWN
        else partial(control.controller_for, firmware=generation)
    )
    if "start" in document:
        own = table.table("start")
        axes = ("position", "velocity", "attitude", "body_rates")
        scales = [own.numbers(name, 3) for name in axes]
        start = start_of(*scales, own.number("homeward", -1.0, 1.0), own.number("above"))
        conditions = conditions._replace(start=start)
        own.end()
    if "guard" in document:
        own = table.table("guard")
        tilt, body_rate = (
            math.radians(own.number(name, 0.0)) for name in ("tilt_deg", "body_rate_deg")
        )
        guard = Guard(tilt, body_rate, own.number("position_error", 0.0))
        conditions = conditions._replace(guard=guard)
        own.end()
    table.end()
    return conditions


def controller_as_flown(interface: ControlInterface) -> Controller:
    """Returns the controller of the authors' drone that does what an interface says.

    Raises:
        InputError: see `control.controller_for`.
    """
    if interface.name == "attitude_rate":
        return _attitude_rate(interface)
    if interface.name == "attitude":
        return _attitude(interface)
    return control.controller_for(interface, FIRMWARE)


@cache
def _attitude_rate(interface: ControlInterface) -> Controller:
    """Attitude-rate control whose yaw rate PID, too, follows the rate that the policy asks for.

    The firmware's commander would turn it into a heading. In the 47 published flights of 150 rows
    and more the rate PID fed with the policy's yaw rate explains 95 % of the variance of the yaw
    torque at a slope of 1.00, that of the heading less than 1 %. No thrust stops all motors and
    resets the PIDs, as in 2,150 of 2,150 rows of these flights (firmware, controller_pid.c).
    """

    def init() -> PIDMemory:
        zero = np.zeros(3, np.float32)
        return PIDMemory(zero, zero)  # type: ignore[arg-type]

    def command(
        memory: PIDMemory,
        action: Float[Array, "4"],
        measurement: Measurement,
        setpoint: Float[Array, "3"],
    ) -> tuple[PIDMemory, Float[Array, "4"]]:
        scaled_action = interface.command(action, control.firmware_units(interface))
        rates = jnp.degrees(measurement.body_rates)
        memory, motors = rate_loops.follow_rates(
            memory, scaled_action[0], scaled_action[1:], rates, FIRMWARE
        )
        return memory, motors / interface.full_scale_counts

    def taking_over(hovers: Float[Array, "4"], measurement: Measurement) -> PIDMemory:
        return rate_loops.balancing(hovers * interface.full_scale_counts)

    commander = control.controller_for(interface, FIRMWARE)
    return commander._replace(init=init, command=command, fitted=None, taking_over=taking_over)


@cache
def _attitude(interface: ControlInterface) -> Controller:
    """Attitude control that does not clip the policy's outputs.

    In 22 of the 54 published flights (those of 150 rows and more) the PIDs fed with 10 deg times
    the outputs explain 96, 95 and 85 % of the variance of the roll, pitch and yaw torque; fed with
    outputs clipped to [-1, 1] it is 79, 79 and 64 %.
    """
    mode = np.array([firmware.DISABLE] * 3 + [firmware.ABSOLUTE] * 3, np.int32)

    def command(
        memory: firmware.Memory,
        action: Float[Array, "4"],
        measurement: Measurement,
        setpoint: Float[Array, "3"],
    ) -> tuple[firmware.Memory, Float[Array, "4"]]:
        scaled_action = interface.scaled(action, control.firmware_units(interface))
        setpoint_command = control.NOTHING._replace(
            mode=mode, attitude=scaled_action[1:], thrust=scaled_action[0]
        )
        memory, motors = firmware.tick(
            memory, setpoint_command, control.sensed(measurement), FIRMWARE, position_due=False
        )
        return memory, motors / interface.full_scale_counts

    return control.controller_for(interface, FIRMWARE)._replace(command=command, fitted=None)
