"""Flight plans from files to files: propose one, fly one on a simulated drone."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import jax

from maidenflight import manifest, parameters, results
from maidenflight.errors import InputError
from maidenflight.flights import log, planned, recording
from maidenflight.flights.flight_plan import FlightPlan
from maidenflight.identification import planning
from maidenflight.identification.drone_file import DroneFile
from maidenflight.identification.planning import Planned
from maidenflight.inputs import StrPath
from maidenflight.simulator.reality import AnyReality
from maidenflight.simulator.virtual_drone import VirtualDrone
from maidenflight.workflow.drones import reality


def plan_for(
    drone: str,
    seed: int,
    output: StrPath | None,
    room: tuple[float, float, float],
    seconds: float,
    interest: Sequence[str] | None = None,
    rate: int = recording.RATE,
    motors: bool = False,
    firmware: str = "2021.10",
    accept_bounds: bool = False,
    on_stage: Callable[[int, int, str], None] = lambda done, of, what: None,
) -> Planned:
    """Proposes a flight for a drone and writes it; see `planning.plan`.

    Args:
        drone: TOML file or name, or a virtual drone such as `virtual:7`.
        seed: of the simulated noise and of random steps.
        output: where to write the plan; nowhere unless given.
        room: width, depth, height [m].
        seconds: of flight.
        interest: parameters to tell.
        rate: rows a second of the log [Hz].
        motors: whether motors may be excited.
        firmware: whose PID flies.
        accept_bounds: see `drone_to_fly`.
        on_stage: called with stages done, stages, and what is next.

    Raises:
        InputError: as of `planning.plan`, or no such drone.
        WriteError: the plan cannot be written.
    """
    known = reality(drone, accept_bounds)
    if not isinstance(known, VirtualDrone):
        raise InputError(
            f"{drone}: {known.name} has physics of its own, in which nothing is planned. Give a "
            "drone's TOML file or name, or virtual:SEED."
        )
    found = planning.plan(
        known,
        room,
        seconds,
        jax.random.key(seed),
        interest=interest,
        rate=rate,
        motors=motors,
        firmware=firmware,
        seed=seed,
        held=drone in parameters.DRONES,
        on_stage=on_stage,
    )
    settings = {
        "drone": Path(drone).name,
        "room": list(room),
        "seconds": seconds,
        "for": None if interest is None else list(interest),
        "rate": rate,
        "motors": motors,
        "firmware": firmware,
    }
    made = results.record(
        seed=seed, inputs=[drone] if Path(drone).is_file() else [], settings=settings
    )
    found = replace(found, plan=replace(found.plan, record=made))
    if output is not None:
        found.plan.write(output)
        read = [drone] if Path(drone).is_file() else []
        manifest.append(output, "plan", {"plan": [output]}, made, {"drone": read})
    return found


def record_planned(
    drone: AnyReality,
    plan: FlightPlan,
    seed: int,
    folder: StrPath,
    truth: StrPath,
    count: int,
    rate: int = recording.RATE,
    firmware: str = "2021.10",
) -> list[Path]:
    """Records flights of a plan in a reality, as `record` does: one CSV a flight in `folder`."""
    settings = {
        "reality": drone.name,
        "flights": count,
        "plan": Path(plan.name).name,
        "rate": rate,
        "firmware": firmware,
    }
    inputs = [plan.name] if Path(plan.name).is_file() else []
    made = results.record(seed=seed, inputs=inputs, settings=settings)
    flown = planned.record(drone, plan, jax.random.key(seed), count, rate, firmware)
    if isinstance(drone, VirtualDrone):
        DroneFile(drone.parameters, record=made).write(truth)
    else:
        Path(truth).unlink(missing_ok=True)
    written = [log.write(Path(folder) / f"{flight.name}.csv", flight, made) for flight in flown]
    results.remove_older(written, made)
    files: manifest.Files = {"logs": written, "truth": [truth]}
    manifest.append(folder, "record", files, made, {"plan": inputs})
    return written
