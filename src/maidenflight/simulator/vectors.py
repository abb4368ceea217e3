"""Lengths of vectors, with a gradient at zero."""

from functools import reduce
from operator import add

import jax.numpy as jnp
from jaxtyping import Array, Float


def norm(vector: Float[Array, "n"]) -> Float[Array, ""]:
    """Euclidean norm whose gradient at zero is zero, not NaN."""
    square = squared(vector)
    return jnp.where(square == 0, 0.0, jnp.sqrt(jnp.where(square == 0, 1.0, square)))


def squared(vector: Float[Array, "n"]) -> Float[Array, ""]:
    """Sum of squares, written out as in `dynamics`."""
    return reduce(add, [entry * entry for entry in vector])
