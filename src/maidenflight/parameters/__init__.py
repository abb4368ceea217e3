"""Physical constants of a simulated quadrotor, with unit, symbol, bounds and source of each."""

from maidenflight.parameters.named import DRONES, NamedDrone, crazyflie, named, sources
from maidenflight.parameters.quantities import (
    COMPONENTS,
    QUANTITIES,
    Parameters,
    Quantity,
    check,
    component,
    noiseless,
    part_names,
    plain,
    replace,
)
from maidenflight.parameters.toml import (
    FORMAT,
    document,
    from_document,
    from_toml,
    full_scale_counts,
    name_of,
    read,
    to_toml,
    write,
)

__all__ = [
    "COMPONENTS",
    "DRONES",
    "FORMAT",
    "QUANTITIES",
    "NamedDrone",
    "Parameters",
    "Quantity",
    "check",
    "component",
    "crazyflie",
    "document",
    "from_document",
    "from_toml",
    "full_scale_counts",
    "name_of",
    "named",
    "noiseless",
    "part_names",
    "plain",
    "read",
    "replace",
    "sources",
    "to_toml",
    "write",
]
