"""Lengths of vectors."""

import jax.numpy as jnp
import numpy as np

from maidenflight.simulator import vectors


def test_a_length_of_what_is_not_a_number_is_not_a_number():
    assert np.isnan(vectors.norm(jnp.array([0.0, jnp.nan, 0.0])))
    assert vectors.norm(jnp.zeros(3)) == 0
