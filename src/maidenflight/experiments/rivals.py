"""What the judge flies beside the drone itself: the drone changed, and others than the policies.

Changes are those that no log excludes: a later link, a payload, a motor that is weaker today.
Beside them fly the firmware's controllers, and policies of another drone, as those of a named one
without logs: on both drones, so that one sees what logs gained.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import polars
from jaxtyping import Array

from maidenflight import names
from maidenflight.errors import InputError
from maidenflight.experiments.conditions import Conditions
from maidenflight.experiments.flight_times import predict_flight_times
from maidenflight.experiments.transfer import fly_firmware
from maidenflight.policy import Policy
from maidenflight.simulator.realities import additions
from maidenflight.simulator.realities.virtual_drone import VirtualDrone
from maidenflight.simulator.tasks.failures import ERRORS, REACHED
from maidenflight.simulator.tasks.tasks import Task, find_task

FLIGHTS = 4
"""Of each policy on each drone; ours."""


class PolicySet(NamedTuple):
    """Policies by what tables call them, and what each flies."""

    names: Sequence[str]
    policies: Sequence[Policy]
    tasks: Sequence[str]


def changed_drones(drone: VirtualDrone) -> tuple[list[VirtualDrone], list[str]]:
    """Returns a drone with each of `names.CHANGES`, and notes on what it cannot bear."""
    drones, notes = [], []
    for change in names.CHANGES:
        try:
            drones.append(additions.with_additions(drone, [change]))
        except InputError as error:
            notes.append(str(error))
    return drones, notes


def fly_drones(
    own: PolicySet,
    drones: Sequence[VirtualDrone],
    key: Array,
    duration: float,
    conditions: Conditions,
) -> polars.DataFrame:
    """Flies policies on drones as they are.

    Returns:
        A row a policy and drone: drone, policy, flights, time_limit (how many reached it),
        duration [s], position_error and estimated_error [m], and end_reason, the most frequent.
    """
    parts = []
    for number, drone in enumerate(drones):
        flights = predict_flight_times(
            own.policies,
            drone.parameters,
            jax.random.fold_in(key, 1 + number),
            trials=FLIGHTS,
            duration=duration,
            conditions=conditions,
            names=own.names,
            policy_tasks=[find_task(task) for task in own.tasks],
        )
        parts.append(summarize(flights, drone.name))
    return polars.concat(parts)


def summarize(flights: polars.DataFrame, drone: str) -> polars.DataFrame:
    """Returns the rows of `fly_drones` of one drone's flights."""
    return flights.group_by("policy", maintain_order=True).agg(
        polars.lit(drone).alias("drone"),
        polars.len().alias("flights"),
        (polars.col("end_reason") == REACHED).sum().alias("time_limit"),
        polars.col("duration").mean(),
        polars.col(*ERRORS).mean(),
        polars.col("end_reason").mode().sort().first(),
    )


def fly_controllers(
    controllers: Sequence[str],
    drones: Sequence[VirtualDrone],
    key: Array,
    counts: float,
    task: Task,
    duration: float,
) -> tuple[list[polars.DataFrame], list[str]]:
    """Flies the firmware's controllers on drones; see `fly_firmware`."""
    how: dict[str, Any] = {"counts": counts, "task": task, "duration": duration}
    tables, notes = fly_firmware(controllers, drones, 1, key, **how)
    rows = [summarize(table, str(table["reality"][0])) for table in tables]
    return rows, notes[:1]


def describe_changes(rows: polars.DataFrame, policy: str, named: Mapping[str, str]) -> str:
    """Returns what a policy's flights on changed drones add to a verdict.

    Args:
        rows: see `fly_drones`.
        policy: its name there.
        named: how a sentence calls each drone.
    """
    own = rows.filter(polars.col("policy") == policy).to_dicts()
    bad = [
        f"with {named[row['drone']]} {row['flights'] - row['time_limit']} of {row['flights']} end "
        f"by {row['end_reason']} ({row['duration']:.1f} s in the mean)"
        for row in own
        if row["drone"] in named and row["time_limit"] < row["flights"]
    ]
    lasts = [row["drone"] for row in own if row["time_limit"] == row["flights"]]
    good = [named[drone] for drone in lasts if drone in named]
    parts = [*([f"it lasts also with {', '.join(good)}"] if good else []), *bad]
    return f" {'; '.join(parts).capitalize()}." if parts else ""
