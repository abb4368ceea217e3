"""What the authors' drone ran: control structures of firmware 2021.10, as its logs show them.

Source: Gronauer et al. 2022, sec. Zero-Shot Experiments; logs of the authors' flights.
"""

from collections.abc import Callable
from functools import cache

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maidenflight.simulator import control, firmware
from maidenflight.simulator.battery import COUNTS
from maidenflight.simulator.control import Controller
from maidenflight.simulator.firmware import Generation
from maidenflight.simulator.sensors import Measurement

FIRMWARE: Generation = "2021.10"
"""What the authors' drone ran."""
GUARD_RATE = 100
"""How often the guard looks [Hz], which is also the rate of the authors' logs and of the
estimates."""


def attitude_rate_as_flown() -> Controller:
    """Attitude-rate control as the authors' drone did it: yaw's rate PID, too, follows the rate
    that the policy asks for.

    The firmware's commander would turn it into a heading. In the 47 published flights of 150 rows
    and more the rate PID fed with the policy's yaw rate explains 95 % of the variance of the yaw
    torque at a slope of 1.00, that of the heading less than 1 %.
    """
    return _attitude_rate_as_flown()


@cache
def _attitude_rate_as_flown() -> Controller:
    commander = control.attitude_rate(FIRMWARE, GUARD_RATE)

    def init() -> firmware.PIDMemory:
        zero = np.zeros(3, np.float32)
        return firmware.PIDMemory(zero, zero)  # type: ignore[arg-type]

    def command(
        memory: firmware.PIDMemory,
        action: Float[Array, "4"],
        measurement: Measurement,
        setpoint: Float[Array, "3"],
    ) -> tuple[firmware.PIDMemory, Float[Array, "4"]]:
        asked = jnp.clip(action, -1.0, 1.0)
        memory, torque = firmware.pid(
            memory, 60.0 * asked[1:], jnp.degrees(measurement.body_rates), firmware.RATE, FIRMWARE
        )
        motors = firmware.mix(30000.0 + 30000.0 * asked[0], firmware.cut(torque), FIRMWARE)
        return memory, jnp.clip(motors / COUNTS, 0.0, 1.0)

    return commander._replace(init=init, command=command)


def attitude_as_flown() -> Controller:
    """Attitude control as the authors' drone did it: the policy's outputs are not clipped.

    In 22 of the 54 published flights (those of 150 rows and more) the PIDs fed with 10 deg times
    the outputs explain 96, 95 and 85 % of the variance of the roll, pitch and yaw torque; fed with
    outputs clipped to [-1, 1] it is 79, 79 and 64 %.
    """
    return _attitude_as_flown()


@cache
def _attitude_as_flown() -> Controller:
    commander = control.attitude(FIRMWARE, GUARD_RATE)
    mode = np.array([firmware.DISABLE] * 3 + [firmware.ABSOLUTE] * 3, np.int32)

    def command(
        memory: firmware.Memory,
        action: Float[Array, "4"],
        measurement: Measurement,
        setpoint: Float[Array, "3"],
    ) -> tuple[firmware.Memory, Float[Array, "4"]]:
        wanted = control.NOTHING._replace(
            mode=mode, attitude=10.0 * action[1:], thrust=45000.0 + 10000.0 * action[0]
        )
        memory, motors = firmware.tick(
            memory, wanted, control.sensed(measurement), FIRMWARE, position_due=False
        )
        return memory, jnp.clip(motors / COUNTS, 0.0, 1.0)

    return commander._replace(command=command)


AS_FLOWN: dict[str, Callable[[], Controller]] = {
    "pwm": control.pwm,
    "attitude_rate": attitude_rate_as_flown,
    "attitude": attitude_as_flown,
}
"""Control structures of the authors' drone, with a place for the guard between actions."""
