"""Open-loop prediction errors of drones on held-out flights, in physical units.

Every quantity has its own column, since the paper's objective weighs position a hundred times as
much as body rates. Every model stands beside the persistence baseline, which predicts that nothing
changes.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import polars
from jax import lax
from jaxtyping import Array, Float, Int
from scipy.spatial.transform import Rotation

from maidenflight.errors import InputError
from maidenflight.flights import trims
from maidenflight.flights.log import GROUPS, Flight, averaged, by_log
from maidenflight.flights.windows import (
    EVERY,
    LEAD_IN,
    Windows,
    first_start,
    segment_names,
    windows,
)
from maidenflight.identification.outcome.problem import generator_of
from maidenflight.identification.replay.open_loop import (
    PHYSICS_STEP,
    in_chunks,
    simulate,
)
from maidenflight.identification.signals.flight_signals import stride
from maidenflight.identification.uncertainty import RESAMPLES, interval
from maidenflight.names import PERSISTENCE
from maidenflight.parameters import Parameters, replace
from maidenflight.run_folder import ERROR_UNITS
from maidenflight.simulator.physics import latency

HORIZONS = (0.02, 0.05, 0.1)
"""Default times ahead at which errors are measured [s]. Open loop a quadrotor tumbles within some
tenths of a second, and nothing then tells a good model from a bad one."""
LOGGED = "logged"
"""Name of what was measured, among what models predict."""
Model = Parameters | Callable[[Sequence[Flight]], Parameters]
"""A drone, or that of the pieces of a log."""
_SIGNALS = [
    column
    for group in ("position", "velocity", "attitude", "body_rates")
    for column in GROUPS[group]
]


def prediction_error(
    flights: Iterable[Flight],
    models: Mapping[str, Model],
    horizons: Sequence[float] = HORIZONS,
    lead_in: int = LEAD_IN,
    key: Array | None = None,
) -> polars.DataFrame:
    """Computes open-loop prediction errors of models, from every tenth row of flights on.

    A window starts from its measured state, and from the motors and the delay line that the
    recorded commands before it imply; the model then sees nothing but the recorded commands. All
    horizons use the same windows, those in which the longest fits. An error is the root
    mean square, over the windows, of the Euclidean distance between prediction and measurement, for
    the attitude of the angle of the rotation between the two, at most pi.

    Args:
        flights: checked flights of one rate; held out, that is not those that the models were
            identified from.
        models: drones by name, or what makes the drone of a log, such as `with_own_trim`.
        horizons: times after a window's start [s]; each is taken to the nearest row.
        lead_in: rows of commands before a window, from which its motors' speed is inferred.
        key: random key of the intervals; `jax.random.key(0)` by default.

    Returns:
        A row for each horizon and model, and for `PERSISTENCE`: `model`, `horizon` [s],
        `windows`, `segments` (of 5 s of flight, redrawn for the intervals), the errors `position`
        [m], `velocity` [m/s], `attitude` [rad], `body_rates` [rad/s], and each with `_low` and
        `_high` appended the ends of its 95 % bootstrap interval. Cost grows linearly with windows,
        horizon and models.

    Raises:
        InputError: horizons that make no sense, a model's name that is taken, a model whose
            simulation diverges, or no flight that is long enough.
    """
    flights = [averaged(flight, stride(flight)) for flight in flights]
    if not flights:
        raise InputError("no flights to predict; give at least one.")
    if PERSISTENCE in models:
        raise InputError(
            f"a model is called {PERSISTENCE!r}, the name of what models are compared with; "
            "rename it."
        )
    period = flights[0].period
    rows = _rows(horizons, period)
    window_set = windows(flights, int(rows[-1]), lead_in=lead_in)
    start = _start(window_set)
    names = np.array(segment_names(flights, int(rows[-1])))[window_set.segment]
    predictions = {
        name: _by_log(window_set, names, flights, model, period)[:, rows - 1]
        for name, model in models.items()
    }
    for name, rows_ahead in predictions.items():
        if not np.all(np.isfinite(rows_ahead)):
            raise InputError(
                f"{name}: its simulation diverges on these flights; a time constant or a damping "
                f"is too fast for physics steps of {PHYSICS_STEP * 1e3:g} ms."
            )
    predictions[PERSISTENCE] = np.broadcast_to(start[:, None], (len(start), len(rows), 12))
    squares = np.stack(
        [_errors(each, window_set.measured[:, rows - 1]) ** 2 for each in predictions.values()],
        axis=1,
    )
    numbers, segment = np.unique(window_set.segment, return_inverse=True)
    low, high = _interval(squares, segment, key)
    value = np.sqrt(squares.mean(axis=0))
    table = []
    for index, row in enumerate(rows):
        for number, name in enumerate(predictions):
            entry = {
                "model": name,
                "horizon": round(float(row * period), 6),
                "windows": len(start),
                "segments": len(numbers),
            }
            for quantity, column in enumerate(ERROR_UNITS):
                here = (number, index, quantity)
                entry |= {
                    column: float(value[here]),
                    f"{column}_low": float(low[here]),
                    f"{column}_high": float(high[here]),
                }
            table.append(entry)
    return polars.DataFrame(table)


def predicted_windows(
    flights: Iterable[Flight],
    models: Mapping[str, Parameters],
    horizon: float = HORIZONS[-1],
    count: int = 4,
    lead_in: int = LEAD_IN,
    key: Array | None = None,
) -> polars.DataFrame:
    """Predicts a few windows row by row, to look at.

    Drawn at random, each from another flight as long as there are any.

    Args:
        flights: checked flights of one rate, held out; of fast logs rows of about 10 ms are used,
            with the mean of the commands in each.
        models: drones by name.
        horizon: length of a window [s].
        count: how many windows.
        lead_in: rows of commands before a window, from which its motors' speed is inferred.
        key: random key of the choice; `jax.random.key(0)` by default.

    Returns:
        A row for each window, model (first `LOGGED`, what was measured) and row of the log from the
        window's start on: `window`, its `flight` and its `start` in it [s], `model`, `time` since
        the start [s] and, in SI units, position, velocity, roll, pitch, yaw and body rates as in a
        flight log.

    Raises:
        InputError: a horizon that makes no sense, a model that is called `LOGGED`, or no flight
            that is long enough.
    """
    flights = [averaged(flight, stride(flight)) for flight in flights]
    if not flights or count < 1:
        raise InputError(
            f"{count} windows of {len(flights)} flights to predict; give at least one of each."
        )
    if LOGGED in models:
        raise InputError(
            f"a model is called {LOGGED!r}, the name of what models are compared with; rename it."
        )
    period = flights[0].period
    length = int(_rows([horizon], period)[0])
    long = [flight for flight in flights if len(flight) > first_start(flight) + length] or flights
    generator = generator_of(key)
    repeats = np.bincount(np.resize(generator.permutation(len(long)), count), minlength=len(long))
    parts, places = [], []
    for number in np.flatnonzero(repeats):
        window_set = windows([long[number]], length, lead_in=lead_in)
        rows = np.sort(
            generator.choice(
                len(window_set.segment),
                min(repeats[number], len(window_set.segment)),
                replace=False,
            )
        )
        parts.append(jax.tree.map(lambda each, rows=rows: each[rows], window_set))
        places += [
            (long[number].name, first_start(long[number]) + EVERY * int(row)) for row in rows
        ]
    window_set = jax.tree.map(lambda *pieces: np.concatenate(pieces), *parts)
    start = _start(window_set)[:, None]
    ahead = {
        LOGGED: window_set.measured,
        **{name: predict(window_set, drone, period) for name, drone in models.items()},
    }
    joined = {name: np.concatenate([start, rows], axis=1) for name, rows in ahead.items()}
    return _window_rows(places, period, joined)


def _window_rows(
    places: list[tuple[str, int]], period: float, rows: Mapping[str, Float[np.ndarray, "W T 12"]]
) -> polars.DataFrame:
    """A table of the rows of windows, each at the `n`-th row of the flight of some name."""
    parts = []
    for number, (flight, first) in enumerate(places):
        for model, values in rows.items():
            time = {"time": np.round(np.arange(values.shape[1]) * period, 6)}
            signals = dict(zip(_SIGNALS, values[number].astype(np.float64).T, strict=True))
            columns = {
                "window": number + 1,
                "flight": flight,
                "start": round(first * period, 6),
                "model": model,
            }
            parts.append(
                polars.DataFrame(
                    {
                        **{name: [value] * values.shape[1] for name, value in columns.items()},
                        **time,
                        **signals,
                    }
                )
            )
    return polars.concat(parts)


def predict(
    window_set: Windows, parameters: Parameters, period: float
) -> Float[np.ndarray, "W T 12"]:
    """Simulates windows open loop.

    Args:
        window_set: W windows of T rows.
        parameters: the drone; its time step is set to fit the rows.
        period: time between rows [s].

    Returns:
        Position, velocity, attitude and body rates in the T rows after each start.
    """
    steps, time_step = latency.physics_steps(period, PHYSICS_STEP)
    drone = jax.tree.map(jnp.asarray, replace(parameters, time_step=time_step))
    simulated = np.asarray(_simulate(in_chunks(window_set), drone, steps))
    return simulated.reshape(-1, *simulated.shape[2:])[: len(window_set.segment)]


def with_own_trim(drone: Parameters, pieces: Sequence[Flight]) -> Parameters:
    """Returns a drone with the constant torques of a flight, where its log tells them."""
    of_flight = trims.trim(pieces, drone).torque_bias
    torques = np.where(np.isfinite(of_flight), of_flight, drone.torque_bias)
    return replace(drone, torque_bias=torques.astype(np.float32))


def without_torque(drone: Parameters) -> Parameters:
    """Returns a drone that its commands carry and hardly turn: of a thousand times its inertia."""
    return replace(drone, inertia=np.float32(1e3) * np.asarray(drone.inertia))


def _by_log(
    window_set: Windows, names: np.ndarray, flights: Sequence[Flight], model: Model, period: float
) -> Float[np.ndarray, "W T 12"]:
    """Predicts windows, those of each log by its drone."""
    if isinstance(model, Parameters):
        return predict(window_set, model, period)
    ahead = np.empty_like(window_set.measured)
    for name, pieces in by_log(flights).items():
        here = names == name
        if here.any():
            of_log = jax.tree.map(lambda each, here=here: each[here], window_set)
            ahead[here] = predict(of_log, model(pieces), period)
    return ahead


@partial(jax.jit, static_argnums=2)
def _simulate(
    chunks: Windows, parameters: Parameters, steps: int
) -> Float[Array, "chunks 256 T 12"]:
    return lax.map(jax.vmap(lambda window: simulate(window, parameters, steps)), chunks)


def _rows(horizons: Sequence[float], period: float) -> Int[np.ndarray, "K"]:
    """The rows nearest to the horizons, rising."""
    times = np.asarray(list(horizons), np.float64)
    if (
        times.size == 0
        or not np.all(np.isfinite(times))
        or times.min() < period / 2
        or times.max() > 1e6
    ):
        columns = ", ".join(f"{time:g}" for time in times) or "none"
        raise InputError(
            f"horizons: {columns}; expected one or more times in seconds, each at least a row "
            f"({period:g} s)."
        )
    rows = np.unique(np.maximum(np.round(times / period), 1)).astype(int)
    if rows.size < times.size:
        columns = ", ".join(f"{time:g}" for time in times)
        raise InputError(
            f"horizons: {columns}; two of them fall on one row (every {period:g} s). "
            "Name each once."
        )
    return rows


def _start(window_set: Windows) -> Float[np.ndarray, "W 12"]:
    """Position, velocity, attitude and body rates at the start of each window."""
    attitude = Rotation.from_quat(window_set.quaternion).as_euler("ZYX")[:, ::-1]
    return np.concatenate(
        [window_set.position, window_set.velocity, attitude, window_set.body_rates], axis=1
    )


def _errors(
    predicted: Float[np.ndarray, "W K 12"], measured: Float[np.ndarray, "W K 12"]
) -> Float[np.ndarray, "W K 4"]:
    """Distances in position and velocity, angle between the attitudes, distance in body rates."""
    difference = predicted.astype(np.float64) - measured
    attitude, other = (
        Rotation.from_euler("ZYX", rows[..., 8:5:-1].reshape(-1, 3))
        for rows in (predicted, measured)
    )
    angle = (attitude.inv() * other).magnitude().reshape(difference.shape[:2])
    position, velocity, rates = (
        np.linalg.norm(difference[..., part], axis=-1)
        for part in (slice(0, 3), slice(3, 6), slice(9, 12))
    )
    return np.stack([position, velocity, angle, rates], axis=-1)


def _interval(
    squares: Float[np.ndarray, "W M K 4"], segment: Int[np.ndarray, "W"], key: Array | None
) -> tuple[Float[np.ndarray, "M K 4"], Float[np.ndarray, "M K 4"]]:
    """Bootstrap interval of the root mean squares; all models have the same draws of segments."""
    counts = np.bincount(segment).astype(np.float64)
    sums = np.zeros((len(counts), *squares.shape[1:]))
    np.add.at(sums, segment, squares)
    draws = (
        generator_of(key)
        .multinomial(len(counts), np.full(len(counts), 1 / len(counts)), RESAMPLES)
        .astype(np.float64)
    )
    redrawn = np.sqrt(np.tensordot(draws, sums, 1) / (draws @ counts)[:, None, None, None])
    return interval(redrawn)
