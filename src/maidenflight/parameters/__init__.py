"""Physical constants of a simulated quadrotor, with unit, symbol, bounds and source of each."""

from maidenflight.parameters.named import DRONES, crazyflie
from maidenflight.parameters.quantities import (
    COMPONENTS,
    QUANTITIES,
    Parameters,
    Quantity,
    check,
    component,
    noiseless,
    replace,
)
from maidenflight.parameters.toml import (
    FORMAT,
    document,
    from_document,
    from_toml,
    read,
    to_toml,
    write,
)

__all__ = [
    "COMPONENTS",
    "DRONES",
    "FORMAT",
    "QUANTITIES",
    "Parameters",
    "Quantity",
    "check",
    "component",
    "crazyflie",
    "document",
    "from_document",
    "from_toml",
    "noiseless",
    "read",
    "replace",
    "to_toml",
    "write",
]
