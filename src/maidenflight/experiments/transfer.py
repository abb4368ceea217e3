"""Zero-shot flights: policies fly in realities that they have never seen, and a guard says when
each flight ends.

Source of the experiment and its guards: Gronauer et al. 2022, sec. Zero-Shot Experiments.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import numpy as np
import polars
from jaxtyping import Array

from maidenflight.errors import InputError
from maidenflight.flights import recording
from maidenflight.flights.log import Flight
from maidenflight.flights.recording import Rows
from maidenflight.parameters import Parameters
from maidenflight.policy import Policy
from maidenflight.simulator import control, tasks
from maidenflight.simulator.control import Controller
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.tasks import MAX_POSITION_ERROR_M, Task
from maidenflight.simulator.virtual_drone import VirtualDrone

MAX_DURATION_S = 20.0
"""Time after which a flight is stopped [s]."""
MAX_TILT_RAD = np.radians(30.0)
"""Roll or pitch at which the backup PID takes over [rad]."""
MAX_BODY_RATE_RAD_S = np.radians(800.0)
"""Roll or pitch rate at which it takes over [rad/s]."""


@dataclass(frozen=True)
class Transfer:
    """What came of zero-shot flights."""

    table: polars.DataFrame
    """One row a flight: flight, policy, reality, trial, duration [s], end_reason, position_error
    [m]."""
    flights: tuple[Flight, ...]
    """Their logs, in the table's order, each up to its end."""


@partial(jax.jit, static_argnums=(0, 4))
def _fly(env: Environment, policies: Policy, drones: Parameters, keys: Array, steps: int) -> Rows:
    def one(policy: Policy, drone: Parameters, key: Array) -> Rows:
        return recording.fly(
            env, lambda observation, number: policy(observation), drone, key, steps
        )

    return jax.vmap(one)(policies, drones, keys)


def end_of_flight(rows: Rows, period: float) -> tuple[int, str]:
    """When a flight ends and why.

    Args:
        rows: one flight, without batch axes, as long as it may last.
        period: control period [s].

    Returns:
        Number of control periods flown, and one of `not finite`, `body rate`, `tilt`, `position
        error`, `time limit`; where guards trip at once, the first of these.
    """
    position = np.asarray(rows.true_position, np.float64)
    attitude, rates = (
        np.asarray(rows.true_attitude, np.float64),
        np.asarray(rows.true_body_rates, np.float64),
    )
    distance = np.linalg.norm(position - np.asarray(rows.true_setpoint, np.float64), axis=1)
    guards = {
        "not finite": ~np.isfinite(np.concatenate([position, attitude, rates], axis=1)).all(axis=1),
        "body rate": np.abs(rates[:, :2]).max(axis=1) > MAX_BODY_RATE_RAD_S,
        "tilt": np.abs(attitude[:, :2]).max(axis=1) > MAX_TILT_RAD,
        "position error": distance > MAX_POSITION_ERROR_M,
    }
    first = {reason: int(np.argmax(tripped)) for reason, tripped in guards.items() if tripped.any()}
    if not first:
        return len(distance), "time limit"
    reason = min(first, key=lambda name: first[name])
    return first[reason] + 1, reason


def transfer(
    policies: Sequence[Policy] | Policy,
    realities: Sequence[VirtualDrone] | VirtualDrone,
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
    from its PID.

    Args:
        policies: policies of one control structure and layer sizes, or one.
        realities: where to fly them; one or more.
        trials: flights of each policy in each reality.
        key: random key; `jax.random.key(0)` unless given.
        task: the circle of the paper unless given.
        controller: what their actions mean; the control structure that they name unless given.
        duration: longest flight [s].
        names: what the table calls the policies; policy_1, policy_2, ... unless given.

    Raises:
        InputError: no policy, no reality, or policies of different shapes.
    """
    policies = [policies] if isinstance(policies, Policy) else policies
    realities = [realities] if isinstance(realities, VirtualDrone) else realities
    _check_kinds(policies, Policy, "policy.read(FILE)")
    _check_kinds(
        realities, VirtualDrone, "mf.virtual_drone(7) or mf.VirtualDrone(NAME, PARAMETERS)"
    )
    if not policies or not realities or trials < 1:
        raise InputError("a transfer needs at least one policy, one reality and one trial.")
    shapes = {
        (policy.control, policy.rate, policy.history, policy.layer_sizes) for policy in policies
    }
    if len(shapes) > 1:
        raise InputError(
            f"policies of different kinds ({'; '.join(map(str, sorted(shapes)))}); transfer each "
            "kind by itself."
        )
    controller = controller or control.CONTROLLERS[policies[0].control]()
    if policies[0].rate != controller.action_rate:
        raise InputError(
            f"{policies[0].control} policies of {policies[0].rate} Hz; the controller given, "
            f"{controller.name}, acts at"
            f" {controller.action_rate} Hz. Give the one that they were trained for."
        )
    key = jax.random.key(0) if key is None else key
    names = list(names or (f"policy_{number}" for number in range(1, len(policies) + 1)))
    plan = [(policy, trial) for policy in range(len(policies)) for trial in range(trials)]
    stacked = jax.tree.map(
        lambda *leaves: np.stack(leaves), *(policies[policy] for policy, _ in plan)
    )
    rows: list[dict[str, Any]] = []
    flights: list[Flight] = []
    for number, reality in enumerate(realities):
        env = replace(
            reality.environment(task or tasks.circle(), controller), history=policies[0].history
        )
        drones = jax.tree.map(
            lambda leaf: np.broadcast_to(leaf, (len(plan), *np.shape(leaf))), reality.parameters
        )
        keys = jax.random.split(jax.random.fold_in(key, number), len(plan))
        flown = jax.tree.map(
            np.asarray, _fly(env, stacked, drones, keys, round(duration * policies[0].rate))
        )
        for place, (policy, trial) in enumerate(plan):
            logged, row = _one_flight(
                flown,
                place,
                reality,
                env,
                1 / policies[0].rate,
                f"flight_{len(rows) + 1:02d}",
            )
            rows.append(
                {
                    "flight": len(rows) + 1,
                    "policy": names[policy],
                    "reality": reality.name,
                    "trial": trial + 1,
                    **row,
                }
            )
            flights.append(logged)
    return Transfer(polars.DataFrame(rows), tuple(flights))


def _check_kinds(given: Sequence[Any], kind: type, way: str) -> None:
    for one in given:
        if not isinstance(one, kind):
            raise InputError(f"{str(one)[:60]!r} is no {kind.__name__}; expected what {way} gives.")


def _one_flight(
    flown: Rows, place: int, reality: VirtualDrone, env: Environment, period: float, name: str
) -> tuple[Flight, dict[str, Any]]:
    """The log of one of many flights up to its end, and how it went."""
    steps, reason = end_of_flight(jax.tree.map(lambda values: values[place], flown), period)
    rows = jax.tree.map(lambda values: values[place, :steps], flown)
    error = np.linalg.norm(rows.true_position - rows.true_setpoint, axis=1)
    logged = recording.to_flight(
        rows, name, held=True, has_battery=env.battery, simulated=reality.name, period=period
    )
    row = {
        "duration": round(steps * period, 6),
        "end_reason": reason,
        "position_error": round(float(np.mean(error, dtype=np.float64)), 6),
    }
    return logged, row
