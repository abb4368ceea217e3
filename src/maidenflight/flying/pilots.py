"""Pilots: policies of ours and of others, and how they begin a flight.

Every pilot commands a `Reality` one command at a time (`begin_stepped`). `PolicyPilot` and
`FirmwarePilot` are pytrees too, which fly many virtual drones at once in JAX (`begin`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import count
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from maidenflight.errors import InputError
from maidenflight.flying.scenario import Scenario
from maidenflight.policy import Actor, Policy
from maidenflight.simulator.controllers import control
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics.battery import COUNTS
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.policy_spec import points_at
from maidenflight.simulator.realities.reality import MOTORS, Reality
from maidenflight.simulator.realities.virtual_drone import VirtualDrone
from maidenflight.simulator.tasks.tasks import Task

Fly = Callable[[Measurement, Float[np.ndarray, "3"]], Float[ArrayLike, "4"]]
"""(measurement, set-point [m]) to four numbers, once a command; it may keep a state."""
Act = Callable[[Float[Array, "20H"], Int[Array, ""]], Float[Array, "4"]]
"""(observation, number of the control period) to action."""


class Commands(NamedTuple):
    """What a pilot gives a reality in one flight."""

    fly: Fly
    """The reality's next command."""
    command_rate: int
    """Commands a second [Hz]."""
    rate: int
    """Set-points, and rows of the log, a second [Hz]."""
    task: Task
    """Whose reference is followed."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class PolicyPilot:
    """A policy of ours, and what carries out its commands."""

    policy: Policy
    controller: Controller = field(metadata={"static": True})

    @property
    def full_scale_counts(self) -> float:
        """Counts that a thrust command of 1 stands for in the log."""
        return self.controller.interface.full_scale_counts

    def environment(self, drone: VirtualDrone, scenario: Scenario) -> Environment:
        """Returns what is simulated."""
        options = {"spec": self.policy.spec, "changing": scenario.changing}
        return drone.environment(scenario.task, self.controller, **options)

    def begin(self, env: Environment, key: Array, steps: int) -> tuple[Environment, Act, Array]:
        """Begins a flight of so many control periods in JAX.

        Returns:
            What is simulated, what acts, and the key of all else that is random.
        """
        return env, lambda observation, _: self.policy(observation), key

    def begin_stepped(
        self, reality: Reality, scenario: Scenario, key: Array
    ) -> tuple[Commands, Array]:
        """Begins a flight, by the reality's own controller if it has the policy's.

        Returns:
            Its commands, and the key of all else that is random.

        Raises:
            InputError: the reality takes other commands.
        """
        actor, calls = Actor(self.policy, reality.hover), count()
        spec, interface, task = self.policy.spec, self.controller.interface, scenario.task

        def decide(measurement: Measurement, setpoint: Float[np.ndarray, "3"]) -> Any:
            ahead = points_at(spec, task.reference, next(calls) / interface.rate)
            return actor.act(measurement, setpoint, ahead)

        if reality.takes == MOTORS:
            fly = cascade(self.controller, lambda *now: decide(*now).action)
            return Commands(fly, self.controller.command_rate, interface.rate, task), key
        if reality.takes == interface.name:
            fly = lambda *now: decide(*now).command  # noqa: E731
            return Commands(fly, interface.rate, interface.rate, task), key
        raise InputError(
            f"{reality.name} takes {reality.takes!r}; expected {MOTORS!r}, or the policies' own "
            f"{interface.name!r}."
        )


@runtime_checkable
class ForeignPolicy(Protocol):
    """A policy that is none of ours; it commands the four motors, one command at a time."""

    @property
    def name(self) -> str:
        """What tables call it."""
        ...

    @property
    def rate(self) -> int:
        """Set-points and rows of the log a second [Hz]."""
        ...

    @property
    def command_rate(self) -> int:
        """Commands a second [Hz], a multiple of `rate`."""
        ...

    def begin(self, hover: float, task: Task) -> Fly:
        """Begins a flight.

        Args:
            hover: thrust command at which the drone hovers.
            task: what it follows; some policies see its velocity.
        """
        ...


@dataclass(frozen=True)
class ForeignPilot:
    """A policy by others."""

    policy: ForeignPolicy
    full_scale_counts: float = COUNTS

    def begin_stepped(
        self, reality: Reality, scenario: Scenario, key: Array
    ) -> tuple[Commands, Array]:
        """Begins a flight; see `PolicyPilot`."""
        policy, task = self.policy, scenario.task
        if reality.takes != MOTORS:
            raise InputError(
                f"{reality.name} takes {reality.takes!r}, but {policy.name} commands the motors."
            )
        fly = policy.begin(reality.hover, task)
        return Commands(fly, policy.command_rate, policy.rate, task), key


AnyPolicy = Policy | ForeignPolicy


def pilots_of(
    policies: Sequence[AnyPolicy], controller: Controller | None = None
) -> list[PolicyPilot | ForeignPilot]:
    """Returns a pilot of each policy.

    Args:
        policies: ours, of one control structure, and others'.
        controller: what carries out commands; `control.controller_for` their interface unless
            given.

    Raises:
        InputError: ours are of different control structures, or the controller is of another
            interface.
    """
    own = [policy for policy in policies if isinstance(policy, Policy)]
    names = sorted({policy.interface.name for policy in own})
    if len(names) > 1:
        raise InputError(
            f"policies of different control structures: {' and '.join(names)}. Fly each by itself."
        )
    counts = own[0].interface.full_scale_counts if own else COUNTS
    return [
        PolicyPilot(policy, _controller_of(policy, controller))
        if isinstance(policy, Policy)
        else ForeignPilot(policy, counts)
        for policy in policies
    ]


def _controller_of(policy: Policy, controller: Controller | None) -> Controller:
    controller = controller or control.controller_for(policy.interface)
    if policy.interface != controller.interface:
        raise InputError(
            f"policies for {policy.interface}, but the controller obeys {controller.interface}. "
            "Give the one that they were trained for."
        )
    return controller


def cascade(
    controller: Controller, act: Callable[[Measurement, Float[np.ndarray, "3"]], Any]
) -> Fly:
    """Returns the motors' commands that a controller makes of actions.

    Args:
        controller: the control structure; its memory stays here, for one flight.
        act: measurement and set-point to action, called at the rate of the controller's interface.
    """
    compiled, every = _compiled(controller), controller.command_rate // controller.interface.rate
    memory, action, calls = controller.init(), np.zeros(4, np.float32), 0

    def fly(measurement: Measurement, setpoint: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4"]:
        nonlocal memory, action, calls
        if calls % every == 0:
            action = np.asarray(act(measurement, setpoint), np.float32)
        calls += 1
        memory, motors = compiled(memory, action, measurement, setpoint)
        return np.asarray(motors)

    return fly


@cache
def _compiled(controller: Controller) -> Any:
    return jax.jit(controller.command)
