"""Linear regression with autoregressive noise: prediction errors in their simplest form.

Signals are lists of gapless pieces. What the noise model cannot predict from its own past is what
the regressors must explain, so that feedback does not bias them, if the regressors are complete.

Rows are read once, for the sums of their products with earlier rows (`products`); each round of
noise model and regression is quadratic forms of these, of all candidates side by side.

Source: Ljung 1999, System identification: theory for the user, ch. 7 and 13.4; iterated generalised
least squares, Cochrane and Orcutt 1949.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

MEMORY = 0.25
"""Time that the noise model of a sensor's signal looks back [s]."""
ROUNDS = 6
"""Most rounds of noise model and regression; four are mostly enough."""
_ROUNDING = 1e-13
"""Mean square of the errors, of the signal's, below which they are the products' rounding."""


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


class Products(NamedTuple):
    """Sums of products of the columns of a signal and its regressors (c is k + 1), and the rows."""

    late: Float[np.ndarray, "p+1 p+1 c c"]
    """Of the rows i and j before, over all rows that have p before them."""
    centred: Float[np.ndarray, "p+1 c c"]
    """Of those rows with those i before, each piece's mean taken off."""
    rows: int


def products(
    signals: Sequence[Float[np.ndarray, "N"]],
    regressors: Sequence[Float[np.ndarray, "N k"]],
    order: int,
) -> Products:
    """What `regress` needs of a signal and of what may explain it.

    Args:
        signals: the explained signal, piece by piece.
        regressors: what explains it.
        order: rows of the past in the noise model; as many at the start of each piece are left out.
    """
    pieces = [np.column_stack(piece) for piece in zip(signals, regressors, strict=True)]
    return Products(
        np.sum([_late(piece, order) for piece in pieces], axis=0),
        np.sum([_centred(piece[order:], order) for piece in pieces], axis=0),
        sum(len(piece) - order for piece in pieces),
    )


def _late(columns: Float[np.ndarray, "N c"], order: int) -> Float[np.ndarray, "p+1 p+1 c c"]:
    """Sums over t of the products of rows t - i and t - j, each i and j up to the order.

    The sum one row earlier has the same products but for those at both ends.
    """
    count, width = columns.shape
    found = np.empty((order + 1, order + 1, width, width))
    for lag in range(order + 1):
        found[0, lag] = columns[order:].T @ columns[order - lag : count - lag]
    first, last = columns[:order][::-1], columns[count - order :][::-1]
    ends = np.einsum("ia,jb->ijab", first, first) - np.einsum("ia,jb->ijab", last, last)
    for lag in range(order):
        found[lag + 1, lag + 1 :] = found[lag, lag:-1] + ends[lag, lag:]
    upper = np.arange(order + 1)[:, None] <= np.arange(order + 1)
    return np.where(upper[..., None, None], found, found.transpose(1, 0, 3, 2))


def _centred(columns: Float[np.ndarray, "N c"], order: int) -> Float[np.ndarray, "p+1 c c"]:
    """Sums of the products of rows with those so many before, means taken off."""
    columns = columns - columns.mean(axis=0)
    return np.stack([columns[lag:].T @ columns[: len(columns) - lag] for lag in range(order + 1)])


def regress(candidates: Sequence[Products], priors: Sequence[Prior | None]) -> list[Fit]:
    """Fits coefficients and an autoregression of the noise together, for each candidate.

    Args:
        candidates: products of as many regressors each.
        priors: of one coefficient of each.
    """
    late, centred, rows = map(np.stack, zip(*candidates, strict=True))
    mean, precision = np.zeros((2, len(late), late.shape[-1] - 1))
    for number, prior in enumerate(priors):
        if prior:
            mean[number, prior.place] = prior.mean
            precision[number, prior.place] = prior.deviation**-2
    white = late[:, 0, 0]
    found, inverse = _solved(white, np.zeros_like(mean), mean)
    found = np.where(precision > 0, mean, found)
    going = np.ones(len(found), bool)
    for _ in range(ROUNDS):
        noise = _noise(found)
        whitening = _whitening(_along(centred, noise[:, None]), rows)
        newer = np.einsum("gi,gj,gijab->gab", whitening, whitening, late, optimize=True)
        weight = (_along(newer, noise) / rows)[:, None] * precision
        after, spread = _solved(newer, weight, mean)
        moved = ~np.isclose(after, found, rtol=1e-3).all(axis=1)
        found = np.where(going[:, None], after, found)
        inverse = np.where(going[:, None, None], spread, inverse)
        white = np.where(going[:, None, None], newer, white)
        going &= moved
        if not going.any():
            break
    square = _along(white, _noise(found)) / rows
    variance = np.maximum(square, 1e-20 + _ROUNDING * late[:, 0, 0, 0, 0] / rows)
    loss = 0.5 * rows * np.log(variance) + 0.5 * np.sum(precision * (found - mean) ** 2, axis=1)
    covariance = inverse * variance[:, None, None]
    return [
        Fit(float(nats), coefficients, spread, int(count))
        for nats, coefficients, spread, count in zip(loss, found, covariance, rows, strict=True)
    ]


def _noise(found: Float[np.ndarray, "G k"]) -> Float[np.ndarray, "G c"]:
    """The noise, as a sum of the columns of signal and regressors."""
    return np.concatenate([np.ones((len(found), 1)), -found], axis=1)


def _along(
    products: Float[np.ndarray, "... c c"], sums: Float[np.ndarray, "... c"]
) -> Float[np.ndarray, "..."]:
    """Products of sums of columns, from those of the columns."""
    return np.einsum("...a,...ab,...b->...", sums, products, sums)


def _solved(
    white: Float[np.ndarray, "G c c"],
    weight: Float[np.ndarray, "G k"],
    mean: Float[np.ndarray, "G k"],
) -> tuple[Float[np.ndarray, "G k"], Float[np.ndarray, "G k k"]]:
    """Coefficients by least squares, and the inverse of their normal equations."""
    matrix = white[:, 1:, 1:] + weight[:, None] * np.eye(weight.shape[1])
    vector = white[:, 1:, 0] + weight * mean
    scale = np.sqrt(np.maximum(np.diagonal(matrix, axis1=1, axis2=2), 1e-30))
    outer = scale[:, :, None] * scale[:, None]
    inverse = np.linalg.pinv(matrix / outer, 1e-10) / outer
    return np.einsum("gab,gb->ga", inverse, vector), inverse


def _whitening(
    covariance: Float[np.ndarray, "G p+1"], rows: Float[np.ndarray, "G"]
) -> Float[np.ndarray, "G p+1"]:
    """What to add of the noise 0 ... p rows before for white noise (Yule and Walker's equations).

    Args:
        covariance: of the noise with that so many rows before, times the rows.
        rows: of the noise.
    """
    right = covariance[:, 1:, None]
    covariance = covariance.copy()
    covariance[:, 0] = covariance[:, 0] * (1 + 1e-9) + 1e-20 * rows
    place = np.arange(right.shape[1])
    weights = np.linalg.solve(covariance[:, np.abs(place[:, None] - place)], right)[..., 0]
    return np.concatenate([np.ones((len(weights), 1)), -weights], axis=1)
