"""Errors of predictions in the measure of the field: mean norms by time ahead, and their sums.

From every row, or each so many, the next half second is predicted from the rows before it and the
inputs that were logged. Beside the model stand what needs none: that nothing changes, and that
velocity and body rates stay.

Source: Busetto et al. 2025, Nonlinear system identification nano-drone benchmark, sec. 4.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import polars
from jaxtyping import Array, Float, Int
from scipy.spatial.transform import Rotation
from scipy.stats import t as student

from maidenflight import compiler
from maidenflight.disturbances.fitting import (
    AHEAD,
    DisturbanceModel,
    filter_flights,
    fit_disturbances,
    log_density,
)
from maidenflight.disturbances.kalman import (
    QUANTITY,
    Filtered,
    delay_speeds,
    filter_rows,
    gains,
    logged_motion,
    predict_rows,
    scale_variance,
)
from maidenflight.disturbances.motion import SIZE, Processes, Slow
from maidenflight.disturbances.rows import Rows, Stretches, input_drone, stretches
from maidenflight.errors import InputError
from maidenflight.flights.log import Flight, by_log
from maidenflight.names import PERSISTENCE
from maidenflight.parameters import Parameters
from maidenflight.run_folder import ERROR_UNITS

ALONE, CONSTANT_RATES = "parameters alone", "constant rates"
"""Names: of the drone whose parameters are all there is; of velocity and body rates that stay."""
WITH_DISTURBANCES = "disturbances estimated"
"""Name of the model's."""
SHARES = (0.8, 0.95)
"""Of real values that predicted bands should hold."""
SUMS = 0.0
"""Horizon of the rows that hold sums over all."""
DEMANDS = ((1.0, 1.0), (4.0, 0.25), (8.0, 0.25))
"""Size and correlation time of what a regulator wants, over those that were fitted: other flights
may want more. Chosen on the brushed logs of `paper/identification/nanodrone.py`."""
_WINDOWS = 20_000
"""Predicted at most; of longer flights some rows are passed over."""


class Predictions(NamedTuple):
    """Norms of the errors of predictions of W windows, H rows each."""

    norms: dict[str, Float[np.ndarray, "H W 4"]]
    """By model: position, velocity, attitude, body rates."""
    within: dict[float, Float[np.ndarray, "H W 4"]]
    """For each of `SHARES`, the share of three axes within the bands of `WITH_DISTURBANCES`."""
    period: float
    """[s]."""


def predict_windows(
    flights: Sequence[Flight],
    model: DisturbanceModel,
    drone: Parameters,
    longest: float = AHEAD,
    every: int = 1,
) -> Predictions:
    """Predicts from each so many rows of flights, by that of `DEMANDS` that predicted best so far.

    Args:
        flights: checked flights of one rate that the model was not fitted to.
        model: of `fit_disturbances`.
        drone: that stands beside it, by its parameters alone, under the same inputs.
        longest: time that is predicted [s].
        every: rows from a window to the next.

    Raises:
        InputError: no flight is long enough, one has no state, or their rates differ.
    """
    parts = stretches(flights, model.drone, model.carrying_speed)
    length = max(1, round(longest / parts.period))
    stretch, row = parts.starts(length, every)
    if not len(stretch):
        raise InputError(
            f"no flight is long enough to predict {longest:g} s; give longer flights, or shorter "
            "horizons."
        )
    chosen = np.linspace(0, len(stretch) - 1, min(_WINDOWS, len(stretch))).astype(int)
    starts = stretch[chosen], row[chosen]
    own = input_drone(drone, measured=model.carrying_speed is not None)
    with jax.enable_x64(True):
        drones = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), (*model[:2], own))
        demands = jnp.asarray(DEMANDS, float)
        predicted = _predicted(parts.rows, *drones, demands, starts, length, parts.period)
        errors, variances, density, alone = map(np.asarray, predicted)
    flight, row = parts.flight[starts[0]], parts.first[starts[0]] + starts[1]
    best, window = _best_before(density, flight, row, length), np.arange(len(row))
    error, variance = (table[best, :, window].swapaxes(0, 1) for table in (errors, variances))
    norms = {
        name: np.linalg.norm(difference.reshape(*difference.shape[:2], 4, 3), axis=-1)
        for name, difference in ((WITH_DISTURBANCES, error), (ALONE, alone))
    }
    freedom = 2.0 + np.asarray(model.processes.tails)[QUANTITY]
    far = np.abs(error) / np.sqrt(variance)
    within = {
        share: (far < student.ppf(0.5 + share / 2, freedom)).reshape(*far.shape[:2], 4, 3).mean(-1)
        for share in SHARES
    }
    return Predictions(norms | _baselines(parts, starts, length), within, parts.period)


@partial(jax.jit, static_argnums=6, compiler_options=compiler.loop())
def _predicted(
    rows: Rows,
    drone: Parameters,
    processes: Processes,
    other: Parameters,
    demands: Float[Array, "K 2"],
    starts: tuple[Array, Array],
    length: int,
    period: float,
) -> tuple[
    Float[Array, "K H W 12"], Float[Array, "K H W 12"], Float[Array, "K W"], Float[Array, "H W 12"]
]:
    speeds = delay_speeds(rows, processes, period)

    def predict(demand: Float[Array, "2"]) -> tuple[Array, ...]:
        own = processes._replace(
            demand_size=demand[0] * processes.demand_size,
            demand_time=demand[1] * processes.demand_time,
        )
        model, every = (drone, own), gains(drone, own, period, length)
        filtered = filter_rows(rows, model, speeds, every, period)
        first, unrest = jax.tree.map(lambda leaf: leaf[starts], filtered)
        errors = predict_rows(rows, model, speeds, first, starts, every.ahead, period)
        variance = scale_variance(every, unrest, own)
        freedom = (2.0 + own.tails[QUANTITY])[None, None]
        return errors, variance, log_density(errors, variance, freedom).mean(axis=(0, 2))

    none = logged_motion(rows, starts, Slow(*[jnp.zeros((len(starts[0]), 3))] * len(Slow._fields)))
    as_it_is = other, processes._replace(velocity_scale=jnp.ones(3))
    ahead = jnp.zeros((length, SIZE, 3))
    alone = predict_rows(rows, as_it_is, speeds, none, starts, ahead, period)
    return *jax.lax.map(predict, demands), alone


def _best_before(
    density: Float[np.ndarray, "K W"],
    flight: Int[np.ndarray, "W"],
    row: Int[np.ndarray, "W"],
    length: int,
) -> Int[np.ndarray, "W"]:
    """Returns which model gave most density to the flight's windows that ended before each.

    Before any has ended, it is the first. Rows of a flight rise.

    Source: Dawid 1984, Statistical theory: the prequential approach.
    """
    best = np.zeros(len(flight), int)
    for number in np.unique(flight):
        own = np.flatnonzero(flight == number)
        ended = np.searchsorted(row[own], row[own] - length, side="right")
        sums = np.pad(np.cumsum(density[:, own], axis=1), ((0, 0), (1, 0)))
        best[own] = sums[:, ended].argmax(axis=0)
    return best


def _baselines(
    parts: Stretches, starts: tuple[np.ndarray, np.ndarray], length: int
) -> dict[str, Float[np.ndarray, "H W 4"]]:
    rows, (stretch, row) = parts.rows, starts
    position, velocity, quaternion, rates, _ = (signal[stretch, row] for signal in rows)
    attitude = Rotation.from_quat(quaternion)
    norms: dict[str, list[np.ndarray]] = {PERSISTENCE: [], CONSTANT_RATES: []}
    for ahead in range(1, length + 1):
        logged = [signal[stretch, row + ahead] for signal in rows[:4]]
        elapsed = ahead * parts.period
        turned = attitude * Rotation.from_rotvec(elapsed * rates)
        moved = position + elapsed * velocity
        for name, point, turn in (
            (PERSISTENCE, position, attitude),
            (CONSTANT_RATES, moved, turned),
        ):
            angle = (turn.inv() * Rotation.from_quat(logged[2])).magnitude()
            off = [
                np.linalg.norm(value - other, axis=-1)
                for value, other in ((point, logged[0]), (velocity, logged[1]), (rates, logged[3]))
            ]
            norms[name].append(np.stack([off[0], off[1], angle, off[2]], axis=-1))
    return {name: np.stack(some) for name, some in norms.items()}


def cross_validate(
    flights: Sequence[Flight],
    drone: Parameters,
    on_evaluation: Callable[[int, int], None] | None = None,
) -> tuple[polars.DataFrame, list[Filtered]]:
    """Predicts flights by disturbances that are fitted to others of them.

    Every other log stands on one side; each side is predicted by what is fitted to the other. Of a
    single log each half is.

    Args:
        flights: checked flights of one rate, with a state.
        drone: identified from other flights.
        on_evaluation: called with (evaluations, about how many).

    Returns:
        See `tabulate_horizons`; and what `filter_flights` says of each flight.

    Raises:
        InputError: see `fit_disturbances`.
    """
    logs = list(by_log(flights).values())
    if len(logs) == 1:
        whole = max(logs[0], key=len)
        logs = [[whole.part(0, len(whole) // 2)], [whole.part(len(whole) // 2, len(whole))]]
    sides = [[piece for log in logs[side::2] for piece in log] for side in (0, 1)]
    parts, filtered = [], []
    for number, (fitted, judged) in enumerate((sides, sides[::-1])):

        def report(done: int, of: int, number: int = number) -> None:
            if on_evaluation is not None:
                on_evaluation(number * of + done, 2 * of)

        model = fit_disturbances(fitted, drone, report)
        every = max(1, sum(map(len, judged)) // _WINDOWS)
        parts.append(predict_windows(judged, model, drone, every=every))
        filtered += filter_flights(judged, model)
    return tabulate_horizons(parts), filtered


def tabulate_horizons(parts: Sequence[Predictions]) -> polars.DataFrame:
    """Returns mean norms of errors by time ahead, and their sums.

    Args:
        parts: of `predict_windows`, of equal lengths; each window counts alike.

    Returns:
        A row a time ahead and model, then those of sums, whose `horizon` is `SUMS`: `model`,
        `horizon` [s], `windows`, the errors `position` [m], `velocity` [m/s], `attitude` [rad],
        `body_rates` [rad/s], and of `WITH_DISTURBANCES` the shares within its bands, NaN of
        others, such as `position_within_80`, mean over the three axes.
    """
    norms = {
        name: np.concatenate([part.norms[name] for part in parts], axis=1)
        for name in parts[0].norms
    }
    within = {
        share: np.concatenate([part.within[share] for part in parts], axis=1).mean(axis=1)
        for share in SHARES
    }
    windows, rows = norms[PERSISTENCE].shape[1], []
    for number in [*range(len(norms[PERSISTENCE])), None]:
        part = slice(None) if number is None else slice(number, number + 1)
        ahead = SUMS if number is None else round((number + 1) * parts[0].period, 6)
        for name, values in norms.items():
            row: dict[str, object] = {"model": name, "horizon": ahead, "windows": windows}
            row |= _by_quantity("", values[part].mean(axis=1).sum(axis=0))
            for share, holds in within.items():
                own = holds[part].mean(axis=0) if name == WITH_DISTURBANCES else np.full(4, np.nan)
                row |= _by_quantity(f"_within_{share * 100:.0f}", own)
            rows.append(row)
    return polars.DataFrame(rows)


def _by_quantity(end: str, values: Float[np.ndarray, "4"]) -> dict[str, float]:
    """Returns numbers by the name of their quantity."""
    return {f"{name}{end}": float(value) for name, value in zip(ERROR_UNITS, values, strict=True)}
