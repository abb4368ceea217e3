"""Observation models: how likely it is what flights measured, under a drone.

Of what a model predicts the errors are autoregressive noise. `estimator` fits every
`ObservationModel`: `one_step` for logs with a state, `sensor_errors` for those without.

Constant torques are estimated by their moment: they make the mean error zero. An autoregression
takes what lasts for noise, whose mean hardly counts, so that the likelihood of a constant is flat,
and drifts within flights carry it to any bound.

Source: Ljung 1999, System identification: theory for the user, ch. 7 (prediction errors).
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Float

from maidenflight.identification.outcome.plausible import HOVERING
from maidenflight.identification.search.gauss_newton import NormalEquations
from maidenflight.identification.uncertainty import Evidence, of_scores
from maidenflight.parameters import Parameters

BY_MOMENT = ("torque_bias_x", "torque_bias_y", "torque_bias_z")
"""Constant torques, how battery and propellers sit, which people change between flights: mean
errors tell them, not the likelihood."""
BALANCED = (HOVERING, *BY_MOMENT)
"""What a `Balance` finds, in the order of `trims.with_standard_errors`; it differs from flight to
flight, and a log of the day tells it."""
DRAG = ("drag_x", "drag_y", "drag_z")
"""Parameters that noise of the velocity passes for; see `of_noise`."""
FLAPPING = ("flapping_moment_x", "flapping_moment_y")
"""Parameters that noise of the velocity hides; likewise."""
MOTORS = ("motor_time_constant", "spin_down_ratio", "motor_coasting", "latency")
"""Parameters on which the rotors' speeds depend, besides commands."""


class NoiseModel(NamedTuple):
    """What prediction errors are: an autoregression of P rows for each of C columns."""

    coefficients: Float[np.ndarray, "C P"]
    """Weight of the error 1 ... P rows ago."""
    deviation: Float[np.ndarray, "C"]
    """Standard deviation of what is new in each row, in the column's unit."""


def noise_model(products: Float[np.ndarray, "C P+1 P+1"]) -> NoiseModel:
    """Returns the least-squares autoregression by the products of errors with their past."""
    past, now = products[:, 1:, 1:], products[:, 1:, 0]
    ridge = 1e-9 * np.trace(past, axis1=1, axis2=2)[:, None, None] * np.eye(past.shape[1])
    coefficients = np.linalg.solve(past + ridge, now[..., None])[..., 0]
    variance = products[:, 0, 0] - np.sum(coefficients * now, axis=1)
    return NoiseModel(coefficients, np.sqrt(np.maximum(variance, 1e-16)))


class OfNoise(NamedTuple):
    """What white noise of the velocity does to the mean log likelihood of a row."""

    damping: Float[np.ndarray, "3"]
    """What it gains by each of `DRAG` [nats s]: a velocity that is measured too high falls by the
    next row, as if by drag."""
    hidden: Float[np.ndarray, "2"]
    """Curvature that is noise's by each of `FLAPPING`: a moment in proportion to a velocity that is
    measured with noise comes out too small."""


def of_noise(
    products: Float[np.ndarray, "6 P+1 P+1"], noise: NoiseModel, drone: Parameters, period: float
) -> OfNoise:
    """Returns what white noise of the velocity does.

    Noise is in the errors of two rows, with opposite signs, so that the mean of their product is
    minus its variance; disturbances add up and are in one. Slopes are whitened as errors are.

    Args:
        products: means of velocity and body rates' errors with their past.
        noise: the autoregression of these errors.
        drone: its inertia.
        period: between two rows [s].

    Source: Nakamura 1990, Corrected score function for errors-in-variables models; Fuller 1987,
    Measurement error models, sec. 1.2.
    """
    variance = np.maximum(-products[:3, 0, 1], 0.0)
    variance[:2] = variance[:2].mean()
    weights = np.concatenate([np.ones((6, 1)), -noise.coefficients], axis=1)
    whole = np.sum(weights**2, axis=1)
    shared = np.sum(weights[:, 1:] * weights[:, :-1], axis=1)
    scale = variance[0] / noise.deviation[3:5] ** 2
    slope = period / np.asarray(drone.inertia, np.float64)[:2]
    return OfNoise(
        period * variance * (whole - shared)[:3] / noise.deviation[:3] ** 2,
        slope**2 * scale * whole[3:5],
    )


def without_past(
    scores: Float[np.ndarray, "S d"],
    curvatures: Float[np.ndarray, "S d d"],
    shared: Float[np.ndarray, "S d C P"],
    products: Float[np.ndarray, "S C P+1 P+1"],
    noise: NoiseModel,
) -> tuple[Float[np.ndarray, "S d"], Float[np.ndarray, "S d d"]]:
    """Returns slopes and curvatures without what a change of the autoregression could do as well.

    Args:
        scores: slopes of half the squared new errors, by segment and parameter.
        curvatures: products of the new errors' slopes.
        shared: their products with the past errors.
        products: of errors with their past.
        noise: the autoregression.

    Source: Golub and Pereyra 1973; see `ObservationModel.derivatives`.
    """
    pasts = products[..., 1:, 1:] / noise.deviation[:, None, None] ** 2
    left = (
        products[..., 1:, 0] - np.einsum("bcij,cj->bci", products[..., 1:, 1:], noise.coefficients)
    ) / noise.deviation[:, None] ** 2
    # The weights with which an error's past stands in for a slope, column by column.
    columns = zip(pasts.sum(axis=0), shared.sum(axis=0).swapaxes(0, 1), strict=True)
    weights = np.stack([np.linalg.lstsq(past, part.T, rcond=1e-12)[0].T for past, part in columns])
    scores = scores - np.einsum("cdi,bci->bd", weights, left, optimize=True)
    twice = np.einsum("cdi,bfci->bdf", weights, shared, optimize=True)
    around = np.einsum("cdi,bcij,cfj->bdf", weights, pasts, weights, optimize=True)
    return scores, curvatures - twice - twice.swapaxes(1, 2) + around


class Balance(Protocol):
    """How a model finds thrust and constant torques by mean errors instead of the likelihood."""

    def balance(self, parameters: Parameters) -> dict[str, float]:
        """Returns the value of each of `BALANCED` at which its mean error is zero."""
        ...

    def hovering(self, parameters: Parameters) -> Float[np.ndarray, "S"]:
        """Returns the thrust-to-weight ratio of that kind of each segment alone."""
        ...

    def climbs(self, parameters: Parameters, names: Sequence[str]) -> Float[np.ndarray, "d"]:
        """Returns the slope of the sum of vertical errors with respect to each parameter."""
        ...


class ObservationModel(Protocol):
    """Minus the mean log likelihood of a row, with the noise model that fits best.

    A model says `rows_per_segment`, `noise_model`, `per_segment` and `derivatives` of flights in S
    segments; the rest follows.
    """

    rows_per_segment: Float[np.ndarray, "S"]
    """Rows that count."""

    def noise_model(self, parameters: Parameters) -> NoiseModel:
        """Returns the noise model that fits best (least squares)."""
        ...

    def per_segment(self, parameters: Parameters, noise: NoiseModel) -> Float[np.ndarray, "S"]:
        """Returns minus the log likelihood of each segment of flight under a noise model."""
        ...

    def derivatives(
        self, parameters: Parameters, names: Sequence[str]
    ) -> tuple[float, Float[np.ndarray, "S d"], Float[np.ndarray, "S d d"]]:
        """Returns the value, and what each segment of flight adds to its slope and curvature.

        The noise model is the best at each point: what a change of the autoregression could do as
        well is taken from every slope (variable projection). Left in, it makes steps too short and
        intervals too narrow by a quarter.

        A parameter of `BY_MOMENT` has the gradient and the curvature of half the errors' mean
        square instead, and shares no curvature with others: what minimises that makes the mean
        error zero.

        Value and slopes lack what noise gains by drag, and loses by flapping; see
        `of_noise`.

        Args:
            parameters: where.
            names: d names of `parameters.COMPONENTS`.

        Source: Golub and Pereyra 1973, The differentiation of pseudo-inverses and nonlinear least
        squares problems whose variables separate; Kaufman 1975.
        """
        ...

    @property
    def rows(self) -> float:
        """Rows of all segments that count."""
        return float(self.rows_per_segment.sum())

    @property
    def segments(self) -> int:
        """Segments of flight, S."""
        return len(self.rows_per_segment)

    @property
    def means(self) -> Balance | None:
        """How thrust and constant torques are found by mean errors; None by the derivatives."""
        return None

    def __call__(self, parameters: Parameters) -> float:
        """Minus the mean log likelihood of a row."""
        return float(self.per_segment(parameters, self.noise_model(parameters)).sum() / self.rows)

    def evidence(self, signal: str, drone: Parameters, names: Sequence[str]) -> list[Evidence]:
        """Returns what the flights say of some parameters by themselves; see `of_scores`."""
        _, scores, curvatures = self.derivatives(drone, names)
        return of_scores(
            signal, drone, names, scores * self.rows, curvatures.sum(axis=0) * self.rows
        )

    def normal_equations(self, parameters: Parameters, names: Sequence[str]) -> NormalEquations:
        """Returns value, gradient and Gauss-Newton curvature; see `derivatives`."""
        value, scores, curvatures = self.derivatives(parameters, names)
        total = curvatures.sum(axis=0)
        return NormalEquations(value, scores.sum(axis=0), total, total)
