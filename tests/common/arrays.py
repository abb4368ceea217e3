"""NumPy arrays for tests, typed so that they pass for JAX's."""

from typing import Any

import numpy as np


def float32(values: Any) -> Any:
    """A float32 array."""
    return np.asarray(values, np.float32)


def float64(values: Any) -> Any:
    """A float64 array."""
    return np.asarray(values, np.float64)
