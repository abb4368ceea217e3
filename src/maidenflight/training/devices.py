"""How training is laid over devices: each flies a share of a policy's drones, and all learn from the mean of what they saw."""

import jax
import numpy as np
from jax import lax
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array

DRONES = "drones"
"""Axis of the mesh over which a policy's drones are laid."""
EVERYWHERE = PartitionSpec()
"""What all devices hold alike."""
LAID = PartitionSpec(None, DRONES)
"""Arrays with an axis of policies and one of drones."""


def mesh(drones: int) -> Mesh:
    """All devices, of all processes, or as many as share the drones evenly."""
    devices = jax.devices()
    count = max(number for number in range(1, len(devices) + 1) if drones % number == 0)
    return Mesh(np.array(devices[:count]), (DRONES,))


def own(keys: Array) -> Array:
    """Of one key a drone, those of the drones on this device."""
    count = keys.shape[0] // lax.axis_size(DRONES)
    return lax.dynamic_slice_in_dim(keys, lax.axis_index(DRONES) * count, count)
