"""Training on several devices.

Each simulates a share of a policy's environments, and gradients are averaged over all.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import lax, tree
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jax.stages import Wrapped
from jaxtyping import Array

Learner = TypeVar("Learner")
DRONES = "drones"
"""Axis of the mesh over which a policy's environments are sharded."""
REPLICATED = PartitionSpec()
"""Arrays that every device holds whole."""
SHARDED = PartitionSpec(None, DRONES)
"""Arrays with an axis of policies and one of environments."""


def mesh(num_envs: int) -> Mesh:
    """Returns all devices of all processes, or the most that divide the environments evenly."""
    devices = jax.devices()
    count = max(number for number in range(1, len(devices) + 1) if num_envs % number == 0)
    return Mesh(np.array(devices[:count]), (DRONES,))


def own(keys: Array) -> Array:
    """Selects the keys of the environments on this device."""
    count = keys.shape[0] // lax.axis_size(DRONES)
    return lax.dynamic_slice_in_dim(keys, lax.axis_index(DRONES) * count, count)


def limited_mean(gradients: Any, most: float) -> Any:
    """Returns the mean of this device's gradients, the longest of which are shortened.

    Args:
        gradients: pytrees of one an environment, stacked along a first axis.
        most: largest norm, in medians of those on all devices. What is not finite counts as zero.
    """
    norms = jax.vmap(optax.tree.norm)(gradients)
    finite = jnp.isfinite(norms)
    largest = most * jnp.median(lax.all_gather(jnp.where(finite, norms, jnp.inf), DRONES))
    shares = jnp.where(norms > largest, largest / norms, 1.0)

    def mean(leaf: Array) -> Array:
        usable, share = (
            jnp.reshape(part, (-1, *[1] * (leaf.ndim - 1))) for part in (finite, shares)
        )
        return jnp.mean(jnp.where(usable, share * leaf, 0.0), axis=0)

    return tree.map(mean, gradients)


def begun(
    init: Callable[[Any, Array], Learner], sharding: Learner, num_envs: int, boxes: Any, keys: Array
) -> Learner:
    """Returns a learner for each policy, stacked.

    Args:
        init: (drones, key) to a learner with this device's share of the environments.
        sharding: of each part of a learner.
        num_envs: of each learner.
        boxes: drones of each policy, stacked.
        keys: one per policy.
    """
    return jax.shard_map(
        jax.vmap(init),
        mesh=mesh(num_envs),
        in_specs=REPLICATED,
        out_specs=sharding,
        check_vma=False,
    )(boxes, keys)


def placed(learners: Learner, sharding: Learner, num_envs: int) -> Learner:
    """Learners on the devices that `begun` puts them on, so that nothing is compiled for others.

    Args:
        learners: stacked, such as from a file; or their shapes alone.
        sharding: of each part of a learner.
        num_envs: of each learner.
    """
    devices = mesh(num_envs)

    def put(spec: PartitionSpec, leaf: Any) -> Any:
        # XLA replicates arrays without content, such as the memory of a policy that has none, and
        # all where there is one device.
        is_shared = leaf.size and devices.size > 1
        there = NamedSharding(devices, spec if is_shared else REPLICATED)
        if isinstance(leaf, jax.ShapeDtypeStruct):
            return jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=there)
        return jax.device_put(leaf, there)

    return tree.map(
        lambda spec, part: tree.map(partial(put, spec), part),
        sharding,
        learners,
        is_leaf=lambda leaf: isinstance(leaf, PartitionSpec),
    )


def over_devices(
    fly: Callable[[Any, Any], Any], num_envs: int, episodes: int
) -> Callable[[Any, Any], Any]:
    """Returns flights of which each device flies its share, on the devices of the learners.

    Args:
        fly: (stacked policies, beginnings of episodes with an axis of policies and one of episodes)
            to what has these axes.
        num_envs: environments of each learner, which decide the devices.
        episodes: their number. Where it does not divide evenly, each device flies all.
    """
    devices = mesh(num_envs)
    if episodes % devices.size:
        return fly
    return jax.shard_map(
        fly,
        mesh=devices,
        in_specs=(REPLICATED, SHARDED),
        out_specs=SHARDED,
        check_vma=False,
    )


def learning(update: Callable[..., Any], sharding: Any) -> Wrapped:
    """Returns the function that does updates of a training method, jitted.

    Args:
        update: (environment, settings, drones, learner, key, number of the update) to the learner
            after it; the key depends on the number alone.
        sharding: of each part of a learner.

    Returns:
        (environment, settings, stacked drones, stacked learners, a key for each, first, end) to the
        learners after updates `first` to `end` - 1.
    """

    @partial(jax.jit, static_argnums=0)
    def update_learners(
        env: Any, settings: Any, boxes: Any, learners: Any, keys: Array, first: Any, end: Any
    ) -> Any:
        def all_of(boxes: Any, learners: Any, keys: Array) -> Any:
            # A loop over `vmap` traces sooner than `vmap` of a loop, whose body JAX batches anew
            # until it knows what of it has an axis of policies.
            def step(number: Array, box: Any, learner: Any, key: Array) -> Any:
                key = jax.random.fold_in(key, number)
                return update(env, settings, box, learner, key, number)

            return lax.fori_loop(
                first,
                end,
                lambda number, learners: jax.vmap(partial(step, number))(boxes, learners, keys),
                learners,
            )

        return jax.shard_map(
            all_of,
            mesh=mesh(settings.num_envs),
            in_specs=(REPLICATED, sharding, REPLICATED),
            out_specs=sharding,
            check_vma=False,
        )(boxes, learners, keys)

    return update_learners
