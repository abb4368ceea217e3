"""`FirmwareController`: the controllers of the Crazyflie's firmware as rivals of policies.

`pid` is the cascaded PID with positions alone, as it ignores all else where a position is
commanded. `mellinger` takes the full state of the reference; `mellinger:positions` its positions
alone. All mix for the firmware's X, and none knows the drone that it flies.
"""

from collections.abc import Callable

import numpy as np

from maidenflight.errors import InputError
from maidenflight.flying.pilots import Fly, cascade
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.controllers.mellinger import mellinger
from maidenflight.simulator.controllers.pid import ATTITUDE_RATE, POSITION_RATE
from maidenflight.simulator.controllers.position_pid import position_pid
from maidenflight.simulator.tasks.tasks import Task
from maidenflight.simulator.tasks.trajectories import Trajectory

CONTROLLERS: dict[str, Callable[[Trajectory], Controller]] = {
    "pid": lambda _: position_pid(),
    "mellinger": mellinger,
    "mellinger:positions": lambda _: mellinger(),
}
"""A controller for a reference, by name."""


class FirmwareController:
    """A controller of the firmware; follows the `ForeignPolicy` protocol."""

    rate, command_rate = POSITION_RATE, ATTITUDE_RATE

    def __init__(self, name: str) -> None:
        """Takes it.

        Args:
            name: a key of `CONTROLLERS`.

        Raises:
            InputError: there is no such controller.
        """
        if name not in CONTROLLERS:
            raise InputError(f"{name}: no such controller. Expected {', '.join(CONTROLLERS)}.")
        self.name = name

    def begin(self, hover: float, task: Task) -> Fly:
        """Begins a flight, as switched on; it does not know at what command the drone hovers."""
        controller = CONTROLLERS[self.name](task.reference)
        return cascade(controller, lambda *_: np.zeros(4, np.float32))
