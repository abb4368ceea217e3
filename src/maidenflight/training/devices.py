"""How training is laid over devices: each flies a share of a policy's drones, and all learn from
the mean of what they saw.
"""

from collections.abc import Callable
from typing import TypeVar

import jax
import numpy as np
from jax import lax
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array

Learner = TypeVar("Learner")
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


def begun(one: Callable[[Array], Learner], laid: Learner, drones: int, keys: Array) -> Learner:
    """A learner of each key, stacked.

    Args:
        one: key to a learner with this device's share of the drones.
        laid: which parts of a learner are laid over devices.
        drones: of each learner.
        keys: one a policy.
    """
    return jax.shard_map(
        jax.vmap(one), mesh=mesh(drones), in_specs=EVERYWHERE, out_specs=laid, check_vma=False
    )(keys)


def advanced(
    update: Callable[[Learner, Array, Array], Learner],
    laid: Learner,
    drones: int,
    learners: Learner,
    keys: Array,
    first: Array | int,
    end: Array | int,
) -> Learner:
    """Stacked learners after the updates from `first` to before `end`.

    Args:
        update: (learner, key, number of the update) to the learner after it; the key depends on the
            number alone.
        laid: which parts of a learner are laid over devices.
        drones: of each learner.
        learners: stacked.
        keys: one a policy.
        first: number of the first update.
        end: number after the last.
    """

    def one(learner: Learner, key: Array) -> Learner:
        return lax.fori_loop(
            first,
            end,
            lambda number, learner: update(learner, jax.random.fold_in(key, number), number),
            learner,
        )

    return jax.shard_map(
        jax.vmap(one),
        mesh=mesh(drones),
        in_specs=(laid, EVERYWHERE),
        out_specs=laid,
        check_vma=False,
    )(learners, keys)
