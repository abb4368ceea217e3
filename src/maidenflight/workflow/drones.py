"""Drones by the words of a command line: what to train over and what to predict for."""

import tomllib
from pathlib import Path
from typing import Any

import jax
import numpy as np

from maidenflight import parameters
from maidenflight.identification.ensembles import TRIM, posterior_ensemble, trim_ensemble
from maidenflight.inputs import StrPath
from maidenflight.parameters import Parameters
from maidenflight.simulator import control
from maidenflight.simulator.control import Controller
from maidenflight.simulator.randomization import (
    Distribution,
    Ensemble,
    randomize,
    relative_box,
    wide_box,
)

POSTERIOR = "posterior"
"""Randomize over the drones that the flights of an identified drone leave possible."""

TRIMS = "trim"
"""Predict for drones whose constant torques differ as they did between the flights that the drone
was identified from."""

WIDE = "wide"
"""Train over drones unlike the identified one too, with all the trims that its flights had."""

POSSIBLE = 256
"""Drones drawn from a box, of which each predicted flight flies one."""


def randomized(drone: StrPath, randomization: float | str, controller: Controller) -> Distribution:
    """Drones to train over, simulated in steps that divide the controller's period.

    See `train_for`.
    """
    centre = control.in_fitting_steps(parameters.read(drone), controller)
    if randomization == POSTERIOR:
        return posterior_ensemble(centre, table(drone, "posterior"), str(drone))
    if randomization == WIDE:
        known = table(drone, "identification")
        return wide_box(
            centre, controller.name, [known.get(name, {}).get("spread", 0.0) for name in TRIM]
        )
    return relative_box(centre, float(randomization))


def usual_randomization(drone: StrPath) -> float | str:
    """What predictions are randomized over where nobody says."""
    told = table(drone, "identification")
    return TRIMS if any("spread" in told.get(name, {}) for name in TRIM) else 0.0


def possible_drones(drone: StrPath, randomization: float | str, seed: int) -> Parameters:
    """What `randomization` makes of a drone, as `predict_with` understands it: a point, or drones
    stacked along a first axis.
    """
    if not randomization:
        return parameters.read(drone)
    if randomization == TRIMS:
        return trim_ensemble(
            parameters.read(drone), table(drone, "identification"), str(drone)
        ).drones
    distribution = randomized(drone, randomization, control.pwm())
    if isinstance(distribution, Ensemble):
        return distribution.drones
    keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), 1), POSSIBLE)
    return jax.tree.map(np.asarray, jax.vmap(lambda key: randomize(distribution, key))(keys))


def table(drone: StrPath, title: str) -> dict[str, Any]:
    """A further table of a drone's TOML file.

    Empty where it has none, or the drone is a named one.
    """
    return (
        tomllib.loads(Path(drone).read_text(encoding="utf-8")).get(title, {})
        if Path(drone).is_file()
        else {}
    )
