"""`FirmwarePilot`: controllers of the firmware, which follow a reference or a plan's set-points."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import repeat
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from maidenflight import names
from maidenflight.errors import InputError
from maidenflight.flights.flight_plan import FlightPlan
from maidenflight.flights.manoeuvres import RATE as PLAN_RATE
from maidenflight.flying.pilots import Act, Commands, cascade
from maidenflight.flying.scenario import Scenario
from maidenflight.simulator.controllers import mellinger
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.controllers.firmware import LEAST_THRUST_COUNTS
from maidenflight.simulator.controllers.pid import POSITION_RATE, Generation, generation_of
from maidenflight.simulator.controllers.position_pid import EXCITATION, position_pid
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.physics.battery import COUNTS, MOST_COUNTS, law_for
from maidenflight.simulator.realities.reality import MOTORS, POSITION, Reality
from maidenflight.simulator.realities.virtual_drone import VirtualDrone
from maidenflight.simulator.tasks.tasks import Task
from maidenflight.simulator.tasks.trajectories import Trajectory

_Make = Callable[[Trajectory, str, float], Controller]
_MAKERS: tuple[_Make, ...] = (
    lambda _, firmware, counts: position_pid(firmware, counts),
    mellinger.mellinger,
)
CONTROLLERS: dict[str, _Make] = dict(zip(names.CONTROLLERS, _MAKERS, strict=True))
"""What flies: (reference, firmware, counts of full scale) to controllers of the firmware."""
RATE = EXCITATION.rate
"""Commands of the firmware, and rows of a log of a Crazyflie's micro-SD card, a second [Hz]."""
_EVERY = RATE // PLAN_RATE
DITHER_PERIODS = 23
"""Commands of 2 ms for which `dither` holds: no multiple of the rows of slower logs, in which it
would change at rows only."""


@partial(jax.jit, static_argnums=0)
def dither(steps: int, key: Array) -> Float[Array, "K 4"]:
    """Draws signs by which motors are raised or lowered in so many commands, new every 46 ms.

    A PID that follows a slow circle hardly moves its motors, and what it does answers disturbances
    that a replay of its commands cannot know. Excitation from outside the loop is what makes lag
    and latency visible.
    """
    return jax.random.rademacher(key, (steps // DITHER_PERIODS + 1, 4), dtype=jnp.float32)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class FirmwarePilot:
    """A controller of the firmware, whose motors are excited by `dither`."""

    excitation: Float[Any, ""] | Float[Any, "N"] = 0.0
    """By how much of full thrust, all the time or each 10 ms; 0 is the plain controller."""
    setpoints: Float[Any, "N 4"] | None = None
    """Position [m] and yaw [rad] each 10 ms, which the PID follows; none: the task's reference."""
    firmware: Generation = field(default="2021.10", metadata={"static": True})
    controller: str = field(default="pid", metadata={"static": True})
    """A key of `CONTROLLERS`; by set-points only the PID flies."""

    @property
    def full_scale_counts(self) -> float:
        """Those of the firmware's logs."""
        return MOST_COUNTS if self.firmware == "2026.08" else COUNTS

    def environment(self, drone: VirtualDrone, scenario: Scenario) -> Environment:
        """Returns what is simulated: the firmware compensates for the battery."""
        hover = float(dynamics.hover_command(drone.parameters))
        require_zero_order_hold(drone.name, hover, self.full_scale_counts)
        if drone.thrust_law is not None:
            drone = replace(drone, thrust_law=law_for(self.full_scale_counts))
        controller = self._controller_for(scenario.task)
        return drone.environment(scenario.task, controller, changing=scenario.changing)

    def begin(self, env: Environment, key: Array, steps: int) -> tuple[Environment, Act, Array]:
        """Begins a flight in JAX; see `PolicyPilot`."""
        sign_key, key = jax.random.split(key)
        signs, share = dither(steps, sign_key), jnp.asarray(self.excitation)

        def act(_: Array, number: Int[Array, ""]) -> Float[Array, "4"]:
            now = share[number // _EVERY] if share.ndim else share
            return now * signs[number // DITHER_PERIODS]

        own = replace(env, task=self._task(env.task), controller=self._turned(env.controller))
        return own, act, key

    def begin_stepped(
        self, reality: Reality, scenario: Scenario, key: Array
    ) -> tuple[Commands, Array]:
        """Begins a flight, of a reality's own position controller if it takes positions."""
        sign_key, key = jax.random.split(key)
        task = self._task(scenario.task)
        if reality.takes == MOTORS:
            require_zero_order_hold(reality.name, reality.hover, self.full_scale_counts)
            steps = round(scenario.duration * RATE)
            shares = np.repeat(np.float32(self.excitation), steps // np.size(self.excitation))
            signs = np.repeat(np.asarray(dither(steps, sign_key)), DITHER_PERIODS, axis=0)
            actions = iter(shares[:, None] * signs[:steps])
            controller = self._turned(self._controller_for(task))
            return Commands(cascade(controller, lambda *_: next(actions)), RATE, RATE, task), key
        if reality.takes == POSITION and not np.any(self.excitation):
            yaw = repeat(0.0) if self.setpoints is None else iter(np.asarray(self.setpoints)[:, 3])
            fly = lambda _, setpoint: np.append(setpoint, next(yaw))  # noqa: E731
            return Commands(fly, POSITION_RATE, POSITION_RATE, task), key
        raise InputError(
            f"{reality.name} takes {reality.takes!r}, with an excitation of "
            f"{np.max(self.excitation):g}; the firmware's controllers need a reality that takes "
            f"{MOTORS!r}, or {POSITION!r} without excitation (of a plan: without --motors)."
        )

    def _controller_for(self, task: Task) -> Controller:
        make = CONTROLLERS[self.controller]
        return make(task.reference, self.firmware, self.full_scale_counts)

    def _turned(self, controller: Controller) -> Controller:
        """The controller, which turns as the set-points say."""
        if self.setpoints is None:
            return controller
        assert controller.turning is not None, "by set-points only the PID flies"
        table = jnp.asarray(self.setpoints)[:, 3]
        return controller.turning(
            lambda number: table[jnp.clip(number // _EVERY, 0, len(table) - 1)]
        )

    def _task(self, task: Task) -> Task:
        """The task whose reference is the set-points, where there are any."""
        if self.setpoints is None:
            return task
        table = jnp.asarray(self.setpoints)[:, :3]

        def reference(time: Float[Array, ""]) -> Float[Array, "3"]:
            index = jnp.floor(time * PLAN_RATE + 0.01).astype(int)
            return table[jnp.clip(index, 0, len(table) - 1)]

        return task._replace(reference=reference)


def planned(plan: FlightPlan, firmware: str) -> FirmwarePilot:
    """Returns the PID of a firmware that flies a plan.

    Raises:
        InputError: there is no such firmware.
    """
    places, shares = (np.float32(part) for part in (plan.setpoints(), plan.excitation()))
    return FirmwarePilot(shares, places, generation_of(firmware))


_ROOM = 0.05
"""Share of the thrust at hover by which the PID must be able to change it."""


def require_zero_order_hold(name: str, hover_command: float, full_scale_counts: float) -> None:
    """Refuses a drone that the Crazyflie's PID cannot hold at a height.

    Raises:
        InputError: it hovers at less thrust than the PID gives at least, or at more than there is.
    """
    hover = full_scale_counts * hover_command
    if not LEAST_THRUST_COUNTS < (1 - _ROOM) * hover < (1 + _ROOM) * hover < MOST_COUNTS:
        raise InputError(
            f"{name} hovers at {hover:.0f} counts of thrust; the Crazyflie's position PID, "
            f"which records flights, gives {LEAST_THRUST_COUNTS:.0f} to {MOST_COUNTS:.0f}. "
            "Identify it from logs of its own autopilot, or give a reality that flies its own "
            "position controller (docs/evaluation.md)."
        )
