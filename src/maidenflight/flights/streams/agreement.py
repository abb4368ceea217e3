"""How well commands that are rebuilt from others agree with those that were logged."""

import numpy as np
from jaxtyping import Float

LEAST_SHARE = 0.95
"""Share of the variance of logged motors, of their mean and of their differences, below which what
is rebuilt is refused: 1.0000 in all PX4 logs seen, those of real drones too."""


def share_explained(
    logged: Float[np.ndarray, "N M"], rebuilt: Float[np.ndarray, "N M"]
) -> float | None:
    """Returns the share of the variance of logged motors that is explained, the lesser of two.

    One is of their mean, the other of their differences.

    Args:
        logged: at some instants.
        rebuilt: at the same.

    Returns:
        None where too few rows are to compare, or neither changes.
    """
    if len(logged) < 10:
        return None
    logged_mean, rebuilt_mean = (rows.mean(axis=1, keepdims=True) for rows in (logged, rebuilt))
    shares = [
        _share(logged_mean, rebuilt_mean),
        _share(logged - logged_mean, rebuilt - rebuilt_mean),
    ]
    return min((share for share in shares if share is not None), default=None)


def _share(logged: np.ndarray, rebuilt: np.ndarray) -> float | None:
    """Share of variance that is explained; none of what does not change."""
    spread = np.sum((logged - logged.mean(axis=0)) ** 2)
    if spread <= 1e-6:
        return None
    return float(1.0 - np.sum((logged - rebuilt) ** 2) / spread)
