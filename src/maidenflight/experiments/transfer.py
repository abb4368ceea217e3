"""`transfer`: zero-shot flights of policies in realities, and the guards that end them.

Source of the experiment and its guards: Gronauer et al. 2022, sec. Zero-Shot Experiments.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import count
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import polars
from jaxtyping import Array, Float

from maidenflight.errors import InputError
from maidenflight.flights import flying
from maidenflight.flights.flying import Pilot, Rows
from maidenflight.flights.log import Flight
from maidenflight.foreign_policy import ForeignPolicy
from maidenflight.parameters import Parameters
from maidenflight.policy import Act, Actor, Policy
from maidenflight.simulator import control, rotations, tasks
from maidenflight.simulator.battery import Supply
from maidenflight.simulator.control import Controller
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.failures import MAX_POSITION_ERROR_M
from maidenflight.simulator.policy_spec import PolicySpec, points_at
from maidenflight.simulator.reality import MOTORS, AnyReality, Reality, Truth, checked
from maidenflight.simulator.sensors import Measurement
from maidenflight.simulator.stepped import Stepped
from maidenflight.simulator.tasks import Task
from maidenflight.simulator.virtual_drone import Later, VirtualDrone

MAX_DURATION_S = 20.0
"""Time after which a flight is stopped [s]."""
MAX_TILT_RAD = np.radians(30.0)
"""Roll or pitch at which the backup PID takes over [rad]."""
MAX_BODY_RATE_RAD_S = np.radians(800.0)
"""Roll or pitch rate at which it takes over [rad/s]."""
TIME_LIMIT = "time limit"
"""End reason of a flight in which no guard trips."""


@dataclass(frozen=True)
class Transfer:
    """Results of zero-shot flights."""

    table: polars.DataFrame
    """One row a flight: flight, policy, reality, trial, duration [s], end_reason, position_error
    [m], command_change and at_limits of `activity`."""
    flights: tuple[Flight, ...]
    """Their logs, in the table's order, each up to its end."""


LIMIT_CYCLE = 0.15
"""Change of commands in 10 ms [-] above which a flight is a limit cycle: motors that are thrown
between their limits. Policies identified from flights of their drone have 0.001 to 0.05."""
_AT_LIMIT = 0.001
"""Distance from 0 or 1 within which a command is at its limit [-]."""


def activity(flight: Flight) -> dict[str, float]:
    """How much the motors are asked to do.

    Returns:
        `command_change`, the mean |u_t - u_(t-1)| of the logged commands in 10 ms [-], and
        `at_limits`, the share of commands that are 0 or at least 1 [-]; NaN of a single row.
    """
    command = flight.command.astype(float)
    change = np.abs(np.diff(command, axis=0))
    if not len(change):
        return {"command_change": float("nan"), "at_limits": float("nan")}
    limits = (command <= _AT_LIMIT) | (command >= 1.0 - _AT_LIMIT)
    return {
        "command_change": round(float(np.mean(change)) * 0.01 / flight.period, 6),
        "at_limits": round(float(np.mean(limits)), 6),
    }


def guards(
    position: Float[np.ndarray, "... 3"],
    attitude: Float[np.ndarray, "... 3"],
    body_rates: Float[np.ndarray, "... 3"],
    setpoint: Float[np.ndarray, "... 3"],
) -> dict[str, Any]:
    """Which guards trip, by the end reason that they give.

    Args:
        position: true position [m].
        attitude: true roll, pitch, yaw [rad].
        body_rates: true [rad/s].
        setpoint: [m].

    Returns:
        Arrays of bool of shape (...), by end reason.
    """
    finite = np.isfinite(np.concatenate([position, attitude, body_rates], axis=-1)).all(axis=-1)
    distance = np.linalg.norm(np.subtract(position, setpoint, dtype=np.float64), axis=-1)
    return {
        "not finite": ~finite,
        "body rate": np.abs(body_rates[..., :2]).max(axis=-1) > MAX_BODY_RATE_RAD_S,
        "tilt": np.abs(attitude[..., :2]).max(axis=-1) > MAX_TILT_RAD,
        "position error": distance > MAX_POSITION_ERROR_M,
    }


def end_of_flight(rows: Rows) -> tuple[int, str]:
    """When a flight ends and why.

    Args:
        rows: one flight, without batch axes, as long as it may last.

    Returns:
        Number of control periods flown, and one of `not finite`, `body rate`, `tilt`, `position
        error`, `time limit`; where guards trip at once, the first of these.
    """
    judged = rows.true_position, rows.true_attitude, rows.true_body_rates, rows.true_setpoint
    tripped = guards(*(np.asarray(values, np.float64) for values in judged))
    first = {reason: int(np.argmax(where)) for reason, where in tripped.items() if where.any()}
    if not first:
        return len(rows.true_position), TIME_LIMIT
    reason = min(first, key=lambda name: first[name])
    return first[reason] + 1, reason


def transfer(
    policies: Sequence[Policy | ForeignPolicy] | Policy | ForeignPolicy,
    realities: Sequence[AnyReality] | AnyReality,
    trials: int = 3,
    key: Array | None = None,
    *,
    task: Task | None = None,
    controller: Controller | None = None,
    duration: float = MAX_DURATION_S,
    names: Sequence[str] | None = None,
) -> Transfer:
    """Flies every policy in every reality.

    Each flight starts from hover within 2 cm of the reference's start, as when a drone hands over
    from its PID. Virtual drones are flown all at once; other realities one flight after another.

    Args:
        policies: policies of one control structure and layer sizes, policies by others beside them,
            or one of either.
        realities: where to fly them; one or more.
        trials: flights of each policy in each reality.
        key: random key; `jax.random.key(0)` unless given.
        task: the circle of the paper unless given.
        controller: what carries out their commands; `control.controller_for` their interface
            unless given.
        duration: longest flight [s].
        names: what the table calls the policies; policy_1, policy_2, ... unless given.

    Raises:
        InputError: no policy, no reality, policies of different kinds, a controller of another
            interface than theirs, or a reality that takes neither motor commands nor those of the
            policies.
    """
    policies = [policies] if isinstance(policies, Policy | ForeignPolicy) else policies
    several: Any = realities if isinstance(realities, list | tuple) else [realities]
    for one in policies:
        if not isinstance(one, Policy | ForeignPolicy):
            raise InputError(
                f"{str(one)[:60]!r} is no Policy; expected what policy_file.read(FILE) gives."
            )
    places = [checked(one) for one in several]
    if not policies or not places or trials < 1:
        raise InputError("a transfer needs at least one policy, one reality and one trial.")
    own = [one for one in policies if isinstance(one, Policy)]
    controller = controller_of(own, controller) if own else control.pwm()
    key = jax.random.key(0) if key is None else key
    names = list(names or (f"policy_{number}" for number in range(1, len(policies) + 1)))
    plan = [(policy, trial) for policy in range(len(policies)) for trial in range(trials)]
    counts = controller.interface.full_scale_counts
    table: list[dict[str, Any]] = []
    flights: list[Flight] = []
    for number, reality in enumerate(places):
        keys = jax.random.split(jax.random.fold_in(key, number), len(plan))
        asked = [policies[policy] for policy, _ in plan]
        flown = _fly_plan(reality, asked, controller, task or tasks.circle(), keys, duration)
        for (policy, trial), (rows, logged) in zip(plan, flown, strict=True):
            steps, reason = end_of_flight(rows)
            rows = jax.tree.map(lambda values, end=steps: values[:end], rows)
            error = np.linalg.norm(rows.true_position - rows.true_setpoint, axis=1)
            flight = flying.to_flight(
                rows,
                f"flight_{len(table) + 1:02d}",
                zero_order_hold=logged.zero_order_hold,
                supply=_supply(reality, counts, logged),
                simulated=reality.name,
                period=1 / logged.rate,
            )
            table.append(
                {
                    "flight": len(table) + 1,
                    "policy": names[policy],
                    "reality": reality.name,
                    "trial": trial + 1,
                    "duration": round(steps / logged.rate, 6),
                    "end_reason": reason,
                    "position_error": round(float(np.mean(error, dtype=np.float64)), 6),
                    **activity(flight),
                }
            )
            flights.append(flight)
    return Transfer(polars.DataFrame(table), tuple(flights))


def controller_of(policies: Sequence[Policy], controller: Controller | None) -> Controller:
    """The controller that all policies are for."""
    kinds = {
        "control structure": [policy.interface for policy in policies],
        **{
            field.name: [getattr(policy.spec, field.name) for policy in policies]
            for field in fields(PolicySpec)
        },
    }
    for kind, values in kinds.items():
        if len(set(values)) > 1:
            found = sorted({getattr(value, "name", str(value)) for value in values})
            raise InputError(
                f"policies of different kinds: {kind} {' and '.join(found)}. Fly each kind by "
                "itself."
            )
    interface = policies[0].interface
    controller = controller or control.controller_for(interface)
    if interface != controller.interface:
        raise InputError(
            f"policies for {interface}, but the controller given obeys {controller.interface}. "
            "Give the one that they were trained for."
        )
    return controller


def as_seen_by(policy: Policy, env: Environment) -> Environment:
    """The environment with the observations of a policy."""
    return replace(env, spec=policy.spec)


class _Logged(NamedTuple):
    """How a flight was logged."""

    rate: int
    """Rows a second [Hz]."""
    zero_order_hold: bool
    by_command: bool
    """Whether the log holds commands as they were given, not what a battery made of them."""


def _supply(reality: AnyReality, counts: float, logged: _Logged) -> Supply:
    if isinstance(reality, VirtualDrone) and not logged.by_command:
        return reality.supply(counts)
    return Supply(full_scale_counts=counts)


def _fly_plan(
    reality: AnyReality,
    policies: Sequence[Policy | ForeignPolicy],
    controller: Controller,
    task: Task,
    keys: Array,
    duration: float,
) -> Iterator[tuple[Rows, _Logged]]:
    """The rows of a flight of each policy, with the key of the same place."""
    own = [(one, key) for one, key in zip(policies, keys, strict=True) if isinstance(one, Policy)]
    together = iter(())
    if own and isinstance(reality, VirtualDrone):
        steps = round(duration * controller.interface.rate)
        several, theirs = [one for one, _ in own], jnp.stack([key for _, key in own])
        together = iter(_fly_together(reality, several, controller, task, theirs, steps))
    rate = controller.interface.rate
    held = controller.command_rate == rate
    stepped: Any = reality
    if isinstance(reality, VirtualDrone) and len(own) < len(policies):
        stepped = Stepped(reality)
    for policy, key in zip(policies, keys, strict=True):
        if isinstance(policy, Policy) and isinstance(reality, VirtualDrone):
            yield next(together), _Logged(rate, held, by_command=False)
            continue
        pilot = pilot_of(stepped, policy, controller, task)
        rows = flying.fly_reality(stepped, pilot, task, key, round(duration * pilot.rate), _ended)
        yield rows, _Logged(pilot.rate, pilot.zero_order_hold, by_command=True)


def _fly_together(
    reality: VirtualDrone,
    policies: Sequence[Policy],
    controller: Controller,
    task: Task,
    keys: Array,
    steps: int,
) -> Iterator[Rows]:
    """Flights of policies on a virtual drone, all at once."""
    env = as_seen_by(policies[0], reality.environment(task, controller, changing=True))
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *policies)
    drones = jax.tree.map(
        lambda leaf: np.broadcast_to(leaf, (len(policies), *np.shape(leaf))), reality.parameters
    )
    flown = jax.tree.map(np.asarray, _fly(env, stacked, drones, keys, steps, reality.later))
    for place in range(len(policies)):
        yield jax.tree.map(lambda values, place=place: values[place], flown)


@partial(jax.jit, static_argnums=(0, 4))
def _fly(
    env: Environment,
    policies: Policy,
    drones: Parameters,
    keys: Array,
    steps: int,
    later: Later | None,
) -> Rows:
    during = None if later is None else partial(_changing, later)

    def one(policy: Policy, drone: Parameters, key: Array) -> Rows:
        return flying.fly(env, lambda seen, _: policy(seen), drone, key, steps, during=during)

    return jax.vmap(one)(policies, drones, keys)


def _changing(later: Later, drone: Parameters, elapsed: Float[Array, ""]) -> Parameters:
    """A drone as it is at a time; it changes in the first control period that begins then."""
    # The time is a sum of periods in float32.
    before = elapsed + drone.time_step / 2 < later.at
    return jax.tree.map(lambda new, old: jnp.where(before, old, new), later.parameters, drone)


def _ended(truth: Truth, setpoint: Float[np.ndarray, "3"]) -> bool:
    attitude = np.asarray(_attitude(truth.quaternion))
    return any(guards(truth.position, attitude, truth.body_rates, setpoint).values())


_attitude = jax.jit(rotations.to_attitude)


def pilot_of(
    reality: Reality, policy: Policy | ForeignPolicy, controller: Controller, task: Task
) -> Pilot:
    """What flies a policy in a reality, by its own controller if it has the policy's."""
    if not isinstance(policy, Policy):
        if reality.takes != MOTORS:
            raise InputError(
                f"{reality.name} takes {reality.takes!r}, but {policy.name} commands the motors."
            )
        fly, held = policy.begin(reality.hover, task), policy.command_rate == policy.rate
        return Pilot(fly, policy.command_rate, policy.rate, zero_order_hold=held)
    act = _acting(policy, reality.hover, task)
    if reality.takes == MOTORS:
        return flying.cascade(controller, lambda *now: act(*now).action)
    interface = controller.interface
    if reality.takes == interface.name:
        return Pilot(
            lambda *now: act(*now).command,
            interface.rate,
            interface.rate,
            zero_order_hold=False,
        )
    raise InputError(
        f"{reality.name} takes {reality.takes!r}; expected {MOTORS!r}, or the policies' own "
        f"{interface.name!r}."
    )


def _acting(
    policy: Policy, hover: float, task: Task
) -> Callable[[Measurement, Float[np.ndarray, "3"]], Act]:
    """A policy that begins a task; where it looks ahead, it is shown the task's reference."""
    actor, calls = Actor(policy, hover), count()

    def act(measurement: Measurement, setpoint: Float[np.ndarray, "3"]) -> Act:
        time = next(calls) / policy.interface.rate
        return actor.act(measurement, setpoint, points_at(policy.spec, task.reference, time))

    return act
