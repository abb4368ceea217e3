from collections.abc import Iterator

import jax
import pytest


@pytest.fixture(autouse=True, scope="package")
def standard_promotion() -> Iterator[None]:
    """optax itself mixes integers and floats, so its users cannot be held to strict promotion."""
    with jax.numpy_dtype_promotion("standard"):
        yield
