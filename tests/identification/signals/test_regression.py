"""Regression under autoregressive noise, against the truth and ordinary least squares."""

import numpy as np
import pytest
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from maidenflight.identification.signals import regression as prediction_errors
from maidenflight.identification.signals.regression import Fit, Prior, products


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


def regress(
    signals: list[np.ndarray], regressors: list[np.ndarray], order: int, prior: Prior | None = None
) -> Fit:
    """The regression of one candidate."""
    return prediction_errors.regress([products(signals, regressors, order)], [prior])[0]


def _row_by_row(
    signals: list[np.ndarray], regressors: list[np.ndarray], order: int, prior: Prior | None
) -> tuple[np.ndarray, float]:
    """Coefficients and loss where each round filters all rows anew."""
    found = np.linalg.lstsq(np.concatenate(regressors), np.concatenate(signals))[0]
    mean, precision = np.zeros(len(found)), np.zeros(len(found))
    if prior is not None:
        mean[prior.place], precision[prior.place] = prior.mean, prior.deviation**-2
        found[prior.place] = prior.mean
    loss = np.inf
    for _ in range(30):
        covariance = np.zeros(order + 1)
        for y, x in zip(signals, regressors, strict=True):
            noise = (y - x @ found)[order:]
            noise = noise - noise.mean()
            covariance += [noise[lag:] @ noise[: len(noise) - lag] for lag in range(order + 1)]
        whitening = np.concatenate([[1.0], -solve_toeplitz(covariance[:-1], covariance[1:])])
        y = np.concatenate([lfilter(whitening, 1.0, part)[order:] for part in signals])
        x = np.concatenate([lfilter(whitening, 1.0, part, axis=0)[order:] for part in regressors])
        pull = np.diag(precision * np.mean((y - x @ found) ** 2))
        found = np.linalg.solve(x.T @ x + pull, x.T @ y + pull @ mean)
        loss = 0.5 * len(y) * np.log(np.mean((y - x @ found) ** 2))
    return found, float(loss + 0.5 * precision @ (found - mean) ** 2)


@pytest.mark.parametrize("prior", [None, Prior(0, 1.9, 0.02)])
def test_products_stand_for_all_rows(prior: Prior | None) -> None:
    signals, regressors = _pieces(3)
    found = regress(signals, regressors, 25, prior)
    coefficients, loss = _row_by_row(signals, regressors, 25, prior)
    assert found.coefficients == pytest.approx(coefficients, rel=2e-3)
    assert found.loss == pytest.approx(loss, abs=0.01)


def test_candidates_side_by_side_are_each_by_itself() -> None:
    priors = [None, Prior(0, 1.9, 0.02), Prior(1, 2.0, 0.1)]
    candidates = [products(*_pieces(seed), order=3) for seed in range(3)]
    together = prediction_errors.regress(candidates, priors)
    for one, prior, fit in zip(candidates, priors, together, strict=True):
        alone = prediction_errors.regress([one], [prior])[0]
        assert fit.loss == pytest.approx(alone.loss)
        assert fit.coefficients == pytest.approx(alone.coefficients)
        assert fit.covariance == pytest.approx(alone.covariance)


def test_a_signal_without_noise_has_a_finite_loss() -> None:
    cause = np.random.default_rng(0).normal(size=(2000, 1))
    found = regress([3 * cause[:, 0]], [cause], order=3)
    assert found.coefficients == pytest.approx([3.0])
    assert np.isfinite(found.loss)


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
