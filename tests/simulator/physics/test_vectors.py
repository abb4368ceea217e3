"""Lengths of vectors, and vectors as their entries."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight.simulator.physics import vectors
from maidenflight.simulator.physics.vectors import Entries


def test_a_length_of_what_is_not_a_number_is_not_a_number():
    assert np.isnan(vectors.norm(jnp.array([0.0, jnp.nan, 0.0])))
    assert vectors.norm(jnp.zeros(3)) == 0


OPERATIONS = {
    "sum": lambda a, b: a + b,
    "difference": lambda a, b: a - b,
    "product": lambda a, b: a * b,
    "quotient": lambda a, b: a / b,
    "negative": lambda a, b: -a * b,
}


@pytest.mark.parametrize("of", OPERATIONS)
def test_the_arithmetic_of_entries_is_that_of_arrays(of: str):
    """With other entries, an array, a number on either side, and a number of NumPy's."""
    one, other = jnp.array([1.0, -2.0, 3.5]), jnp.array([4.0, 0.5, -6.0])
    a, b, compute = Entries(one), Entries(other), OPERATIONS[of]
    expected = compute(one, other)
    for found in (compute(a, b), compute(a, other)):
        assert isinstance(found, Entries)
        assert len(found) == 3
        np.testing.assert_array_equal(jnp.stack(list(found)), expected)
    two = np.float32(2.0)
    np.testing.assert_array_equal(jnp.stack(list(compute(a, two))), compute(one, two))
    if of != "quotient":
        for number in (two, jnp.float32(2.0)):
            found = compute(number, b)
            assert isinstance(found, Entries)
            np.testing.assert_array_equal(jnp.stack(list(found)), compute(number, other))


def test_entries_of_different_lengths_do_not_combine():
    with pytest.raises(ValueError, match="shorter"):
        _ = Entries([1.0, 2.0, 3.0]) + Entries([1.0, 2.0])


def test_entries_are_a_pytree_of_their_numbers():
    cut = vectors.entries({"vector": jnp.arange(4.0), "number": jnp.float32(7.0)})
    assert isinstance(cut["vector"], Entries)
    assert [float(number) for number in jax.tree.leaves(cut)] == [7.0, 0.0, 1.0, 2.0, 3.0]
    doubled = jax.jit(lambda given: jax.tree.map(lambda number: 2 * number, given))(cut)
    assert isinstance(doubled["vector"], Entries)
    assert doubled["vector"][3] == 6.0
