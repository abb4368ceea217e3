"""Control structures: what turns an action, or a set-point, into four thrust commands.

A `Controller` is a NamedTuple of pure functions and of the `ControlInterface` that it obeys. PWM,
attitude-rate and attitude control are the paper's; `driven` makes another from its interface.
"""

from collections.abc import Callable
from dataclasses import replace as replaced
from functools import cache, partial
from typing import Any, NamedTuple, Self, cast

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from maidenflight.errors import InputError
from maidenflight.names import CONTROLS
from maidenflight.parameters import Parameters, replace
from maidenflight.parameters.frames import Mixer, mixer_of
from maidenflight.parameters.platforms import Platform, platform_of
from maidenflight.registry import import_part
from maidenflight.simulator.controllers import interface as interfaces
from maidenflight.simulator.controllers.firmware import (
    ABSOLUTE,
    DISABLE,
    USUAL,
    Memory,
    Setpoint,
    StateEstimate,
    switched_on,
    tick,
)
from maidenflight.simulator.controllers.interface import HIGHEST_RATE_DEG, ControlInterface, Four
from maidenflight.simulator.controllers.pid import ATTITUDE_RATE, Generation, generation_of
from maidenflight.simulator.controllers.rate_loops import (
    RateMemory,
    balancing,
    rate_tick,
    rates_switched_on,
)
from maidenflight.simulator.physics import rotations
from maidenflight.simulator.physics.battery import COUNTS
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.physics.vectors import each

MOTOR_RATE = 100
"""Commands a second [Hz] where a policy commands the motors itself and its rate divides this."""

Drive = Callable[
    [Any, Float[Array, "4"], Measurement, Float[Array, "3"]], tuple[Any, Float[Array, "4"]]
]
"""(memory, command or action, measurement, setpoint [m]) to (memory, thrust commands u)."""
Heading = Callable[[Int[Array, ""]], Float[Array, ""]]
"""(number of the command) to the commanded yaw [rad]. It may hold traced arrays, so that
flights with other headings are one compiled program."""


class Controller(NamedTuple):
    """A control structure."""

    interface: ControlInterface
    """What actions mean, and how often they come."""
    init: Callable[[], Any]
    """Memory at switch-on."""
    command: Drive
    """(memory, action, measurement, setpoint [m]) to (memory, thrust commands u from 0)."""
    command_rate: int
    """Thrust commands a second [Hz]."""
    fitted: Callable[[Mixer | None, Platform], "Controller"] | None = None
    """The same for a mixer, None being the firmware's own, and a platform; None: it has neither."""
    taking_over: Callable[[Float[Array, "4"], Measurement], Any] | None = None
    """(thrust commands u that hover the drone, measurement) to the memory where the firmware has
    hovered it before; None: that of switch-on."""
    turning: Callable[[Heading], "Controller"] | None = None
    """The same that also turns; None: it does not."""

    def acting_at(self, rate: int) -> Self:
        """Returns the same controller with so many actions a second [Hz]."""
        return self._replace(interface=replaced(self.interface, rate=rate))

    def on(self, drone: Parameters) -> "Controller":
        """Returns the same controller with a drone's mixer and platform, where it has them.

        Args:
            drone: a point, of NumPy's numbers.
        """
        if self.fitted is None:
            return self
        mixer, platform = mixer_of(drone), platform_of(drone.platform)
        if mixer is None and platform == USUAL:
            return self
        return self.fitted(mixer, platform)._replace(interface=self.interface)


def driven(
    interface: ControlInterface,
    drive: Drive,
    command_rate: int | None = None,
    init: Callable[[], Any] = lambda: None,
    factors: Four = (1.0, 1.0, 1.0, 1.0),
    fitted: Callable[[Mixer | None, Platform], Controller] | None = None,
    taking_over: Callable[[Float[Array, "4"], Measurement], Any] | None = None,
) -> Controller:
    """Returns a controller that scales actions as its interface says, and so as exported code does.

    Args:
        interface: what actions mean.
        drive: (memory, command in the interface's units, measurement, setpoint [m]) to (memory, the
            motors' thrust commands u from 0); the firmware's PIDs may ask for more than 1.
        command_rate: thrust commands a second [Hz]; 100 by default, or the rate of actions where
            that does not divide 100.
        init: memory at switch-on.
        factors: from the interface's units to those that `drive` takes.
        fitted: see `Controller`.
        taking_over: see `Controller`.
    """

    def command(
        memory: Any,
        action: Float[Array, "4"],
        measurement: Measurement,
        setpoint: Float[Array, "3"],
    ) -> tuple[Any, Float[Array, "4"]]:
        return drive(memory, interface.command(action, factors), measurement, setpoint)

    own = interface.rate if MOTOR_RATE % interface.rate else MOTOR_RATE
    return Controller(interface, init, command, command_rate or own, fitted, taking_over)


def time_step(controller: Controller, longest: float = 0.005) -> float:
    """Returns the longest physics step [s] that divides the period between two commands.

    Args:
        controller: whose commands.
        longest: the step is no longer than this [s].
    """
    period = 1.0 / controller.command_rate
    return period / np.ceil(period / longest - 1e-6)


def in_fitting_steps(drone: Parameters, controller: Controller) -> Parameters:
    """Returns the drone in time steps that divide the period between two commands."""
    return replace(drone, time_step=np.float32(time_step(controller, float(drone.time_step))))


_ZERO: Any = np.zeros(3, np.float32)
_MODE: Any = np.zeros(6, np.int32)
_NO_FORCE: Any = np.float32(0.0)
_IN_WORLD: Any = np.bool_(False)
NOTHING = Setpoint(_ZERO, _ZERO, _ZERO, _ZERO, _NO_FORCE, _MODE, _IN_WORLD)
"""A set-point that asks for nothing, to be filled in."""


def pwm(action_rate: int = 100, full_scale_counts: float = COUNTS, most: float = 1.0) -> Controller:
    """Makes PWM control: the policy commands the motors at 100 Hz.

    Args:
        action_rate: actions a second [Hz].
        full_scale_counts: see `ControlInterface`.
        most: see `interface.pwm`.

    Raises:
        InputError: a number is not what it should be.

    Source: Gronauer et al. 2022, sec. Motor Model and sec. Control Structures.
    """
    return controller_for(interfaces.pwm(action_rate, full_scale_counts, most))


def attitude_rate(
    firmware: str = "2026.08",
    action_rate: int = 50,
    highest_rate: float = HIGHEST_RATE_DEG,
    full_scale_counts: float = COUNTS,
) -> Controller:
    """Makes attitude-rate control: thrust and body rates at 50 Hz, which PIDs follow at 500 Hz.

    The thrust is 0.5 + 0.5 a_0 of full thrust; roll, pitch and yaw rate are 60 deg/s times a_1,
    a_2, a_3, with a clipped to [-1, 1]. The firmware does not follow a yaw rate itself but the yaw
    that it leads to.

    Args:
        firmware: `"2021.10"` or `"2026.08"`.
        action_rate: actions a second [Hz]; the authors trained at 100 and flew at 50.
        highest_rate: body rate [deg/s] that an action of 1 asks for.
        full_scale_counts: see `ControlInterface`.

    Raises:
        InputError: there is no such firmware, the action rate does not divide 500 Hz, or another
            number is not what it should be.

    Source: Gronauer et al. 2022, sec. Control Structures; scales from the authors' code; +-360
    deg/s from sec. Discussion.
    """
    interface = interfaces.attitude_rate(action_rate, highest_rate, full_scale_counts)
    return controller_for(interface, firmware)


def attitude(
    firmware: str = "2026.08",
    action_rate: int = 25,
    full_scale_counts: float = COUNTS,
    hover: float | None = None,
) -> Controller:
    """Makes attitude control: thrust and attitude at 25 Hz, which PIDs follow at 500 Hz.

    The thrust is 3/4 + a_0 / 6 of full thrust; roll, pitch and yaw are 10 deg times a_1, a_2, a_3,
    with a clipped to [-1, 1]. The least thrust lifts a drone whose thrust-to-weight ratio is above
    1.71, which cannot descend, unless the range is set about the share that it hovers at.

    Args:
        firmware: `"2021.10"` or `"2026.08"`.
        action_rate: actions a second [Hz]; the authors trained at 100 and flew at 25.
        full_scale_counts: see `ControlInterface`.
        hover: see `interface.attitude`.

    Raises:
        InputError: there is no such firmware, the action rate does not divide 500 Hz, or another
            number is not what it should be.

    Source: Gronauer et al. 2022, sec. Control Structures; scales from the authors' code.
    """
    return controller_for(interfaces.attitude(action_rate, full_scale_counts, hover), firmware)


CONTROLLERS: dict[str, Callable[..., Controller]] = {name: globals()[name] for name in CONTROLS}
"""The paper's control structures by name, each a function of this module; all take `action_rate`
and `full_scale_counts`, those of the firmware also `firmware`."""


@cache
def _pwm(interface: ControlInterface, firmware: Generation) -> Controller:
    return driven(interface, lambda memory, command, *_: (memory, command))


@cache
def _attitude_rate(
    interface: ControlInterface,
    firmware: Generation,
    mixer: Mixer | None = None,
    platform: Platform = USUAL,
) -> Controller:
    def drive(
        memory: RateMemory,
        rate_setpoint: Float[Array, "4"],
        measurement: Measurement,
        setpoint: Float[Array, "3"],
    ) -> tuple[RateMemory, Float[Array, "4"]]:
        yaw, rates = (
            jnp.degrees(rotations.heading(measurement.quaternion)),
            each(jnp.degrees, measurement.body_rates),
        )
        memory, motors = rate_tick(
            memory, rate_setpoint[0], rate_setpoint[1:], yaw, rates, firmware, mixer, platform
        )
        return memory, _shares(motors, interface)

    def taking_over(hovers: Float[Array, "4"], measurement: Measurement) -> RateMemory:
        yaw = jnp.degrees(rotations.heading(measurement.quaternion))
        rate = balancing(hovers * interface.full_scale_counts, mixer, platform)
        return rates_switched_on()._replace(rate=rate, heading=yaw, first=jnp.zeros((), bool))

    return driven(
        interface,
        drive,
        _pid_rate(interface),
        rates_switched_on,
        firmware_units(interface),
        partial(_attitude_rate, interface, firmware),
        taking_over if firmware == "2021.10" else None,
    )


@cache
def _attitude(
    interface: ControlInterface,
    firmware: Generation,
    mixer: Mixer | None = None,
    platform: Platform = USUAL,
) -> Controller:
    mode: Any = np.array([DISABLE] * 3 + [ABSOLUTE] * 3, np.int32)

    def drive(
        memory: Memory,
        attitude_setpoint: Float[Array, "4"],
        measurement: Measurement,
        setpoint: Float[Array, "3"],
    ) -> tuple[Memory, Float[Array, "4"]]:
        target = NOTHING._replace(
            mode=mode, attitude=attitude_setpoint[1:], thrust=attitude_setpoint[0]
        )
        memory, motors = tick(
            memory, target, sensed(measurement), firmware, False, mixer=mixer, platform=platform
        )
        return memory, _shares(motors, interface)

    def taking_over(hovers: Float[Array, "4"], measurement: Measurement) -> Memory:
        rate = balancing(hovers * interface.full_scale_counts, mixer, platform)
        return switched_on(fixed=True)._replace(rate=rate, mode=jnp.zeros((), jnp.int32))

    return driven(
        interface,
        drive,
        _pid_rate(interface),
        partial(switched_on, fixed=True),
        firmware_units(interface),
        partial(_attitude, interface, firmware),
        taking_over if firmware == "2021.10" else None,
    )


DRIVES: dict[str, Callable[[ControlInterface, Generation], Controller]] = {
    "pwm": _pwm,
    "attitude_rate": _attitude_rate,
    "attitude": _attitude,
}
"""What flies policies that are read from files: a controller by the name of its interface."""


def controller_for(interface: ControlInterface, firmware: str = "2026.08") -> Controller:
    """Returns the controller that does what an interface says.

    Args:
        interface: a policy's.
        firmware: `"2021.10"` or `"2026.08"`, of no consequence to PWM.

    Raises:
        InputError: there is no such firmware, `DRIVES` has no structure of that name, or the action
            rate does not divide the 500 Hz of the PIDs that follow it.
    """
    if interface.name not in DRIVES:
        raise InputError(
            f"control structure {interface.name!r}: not one of {', '.join(DRIVES)}. Give the "
            "controller that the policy was trained for, or enter it in control.DRIVES."
        )
    return DRIVES[interface.name](interface, generation_of(firmware))


def find_controller(name: str, **settings: Any) -> Controller:
    """Returns the control structure of a name, one of `CONTROLLERS` or `MODULE:NAME`.

    One of your own is a controller or what makes one; policies that command it then fly from files.

    Args:
        name: as above.
        settings: of one of `CONTROLLERS`; of the others, only `action_rate` counts.

    Raises:
        InputError: there is no such control structure, or it has the name of another.
    """
    if name in CONTROLLERS:
        return CONTROLLERS[name](**settings)
    part = import_part(name, "control structure")
    own = part if isinstance(part, Controller) or not callable(part) else part()
    if not isinstance(own, Controller):
        raise InputError(f"{name}: is a {type(own).__name__}; expected what control.driven makes.")
    if own.interface.name in CONTROLLERS:
        raise InputError(
            f"{name}: its interface has the name of another, {own.interface.name}. Rename it."
        )
    DRIVES[own.interface.name] = lambda interface, firmware: own._replace(interface=interface)
    return own.acting_at(settings.get("action_rate", own.interface.rate))


def firmware_units(interface: ControlInterface) -> Four:
    """Factors from the interface's units to the firmware's: counts, and degrees for radians."""
    scales = {interfaces.THRUST: interface.full_scale_counts}
    degree = float(np.degrees(1.0))
    return cast(Four, tuple(scales.get(unit, degree) for unit in interface.units))


def _shares(motors: Float[Array, "4"], interface: ControlInterface) -> Float[Array, "4"]:
    """Motor commands [counts] as u, which may exceed 1."""
    return motors * (1.0 / interface.full_scale_counts)


def _pid_rate(interface: ControlInterface) -> int:
    if ATTITUDE_RATE % interface.rate:
        raise InputError(
            f"action_rate = {interface.rate} Hz does not divide the PIDs' {ATTITUDE_RATE} Hz. Give "
            "25, 50 or 100."
        )
    return ATTITUDE_RATE


def sensed(measurement: Measurement) -> StateEstimate:
    """Returns a measurement in the firmware's units."""
    attitude = rotations.to_attitude(measurement.quaternion)
    return StateEstimate(
        measurement.position,
        measurement.velocity,
        jnp.degrees(attitude),
        jnp.degrees(measurement.body_rates),
    )
