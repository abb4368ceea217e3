"""Drones by the words of a command line: what to train over and what to predict for."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import numpy as np

from maidenflight.errors import InputError
from maidenflight.flights.reading import read_flights
from maidenflight.identification import drone_file
from maidenflight.identification.bounds import must_lie_within_bounds
from maidenflight.identification.drone_file import DroneFile
from maidenflight.identification.ensembles import (
    TRIM,
    drone_of_the_day,
    posterior_ensemble,
    trim_ensemble,
)
from maidenflight.inputs import StrPath
from maidenflight.parameters import Parameters, full_scale_counts
from maidenflight.simulator import additions, control
from maidenflight.simulator.any_drone import AnyDay, AnyDrone
from maidenflight.simulator.battery import COUNTS, PLUS
from maidenflight.simulator.control import Controller
from maidenflight.simulator.plant import RunningPlant
from maidenflight.simulator.randomization import (
    Distribution,
    Ensemble,
    randomize,
    relative_box,
    wide_box,
)
from maidenflight.simulator.reality import AnyReality, is_drone
from maidenflight.simulator.reality import reality as known_reality
from maidenflight.simulator.virtual_drone import VirtualDrone

POSTERIOR = "posterior"
"""Randomize over the posterior samples of an identified drone."""

TRIMS = "trim"
"""Predict for drones whose constant torques differ as between the identified flights."""

WIDE = "wide"
"""Train over drones unlike the identified one too, with all the trims that its flights had."""

ANY = "any"
"""Train over small quadrotors of any make, for policies that find out in flight what they fly."""

ANY_DAY = "any-day"
"""Train over the drone as it may be on any day: `WIDE`, with trims and more that no log told."""

POSSIBLE = 256
"""Drones drawn from a box, of which each predicted flight flies one."""


def randomized(
    drone: StrPath | DroneFile, randomization: float | str, controller: Controller
) -> Distribution:
    """Drones to train over, simulated in steps that divide the controller's period.

    Args:
        drone: a drone file, its path, or a named drone.
        randomization: half width of the box about the drone as a share of each parameter, or
            `POSTERIOR`, `WIDE`, `ANY_DAY` or `ANY`; see `train_for`.
        controller: its period is what physics steps must divide.
    """
    file = _file(drone)
    centre = control.in_fitting_steps(file.parameters, controller)
    if randomization == POSTERIOR:
        return posterior_ensemble(centre, file.posterior, file.name)
    if randomization in (WIDE, ANY_DAY):
        trims = [file.estimates.get(name) for name in TRIM]
        deviations = [0.0 if trim is None else trim.between_sd for trim in trims]
        box = wide_box(centre, controller.interface.name, deviations)
        return box if randomization == WIDE else AnyDay(box)
    if randomization == ANY:
        return AnyDrone(centre)
    return relative_box(centre, float(randomization))


def drone_to_fly(drone: StrPath, accept_bounds: bool = False) -> DroneFile:
    """Reads a drone that is to be flown or trained for.

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


def reality(name: str, accept_bounds: bool = False) -> AnyReality:
    """A reality by name; see `simulator.reality.reality`.

    Raises:
        InputError: no such reality, or `drone_to_fly` refuses the drone.
    """
    drone = _centre(name)
    if Path(drone).is_file():
        drone_to_fly(drone, accept_bounds)
    return known_reality(name)


def _centre(name: str) -> str:
    """The drone that a reality's name is about: `drone.toml` of `virtual:7@drone.toml+10ms`."""
    plain = name if is_drone(name) else additions.split(name)[0]
    return plain.partition("@")[2] or plain


def plant(drone: str, seed: int, compensated: bool = True) -> Callable[[], RunningPlant]:
    """What begins flights of a drone for a firmware that runs elsewhere.

    Args:
        drone: a drone's TOML file or name, or a virtual drone such as `virtual:7`.
        seed: of the noise.
        compensated: whether that firmware compensates for the battery, as today's does by the law
            of the 2.1+ propellers; else PWM is the thrust command.

    Raises:
        InputError: no such drone, or a reality that is no virtual drone or changes in the course of
            a flight.
    """
    found = reality(drone, accept_bounds=True)
    if not isinstance(found, VirtualDrone):
        raise InputError(
            f"{drone}: {found.name} has physics of its own. Give a drone's TOML file, or "
            "virtual:SEED."
        )
    found.must_not_change()
    law = PLUS if compensated and found.thrust_law is not None else None
    own = _centre(drone)
    file = own if Path(own).is_file() else "crazyflie"
    counts = full_scale_counts(file) or COUNTS
    return partial(RunningPlant, replace(found, thrust_law=law), seed, counts)


def usual_randomization(drone: StrPath | DroneFile) -> float | str:
    """What predictions are randomized over unless the user says."""
    return TRIMS if set(TRIM) & set(_file(drone).estimates) else 0.0


def possible_drones(
    drone: StrPath | DroneFile, randomization: float | str, seed: int, today: StrPath | None = None
) -> Parameters:
    """The drones that `predict_with` flies: a point, or drones stacked along a first axis.

    Args:
        drone: a drone file, its path, or a named drone.
        randomization: see `predict_with`.
        seed: random seed.
        today: logs of the day, which tell the constant torques and the thrust.

    Raises:
        InputError: see `drone_of_the_day` and `trim_ensemble`; or a randomization that the day's
            logs do not narrow.
    """
    file = _file(drone)
    if today is not None:
        if randomization not in (0.0, TRIMS):
            raise InputError(
                f"randomization {randomization} with logs of the day, which tell trims and thrust; "
                f"leave it out, or give {TRIMS} or 0."
            )
        told = drone_of_the_day(
            file.parameters, file.estimates, read_flights(today).flights, file.name
        )
        file = replace(file, parameters=told[0], estimates=told[1])
    if not randomization:
        return file.parameters
    if randomization == TRIMS:
        return trim_ensemble(file.parameters, file.estimates, file.name).drones
    distribution = randomized(file, randomization, control.pwm())
    if isinstance(distribution, Ensemble):
        return distribution.drones
    keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), 1), POSSIBLE)
    return jax.tree.map(np.asarray, jax.vmap(lambda key: randomize(distribution, key))(keys))


def _file(drone: StrPath | DroneFile) -> DroneFile:
    return drone if isinstance(drone, DroneFile) else drone_file.read(drone)
