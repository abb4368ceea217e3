"""Inertia about z and what yaw shows only as shares of it.

Torques about z turn the drone by their share of that inertia, which no flight shows by itself. It
is taken in the start's ratio to those about x and y, as well as that ratio is known of any drone.

Gyroscopic coupling of roll and pitch shows it in flights without noise alone, and beside yaw, whose
torques are then the start's: what is found so is their share, too.
"""

from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from maidenflight.identification.uncertainty import RESAMPLES
from maidenflight.identification.unknowns import INERTIA, RATIO_SD
from maidenflight.parameters import Parameters, component, replace

ABOUT_Z = ("torque_to_thrust", "rotor_momentum", "torque_bias_z")
"""Parameters that yaw shows, as shares of the inertia about z."""


class AboutZ(NamedTuple):
    """A drone with the inertia about z that belongs to it."""

    drone: Parameters
    draws: dict[str, Float[np.ndarray, "N"]]
    """Samples of the posterior by parameter, SI units."""
    spread: dict[str, float]
    """Standard deviation between segments of flight by parameter, SI units."""
    notes: tuple[str, ...]


def with_inertia_z(
    start: Parameters,
    drone: Parameters,
    draws: Mapping[str, Float[np.ndarray, "N"]],
    spread: Mapping[str, float],
    unidentifiable: Collection[str],
    generator: np.random.Generator,
) -> AboutZ:
    """Returns what was found with the inertia about z, and what yaw shows, in proportion.

    Args:
        start: whose ratio of inertia is taken.
        drone: what was found with the start's inertia about z, or a fitted one.
        draws: its posterior, `RESAMPLES` by parameter.
        spread: between segments of flight.
        unidentifiable: parameters that keep the start's value.
        generator: random numbers.
    """
    identified = draws.keys() - set(unidentifiable)
    is_fitted = "inertia_z" in identified
    # Yaw told the fitted inertia as a share of the torque, be that the start's.
    names = [
        name for name in ABOUT_Z if name in identified or (is_fitted and name == "torque_to_thrust")
    ]
    if not is_fitted and (not names or "inertia_z" in draws):
        return AboutZ(drone, dict(draws), dict(spread), ())
    if not is_fitted and identified.isdisjoint(INERTIA):
        note = "yaw shows its torques only as shares of inertia_z, which is the start's"
        return AboutZ(drone, dict(draws), dict(spread), (note,))
    first, here = (
        np.array([float(component(parameters, name)) for name in INERTIA])
        for parameters in (start, drone)
    )
    level = sum(draws.get(name, value) for name, value in zip(INERTIA, here, strict=True))
    doubt = np.exp(RATIO_SD * generator.standard_normal(RESAMPLES))
    factor, best = level / first.sum() * doubt, float(here.sum() / first.sum())
    about_z = float(component(start, "inertia_z"))
    fitted = float(component(drone, "inertia_z")) / about_z
    share = draws["inertia_z"] / about_z if is_fitted else fitted
    draws = dict(draws) | {
        name: factor / share * draws.get(name, float(component(drone, name))) for name in names
    }
    draws["inertia_z"] = about_z * factor
    spread = dict(spread) | {name: best / fitted * spread.get(name, 0.0) for name in names}
    level_spread = np.linalg.norm([spread.get(name, 0.0) for name in INERTIA])
    spread["inertia_z"] = about_z * float(level_spread / first.sum())
    changes = {name: np.float32(best / fitted * float(component(drone, name))) for name in names}
    changes["inertia_z"] = np.float32(best * about_z)
    note = (
        f"yaw shows its torques only as shares of inertia_z, which is taken as "
        f"{about_z / first.sum():.3g} times inertia_x plus inertia_y, as in the start, give or "
        f"take {RATIO_SD:.0%}"
    )
    return AboutZ(replace(drone, **changes), draws, spread, (note,))
