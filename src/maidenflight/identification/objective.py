"""The paper's objective: the distance between simulated and measured windows.

Each window is simulated open loop from its measured start with its recorded commands. The motors'
speed and the delay line at the start are those that the recorded commands before it imply.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from maidenflight import cores
from maidenflight.flights.windows import Windows
from maidenflight.identification.gauss_newton import NormalEquations
from maidenflight.parameters import Parameters, component, replace
from maidenflight.simulator import actuators, dynamics, rotations, stepping
from maidenflight.simulator.dynamics import State
from maidenflight.simulator.latency import DelayLine
from maidenflight.simulator.vectors import entries

DISCOUNT = 0.95
"""delta, weight of each later step over the one before (Gronauer et al. 2022, sec. Simulation
Optimization)."""
WEIGHTS = np.array([100.0] * 3 + [10.0] * 3 + [1.0] * 6, np.float32)
"""Diagonal of W: position [1/m], velocity [s/m], attitude [1/rad], body rates [s/rad]. The paper
gives no values; these are the authors' code's."""
PHYSICS_STEP = 0.005
"""Nominal physics step [s]: the paper simulates at 200 Hz."""
_CHUNK = 256
"""Windows simulated side by side; their state fits a core's cache, which is 2 to 3 times faster
than one large batch."""
_FEW = 64
"""Windows differentiated side by side, at the same cost each, so that few windows can be asked
for."""
_SMOOTHING = 0.5
"""Width over which the kink of an absolute value is rounded, as a share of what is usual in a
window."""
_SMALLEST = 1e-4
"""Weighted residual that counts as none; rounding alone is about as large."""


def simulate(window: Windows, parameters: Parameters, steps: int) -> Float[Array, "T 12"]:
    """Simulates one window.

    Args:
        window: one of `Windows` (no leading axis).
        parameters: the drone; its `time_step` times `steps` is the period of the rows.
        steps: physics steps a row.

    Returns:
        Position, velocity, attitude and body rates in the T rows after the start.
    """
    given, places, speed = under_way(window, parameters, steps)

    def advance(state: State, newest: Array) -> tuple[State, Array]:
        line = DelayLine(given, newest)
        state = stepping.drive_entries(dynamics.midpoint, state, line, steps, parameters)
        return state, jnp.stack(columns(state))

    position, velocity, quaternion, body_rates, _ = map(jnp.asarray, window[:5])
    start = entries(State(position, velocity, quaternion, body_rates, speed))
    return lax.scan(advance, start, places)[1]


def columns(state: State) -> list[Float[Array, ""]]:
    """Position, velocity, attitude and body rates of a state of `Entries`."""
    attitude = rotations.to_attitude(state.quaternion)
    return [*state.position, *state.velocity, *attitude, *state.body_rates]


def under_way(
    window: Windows, parameters: Parameters, steps: int | Array, stride: int = 1
) -> tuple[Float[Array, "history+TS 4"], Int[Array, "TS"], Float[Array, "4"]]:
    """What the recorded commands before a window's start imply.

    Args:
        window: one of `Windows` (no leading axis).
        parameters: the drone.
        steps: physics steps from a command to the next.
        stride: S, commands to a measured row.

    Returns:
        All rotor speed commands, newest first; the place among them of each row's newest command;
        and the rotor speeds at the start.
    """
    given, rows = commands(window), places(window, stride)

    def spin(speed: Array, newest: Array) -> tuple[Array, None]:
        return stepping.spin(speed, DelayLine(given, newest), steps, parameters), None

    before = jnp.arange(rows.shape[0], given.shape[0])[::-1]
    speed, _ = lax.scan(spin, given[-1], before)
    return given, rows, speed


def commands(window: Windows) -> Float[Array, "history+TS 4"]:
    """All rotor speed commands of a window, newest first."""
    return actuators.rotor_speed_command(jnp.asarray(window.command))[::-1]


def places(window: Windows, stride: int = 1) -> Int[Array, "TS"]:
    """Where among them each row's newest command is; S = `stride` commands to a row."""
    return jnp.arange(window.measured.shape[0] * stride)[::-1]


def window_loss(
    simulated: Float[Array, "T 12"],
    measured: Float[Array, "T 12"],
    weights: Float[Array, "12"],
    discount: float | Array,
) -> Float[Array, ""]:
    """sum_t delta^t |W (x_sim - x_real)|_1 + sum_t delta^t |W (x_sim - x_real)|_2, t = 1 ...

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


def wrapped(angles: Float[Array, "..."]) -> Float[Array, "..."]:
    """Angles to +-pi."""
    return (angles + jnp.pi) % (2 * jnp.pi) - jnp.pi


def _discounts(length: int, discount: float | Array) -> Float[Array, "T"]:
    return discount ** jnp.arange(1, length + 1, dtype=jnp.float32)


def in_chunks(windows: Windows, size: int = _CHUNK) -> Windows:
    """Windows by chunks of some size, on the device.

    The last chunk is filled up with windows that stand for nothing new.
    """
    count = len(windows.segment)
    chunks = -(-count // size)
    order = np.resize(np.arange(count), chunks * size)
    return jax.tree.map(
        lambda array: jnp.asarray(array[order]).reshape(chunks, size, *array.shape[1:]), windows
    )


def physics_steps(period: float) -> tuple[int, np.float32]:
    """Physics steps a row, and how long each is [s], for rows that are `period` seconds apart."""
    steps = max(1, round(period / PHYSICS_STEP))
    return steps, np.float32(period / steps)


def on_all_cores(
    compute: Callable[[int, int], tuple[Array | np.ndarray, ...]], chunks: int
) -> list[np.ndarray]:
    """Computes chunks of windows on all cores; XLA alone would use one for arrays this small.

    Every number belongs to one chunk, so the result does not depend on the number of cores.

    Args:
        compute: (first chunk, end) to arrays with a row for each chunk from the first to the end.
        chunks: how many there are.

    Returns:
        The arrays for all chunks.
    """
    workers = min(cores.count(), chunks) if jax.default_backend() == "cpu" else 1
    ends = [chunks * worker // workers for worker in range(workers + 1)]
    with ThreadPoolExecutor(workers) as pool:
        # The copies to NumPy wait for the results, and let go of Python's lock meanwhile.
        parts = list(
            pool.map(
                lambda first, end: [np.asarray(part) for part in compute(first, end)],
                ends[:-1],
                ends[1:],
            )
        )
    return [np.concatenate(pieces) for pieces in zip(*parts, strict=True)]


class Objective:
    """The objective over a set of windows, held on the device and compiled once for all parameters.

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
        self._windows = in_chunks(windows)
        self.size = len(windows.segment)
        self.segments = int(windows.segment.max()) + 1
        self._segment = windows.segment
        self.steps, self.time_step = physics_steps(period)
        self._settings = (jnp.asarray(weights), jnp.float32(discount))

    def per_window(self, parameters: Parameters) -> Float[np.ndarray, "W"]:
        """Loss of each window."""
        parameters = jax.tree.map(jnp.asarray, replace(parameters, time_step=self.time_step))

        def losses(first: int, end: int) -> tuple[Array]:
            return (
                _losses(self._windows, parameters, *self._settings, first, end, self.steps)[
                    first:end
                ],
            )

        return on_all_cores(losses, len(self._windows.segment))[0].reshape(-1)[: self.size]

    def per_segment(self, parameters: Parameters) -> Float[np.ndarray, "S"]:
        """Sum of the losses of each segment's windows."""
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
        parameters = jax.tree.map(jnp.asarray, replace(parameters, time_step=self.time_step))

        def sums(first: int, end: int) -> tuple[Array, ...]:
            share = Share(self.size, every, first, end)
            found = _normal_equations(
                self._windows, parameters, self._settings, share, self.steps, tuple(names)
            )
            return tuple(part[first:end] for part in found)

        used = -(-self.size // every)
        loss, *derivatives = (
            part.sum(axis=0, dtype=np.float64) / used
            for part in on_all_cores(sums, -(-used // _FEW))
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

    def one(window: Windows) -> Float[Array, ""]:
        return window_loss(
            simulate(window, parameters, steps), jnp.asarray(window.measured), weights, discount
        )

    def fill(number: Array, losses: Float[Array, "chunks 256"]) -> Float[Array, "chunks 256"]:
        return losses.at[number].set(
            jax.vmap(one)(jax.tree.map(lambda array: array[number], windows))
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

    def one(window: Windows) -> tuple[Array, ...]:
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
        chosen = (number * _FEW + jnp.arange(_FEW)) * every
        chunk = jax.tree.map(lambda array: array[chosen // _CHUNK, chosen % _CHUNK], windows)
        counts = jnp.where(chosen < count, 1.0, 0.0)
        return jax.tree.map(
            lambda rows, part: rows.at[number].set(jnp.tensordot(counts, part, 1)),
            sums,
            jax.vmap(one)(chunk),
        )

    chunks = -(-windows.segment.size // _FEW)
    empty = (
        jnp.zeros(chunks),
        jnp.zeros((chunks, d)),
        jnp.zeros((chunks, d, d)),
        jnp.zeros((chunks, d, d)),
    )
    return lax.fori_loop(first, end, fill, empty)
