"""Agreement of predicted flight times with measured ones, and the conditions of those measured."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy
from jaxtyping import Float

from maidenflight.errors import InputError
from maidenflight.experiments.conditions import read_conditions

CONDITIONS = Path(__file__).parents[1] / "settings" / "gronauer_2021.toml"
GRONAUER_2021 = read_conditions(CONDITIONS)
"""How the published flights were flown."""


@dataclass(frozen=True)
class Agreement:
    """Measures of agreement between predictions and measurements."""

    policies: int
    spearman: float
    """Rank correlation."""
    pearson: float
    """Linear correlation."""
    mean_absolute_error: float
    """In the unit of what was measured."""


def agreement(predicted: Float[np.ndarray, "P"], measured: Float[np.ndarray, "P"]) -> Agreement:
    """Compares predicted and measured mean flight times, policy by policy.

    Correlations with a constant are not numbers.

    Raises:
        InputError: not two rows of one length of at least two finite numbers.
    """
    predicted, measured = np.asarray(predicted, np.float64), np.asarray(measured, np.float64)
    if (
        predicted.ndim != 1
        or predicted.shape != measured.shape
        or len(predicted) < 2
        or not np.isfinite([predicted, measured]).all()
    ):
        raise InputError(
            f"predictions of shape {predicted.shape} for measurements of shape {measured.shape}; "
            "expected two equal rows."
        )

    def correlation(first: np.ndarray, second: np.ndarray) -> float:
        spread = float(np.std(first) * np.std(second))
        return (
            float(np.mean((first - first.mean()) * (second - second.mean()))) / spread
            if spread > 0
            else float("nan")
        )

    return Agreement(
        policies=len(predicted),
        spearman=correlation(scipy.stats.rankdata(predicted), scipy.stats.rankdata(measured)),
        pearson=correlation(predicted, measured),
        mean_absolute_error=float(np.mean(np.abs(predicted - measured))),
    )
