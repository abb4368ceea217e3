"""Regression under autoregressive noise, against the truth and ordinary least squares."""

import numpy as np
import pytest
from scipy.signal import lfilter

from maidenflight.identification.prediction_errors import Prior, regress


def _pieces(seed: int, rows: int = 4000) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Two pieces of 2 x + 1 with noise that lasts for some twenty rows."""
    generator = np.random.default_rng(seed)
    signals, regressors = [], []
    for _ in range(2):
        cause = np.asarray(lfilter([1.0], [1.0, -0.9], generator.normal(size=rows)))
        noise = np.asarray(lfilter([1.0], [1.0, -0.95], generator.normal(size=rows)))
        signals.append(2 * cause + 1 + noise)
        regressors.append(np.stack([cause, np.ones(rows)], axis=1))
    return signals, regressors


def test_coefficients_are_found_and_their_deviation_is_honest() -> None:
    errors = []
    for seed in range(20):
        found = regress(*_pieces(seed), order=3)
        errors.append((found.coefficients[0] - 2) / np.sqrt(found.covariance[0, 0]))
    assert np.std(errors) == pytest.approx(1.0, abs=0.4)
    assert abs(np.mean(errors)) < 0.6


def test_a_noise_model_beats_none() -> None:
    signals, regressors = _pieces(1)
    with_noise = regress(signals, regressors, order=3)
    plain = regress(signals, regressors, order=1)
    assert with_noise.loss <= plain.loss + 1e-6 * abs(plain.loss) + 5
    assert with_noise.rows == 2 * 4000 - 6


def test_a_prior_holds_a_coefficient_and_costs_likelihood() -> None:
    signals, regressors = _pieces(2)
    free = regress(signals, regressors, order=3)
    held = regress(signals, regressors, order=3, prior=Prior(0, 3.0, 1e-4))
    assert held.coefficients[0] == pytest.approx(3.0, abs=1e-2)
    assert held.loss > free.loss
