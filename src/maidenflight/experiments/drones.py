"""Drones and realities by the options of a command."""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np

from maidenflight.errors import InputError
from maidenflight.flights.checkup.result import warning_lines
from maidenflight.flights.reading import read_flights
from maidenflight.identification import drone_file
from maidenflight.identification.drone_file import DroneFile
from maidenflight.identification.likelihood.flight_differences import (
    drone_of_the_day,
    trim_ensemble,
)
from maidenflight.identification.likelihood.observation import BY_MOMENT
from maidenflight.identification.outcome.bounds import must_lie_within_bounds
from maidenflight.inputs import StrPath
from maidenflight.names import ANY, ANY_DAY, POSTERIOR, TRIMS, WIDE
from maidenflight.parameters import DRONES, Parameters
from maidenflight.registry import import_part
from maidenflight.simulator.any_drone import ANY_RANGES, DayToDay, GenericQuadrotor
from maidenflight.simulator.controllers import control
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.controllers.phase_margin import (
    describe_rate_loop,
    most_latency,
    rate_margin,
)
from maidenflight.simulator.physics.battery import COUNTS
from maidenflight.simulator.randomization import (
    Distribution,
    Ensemble,
    randomize,
    relative_box,
    wide_box,
)
from maidenflight.simulator.realities import additions
from maidenflight.simulator.realities.reality import AnyReality, is_drone
from maidenflight.simulator.realities.reality import reality as named_reality
from maidenflight.simulator.realities.virtual_drone import VirtualDrone

BOX_DRONES = 256
"""Drones drawn from a box, of which each predicted flight flies one."""


def distribution_of(
    drone: StrPath | DroneFile, randomization: float | str, controller: Controller
) -> Distribution:
    """Returns drones to train over, simulated in steps that divide the controller's period.

    Args:
        drone: a drone file, its path, or a named drone.
        randomization: half width of the box about the drone as a share of each parameter, or
            `POSTERIOR`, `WIDE`, `ANY_DAY` or `ANY`; or `MODULE:NAME` of a function that makes a
            distribution of the drone.
        controller: its period is what physics steps must divide.
    """
    file = read_file(drone)
    centre = control.in_fitting_steps(file.parameters, controller)
    if randomization == POSTERIOR:
        return file.posterior.ensemble(centre, file.name)
    if randomization in (WIDE, ANY_DAY):
        trims = [file.estimates.get(name) for name in BY_MOMENT]
        deviations = [0.0 if trim is None else trim.between_sd for trim in trims]
        box = wide_box(centre, controller.interface.name, deviations, bool(file.estimates))
        return box if randomization == WIDE else DayToDay(box, _most_later(centre, controller))
    if randomization == ANY:
        return GenericQuadrotor(centre)
    if isinstance(randomization, str):
        return import_part(randomization, "function that makes a distribution of drones")(centre)
    return relative_box(centre, randomization)


def _most_later(drone: Parameters, controller: Controller) -> np.float32:
    """Returns the most latency of any day [s]: no more than the firmware's rate loop bears.

    Of drones that the firmware itself cannot hold policies learn nothing
    (paper/notes/training.md#attitude-rate-by-default).
    """
    most = ANY_RANGES["latency"][1]
    if controller.fitted is not None:
        most = min(most, most_latency(drone, controller.interface.full_scale_counts))
    return np.float32(most)


def read_drone(drone: StrPath, accept_bounds: bool = False) -> DroneFile:
    """Reads a drone to fly or to train for.

    Args:
        drone: TOML file or name.
        accept_bounds: take it even if an identified parameter lies at a bound of its search.

    Raises:
        InputError: it cannot be read, or such a parameter is in it.
    """
    file = drone_file.read(drone)
    if not accept_bounds:
        must_lie_within_bounds(file)
    return file


def describe_loop(file: DroneFile) -> str:
    """Returns a sentence on the phase that the firmware's rate loop has left about a drone."""
    return describe_rate_loop(Path(file.name).name, file.parameters, file.full_scale_counts)


def describe_unstable(
    realities: Sequence[AnyReality], full_scale_counts: float = COUNTS
) -> list[str]:
    """Returns a sentence on each virtual drone that the firmware's rate loop cannot hold."""
    return [
        describe_rate_loop(reality.name, reality.parameters, full_scale_counts)
        for reality in realities
        if isinstance(reality, VirtualDrone)
        and rate_margin(reality.parameters, full_scale_counts).phase < 0.0
    ]


def describe_unknown(file: DroneFile) -> list[str]:
    """Returns what a drone's file does not know of its drone, for users that train for it."""
    if file.name in DRONES:
        return []
    return [*_unidentified(file), *repeat_doubts(file)]


def repeat_doubts(file: DroneFile) -> list[str]:
    """Returns the sure doubts of a drone's file, and how many others `identify` has said."""
    others = [warning for warning in file.warnings if not warning.sure]
    certain = tuple(warning for warning in file.warnings if warning.sure)
    lines = doubts(replace(file, warnings=certain))
    if len(others) < 2:
        return [*lines, *doubts(replace(file, warnings=tuple(others)))]
    name = Path(file.name).name
    return [*lines, f"{name}: {len(others)} doubts of its flights, as identify said, stand in it"]


def doubts(file: DroneFile) -> list[str]:
    """Returns what made the flights or values of a drone's file doubtful, a line each."""
    return [f"{Path(file.name).name}: {line}" for line in warning_lines(file.warnings)]


def _unidentified(file: DroneFile) -> list[str]:
    if not file.estimates:
        return [
            f"{file.name}: no parameter was identified from flights. Policies are trained as if "
            "its values were those of your drone; identify it (maidenflight identify LOGS)."
        ]
    if not file.unidentified:
        return []
    ranges = (
        f"{name} ({low:.3g} to {high:.3g})" for name, (low, high) in file.unidentified.items()
    )
    return [
        f"{file.name}: the flights do not determine {', '.join(ranges)}, SI units. --randomize "
        "posterior trains over these ranges, and over nothing else."
    ]


def find_reality(name: str, accept_bounds: bool = False) -> AnyReality:
    """Returns a reality by name; see `realities.reality.reality`.

    Raises:
        InputError: no such reality, or `read_drone` refuses the drone.
    """
    drone = drone_of(name)
    if os.path.isfile(drone):
        read_drone(drone, accept_bounds)
    return named_reality(name)


def drone_of(name: str) -> str:
    """Returns the drone that a reality is about: `drone.toml` of `virtual:7@drone.toml+10ms`."""
    plain = name if is_drone(name) else additions.split(name)[0]
    return plain.partition("@")[2] or plain


def choose_prediction(drone: StrPath | DroneFile) -> float | str:
    """Returns what predictions are randomized over by default."""
    return TRIMS if set(BY_MOMENT) & set(read_file(drone).estimates) else 0.0


def possible_drones(
    drone: StrPath | DroneFile, randomization: float | str, seed: int, today: StrPath | None = None
) -> Parameters:
    """Returns the drones that predicted flights fly: a point, or drones along a first axis.

    Args:
        drone: a drone file, its path, or a named drone.
        randomization: half width of a box about the drone; `POSTERIOR`: each flight is of another
            posterior sample; `TRIMS`: constant torques differ between flights as between those that
            the drone was identified from.
        seed: random seed.
        today: logs of the day, from which the constant torques and the thrust are estimated.

    Raises:
        InputError: see `drone_of_the_day` and `trim_ensemble`; or a randomization that the day's
            logs do not narrow.
    """
    file = read_file(drone)
    if today is not None:
        if randomization not in (0.0, TRIMS):
            raise InputError(
                f"randomization {randomization} with logs of the day, which fix trims and thrust; "
                f"leave it out, or give {TRIMS} or 0."
            )
        flights = read_flights(today).flights
        parameters, estimates = drone_of_the_day(
            file.parameters, file.estimates, flights, file.name
        )
        file = replace(file, parameters=parameters, estimates=estimates)
    if not randomization:
        return file.parameters
    if randomization == TRIMS:
        return trim_ensemble(file.parameters, file.estimates, file.name).drones
    distribution = distribution_of(file, randomization, control.pwm())
    if isinstance(distribution, Ensemble):
        return distribution.drones
    keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), 1), BOX_DRONES)
    return jax.tree.map(np.asarray, jax.vmap(lambda key: randomize(distribution, key))(keys))


def read_file(drone: StrPath | DroneFile) -> DroneFile:
    """Reads a drone, unless it is read already."""
    return drone if isinstance(drone, DroneFile) else drone_file.read(drone)
