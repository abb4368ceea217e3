"""Physical constants of a simulated quadrotor, with unit, symbol, bounds and source of each."""

from maidenflight.parameters.components import (
    COMPONENTS,
    check,
    check_names,
    component,
    noiseless,
    part_names,
    plain,
    replace,
)
from maidenflight.parameters.frames import (
    GEOMETRY,
    arm_length,
    h_frame,
    levers,
    plus_frame,
    rotors,
    x_frame,
)
from maidenflight.parameters.named import DRONES, NamedDrone, crazyflie, drone, sources
from maidenflight.parameters.platforms import PLATFORMS, Platform, platform_of
from maidenflight.parameters.quantities import QUANTITIES, Parameters, Quantity
from maidenflight.parameters.toml import (
    FORMAT,
    document,
    from_document,
    from_toml,
    full_scale_counts,
    name_of,
    read_drone,
    to_toml,
    write_drone,
)

__all__ = [
    "COMPONENTS",
    "DRONES",
    "FORMAT",
    "GEOMETRY",
    "PLATFORMS",
    "QUANTITIES",
    "NamedDrone",
    "Parameters",
    "Platform",
    "Quantity",
    "arm_length",
    "check",
    "check_names",
    "component",
    "crazyflie",
    "document",
    "drone",
    "from_document",
    "from_toml",
    "full_scale_counts",
    "h_frame",
    "levers",
    "name_of",
    "noiseless",
    "part_names",
    "plain",
    "platform_of",
    "plus_frame",
    "read_drone",
    "replace",
    "rotors",
    "sources",
    "to_toml",
    "write_drone",
    "x_frame",
]
