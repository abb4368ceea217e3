"""The paper's objective: the distance between simulated and measured windows.

Windows are simulated open loop.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from maidenflight.flights.windows import Windows
from maidenflight.identification.methods import DISCOUNT
from maidenflight.identification.replay.open_loop import (
    CHUNK,
    PHYSICS_STEP,
    in_chunks,
    on_all_cores,
    simulate,
    wrapped,
)
from maidenflight.identification.search.gauss_newton import NormalEquations
from maidenflight.identification.search.gradient import FAR
from maidenflight.parameters import Parameters, component, replace
from maidenflight.simulator.physics import latency

WEIGHTS = np.array([100.0] * 3 + [10.0] * 3 + [1.0] * 6, np.float32)
"""Diagonal of W: position [1/m], velocity [s/m], attitude [1/rad], body rates [s/rad]. The paper
gives no values; these are the authors' code's."""
_SMOOTHING = 0.5
"""Width over which the kink of an absolute value is rounded, as a share of what is usual in a
window; harmless within a factor of 1.4 (paper/identification/constants.py)."""
_SMALLEST = 1e-4
"""Weighted residual that counts as none: by definition of single precision, positions of 8 m are
rounded by as much."""


def window_loss(
    simulated: Float[Array, "T 12"],
    measured: Float[Array, "T 12"],
    weights: Float[Array, "12"],
    discount: float | Array,
) -> Float[Array, ""]:
    """Returns the loss of a window.

    sum_t delta^t |W (x_sim - x_real)|_1 + sum_t delta^t |W (x_sim - x_real)|_2, t = 1 ...

    T, angles wrapped to +-pi.

    Source: Gronauer et al. 2022, eq:sim-opt-objective.
    """
    weighted = _residuals(simulated, measured, weights)
    per_step = jnp.sum(jnp.abs(weighted), axis=1) + jnp.sqrt(jnp.sum(weighted**2, axis=1))
    return jnp.sum(_discounts(per_step.shape[0], discount) * per_step)


def _residuals(
    simulated: Float[Array, "T 12"], measured: Float[Array, "T 12"], weights: Float[Array, "12"]
) -> Float[Array, "T 12"]:
    wrong = simulated - measured
    return weights[None] * jnp.concatenate(
        [wrong[:, :6], wrapped(wrong[:, 6:9]), wrong[:, 9:]], axis=1
    )


def _discounts(length: int, discount: float | Array) -> Float[Array, "T"]:
    return discount ** jnp.arange(1, length + 1, dtype=jnp.float32)


class Objective:
    """The objective over a set of windows, on the device and compiled once for all parameters.

    Cost grows linearly with windows and their length; 10,000 windows of 30 rows take about 0.025 s
    on two idle cores.
    """

    def __init__(
        self,
        windows: Windows,
        period: float,
        discount: float = DISCOUNT,
        weights: Float[np.ndarray, "12"] = WEIGHTS,
    ):
        """Prepares the windows.

        Args:
            windows: W windows.
            period: time between their rows [s].
            discount: delta.
            weights: diagonal of W.
        """
        self._windows = jax.device_put(in_chunks(windows))
        self.size = len(windows.segment)
        self.segments = int(windows.segment.max()) + 1
        self._segment = windows.segment
        self.period = period
        self.steps, self._time_step = latency.physics_steps(period, PHYSICS_STEP)
        self._settings = (jnp.asarray(weights), jnp.float32(discount))

    def per_window(self, parameters: Parameters) -> Float[np.ndarray, "W"]:
        """Loss of each window."""
        parameters = jax.tree.map(jnp.asarray, replace(parameters, time_step=self._time_step))

        def losses(first: int, end: int) -> tuple[Array]:
            every = _losses(self._windows, parameters, *self._settings, first, end, self.steps)
            return (every[first:end],)

        return on_all_cores(losses, len(self._windows.segment))[0].reshape(-1)[: self.size]

    def per_segment(self, parameters: Parameters) -> Float[np.ndarray, "S"]:
        """Returns the sum of the losses of each segment's windows."""
        return np.bincount(
            self._segment, weights=self.per_window(parameters), minlength=self.segments
        )

    def __call__(self, parameters: Parameters) -> float:
        """Mean loss of the windows, F(xi, D) over the size of D."""
        return float(self.per_window(parameters).mean(dtype=np.float64))

    def normal_equations(
        self, parameters: Parameters, names: Sequence[str], every: int = 1
    ) -> NormalEquations:
        """Loss, gradient and curvature. Costs as much as four to eight evaluations.

        With J the Jacobian of the weighted residuals r: the gradient is J^T V r with the weights V
        of iteratively reweighted least squares, 1 / |r_i| + 1 / |r|_2; the majorant is J^T V J; the
        curvature is J^T B J, with B the second derivative of the loss in r, its kinks rounded.

        Args:
            parameters: where.
            names: d names of `parameters.COMPONENTS`.
            every: 1 for all windows, n for each n-th, at an n-th of the cost.

        Source: Holland and Welsch 1977, Robust regression using iteratively reweighted
        least-squares.
        """
        parameters = jax.tree.map(jnp.asarray, replace(parameters, time_step=self._time_step))

        def sums(first: int, end: int) -> tuple[Array, ...]:
            share = Share(self.size, every, first, end)
            equations = _normal_equations(
                self._windows, parameters, self._settings, share, self.steps, tuple(names)
            )
            return tuple(part[first:end] for part in equations)

        segment_count = -(-self.size // every)
        loss, *derivatives = (
            part.sum(axis=0, dtype=np.float64) / segment_count
            for part in on_all_cores(sums, -(-segment_count // FAR))
        )
        return NormalEquations(float(loss), *derivatives)

    @property
    def windows_per_segment(self) -> Float[np.ndarray, "S"]:
        """Number of windows in each segment."""
        return np.bincount(self._segment, minlength=self.segments).astype(np.float64)


@partial(jax.jit, static_argnums=(6,))
def _losses(
    windows: Windows,
    parameters: Parameters,
    weights: Array,
    discount: Array,
    first: Array | int,
    end: Array | int,
    steps: int,
) -> Float[Array, "chunks 256"]:
    """Losses of the windows of some chunks, and zeros for the others."""

    def loss(window: Windows) -> Float[Array, ""]:
        return window_loss(
            simulate(window, parameters, steps), jnp.asarray(window.measured), weights, discount
        )

    def fill(number: Array, losses: Float[Array, "chunks 256"]) -> Float[Array, "chunks 256"]:
        return losses.at[number].set(
            jax.vmap(loss)(jax.tree.map(lambda array: array[number], windows))
        )

    return lax.fori_loop(first, end, fill, jnp.zeros(windows.segment.shape))


class Share(NamedTuple):
    """Some chunks of some of the windows."""

    windows: Array | int
    """How many there are."""
    every: Array | int
    """Of these each so many-th is used."""
    first: Array | int
    """The first chunk."""
    end: Array | int
    """The chunk after the last."""


@partial(jax.jit, static_argnums=(4, 5))
def _normal_equations(
    windows: Windows,
    parameters: Parameters,
    settings: tuple[Array, Array],
    share: Share,
    steps: int,
    names: tuple[str, ...],
) -> tuple[
    Float[Array, "chunks"],
    Float[Array, "chunks d"],
    Float[Array, "chunks d d"],
    Float[Array, "chunks d d"],
]:
    """`NormalEquations` summed over each chunk of a share, zeros for the other chunks."""
    (weights, discount), (count, every, first, end) = settings, share
    values = jnp.stack([jnp.asarray(component(parameters, name), jnp.float32) for name in names])
    d = len(names)

    def window_sums(window: Windows) -> tuple[Array, ...]:
        def residuals(
            values: Float[Array, "d"],
        ) -> tuple[Float[Array, "T 12"], Float[Array, "T 12"]]:
            drone = replace(parameters, **dict(zip(names, values, strict=True)))
            left = _residuals(simulate(window, drone, steps), jnp.asarray(window.measured), weights)
            return left, left

        # A slope that is not finite gives no direction.
        slopes, left = jax.vmap(
            lambda way: jax.jvp(residuals, (values,), (way,), has_aux=True)[1:], out_axes=(0, None)
        )(jnp.eye(d))
        slopes = jnp.where(jnp.isfinite(slopes), slopes, 0.0)
        size = jnp.sqrt(jnp.sum(left**2, axis=1, keepdims=True))
        single, joint = (
            1.0 / jnp.maximum(jnp.abs(left), _SMALLEST),
            1.0 / jnp.maximum(size, _SMALLEST),
        )
        usual = _SMOOTHING * jnp.mean(jnp.abs(left), axis=0, keepdims=True) + _SMALLEST
        spread = left**2 + usual**2
        rounded = usual**2 / (spread * jnp.sqrt(spread))
        discounts = _discounts(left.shape[0], discount)[:, None]
        along = jnp.sum(slopes * (left * joint)[None], axis=2)
        flat = slopes.reshape(d, -1)

        def product(weight: Float[Array, "T 12"]) -> Float[Array, "d d"]:
            return (flat * (discounts * weight).reshape(1, -1)) @ flat.T

        return (
            jnp.sum(discounts[:, 0] * (jnp.sum(jnp.abs(left), axis=1) + size[:, 0])),
            flat @ (discounts * (single + joint) * left).reshape(-1),
            product(rounded + joint) - ((discounts * joint).reshape(1, -1) * along) @ along.T,
            product(single + joint),
        )

    def fill(number: Array, sums: tuple[Array, ...]) -> tuple[Array, ...]:
        indices = (number * FAR + jnp.arange(FAR)) * every
        chunk = jax.tree.map(lambda array: array[indices // CHUNK, indices % CHUNK], windows)
        counts = jnp.where(indices < count, 1.0, 0.0)
        return jax.tree.map(
            lambda rows, part: rows.at[number].set(jnp.tensordot(counts, part, 1)),
            sums,
            jax.vmap(window_sums)(chunk),
        )

    chunks = -(-windows.segment.size // FAR)
    empty = (
        jnp.zeros(chunks),
        jnp.zeros((chunks, d)),
        jnp.zeros((chunks, d, d)),
        jnp.zeros((chunks, d, d)),
    )
    return lax.fori_loop(first, end, fill, empty)
