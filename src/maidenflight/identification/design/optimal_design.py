"""Optimal design of an experiment: how long each of some manoeuvres is to last.

Information is additive, so that the information of a flight is linear in the seconds of its
manoeuvres, and the logarithm of the volume of the confidence ellipsoid of the parameters of
interest is convex in them (D-optimality; of some parameters D_S-optimality). It is minimised by the
multiplicative algorithm, which keeps seconds positive and their sum.

At the optimum, and there only, no manoeuvre's rate of gain exceeds the mean rate of those that are
flown: the equivalence theorem, which `excess` measures.

Source: Kiefer and Wolfowitz 1960, The equivalence of two extremum problems; Silvey, Titterington
and Torsney 1978, An algorithm for optimal designs on a finite design space (the algorithm);
Pukelsheim 2006, Optimal design of experiments, ch. 7 (equivalence theorem) and sec. 12.6 (efficient
rounding); Goodwin and Payne 1977, Dynamic system identification, ch. 6 (of inputs).
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

MOST_STEPS = 20_000
"""Steps of the multiplicative algorithm at most: designs as large as a plan's need a fortieth
(tests/identification/design/test_optimal_design.py)."""
CLOSE = 1e-3
"""Excess of the best manoeuvre's rate of gain over the mean, as a share, at which it ends: the loss
is convex, so that it is within this of the least, in nats a parameter of interest (see source)."""


def loss(matrix: Float[np.ndarray, "d d"], of: Sequence[int]) -> float:
    """Returns the log determinant of the covariance of some parameters.

    The others are unknown too.

    Args:
        matrix: information on all.
        of: numbers of the parameters of interest.
    """
    rows = list(of)
    return float(np.linalg.slogdet(np.linalg.inv(matrix)[np.ix_(rows, rows)])[1])


def gains(
    parts: Float[np.ndarray, "m d d"],
    before: Float[np.ndarray, "d d"],
    seconds: Float[np.ndarray, "m"],
    of: Sequence[int],
) -> Float[np.ndarray, "m"]:
    """Returns the decrease of the loss by a further second of each manoeuvre [1/s], never negative.

    Args:
        parts: information of a second of each.
        before: information without any flight, positive definite.
        seconds: of each.
        of: numbers of the parameters of interest.
    """
    rows = list(of)
    spread = np.linalg.inv(before + np.tensordot(seconds, parts, 1))
    towards = spread[:, rows]
    kernel = towards @ np.linalg.solve(spread[np.ix_(rows, rows)], towards.T)
    return np.maximum(np.einsum("ij,mij->m", kernel, parts), 0.0)


def excess(
    parts: Float[np.ndarray, "m d d"],
    before: Float[np.ndarray, "d d"],
    seconds: Float[np.ndarray, "m"],
    of: Sequence[int],
) -> float:
    """Returns the share by which the largest gain exceeds the mean over the seconds.

    0 at the optimum.

    Args are those of `gains`.
    """
    gain_values = gains(parts, before, seconds, of)
    return float(gain_values.max() / (seconds @ gain_values / seconds.sum()) - 1.0)


def optimal(
    parts: Float[np.ndarray, "m d d"],
    before: Float[np.ndarray, "d d"],
    total: float,
    of: Sequence[int],
) -> Float[np.ndarray, "m"]:
    """Seconds of each manoeuvre at which the loss is least.

    Args:
        parts: information of a second of each, positive semi-definite, not all zero.
        before: information without any flight, positive definite.
        total: seconds together.
        of: numbers of the parameters of interest.
    """
    seconds = np.full(len(parts), total / len(parts))
    for _ in range(MOST_STEPS):
        gain_values = gains(parts, before, seconds, of)
        mean = seconds @ gain_values / total
        if gain_values.max() <= (1 + CLOSE) * mean:
            break
        seconds = seconds * gain_values / mean
        seconds *= total / seconds.sum()
    return seconds


def rounded(
    seconds: Float[np.ndarray, "m"], chunk: float, rest: float, total: float
) -> Float[np.ndarray, "m"]:
    """Returns whole chunks of the manoeuvres that last longest, each with a rest, in a time.

    Args:
        seconds: wanted.
        chunk: [s].
        rest: after each manoeuvre [s].
        total: what chunks and rests together do not exceed [s]; at least a chunk and a rest.

    Source: Pukelsheim and Rieder 1992, Efficient rounding of approximate designs; the number of
    manoeuvres is reduced until each has a chunk.
    """
    order = np.argsort(-seconds, kind="stable")
    for count in range(int(np.sum(seconds > 0.0)), 0, -1):
        support = order[:count]
        chunks = int((total - count * rest) / chunk + 1e-9)
        if chunks < count:
            continue
        shares = seconds[support] / seconds[support].sum()
        if count > 1 and chunks * shares.min() < 0.5:
            continue
        numbers = np.ceil((chunks - count / 2) * shares).astype(int)
        while numbers.sum() != chunks:
            if numbers.sum() < chunks:
                numbers[np.argmin(numbers / shares)] += 1
            else:
                numbers[np.argmax((numbers - 1) / shares)] -= 1
        gain_values = np.zeros(len(seconds))
        gain_values[support] = chunk * numbers
        return gain_values
    raise ValueError(f"{total} s hold no chunk of {chunk} s and a rest of {rest} s")
