"""What each signal says by itself of a parameter, and whether signals agree."""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from maidenflight.identification.uncertainty import inverse, sandwich
from maidenflight.parameters import Parameters, component

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
