"""Drones to randomize over: posterior samples, or trims as they differed between flights."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from scipy import stats
from scipy.stats import qmc

from maidenflight.errors import InputError
from maidenflight.identification.drone_file import Estimate
from maidenflight.parameters import Parameters, check, component, replace
from maidenflight.simulator.randomization import Ensemble, ensemble

TRIM = ("torque_bias_x", "torque_bias_y", "torque_bias_z")
"""Constant torques: how the battery sits and the propellers are mounted, which people change
between flights."""


def posterior_ensemble(
    drone: Parameters, samples: Mapping[str, Float[np.ndarray, "N"]], where: str
) -> Ensemble:
    """Drones with the values of posterior samples in place.

    Args:
        drone: the identified drone.
        samples: see `DroneFile.posterior`.
        where: the drone's file, for errors.

    Raises:
        InputError: there are no samples, or one is outside its physical range.
    """
    if not samples:
        raise InputError(
            f"{where}: no [posterior] to draw drones from. Make the file with: maidenflight "
            f"identify LOGS -o {where}."
        )
    rows = np.stack(list(samples.values()), axis=1).astype(np.float32)
    drones = [
        check(replace(drone, **dict(zip(samples, row, strict=True))), f"{where} [posterior] {i}")
        for i, row in enumerate(rows, 1)
    ]
    return ensemble(drones)


def trim_ensemble(
    drone: Parameters, estimates: Mapping[str, Estimate], where: str, count: int = 256
) -> Ensemble:
    """Drones whose constant torques differ as those of the identified flights did.

    Args:
        drone: the identified drone.
        estimates: see `DroneFile.estimates`.
        where: the drone's file, for errors.
        count: of drones, always the same ones.

    Raises:
        InputError: no constant torque was identified, or a drone is outside its physical range.
    """
    names = [name for name in TRIM if name in estimates]
    if not names:
        raise InputError(
            f"{where}: none of {', '.join(TRIM)} was identified, so it is not known how trims "
            "differ from flight to flight. Identify it from flights by likelihood, or choose "
            "another randomization."
        )
    deviations = np.array([estimates[name].between_segment_sd for name in names])
    # A low-discrepancy sequence represents the distribution better than as many random points.
    sobol = qmc.Sobol(len(names), rng=np.random.default_rng(0)).random(count)
    drones = []
    for row in deviations * stats.norm.ppf(sobol.clip(1e-6, 1 - 1e-6)):
        changes = zip(names, row, strict=True)
        values = {name: np.float32(component(drone, name) + change) for name, change in changes}
        drones.append(check(replace(drone, **values), where))
    return ensemble(drones)
