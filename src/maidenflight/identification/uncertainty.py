"""Uncertainty of parameters: a bootstrap over segments, the sandwich, and what each signal says.

The bootstrap draws segments of flight with replacement and finds the optimum of each draw. A
quadratic surrogate, fitted to every segment's loss around the optimum, makes that cheap: the
surrogate of a sum of losses is the sum of the surrogates.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from maidenflight.parameters import Parameters, component

DESIGN = 64
"""Points at which the losses around an optimum are evaluated, at least; harmless within a factor of
1.4 (paper/identification/constants.py)."""
RESAMPLES = 500
"""Redrawn data sets: by definition of a quantile, the ends of 95 % intervals are then off by 6 % of
half their width."""
LEVEL = 0.95
"""Share of the redrawn optima that a 95 % interval holds, by definition."""


class Bootstrap(NamedTuple):
    """Optima of redrawn data, in the unit cube of the search."""

    optima: Float[np.ndarray, "resamples d"]
    separate: Float[np.ndarray, "S d"]
    """Optima of each segment of flight by itself, within the last neighbourhood."""
    points: Float[np.ndarray, "n d"]
    """Points evaluated on the way."""
    losses: Float[np.ndarray, "n"]
    """Their mean loss."""

    def interval(self) -> tuple[Float[np.ndarray, "d"], Float[np.ndarray, "d"]]:
        """Returns the central interval of the optima, in each dimension."""
        return interval(self.optima)


def interval(
    draws: Float[np.ndarray, "N ..."],
) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
    """Returns the central interval that holds `LEVEL` of the draws, number by number."""
    tail = (1 - LEVEL) / 2
    return np.quantile(draws, tail, axis=0), np.quantile(draws, 1 - tail, axis=0)


def basis(points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n k"]:
    """Returns monomials up to the second degree."""
    dimensions = points.shape[1]
    squares = [points[:, i] * points[:, j] for i in range(dimensions) for j in range(i, dimensions)]
    return np.stack([np.ones(len(points)), *points.T, *squares], axis=1)


def design_points(dimensions: int) -> int:
    """Returns points of a design: a power of two.

    At least twice the coefficients of a quadratic.
    """
    return max(DESIGN, 1 << ((dimensions + 1) * (dimensions + 2) - 1).bit_length())


def bootstrap(
    segment_losses: Callable[[Float[np.ndarray, "d"]], Float[np.ndarray, "S"]],
    windows_per_segment: Float[np.ndarray, "S"],
    best: Float[np.ndarray, "d"],
    radius: Float[np.ndarray, "d"],
    limits: tuple[Float[np.ndarray, "d"], Float[np.ndarray, "d"]],
    generator: np.random.Generator,
    on_evaluation: Callable[[], None] | None = None,
) -> Bootstrap:
    """Redraws the data and finds the optimum of each draw.

    Args:
        segment_losses: point to the summed loss of each segment's windows.
        windows_per_segment: S numbers of windows.
        best: the optimum of all data.
        radius: half width of the first neighbourhood in which a surrogate is fitted; it grows or
            shrinks to fit the optima.
        limits: smallest and largest point that makes sense.
        generator: random numbers.
        on_evaluation: called after each evaluation.
    """
    dimensions = len(best)
    points, losses = np.empty((0, dimensions)), np.empty(0)
    optima = separate = np.empty((0, dimensions))
    for _ in range(3):
        low, high = np.maximum(best - radius, limits[0]), np.minimum(best + radius, limits[1])
        design = scipy.stats.qmc.scale(
            scipy.stats.qmc.Sobol(dimensions, rng=generator).random(design_points(dimensions)),
            low,
            high,
        )
        per_segment = []
        for point in design:
            per_segment.append(segment_losses(point))
            if on_evaluation is not None:
                on_evaluation()
        matrix = np.array(per_segment)
        centred = (design - best) / radius
        coefficients = np.linalg.lstsq(basis(centred), matrix, rcond=None)[0]
        draws = generator.multinomial(
            len(windows_per_segment),
            np.full(len(windows_per_segment), 1 / len(windows_per_segment)),
            RESAMPLES,
        )
        trial = generator.uniform(low, high, (8192, dimensions))
        # A resample's surrogate; the number of windows in it scales the whole and moves no optimum.
        surrogate = basis((trial - best) / radius) @ (coefficients @ draws.T)
        optima = trial[np.argmin(surrogate, axis=0)]
        separate = trial[np.argmin(basis((trial - best) / radius) @ coefficients, axis=0)]
        points = np.concatenate([points, design])
        losses = np.concatenate([losses, matrix.sum(axis=1) / windows_per_segment.sum()])
        best = points[int(np.argmin(losses))]
        reach = np.quantile(np.abs(optima - best), LEVEL, axis=0)
        radius = np.maximum(np.minimum(2.0 * reach, 2.0 * radius), radius / 4)
    return Bootstrap(optima, separate, points, losses)


def sandwich(
    scores: Float[np.ndarray, "S d"], curvature: Float[np.ndarray, "d d"]
) -> Float[np.ndarray, "d d"]:
    """Returns the covariance of maximum-likelihood estimates: H^-1 (sum s s^T) H^-1.

    Segments of flight are independent, rows are not. Where the model is right this is Laplace's
    H^-1; where it is not, as for every real drone, H^-1 is too small.

    Args:
        scores: gradient of minus the log likelihood that each of S segments adds.
        curvature: H, its second derivative.

    Source: White 1982, Maximum likelihood estimation of misspecified models, theorem 3.2.
    """
    bread = inverse(curvature)
    return bread @ (scores.T @ scores) @ bread * len(scores) / max(len(scores) - scores.shape[1], 1)


def between_segments(
    scores: Float[np.ndarray, "S d"], curvatures: Float[np.ndarray, "S d d"]
) -> tuple[Float[np.ndarray, "d"], Float[np.ndarray, "d d"]]:
    """Returns how parameters differ between segments of flight, beyond noise.

    A segment whose parameters differ from the mean by x has a score of variance H + H x x^T H, in
    nats; the rest is the method of moments.

    Args:
        scores: gradient of minus the log likelihood of each of S segments.
        curvatures: its second derivative.

    Returns:
        Standard deviations, and correlations, of that part which is a covariance: a full thrust and
        a curve that segments disagree about may well agree about the thrust of each command.

    Source: DerSimonian and Laird 1986, Meta-analysis in clinical trials (random effects by
    moments); Jackson, White and Riley 2010 (several effects; negative eigenvalues are zero).
    """
    mean = curvatures.mean(axis=0)
    bread = inverse(mean)
    between = bread @ (scores.T @ scores / len(scores) - mean) @ bread
    deviation = np.sqrt(np.maximum(np.diag(between), 0.0))
    scale = np.sqrt(np.maximum(np.diag(bread), 1e-300))
    values, vectors = np.linalg.eigh(between / np.outer(scale, scale))
    sound = (vectors * np.maximum(values, 0.0)) @ vectors.T
    size = np.sqrt(np.maximum(np.diag(sound), 1e-300))
    correlation = sound / np.outer(size, size)
    np.fill_diagonal(correlation, 1.0)
    return deviation, correlation


def inverse(curvature: Float[np.ndarray, "d d"]) -> Float[np.ndarray, "d d"]:
    """Inverts by way of unit diagonals, since the parameters' units differ by decades."""
    scale = np.sqrt(np.maximum(np.diag(curvature), 1e-30))
    return np.linalg.inv(curvature / np.outer(scale, scale) + 1e-9 * np.eye(len(scale))) / np.outer(
        scale, scale
    )


DELAY = "motor lag and latency"
"""Both together, which signals show better than either."""


class Evidence(NamedTuple):
    """What one signal says of one parameter, SI units."""

    signal: str
    value: float
    interval: tuple[float, float]
    """95 %."""
    parameter: str = DELAY
    """Its name, or `DELAY`."""
    is_taken: bool = False
    """Whether it is what all signals together say."""

    @property
    def error(self) -> float:
        """Standard error, of which the interval has two."""
        return (self.interval[1] - self.interval[0]) / 3.92


class Agreement(NamedTuple):
    """How far signals agree about one parameter."""

    chi_square: float
    """Of their values about the weighted mean."""
    degrees: int
    """Of freedom: signals but one."""

    @property
    def chance(self) -> float:
        """Probability that signals which agree differ as much."""
        return float(scipy.stats.chi2.sf(self.chi_square, self.degrees))


def agreements(evidence: Iterable[Evidence]) -> dict[str, Agreement]:
    """Returns how far signals agree, by each parameter of which two or more say something.

    Source: Cochran 1954, The combination of estimates from different experiments.
    """
    by_parameter: dict[str, list[Evidence]] = {}
    for estimate in evidence:
        if not estimate.is_taken and 0.0 < estimate.error < np.inf:
            by_parameter.setdefault(estimate.parameter, []).append(estimate)
    result = {}
    for parameter, some in by_parameter.items():
        if len(some) < 2:
            continue
        values, weights = (
            np.array(column) for column in zip(*((x.value, x.error**-2) for x in some), strict=True)
        )
        middle = float(weights @ values / weights.sum())
        chi_square = float(weights @ (values - middle) ** 2)
        result[parameter] = Agreement(chi_square, len(some) - 1)
    return result


def of_samples(signal: str, samples: Mapping[str, Float[np.ndarray, "N"]]) -> list[Evidence]:
    """Returns what samples of a posterior say, by parameter."""
    evidence = []
    for name, values in samples.items():
        low, value, high = np.quantile(values, [0.025, 0.5, 0.975]).tolist()
        evidence.append(Evidence(signal, value, (low, high), name))
    return evidence


def of_scores(
    signal: str,
    drone: Parameters,
    names: Sequence[str],
    scores: Float[np.ndarray, "S d"],
    curvature: Float[np.ndarray, "d d"],
) -> list[Evidence]:
    """Returns what a likelihood alone says of d parameters: one Newton step from a drone.

    All of them move, so that what it cannot tell apart has wide intervals.

    Args:
        signal: what the likelihood is of.
        drone: near its optimum.
        names: of the parameters.
        scores: gradient of minus the log likelihood [nats] that each of S segments adds.
        curvature: its second derivative.

    Source: Le Cam 1956, On the asymptotic theory of estimation and testing hypotheses (one-step
    estimates); White 1982 (their covariance).
    """
    steps = -inverse(curvature) @ scores.sum(axis=0)
    errors = np.sqrt(np.diag(sandwich(scores, curvature)))
    evidence = []
    for name, step, error in zip(names, steps.tolist(), errors.tolist(), strict=True):
        value = float(component(drone, name)) + step
        evidence.append(Evidence(signal, value, (value - 1.96 * error, value + 1.96 * error), name))
    return evidence
