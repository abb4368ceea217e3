"""What the authors' drone ran: control structures of firmware 2021.10, as its logs show them.

Source: Gronauer et al. 2022, sec. Zero-Shot Experiments; logs of the authors' flights.
"""

from functools import cache

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maidenflight.simulator.controllers import control, firmware, rate_loops
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.controllers.interface import ControlInterface
from maidenflight.simulator.controllers.pid import Generation, PIDMemory
from maidenflight.simulator.physics.sensors import Measurement

FIRMWARE: Generation = "2021.10"
"""What the authors' drone ran."""
GUARD_RATE = 100
"""Rate [Hz] of the guard, of the authors' logs and of the estimates."""


def real_controller(interface: ControlInterface) -> Controller:
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
    return commander._replace(init=init, command=command, mixed=None, taking_over=taking_over)


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

    return control.controller_for(interface, FIRMWARE)._replace(command=command, mixed=None)
