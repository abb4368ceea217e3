"""From logs and the policies that flew them to a drone with which these fly alike."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from maidenflight import manifest, parameters, results
from maidenflight.errors import InputError
from maidenflight.experiments.as_flown import controller_as_flown
from maidenflight.flights.reading import Flights
from maidenflight.identification.behaviour import flown_by
from maidenflight.identification.closed_loop import ClosedLoop, Match, match
from maidenflight.identification.drone_file import (
    CLOSED_LOOP,
    DroneFile,
    Estimate,
    Search,
    Source,
)
from maidenflight.identification.estimates import source_of
from maidenflight.inputs import StrPath
from maidenflight.workflow.drones import possible_drones, usual_randomization
from maidenflight.workflow.logs import Reading, Start
from maidenflight.workflow.policies import names, policy_files, read_as


def match_loops(
    logs: StrPath,
    given: Sequence[StrPath],
    seed: int,
    output: StrPath,
    settings: ClosedLoop | None = None,
    *,
    start: Start | None = None,
    reading: Reading | None = None,
    on_step: Callable[[int, int, float], None] | None = None,
) -> tuple[Flights, Match]:
    """Finds the parameters with which policies behave in simulation as they did in logs.

    Writes `output` (TOML): the drone that the search began with, with what was found in place.

    Args:
        logs: a log or a folder, of flights of the policies, among others.
        given: policy files and folders, ours and the authors'.
        seed: random seed.
        output: the file.
        settings: how much is simulated.
        start: the identified drone.
        reading: of the logs.
        on_step: see `match`.

    Raises:
        InputError: logs or policies are refused, or none of the policies flew one of the logs.
    """
    settings = settings or ClosedLoop()
    reading, start = reading or Reading(), start or Start()
    begun = start.read()
    files = policy_files(given)
    policies = dict(zip(names(files), (read_as(path, None) for path in files), strict=True))
    flights = reading.flights(logs, 0)
    flown = flown_by(flights.flights, policies)
    if not flown:
        raise InputError(
            f"{logs}: none of {len(policies)} policies gives the commands of any of "
            f"{len(flights)} flights. Give the policies that flew, and logs at their rate that "
            "hold the estimates which the policies saw."
        )
    found = match(
        flown,
        policies,
        possible_drones(begun, usual_randomization(begun), seed),
        jax.random.key(seed),
        settings,
        controller_as_flown,
        on_step,
    )
    own = [start.drone] if Path(start.drone).is_file() else []
    made = results.record(
        seed=seed,
        inputs=[*flights.paths, *files, *own],
        settings={
            "start": Path(start.drone).name,
            "mass": start.mass,
            "objective": CLOSED_LOOP,
            **dataclasses.asdict(settings),
            **reading.settings,
        },
    )
    used = [flight for own in flown.values() for flight in own]
    _drone_file(begun, found, source_of(used), made).write(output)
    read: manifest.Files = {"logs": flights.paths, "policies": files, "drone": own}
    manifest.append(output, "identify", {"drone": [output]}, made, read)
    return flights, found


def _drone_file(
    begun: DroneFile, found: Match, source: Source, made: Mapping[str, Any]
) -> DroneFile:
    """The drone file that the search began with, with what was found in place."""
    estimates, posterior = dict(begun.estimates), dict(begun.posterior)
    for name, (value, error) in found.found.items():
        old = estimates.get(name)
        ends = max(value - 1.96 * error, 0.0), value + 1.96 * error
        between = 0.0 if old is None else old.between_sd
        estimates[name] = Estimate(value, ends, (value,), between)
        if name in posterior:
            drawn = posterior[name]
            unit = (drawn - drawn.mean()) / (drawn.std() or 1.0)
            posterior[name] = np.maximum(value + error * unit, 0.0)
    return dataclasses.replace(
        begun,
        parameters=parameters.replace(
            begun.parameters,
            **{name: np.float32(value) for name, (value, _) in found.found.items()},
        ),
        estimates=estimates,
        posterior=posterior,
        source=begun.source or source,
        search=Search(CLOSED_LOOP, found.cost[1], found.flights, found.evaluations),
        record=made,
    )
