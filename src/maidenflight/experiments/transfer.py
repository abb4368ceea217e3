"""`transfer`: zero-shot flights of policies in realities.

Source of the experiment and its guards: Gronauer et al. 2022, sec. Zero-Shot Experiments.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any

import jax
import numpy as np
import polars
from jaxtyping import Array

from maidenflight import inputs
from maidenflight.errors import InputError
from maidenflight.experiments.policies import read_policies
from maidenflight.flights.log import Flight
from maidenflight.flying.engine import fly_all
from maidenflight.flying.firmware_pilot import FirmwarePilot
from maidenflight.flying.pilots import AnyPolicy, pilots_of
from maidenflight.flying.scenario import Scenario
from maidenflight.inputs import PATHS, StrPath
from maidenflight.names import Firmware
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.physics.battery import COUNTS
from maidenflight.simulator.realities.reality import AnyReality, check_reality
from maidenflight.simulator.tasks import failures, tasks
from maidenflight.simulator.tasks.failures import APP, ZERO_SHOT
from maidenflight.simulator.tasks.tasks import Task

MAX_DURATION_S = 20.0
"""Time after which a flight is stopped [s]."""


@dataclass(frozen=True)
class Transfer:
    """Results of zero-shot flights."""

    table: polars.DataFrame
    """One row a flight: flight, policy, reality, trial, duration [s], end_reason; position_error
    and estimated_error, mean distances from the set-point of the true position and of the drone's
    estimate [m]; command_change and at_limits of `activity`; largest_tilt [rad], largest_body_rate
    [rad/s] and largest_distance [m], of the true state, or by the estimates where these drift."""
    flights: tuple[Flight, ...]
    """Their logs, in the table's order, each up to its end."""

    def __repr__(self) -> str:
        policies, realities = (self.table[name].n_unique() for name in ("policy", "reality"))
        duration, error = (
            float(self.table[name].to_numpy().mean()) for name in ("duration", "position_error")
        )
        return (
            f"<{len(self.flights)} flights of {policies} policies in {realities} realities: "
            f"{duration:.1f} s, {100 * error:.1f} cm from the set-point in the mean>"
        )


LIMIT_CYCLE = 0.15
"""Change of commands in 10 ms [-] above which a flight is a limit cycle: motors that are thrown
between their limits. Policies identified from flights of their drone have 0.001 to 0.05."""
_AT_LIMIT = 0.001
"""Distance from 0 or 1 within which a command is at its limit [-]."""


def activity(flight: Flight) -> dict[str, float]:
    """Returns how much the motors work.

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


def transfer(
    policies: Sequence[AnyPolicy | FirmwarePilot] | AnyPolicy | StrPath,
    realities: Sequence[AnyReality | str] | AnyReality | str = "virtual:7",
    trials: int = 3,
    key: Array | int | None = None,
    *,
    task: Task | None = None,
    controller: Controller | None = None,
    duration: float = MAX_DURATION_S,
    names: Sequence[str] | None = None,
) -> Transfer:
    """Flies every policy in every reality.

    Each flight starts from hover within 2 cm of the reference's start, as when a drone hands over
    from its PID. It ends at `ZERO_SHOT`; of the firmware's controllers, which lag behind, at `APP`.
    Virtual drones fly all at once; other realities one flight after another.

    Args:
        policies: policies of one control structure and layer sizes, policies by others beside them,
            or one of either; or pilots of the firmware, of one controller; or a policy file or a
            folder of them, which fly what they were trained for.
        realities: where to fly them; one or more, or their names.
        trials: flights of each policy in each reality.
        key: random key, or a whole number that makes one.
        task: the circle, from rest, by default.
        controller: what carries out their commands; `control.controller_for` their interface
            by default.
        duration: longest flight [s].
        names: what the table calls the policies; policy_1, policy_2, ... by default.

    Raises:
        InputError: no policy, no reality, policies of different kinds, a controller of another
            interface than theirs, or a reality that takes neither motor commands nor those of the
            policies.
    """
    several: Any = [policies] if isinstance(policies, AnyPolicy | str | PathLike) else policies
    if several and all(isinstance(policy, PATHS) for policy in several):
        files = read_policies(several)
        several, names = files.every, names or files.names
        task = task or tasks.find_task(files.choose_task(None)[0])
    for item in several:
        if not isinstance(item, AnyPolicy | FirmwarePilot):
            raise InputError(
                f"{str(item)[:60]!r} is no Policy; give policies, or their files alone."
            )
    places: Any = realities if isinstance(realities, list | tuple) else [realities]
    places = [check_reality(reality) for reality in places]
    if not several or not places or trials < 1:
        raise InputError("a transfer needs at least one policy, one reality and one trial.")
    by_firmware = isinstance(several[0], FirmwarePilot)
    pilots = list(several) if by_firmware else pilots_of(several, controller)
    key = inputs.random_key(key)
    names = list(names or (f"policy_{number}" for number in range(1, len(pilots) + 1)))
    plan = [(policy, trial) for policy in range(len(pilots)) for trial in range(trials)]
    scenario = Scenario(task or tasks.circle(), duration, changing=True)
    table: list[dict[str, Any]] = []
    flights: list[Flight] = []
    for number, reality in enumerate(places):
        keys = jax.random.split(jax.random.fold_in(key, number), len(plan))
        flown_pilots = [pilots[policy] for policy, _ in plan]
        guard = APP if by_firmware else ZERO_SHOT
        simulated = fly_all(reality, flown_pilots, scenario, keys, guard)
        for (policy, trial), outcome in zip(plan, simulated, strict=True):
            flight = outcome.to_flight(f"flight_{len(table) + 1:02d}")
            excursions = [outcome.rows.excursion(by_estimate) for by_estimate in (False, True)]
            table.append(
                {
                    # A printed table shows the first four and the last four columns.
                    "policy": names[policy],
                    "reality": reality.name,
                    "duration": round(outcome.duration, 6),
                    "end_reason": outcome.end_reason,
                    "flight": len(table) + 1,
                    "trial": trial + 1,
                    **activity(flight),
                    **failures.largest(excursions[outcome.estimated]),
                    **{
                        name: round(float(np.mean(excursion.position_error)), 6)
                        for name, excursion in zip(failures.ERRORS, excursions, strict=True)
                    },
                }
            )
            flights.append(flight)
    return Transfer(polars.DataFrame(table), tuple(flights))


def firmware_pilot(controller: str, counts: float) -> FirmwarePilot:
    """Returns a controller of the firmware whose command of 1 has as much thrust as the policies'.

    Args:
        controller: a name of `CONTROLLERS`.
        counts: of full scale, of the policies; all of them: the firmware is today's.
    """
    firmware: Firmware = "2026.08" if counts > COUNTS else "2021.10"
    return FirmwarePilot(controller=controller, firmware=firmware)


def fly_firmware(
    controllers: Sequence[str],
    realities: Sequence[AnyReality],
    trials: int,
    key: Array,
    counts: float = COUNTS,
    **how: Any,
) -> tuple[list[polars.DataFrame], list[str]]:
    """Flies controllers of the firmware as policies fly, where they can hold the drone.

    Args:
        controllers: names of `CONTROLLERS`.
        realities: as of `transfer`, as the following ones are.
        trials: flights of each.
        key: random key.
        counts: see `firmware_pilot`.
        how: task and duration.

    Returns:
        Tables of flights, and notes on realities where a controller cannot fly.
    """
    tables, notes = [], []
    for name in controllers:
        for reality in realities:
            try:
                pilot, label = firmware_pilot(name, counts), f"{name} (firmware)"
                tables.append(transfer([pilot], reality, trials, key, names=[label], **how).table)
            except InputError as error:
                notes.append(f"the firmware's {name} does not fly in {reality.name}: {error}")
    return tables, notes
