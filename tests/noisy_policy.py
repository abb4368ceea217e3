"""A policy whose file shows every digit that is lost."""

import jax

from maidenflight.policy import untrained_policy


def noisy(key, spec):
    """A policy in which no number is round."""
    made = untrained_policy(key, spec=spec)
    leaves, structure = jax.tree.flatten(made)
    keys = jax.random.split(key, len(leaves))
    leaves = [
        leaf + jax.random.uniform(k, leaf.shape, minval=1e-7, maxval=1e-3)
        for leaf, k in zip(leaves, keys, strict=True)
    ]
    return jax.tree.unflatten(structure, leaves)
