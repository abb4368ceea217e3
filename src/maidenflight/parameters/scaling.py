"""A drone of another mass: the same drone with more or less on it, or a larger or smaller one."""

import numpy as np

from maidenflight.errors import InputError
from maidenflight.parameters.components import check, replace
from maidenflight.parameters.frames import PLACES
from maidenflight.parameters.quantities import Parameters


def with_mass(drone: Parameters, mass: float, name: str) -> Parameters:
    """Returns the same frame and motors with another mass, as of a battery or a deck.

    Inertia is in proportion to the mass, as if it were spread as before, and full thrust stays.

    Args:
        drone: a point.
        mass: [kg].
        name: of the drone, for errors.

    Raises:
        InputError: the motors do not lift the mass, or it is outside its physical range.
    """
    share = mass / float(drone.mass)
    thrust_to_weight = float(drone.thrust_to_weight) / share
    if thrust_to_weight < 1.0:
        lifted = 1e3 * float(drone.mass) * float(drone.thrust_to_weight)
        raise InputError(
            f"a mass of {1e3 * mass:.4g} g is more than the motors of {name} lift, {lifted:.3g} g. "
            "Give another drone, or a TOML file with its thrust_to_weight."
        )
    return check(
        replace(
            drone,
            mass=np.float32(mass),
            inertia=np.asarray(drone.inertia) * np.float32(share),
            thrust_to_weight=np.float32(thrust_to_weight),
        ),
        f"{name} of {1e3 * mass:.4g} g",
    )


def isometric(drone: Parameters, mass: float, name: str) -> Parameters:
    """Returns a drone of the same shape and density and another mass.

    Lengths grow with the cube root of the mass, inertia with its power of 5/3; ratios and times
    stay.

    Args:
        drone: a point.
        mass: [kg].
        name: of the drone, for errors.

    Raises:
        InputError: a value is outside its physical range.

    Source: Kushleyev et al. 2013, Towards a swarm of agile micro quadrotors (scaling).
    """
    length = np.cbrt(mass / float(drone.mass))
    return check(
        replace(
            drone,
            mass=np.float32(mass),
            inertia=np.asarray(drone.inertia) * np.float32(length**5),
            **{
                field: (np.asarray(getattr(drone, field)) * length).astype(np.float32)
                for field in (*PLACES, "torque_to_thrust")
            },
            ground_effect=np.float32(drone.ground_effect * length**2),
        ),
        f"{name} of {1e3 * mass:.4g} g",
    )
