"""One-step prediction errors and their likelihood, an objective that feedback does not bias.

Logged commands react to what the drone did. A replay over many rows does not see the disturbances
that they react to, so it takes the reaction for a cause and favours every model that damps: more
inertia, more drag, more latency. One row ahead from measured states there is hardly time for that,
and what is left, errors that last from one row to the next, is described by a noise model: each
velocity's and each body rate's error is an autoregression on its own past. Given the model, what
remains is new at each row and does not depend on past commands, so maximum likelihood is consistent
for flights under feedback.

Source: Ljung 1999, System identification: theory for the user, ch. 7 and 13.4 (prediction errors,
closed loop).
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float

from maidenflight.flights.log import Flight
from maidenflight.flights.windows import Windows, windows
from maidenflight.identification.likelihood import one_step_errors
from maidenflight.identification.likelihood.observation import (
    BALANCED,
    BY_MOMENT,
    DRAG,
    FLAPPING,
    Balance,
    NoiseModel,
    ObservationModel,
    noise_model,
    of_noise,
    without_past,
)
from maidenflight.identification.likelihood.one_step_errors import (
    AT_ONCE,
    COLUMNS,
    ORDER,
    TURNING,
    VERTICAL,
    Innovations,
)
from maidenflight.identification.methods import Likelihood
from maidenflight.identification.replay.open_loop import in_chunks, on_all_cores
from maidenflight.identification.signals.flight_signals import stride
from maidenflight.parameters import Parameters, component, replace
from maidenflight.simulator.physics import latency

LENGTH = 100
"""Rows of a window; its first rows only start the noise model, so that windows that are short waste
much: with 70 an end moves by 0.65 of half its interval (paper/identification/constants.py)."""
LEAST_NOISE = 0.002
"""Standard deviation that white noise of velocity [m/s] and body rates [rad/s] has at least: less
than any sensor's (BMI088: 0.014 deg/s/sqrt(Hz), 0.003 rad/s behind a filter of 80 Hz). Flights of a
simulator have none; an autoregression then foretells what a wrong drone leaves, to the last digit,
and neither the optimum nor the gain of a parameter means anything."""
_MOST_NOISE = 0.9
"""Share of a curvature that noise of the velocity may have; harmless within a factor of 1.4
(paper/identification/constants.py)."""
CHUNK = 32
"""Windows differentiated side by side, which fit a core's cache; harmless
(paper/identification/constants.py)."""
JOINED = 2
"""Parts of `AT_ONCE` directions are joined in multiples of this, so that two programs serve most
numbers of them."""


class OneStep(ObservationModel):
    """Minus the mean log likelihood of a row, with the noise model that fits best.

    Compiled once for all parameters.

    Cost grows linearly with rows and, for derivatives, with the number of parameters.
    """

    def __init__(self, windows: Windows, period: float, steps: int, stride: int = 1):
        """Prepares the windows.

        Args:
            windows: W windows that do not overlap.
            period: time between their commands [s].
            steps: physics steps a command.
            stride: commands to a row.
        """
        # One by one, so that one program serves any number of windows.
        chunks = zip(*in_chunks(windows, CHUNK), strict=True)
        self._chunks = [jax.device_put(type(windows)(*arrays)) for arrays in chunks]
        self.size = len(windows.segment)
        counts = np.bincount(windows.segment)
        # Windows are cut one segment after the other.
        self._ends = np.searchsorted(windows.segment, np.arange(len(counts) + 1))
        self.rows_per_segment = counts * float(windows.measured.shape[1] - ORDER)
        self.steps, self.stride = steps, stride
        self._time_step = np.float32(period / steps)
        self._climbs = np.empty(0)
        self._slopes: np.ndarray | None = None
        self._latest: (
            tuple[Parameters, tuple[str, ...], tuple[float, np.ndarray, np.ndarray]] | None
        ) = None

    def _drone(self, parameters: Parameters) -> Parameters:
        # All at once: leaf by leaf it took a twentieth of an identification.
        return jax.device_put(replace(parameters, time_step=self._time_step))

    def _by_segment(self, per_window: np.ndarray) -> np.ndarray:
        """Sums of what each window adds, by segment of flight."""
        rows = per_window.reshape(-1, *per_window.shape[2:])
        return np.stack(
            [rows[first:end].sum(axis=0, dtype=np.float64) for first, end in pairwise(self._ends)]
        )

    def _summed(
        self,
        of_errors: Callable[[Float[np.ndarray, "W C T"]], np.ndarray],
        parameters: Parameters,
        columns: Sequence[int],
    ) -> np.ndarray:
        """Sums of something that a function has of each window's errors, by segment of flight."""
        drone, by = self._drone(parameters), (self.steps, self.stride)

        def compute(first: int, end: int) -> tuple[np.ndarray, ...]:
            chunks = self._chunks[first:end]
            wrong = [one_step_errors.errors_of_chunk(chunk, drone, *by) for chunk in chunks]
            return (np.stack([of_errors(np.asarray(errors)[:, columns]) for errors in wrong]),)

        return self._by_segment(on_all_cores(compute, len(self._chunks))[0])

    def products(
        self, parameters: Parameters, columns: Sequence[int] = range(12)
    ) -> Float[np.ndarray, "S C P+1 P+1"]:
        """Products of an error with itself 0 ... P rows before, summed over each segment of flight.

        Args:
            parameters: the drone.
            columns: of `one_step_errors.errors`.
        """
        return self._summed(one_step_errors.products, parameters, columns)

    def sums(self, parameters: Parameters) -> Float[np.ndarray, "S 12"]:
        """Sums the errors of each segment of flight, without those that start the noise model."""

        def of_errors(wrong: np.ndarray) -> np.ndarray:
            return wrong[..., ORDER:].sum(axis=-1, dtype=np.float64)

        return self._summed(of_errors, parameters, range(12))

    @property
    def means(self) -> Balance:
        """How thrust and constant torques are found: mean errors are linear in them."""
        return self

    def hovering(self, parameters: Parameters) -> Float[np.ndarray, "S"]:
        """Returns the thrust-to-weight ratio at which each segment's vertical errors cancel.

        Errors are linear in it.
        """
        here = float(parameters.thrust_to_weight)
        ahead = replace(parameters, thrust_to_weight=np.float32(1.1 * here))
        errors = self.sums(parameters)[:, VERTICAL]
        slopes = (self.sums(ahead)[:, VERTICAL] - errors) / (0.1 * here)
        return here - errors / slopes

    def balance(self, parameters: Parameters) -> dict[str, float]:
        """Returns where mean errors are zero, in one pass with the slopes of the first time.

        Of a constant torque the slope is that of an angular acceleration, which inertia divides.
        """
        here = np.array([float(component(parameters, name)) for name in BALANCED])
        scale = np.array([1.0, *np.asarray(parameters.inertia, np.float64)])
        errors = self._balanced_sums(parameters)
        if self._slopes is None:
            change = np.array([0.1 * here[0], *scale[1:]])
            thrust, *torques = here + change
            stronger = replace(parameters, thrust_to_weight=np.float32(thrust))
            turned = replace(parameters, torque_bias=np.asarray(torques, np.float32))
            ahead = self._balanced_sums(turned)
            ahead[0] = self._balanced_sums(stronger)[0]
            self._slopes = (ahead - errors) / change * scale
        return dict(zip(BALANCED, (here - errors / self._slopes * scale).tolist(), strict=True))

    def _balanced_sums(self, parameters: Parameters) -> Float[np.ndarray, "4"]:
        """Sums of the errors that each of `BALANCED` brings to zero."""
        return self.sums(parameters)[:, [VERTICAL, *TURNING]].sum(axis=0)

    def climbs(self, parameters: Parameters, names: Sequence[str]) -> Float[np.ndarray, "d"]:
        """Returns the derivative of the sum of vertical errors with respect to each parameter."""
        self.derivatives(parameters, names)
        return self._climbs

    def mean_products(self, parameters: Parameters) -> Float[np.ndarray, "12 P+1 P+1"]:
        """Returns their mean over the rows."""
        return self.products(parameters).sum(axis=0) / self.rows

    def products_about_means(self, parameters: Parameters) -> Float[np.ndarray, "12 P+1 P+1"]:
        """Returns the same of what errors differ by from the mean of their segment of flight."""
        rows = np.maximum(self.rows_per_segment, 1.0)[:, None]
        constant = (self.sums(parameters) ** 2 / rows).sum(axis=0) / self.rows
        return self.mean_products(parameters) - constant[:, None, None]

    def _noisy_products(self, parameters: Parameters) -> Float[np.ndarray, "S 6 P+1 P+1"]:
        """The products of the columns that count, with the least white noise of their sensors."""
        noise = LEAST_NOISE**2 * self.rows_per_segment[:, None, None, None] * np.eye(ORDER + 1)
        return self.products(parameters, COLUMNS) + noise

    def noise_model(self, parameters: Parameters) -> NoiseModel:
        """See `ObservationModel`."""
        return noise_model(self._noisy_products(parameters).sum(axis=0) / self.rows)

    def __call__(self, parameters: Parameters) -> float:
        """Minus the mean log likelihood of a row."""
        return float(_minus_log_likelihood(self.noise_model(parameters).deviation, np.ones(6)))

    def per_segment(self, parameters: Parameters, noise: NoiseModel) -> Float[np.ndarray, "S"]:
        """See `ObservationModel`."""
        products = self._noisy_products(parameters)
        weights = np.concatenate([np.ones((6, 1)), -noise.coefficients], axis=1)
        new = np.einsum("ci,bcij,cj->bc", weights, products, weights) / noise.deviation[None] ** 2
        rows = self.rows_per_segment
        return rows * _minus_log_likelihood(noise.deviation, new / np.maximum(rows[:, None], 1.0))

    def derivatives(
        self, parameters: Parameters, names: Sequence[str]
    ) -> tuple[float, Float[np.ndarray, "S d"], Float[np.ndarray, "S d d"]]:
        """See `ObservationModel`."""
        # Where a search ends, what it computed last is needed once more.
        latest = self._latest
        if latest and latest[1] == tuple(names) and _same(latest[0], parameters):
            return latest[2]
        products = self._noisy_products(parameters)
        noise = noise_model(products.sum(axis=0) / self.rows)
        size, segments = len(names), self.segments
        scores, climbs = np.zeros((segments, size)), np.zeros(size)
        curvatures = np.zeros((segments, size, size))
        for by_moment in (False, True):
            indices = [at for at, name in enumerate(names) if (name in BY_MOMENT) == by_moment]
            if indices:
                some = [names[index] for index in indices]
                slope, curvature, climb = self._along(parameters, some, products, noise, by_moment)
                scores[:, indices], climbs[indices] = slope, climb
                curvatures[np.ix_(range(segments), indices, indices)] = curvature
        value = float(_minus_log_likelihood(noise.deviation, np.ones(6)))
        value += self._correct(parameters, names, products, noise, scores, curvatures)
        parts = value, scores / self.rows, curvatures / self.rows
        self._climbs = climbs
        self._latest = parameters, tuple(names), parts
        return parts

    def _correct(
        self,
        parameters: Parameters,
        names: Sequence[str],
        products: Float[np.ndarray, "S 6 P+1 P+1"],
        noise: NoiseModel,
        scores: Float[np.ndarray, "S d"],
        curvatures: Float[np.ndarray, "S d d"],
    ) -> float:
        """Takes what noise of the velocity does from slopes and curvatures; returns the value's."""
        period = float(self._time_step) * self.steps * self.stride
        damping, hidden = of_noise(products.sum(axis=0) / self.rows, noise, parameters, period)
        flapping = np.asarray(parameters.flapping_moment, np.float64)
        rows = self.rows_per_segment
        for index, name in enumerate(names):
            if name in DRAG:
                scores[:, index] += rows * damping[DRAG.index(name)]
            elif name in FLAPPING:
                axis, own = FLAPPING.index(name), curvatures[:, index, index]
                scores[:, index] -= rows * hidden[axis] * flapping[axis]
                # Where hardly more than noise moves, enough is left to end the search.
                own -= np.minimum(rows * hidden[axis], _MOST_NOISE * own)
        drag = np.asarray(parameters.drag, np.float64)
        return float(damping @ drag - 0.5 * hidden @ flapping**2)

    def _along(
        self,
        parameters: Parameters,
        names: Sequence[str],
        products: Float[np.ndarray, "S 6 P+1 P+1"],
        noise: NoiseModel,
        by_moment: bool,
    ) -> tuple[
        Float[np.ndarray, "S d"],
        Float[np.ndarray, "S d d"],
        Float[np.ndarray, "d"],
    ]:
        """Slope and curvature of each segment, and `climbs`, of parameters of one kind."""
        drone, size = self._drone(parameters), len(names)
        parts, by = directions(drone, names), (self.steps, self.stride)
        whole = np.sqrt(products.sum(axis=0)[:, 0, 0] / self.rows)
        sizes = noise.coefficients, noise.deviation, noise.deviation / whole
        weights, deviation, share = (np.asarray(part, np.float32) for part in sizes)
        new = Innovations(weights, deviation, share, by_moment)

        def of_chunk(chunk: Windows) -> tuple[Array, ...]:
            motors = one_step_errors.spins(chunk, drone, *by)
            along = [one_step_errors.slopes(chunk, drone, *motors, part, *by) for part in parts]
            slopes = [slope for _, slope in along]
            nothing = jax.device_put(np.zeros(slopes[0].shape, np.float32))
            slopes += [nothing] * (-len(slopes) % JOINED)
            return one_step_errors.derivatives(along[0][0], slopes, new)

        def compute(first: int, end: int) -> tuple[np.ndarray, ...]:
            return _stacked([of_chunk(chunk) for chunk in self._chunks[first:end]])

        scores, curvatures, shared, climbs = (
            self._by_segment(part) for part in on_all_cores(compute, len(self._chunks))
        )
        if not by_moment:
            scores, curvatures = without_past(scores, curvatures, shared, products, noise)
        climbs = climbs.sum(axis=0)[:size] * noise.deviation[COLUMNS.index(VERTICAL)]
        return scores[:, :size], curvatures[:, :size, :size], climbs


def log_likelihood(
    flights: Sequence[Flight], drone: Parameters, settings: Likelihood | None = None
) -> float:
    """Returns the mean log likelihood of a row [nats] under a drone and the best noise model.

    Args:
        flights: checked flights of one rate.
        drone: the drone; its noise does not count.
        settings: uses `lead_in` and `physics_step`; `Likelihood()` by default.

    Raises:
        InputError: too little flight.
    """
    settings = Likelihood() if settings is None else settings
    return -one_step_objective(flights, settings)(drone)


def one_step_objective(flights: Sequence[Flight], settings: Likelihood, every: int = 1) -> OneStep:
    """Returns the objective on each `every`-th window.

    Args:
        flights: checked flights of one rate.
        settings: uses `lead_in` and `physics_step`.
        every: windows from one that counts to the next.

    Raises:
        InputError: too little flight.
    """
    rows, period = stride(flights[0]), flights[0].period
    cut = windows(
        flights,
        LENGTH,
        every=LENGTH,
        lead_in=settings.lead_in,
        stride=rows,
    )
    steps, _ = latency.physics_steps(period, settings.physics_step)
    return OneStep(type(cut)(*(array[::every] for array in cut)), period, steps, rows)


def directions(drone: Parameters, names: Sequence[str]) -> list[Parameters]:
    """Returns a unit direction for each parameter, stacked in parts of `AT_ONCE`.

    Those without a name are zero.
    """
    nothing = jax.tree.map(lambda leaf: np.zeros_like(np.asarray(leaf)), drone)
    units = [replace(nothing, **{name: np.float32(1)}) for name in names]
    units += [nothing] * (-len(names) % AT_ONCE)
    parts = [units[first : first + AT_ONCE] for first in range(0, len(units), AT_ONCE)]
    return [jax.tree.map(lambda *leaves: np.stack(leaves), *part) for part in parts]


def _same(drone: Parameters, other: Parameters) -> bool:
    return all(
        np.array_equal(a, b)
        for a, b in zip(jax.tree.leaves(drone), jax.tree.leaves(other), strict=True)
    )


def _stacked(chunks: Sequence[tuple[Array, ...]]) -> tuple[np.ndarray, ...]:
    """What was computed for each of some chunks, with a leading axis for them.

    By NumPy, which compiles nothing for each number of them.
    """
    return tuple(
        np.stack([np.asarray(part) for part in parts]) for parts in zip(*chunks, strict=True)
    )


def _minus_log_likelihood(
    deviation: Float[np.ndarray, "6"], ratio: Float[np.ndarray, "... 6"]
) -> Any:
    """Of a row whose mean squared new errors are `ratio` times the noise model's variances."""
    return np.sum(np.log(deviation)) + 3 * np.log(2 * np.pi) + 0.5 * np.sum(ratio, axis=-1)
