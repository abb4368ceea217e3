"""A policy whose file shows every digit that is lost."""

import jax
import jax.numpy as jnp
import numpy as np

from maidenflight.policy import untrained_policy


def noisy(key, spec):
    """A policy in which no number is round.

    Noise is drawn by NumPy, as JAX would compile a program for each shape.
    """
    generator = np.random.default_rng(np.asarray(jax.random.key_data(key)))
    return jax.tree.map(
        lambda leaf: jnp.asarray(leaf + np.float32(generator.uniform(1e-7, 1e-3, leaf.shape))),
        jax.tree.map(np.asarray, untrained_policy(key, spec=spec)),
    )
