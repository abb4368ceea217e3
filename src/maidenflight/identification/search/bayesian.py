"""Bayesian optimisation by a Gaussian process, as in the paper.

The acquisition function is drawn at random for every evaluation. The process models the logarithm
of the objective, which spans decades.
"""

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy
from jaxtyping import Float
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Kernel, Matern, WhiteKernel
from threadpoolctl import threadpool_limits

_FIRST = 10
"""Evenly distributed evaluations before the process is used, as in the manual of scikit-optimize's
`gp_minimize`."""
_GROWTH = 1.1
"""The kernel is fitted again when evaluations have grown by this factor. Chosen for speed: fitted
each time, sixty evaluations take twice as long; either way the minimum is found
(tests/identification/search/test_bayesian.py)."""


def minimise(
    objective: Callable[[Float[np.ndarray, "d"]], float],
    dimensions: int,
    evaluations: int,
    generator: np.random.Generator,
    on_evaluation: Callable[[], None] | None = None,
) -> tuple[Float[np.ndarray, "n d"], Float[np.ndarray, "n"]]:
    """Minimises a positive function on the unit cube.

    Args:
        objective: point to value.
        dimensions: d.
        evaluations: how often the objective is evaluated.
        generator: random numbers.
        on_evaluation: called after each, for a progress bar.

    Returns:
        All points and their values, in the order of evaluation.

    Source: Gronauer et al. 2022, sec. Simulation Optimization: lower confidence bound, expected
    improvement and probability of improvement, chosen uniformly.
    """
    first = min(_FIRST, evaluations)
    with warnings.catch_warnings():
        # Ten is no power of two; balance does not matter here.
        warnings.simplefilter("ignore", UserWarning)
        points = scipy.stats.qmc.Sobol(dimensions, rng=generator).random(first)
    values = []
    for point in points:
        values.append(objective(point))
        if on_evaluation is not None:
            on_evaluation()
    kernel, fitted_to = _kernel(dimensions), 0
    while len(values) < evaluations:
        fits = len(values) >= _GROWTH * fitted_to
        fitted_to = len(values) if fits else fitted_to
        candidate, kernel = _ask(points, np.array(values), kernel, fits, generator)
        points = np.concatenate([points, candidate[None]])
        values.append(objective(candidate))
        if on_evaluation is not None:
            on_evaluation()
    return points, np.array(values)


def _kernel(dimensions: int) -> Kernel:
    """Where fitting the kernel starts."""
    scales: Any = [0.5] * dimensions
    return ConstantKernel(4.0, (1e-2, 1e3)) * Matern(scales, (0.02, 20.0), nu=2.5) + WhiteKernel(
        1e-4, (1e-8, 1e-1)
    )


def _ask(
    points: np.ndarray,
    values: np.ndarray,
    kernel: Kernel,
    fits: bool,
    generator: np.random.Generator,
) -> tuple[np.ndarray, Kernel]:
    """The point to evaluate next, and the kernel, which is fitted if `fits`."""
    logs = np.log(np.maximum(values, 1e-12))
    scaled = (logs - logs.mean()) / (logs.std() + 1e-12)
    optimiser: Any = "fmin_l_bfgs_b" if fits else None
    process = GaussianProcessRegressor(kernel, optimizer=optimiser, random_state=0)
    # On matrices this small several threads only wait for each other, on a busy machine thirty
    # times as long as one computes.
    with warnings.catch_warnings(), threadpool_limits(1, user_api="blas"):
        warnings.simplefilter("ignore", ConvergenceWarning)
        process.fit(points, scaled)
        candidates = _candidates(points[int(np.argmin(values))], points.shape[1], generator)
        mean, deviation = process.predict(candidates, return_std=True)
    acquisition = ACQUISITIONS[generator.integers(len(ACQUISITIONS))]
    best = int(np.argmax(acquisition(mean, np.maximum(deviation, 1e-9), float(scaled.min()))))
    fitted: Any = process.kernel_
    return candidates[best], fitted


def _candidates(best: np.ndarray, dimensions: int, generator: np.random.Generator) -> np.ndarray:
    """Points among which the acquisition is maximised: everywhere, and around the best point."""
    everywhere = generator.random((1024, dimensions))
    scales = generator.choice([0.1, 0.03, 0.01], size=(512, 1))
    near = np.clip(best + scales * generator.normal(size=(512, dimensions)), 0.0, 1.0)
    return np.concatenate([everywhere, near])


def lower_confidence_bound(mean: np.ndarray, deviation: np.ndarray, best: float) -> np.ndarray:
    """Returns how low the value may well be: -(mean - 1.96 deviation)."""
    return 1.96 * deviation - mean


def expected_improvement(mean: np.ndarray, deviation: np.ndarray, best: float) -> np.ndarray:
    """Returns the expected improvement over the best value."""
    z = (best - mean) / deviation
    return (best - mean) * scipy.stats.norm.cdf(z) + deviation * scipy.stats.norm.pdf(z)


def probability_of_improvement(mean: np.ndarray, deviation: np.ndarray, best: float) -> np.ndarray:
    """Returns the probability of improving by 1 % of the values' standard deviation."""
    return scipy.stats.norm.cdf((best - 0.01 - mean) / deviation)


ACQUISITIONS = (lower_confidence_bound, expected_improvement, probability_of_improvement)
