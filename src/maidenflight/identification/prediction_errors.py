"""Linear regression with autoregressive noise: prediction errors in their simplest form.

Signals are lists of gapless pieces. What the noise model cannot predict from its own past is what
the regressors must explain, so that feedback does not bias them, if the regressors are complete.

Source: Ljung 1999, System identification: theory for the user, ch. 7 and 13.4; iterated generalised
least squares, Cochrane and Orcutt 1949.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

MEMORY = 0.25
"""Time that the noise model of a sensor's signal looks back [s]."""
ROUNDS = 6
"""Most rounds of noise model and regression; four are mostly enough."""


class Prior(NamedTuple):
    """What is known of one coefficient beforehand."""

    place: int
    mean: float
    deviation: float


class Fit(NamedTuple):
    """A regression's end."""

    loss: float
    """Minus the log likelihood of all rows, less a constant, prior included [nats]."""
    coefficients: Float[np.ndarray, "k"]
    covariance: Float[np.ndarray, "k k"]
    rows: int


def regress(
    signals: Sequence[Float[np.ndarray, "N"]],
    regressors: Sequence[Float[np.ndarray, "N k"]],
    order: int,
    prior: Prior | None = None,
) -> Fit:
    """Fits coefficients and an autoregression of the noise together.

    Args:
        signals: the explained signal, piece by piece.
        regressors: what explains it.
        order: rows of the past in the noise model; as many at the start of each piece are left out.
        prior: of one coefficient.
    """
    found = np.linalg.lstsq(np.concatenate(regressors), np.concatenate(signals), rcond=1e-10)[0]
    if prior:
        found[prior.place] = prior.mean
    found, inverse, left = _round(signals, regressors, order, found, prior)
    for _ in range(ROUNDS - 1):
        before = found
        found, inverse, left = _round(signals, regressors, order, before, prior)
        if np.allclose(found, before, rtol=1e-3):
            break
    variance = max(float(np.mean(left**2)), 1e-20)
    loss = 0.5 * len(left) * np.log(variance)
    if prior:
        loss += 0.5 * ((found[prior.place] - prior.mean) / prior.deviation) ** 2
    return Fit(float(loss), found, inverse * variance, len(left))


def _round(
    signals: Sequence[Float[np.ndarray, "N"]],
    regressors: Sequence[Float[np.ndarray, "N k"]],
    order: int,
    found: Float[np.ndarray, "k"],
    prior: Prior | None,
) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k k"], Float[np.ndarray, "M"]]:
    """Coefficients under the noise of the last ones.

    And the inverse of their normal equations, and the residuals.
    """
    noise = [y - x @ found for y, x in zip(signals, regressors, strict=True)]
    weights = _autoregression([part[order:] for part in noise], order)
    whitening = np.concatenate([[1.0], -weights])
    x = np.concatenate(
        [scipy.signal.lfilter(whitening, 1.0, part, axis=0)[order:] for part in regressors]
    )
    y = np.concatenate([scipy.signal.lfilter(whitening, 1.0, part)[order:] for part in signals])
    matrix, vector = x.T @ x, x.T @ y
    if prior:
        weight = float(np.mean((y - x @ found) ** 2)) / prior.deviation**2
        matrix[prior.place, prior.place] += weight
        vector[prior.place] += weight * prior.mean
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-30))
    inverse = np.linalg.pinv(matrix / np.outer(scale, scale), 1e-10) / np.outer(scale, scale)
    found = inverse @ vector
    return found, inverse, y - x @ found


def _autoregression(noise: Sequence[Float[np.ndarray, "N"]], order: int) -> Float[np.ndarray, "p"]:
    """Weights of the noise 1 ... p rows before (Yule and Walker's equations)."""
    rows = sum(map(len, noise))
    covariance = np.zeros(order + 1)
    for part in noise:
        size = 1 << (2 * len(part) - 1).bit_length()
        spectrum = np.fft.rfft(part - part.mean(), size)
        covariance += np.fft.irfft(np.abs(spectrum) ** 2, size)[: order + 1]
    covariance[0] = covariance[0] * (1 + 1e-9) + 1e-20 * rows
    return scipy.linalg.solve_toeplitz(covariance[:order], covariance[1:])
