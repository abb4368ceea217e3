"""Flights at the end of training: of the drone, and of others about it that chose nothing.

Episodes of training end after 5 s, and tell no policy that turns away and falls later
(paper/notes/training.md#attitude-rate-by-default).
"""

from collections.abc import Callable, Sequence
from functools import cache
from itertools import chain, product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from maidenflight.flying.engine import fly_all
from maidenflight.flying.pilots import PolicyPilot
from maidenflight.flying.rows import SimulatedFlight
from maidenflight.flying.scenario import Scenario
from maidenflight.parameters import Parameters, replace
from maidenflight.policy import Policy
from maidenflight.simulator.any_drone import MOST_THRUST
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.controllers.phase_margin import rate_margin
from maidenflight.simulator.physics.balance import balanced_shares
from maidenflight.simulator.physics.battery import law_for
from maidenflight.simulator.realities.virtual_drone import VARIANTS, VirtualDrone, virtual_drone
from maidenflight.simulator.tasks.failures import (
    LOST,
    REACHED,
    TAKE_OFF_MAX_POSITION_ERROR_M,
    ZERO_SHOT,
    Guard,
)
from maidenflight.simulator.tasks.tasks import Task

FLIGHT_S = 20.0
"""How long a flight lasts [s]; ours."""
SEEDS = (101, 102, 103)
"""Of drones of each variant about the one trained for; ours, and used for nothing else."""
ITSELF = "itself"
_AT_ONCE = 16
"""Policies whose flights are simulated together: as much memory as training takes."""


class FinalFlight(NamedTuple):
    """How a policy flew a drone."""

    kind: str
    """`ITSELF` or a variant of virtual drones."""
    reality: str
    """Its name."""
    seconds: float
    """Until a guard ended it, at most `FLIGHT_S`."""
    end_reason: str
    """One of `failures.END_REASONS`."""
    position_error: float
    """Mean distance from the set-point until then [m], by the estimate where that drifts."""
    lack: str = ""
    """Why no policy may be expected to hold this drone, where the flight ended early."""

    @property
    def lasts(self) -> bool:
        """Whether no guard ended it."""
        return self.end_reason == REACHED

    @property
    def is_fault(self) -> bool:
        """Whether it ended early on a drone that lacks nothing."""
        return not self.lasts and not self.lack


def find_drones(name: str, drone: Parameters, full_scale_counts: float) -> list[VirtualDrone]:
    """Returns a drone and those about it of `SEEDS` in each variant, behind the same firmware.

    Args:
        name: of the drone.
        drone: a point.
        full_scale_counts: of its thrust commands.
    """
    law = law_for(full_scale_counts)
    others = [virtual_drone(seed, kind, drone, law) for kind, seed in product(VARIANTS, SEEDS)]
    step = others[0].parameters.time_step
    itself = VirtualDrone(name, replace(drone, time_step=step), thrust_law=others[0].thrust_law)
    return [itself, *others]


def describe_lack(drone: Parameters, controller: Controller) -> str:
    """Returns what a drone lacks to be held, if anything: thrust, or phase of the firmware's loop.

    Args:
        drone: a point.
        controller: by which policies fly it.
    """
    share = float(jnp.max(_shares(drone)))
    lacking = [f"hovering takes {share:.2f} of a rotor's thrust"] if share > MOST_THRUST else []
    if controller.fitted is not None:
        phase = np.degrees(rate_margin(drone, controller.interface.full_scale_counts).phase)
        lacking += [f"the rate loop has {phase:.0f} deg of phase"] if phase < 0.0 else []
    return " and ".join(lacking)


_shares = jax.jit(balanced_shares)


def fly_drones(
    drones: Sequence[VirtualDrone],
    policies: Sequence[Policy],
    task: Task,
    controller: Controller,
    key: Array,
) -> list[list[FinalFlight]]:
    """Flies each drone once by each policy, from hover near the reference's start.

    Args:
        drones: see `find_drones`.
        policies: of one kind.
        task: what they follow.
        controller: their control structure.
        key: random key; all policies meet the same noise.

    Returns:
        The flights of each policy, in the order of the drones.
    """
    latest = max(drones, key=lambda drone: float(drone.parameters.estimator_delay))
    parameters, keys = [drone.parameters for drone in drones], jax.random.split(key, len(drones))
    lack_of = cache(lambda number: describe_lack(parameters[number], controller))

    def judge(number: int, flight: SimulatedFlight) -> FinalFlight:
        lasts, name = flight.end_reason == REACHED, drones[number].name
        return FinalFlight(
            name.partition(":")[0] if number else ITSELF,
            name,
            flight.duration,
            flight.end_reason,
            float(np.mean(flight.excursion.position_error)),
            "" if lasts else lack_of(number),
        )

    flights: list[list[FinalFlight]] = []
    for first in range(0, len(policies), _AT_ONCE):
        some = policies[first : first + _AT_ONCE]
        pilots = [PolicyPilot(policy, controller) for policy in some for _ in drones]
        scenario = Scenario(task, FLIGHT_S, drones=parameters * len(some))
        simulated = fly_all(latest, pilots, scenario, jnp.tile(keys, len(some)), _guard_of(task))
        judged = [judge(number % len(drones), flight) for number, flight in enumerate(simulated)]
        flights += [judged[at : at + len(drones)] for at in range(0, len(judged), len(drones))]
    return flights


def fly_about(
    name: str,
    drone: Parameters,
    full_scale_counts: float,
    task: Task,
    controller: Controller,
    key: Array,
    policies: Sequence[Policy],
) -> list[list[FinalFlight]]:
    """Flies a drone and those about it once by each policy; see `find_drones` and `fly_drones`."""
    drones = find_drones(name, drone, full_scale_counts)
    return fly_drones(drones, policies, task, controller, key)


def _guard_of(task: Task) -> Guard:
    """What ends flights of a task: as of `transfer`, but as the task itself allows more."""
    guard = LOST if task.tilt_margin > np.sin(ZERO_SHOT.tilt) else ZERO_SHOT
    if task.floor is None:
        return guard
    return guard._replace(position_error=TAKE_OFF_MAX_POSITION_ERROR_M)


def train_until_sound(
    train: Callable[[int, Sequence[int] | None], tuple[Policy, ...]],
    fly: Callable[[Sequence[Policy]], list[list[FinalFlight]]],
    first: int,
    most: int,
) -> tuple[tuple[Policy, ...], list[list[FinalFlight]]]:
    """Trains and flies policies, and trains on those that fell on a drone that lacks nothing.

    Args:
        train: (updates, numbers of the policies to train on, or none for all) to all policies.
        fly: see `fly_drones`.
        first: updates before the first flights.
        most: updates of those that are trained on; as many as `first` where none is.

    Returns:
        The policies, and their flights.
    """
    policies = train(first, None)
    flights = fly(policies)
    faulty = [n for n, own in enumerate(flights) if any(flight.is_fault for flight in own)]
    if not faulty or most <= first:
        return policies, flights
    policies = train(most, faulty)
    # All fly again: as many as before need no other program.
    return policies, fly(policies)


def find_falls(flights: Sequence[Sequence[FinalFlight]], drone: str) -> dict[int, str]:
    """Returns a sentence on each policy that fell, where and why, by its number from 1.

    Args:
        flights: see `fly_drones`.
        drone: name of that which was trained for.
    """
    return {
        number: f"policy_{number} falls {'; '.join(map(_tell, lost))}. {_cure(lost, drone)}"
        for number, own in enumerate(flights, 1)
        if (lost := [kind for kind in _by_kind(own) if not all(flight.lasts for flight in kind)])
    }


def _by_kind(flights: Sequence[FinalFlight]) -> list[list[FinalFlight]]:
    return [
        [flight for flight in flights if flight.kind == kind]
        for kind in dict.fromkeys(flight.kind for flight in flights)
    ]


def _tell(flights: Sequence[FinalFlight]) -> str:
    lost = [flight for flight in flights if not flight.lasts]
    seconds = np.mean([flight.seconds for flight in lost])
    reasons = " or ".join(dict.fromkeys(flight.end_reason for flight in lost))
    lacking = dict.fromkeys(f"{flight.reality}: {flight.lack}" for flight in lost if flight.lack)
    why = "".join(f", {reason}" for reason in lacking)
    return (
        f"{flights[0].kind}, {len(lost)} of {len(flights)} flights ({reasons} after {seconds:.1f} s"
        f" in the mean{why})"
    )


def _cure(lost: Sequence[Sequence[FinalFlight]], drone: str) -> str:
    if any(flight.is_fault for flights in lost for flight in flights):
        return "Do not fly it; train on with --resume and more --updates, or fly another."
    return f"No policy could hold these; fly it only if {drone} is as identified."


def describe_flights(flights: Sequence[Sequence[FinalFlight]], drone: str) -> list[str]:
    """Returns lines on how a training's policies fly the drone and others, and on each fall.

    Args:
        flights: see `fly_drones`.
        drone: name of that which was trained for.
    """
    if not flights:
        return []
    parts = "; ".join(map(_summarize, _by_kind([*chain.from_iterable(flights)])))
    line = f"flights of {FLIGHT_S:g} s of {drone} itself and of drones about it: {parts}."
    return [line, *find_falls(flights, drone).values()]


def _summarize(flights: Sequence[FinalFlight]) -> str:
    lasting = [100.0 * flight.position_error for flight in flights if flight.lasts]
    error = f", {min(lasting):.1f} to {max(lasting):.1f} cm" if lasting else ""
    return f"{flights[0].kind} {len(lasting)} of {len(flights)}{error}"
