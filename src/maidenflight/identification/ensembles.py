"""Drones to randomize over, from the tables that an identification leaves in a TOML file."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import stats
from scipy.stats import qmc

from maidenflight.errors import InputError
from maidenflight.parameters import COMPONENTS, Parameters, check, component, replace
from maidenflight.simulator.randomization import Ensemble, ensemble


def posterior_ensemble(drone: Parameters, table: Mapping[str, Any], where: str) -> Ensemble:
    """Drones from a TOML file's `[posterior]` table.

    Args:
        drone: the drone of the file.
        table: as `Identification.posterior_table` made it.
        where: what errors name.

    Raises:
        InputError: the table is missing or makes no sense, or a drone in it is outside its physical
            range.
    """
    names, draws = (
        (table.get("names"), table.get("draws")) if isinstance(table, Mapping) else (None, None)
    )
    try:
        with np.errstate(
            over="ignore"
        ):  # what float32 cannot hold is infinite, and refused as that
            values = np.array(draws, np.float32)
    except (TypeError, ValueError):
        values = np.empty((0, 0), np.float32)
    known = (
        names
        if isinstance(names, list)
        and all(isinstance(name, str) and name in COMPONENTS for name in names)
        else []
    )
    if (
        values.ndim != 2
        or not known
        or values.shape[1] != len(known)
        or len(set(known)) < len(known)
        or len(values) == 0
    ):
        raise InputError(
            f"{where}: no usable [posterior] table (names, draws). Make the file with: "
            f"maidenflight identify LOGS -o {where}."
        )
    drones = [
        check(replace(drone, **dict(zip(known, row, strict=True))), f"{where} [posterior] draw {i}")
        for i, row in enumerate(values, 1)
    ]
    return ensemble(drones)


TRIM = ("torque_bias_x", "torque_bias_y", "torque_bias_z")
"""Constant torques: how the battery sits and the propellers are mounted, which people change
between flights."""


def trim_ensemble(
    drone: Parameters, table: Mapping[str, Any], where: str, count: int = 256
) -> Ensemble:
    """Drones whose constant torques differ from each other as those of the identified flights did.

    Args:
        drone: the drone of the file.
        table: the file's `[identification]`, with a value and a spread of each identified
            parameter.
        where: what errors name.
        count: of drones, always the same ones.

    Raises:
        InputError: no spread of a constant torque is told, or what is told makes no sense.
    """
    told = {name: table[name] for name in TRIM if isinstance(table.get(name), Mapping)}
    try:
        spreads = np.array([float(told[name]["spread"]) for name in told])
    except (KeyError, TypeError, ValueError):
        spreads = np.empty(0)
    if len(spreads) == 0 or not np.all(np.isfinite(spreads) & (spreads >= 0)):
        raise InputError(
            f"{where}: its [identification] does not tell how trims ({', '.join(TRIM)}) differ "
            "from flight to flight. Identify it from"
            " flights by likelihood, or fly the drone as it is."
        )
    # Evenly spread points stand for the distribution better than as many random ones.
    normal = stats.norm.ppf(
        qmc.Sobol(len(told), rng=np.random.default_rng(0)).random(count).clip(1e-6, 1 - 1e-6)
    )
    drones = [
        check(
            replace(
                drone,
                **{
                    name: np.float32(component(drone, name) + change)
                    for name, change in zip(told, row, strict=True)
                },
            ),
            where,
        )
        for row in spreads * normal
    ]
    return ensemble(drones)
