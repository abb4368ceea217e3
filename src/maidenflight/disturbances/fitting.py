"""The disturbances under which flights are most likely, half a second ahead."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.scipy.special import gammaln
from jaxtyping import Array, Float
from scipy.optimize import minimize

from maidenflight import compiler
from maidenflight.disturbances.kalman import (
    QUANTITY,
    Filtered,
    delay_speeds,
    filter_rows,
    filter_stretches,
    gains,
    predict_rows,
    scale_variance,
)
from maidenflight.disturbances.motion import MEASURED, Processes
from maidenflight.disturbances.rows import (
    Rows,
    Stretches,
    has_speeds,
    hover_speed,
    input_drone,
    stretches,
)
from maidenflight.flights.log import Flight
from maidenflight.parameters import Parameters, replace
from maidenflight.simulator.physics.dynamics import hover_command

AHEAD = 0.5
"""Time over which predictions count [s] (Busetto et al. 2025)."""
HORIZONS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5)
"""At which they are judged [s]: about as many of each size of error."""
_STRETCHES, _WINDOWS, _ITERATIONS = 16, 600, 60
"""Of flights, evenly; more take longer and tell hardly more."""
_UNKNOWN_BY = 1.0
"""Standard deviation of a logarithm about its start: what flights do not tell may be e times more
or less."""


class DisturbanceModel(NamedTuple):
    """A drone, the disturbances that its flights show, and how inputs are read."""

    drone: Parameters
    processes: Processes
    carrying_speed: float | None
    """Measured rotor speed at which the drone's thrust carries it [rad/s]; None where rotors follow
    commands."""


def start_processes() -> Processes:
    """Returns where a fit begins: a quadrotor of some tens of grams, by NanoDrone's flights."""

    def thrice(value: float) -> np.ndarray:
        return np.full(3, value)

    return Processes(
        gust_size=thrice(5.0),
        gust_time=thrice(0.3),
        trim_size=thrice(5.0),
        trim_time=thrice(3.0),
        push_size=thrice(0.3),
        push_time=thrice(1.0),
        demand_size=thrice(3.0),
        demand_time=thrice(0.5),
        drift_size=thrice(0.03),
        drift_time=thrice(1.0),
        velocity_scale=thrice(1.0),
        rate_gain=thrice(5.0),
        tilt_gain=np.full(2, 25.0),
        regulator_delay=np.array(0.02),
        speed_delay=np.array(0.006),
        velocity_walk=thrice(0.05),
        rate_walk=thrice(0.4),
        position_error=thrice(0.002),
        velocity_error=thrice(0.03),
        attitude_error=thrice(0.002),
        rate_error=thrice(0.03),
        regulator_error=thrice(3.0),
        tails=np.full(4, 2.0),
        core=np.full(4, 0.6),
        unrest_time=np.array(0.5),
        unrest_power=np.full((4, 2), 0.25),
    )


def fit_disturbances(
    flights: Sequence[Flight],
    drone: Parameters,
    on_evaluation: Callable[[int, int], None] | None = None,
) -> DisturbanceModel:
    """Finds the disturbances under which the next half second of flights is most likely.

    Beside them it finds thrust, drag, damping, and the rotors' moment against flight, each from the
    drone's on. The inertia is the drone's: half seconds in closed loop would tell one that is twice
    as large. The likelihood is that of each of `HORIZONS` by itself, by Student's t.

    Args:
        flights: checked flights of one rate, with a state. Inputs are measured rotor speeds where
            all have them, else what the drone's motors make of the commands.
        drone: identified, or a named one that is alike.
        on_evaluation: called with (evaluations, about how many).

    Raises:
        InputError: no flight is long enough, one has no state, or their rates differ.

    Source: Varin, Reid and Firth 2011, An overview of composite likelihood methods; Lange, Little
    and Taylor 1989, Robust statistical modeling using the t distribution.
    """
    carrying = hover_speed(flights) if has_speeds(flights) else None
    start = input_drone(drone, measured=carrying is not None)
    parts = stretches(flights, start, carrying)
    length = round(AHEAD / parts.period)
    few = np.linspace(0, len(parts.flight) - 1, min(_STRETCHES, len(parts.flight))).astype(int)
    parts = parts._replace(
        rows=jax.tree.map(lambda leaf: leaf[few], parts.rows),
        first=parts.first[few],
        row_count=parts.row_count[few],
        is_own=parts.is_own[few],
    )
    stretch, row = parts.starts(length)
    chosen = np.linspace(0, len(stretch) - 1, min(_WINDOWS, len(stretch))).astype(int)
    with jax.enable_x64(True):
        best = _maximise(parts, (stretch[chosen], row[chosen]), start, length, on_evaluation)
    fitted, processes = jax.tree.map(lambda leaf: np.asarray(leaf, float), best)
    if carrying is not None:
        # Speeds stay what they were: a thrust that is fitted larger carries at a smaller one.
        carrying *= float(np.sqrt(hover_command(fitted) / hover_command(start)))
    fitted = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), fitted)
    return DisturbanceModel(fitted, processes, carrying)


def filter_flights(flights: Sequence[Flight], model: DisturbanceModel) -> list[Filtered]:
    """Estimates motion, and the torques and forces that parameters lack, from past rows alone.

    Args:
        flights: checked flights of one rate, with a state, and with rotor speeds if those that the
            model was fitted to had them.
        model: of `fit_disturbances`.

    Returns:
        Rows of about 10 ms of each flight.

    Raises:
        InputError: no flight is long enough, one has no state, or their rates differ.
    """
    parts = stretches(flights, model.drone, model.carrying_speed)
    return filter_stretches(parts, model.drone, model.processes)


def _maximise(
    parts: Stretches,
    starts: tuple[np.ndarray, np.ndarray],
    start: Parameters,
    length: int,
    on_evaluation: Callable[[int, int], None] | None,
) -> tuple[Parameters, Processes]:
    judged = np.unique(np.clip(np.round(np.array(HORIZONS) / parts.period), 1, length)) - 1
    begin = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), start)
    origin = ravel_pytree((_begin_body(begin), _log_processes()))[0]
    # Windows overlap; as many as do not tell something of their own.
    independent = MEASURED * max(1, int(parts.is_own.sum()) // length)
    prior = origin, 0.5 / _UNKNOWN_BY**2 / independent
    fixed = parts.rows, starts, begin, prior, parts.period
    count = 0

    def evaluate(numbers: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal count
        count += 1
        ahead = tuple(judged.astype(int).tolist())
        value, slope = _loss(jnp.asarray(numbers), *fixed, length, ahead)
        if on_evaluation is not None:
            on_evaluation(min(count, _ITERATIONS), _ITERATIONS)
        if not np.isfinite(value) or not np.all(np.isfinite(slope)):
            return 1e6, np.zeros_like(numbers)
        return float(value), np.asarray(slope)

    best = minimize(
        evaluate,
        np.asarray(origin),
        jac=True,
        method="L-BFGS-B",
        options={"maxiter": _ITERATIONS, "maxfun": _ITERATIONS},
    )
    return _models(jnp.asarray(best.x), begin)


@partial(jax.jit, static_argnums=(6, 7), compiler_options=compiler.loop())
@jax.value_and_grad
def _loss(
    numbers: Float[Array, "n"],
    rows: Rows,
    starts: tuple[Array, Array],
    begin: Parameters,
    prior: tuple[Float[Array, "n"], float],
    period: float,
    length: int,
    judged: tuple[int, ...],
) -> Float[Array, ""]:
    (origin, weight), ahead = prior, np.array(judged)
    model = _models(numbers, begin)
    every, speeds = gains(*model, period, length), delay_speeds(rows, model[1], period)
    filtered = filter_rows(rows, model, speeds, every, period)
    first, unrest = jax.tree.map(lambda leaf: leaf[starts], filtered)
    errors = predict_rows(rows, model, speeds, first, starts, every.ahead, period)
    scale = scale_variance(every, unrest, model[1])[ahead]
    surprise = -log_density(errors[ahead], scale, 2.0 + model[1].tails[QUANTITY][None, None])
    return surprise.mean() + weight * jnp.sum((numbers - origin) ** 2)


def _models(numbers: Float[Array, "n"], begin: Parameters) -> tuple[Parameters, Processes]:
    body, logs = ravel_pytree((_begin_body(begin), _log_processes()))[1](numbers)
    return _with_body(begin, body), jax.tree.map(jnp.exp, logs)


def _log_processes() -> Processes:
    return jax.tree.map(lambda leaf: jnp.log(jnp.asarray(leaf)), start_processes())


def log_density(
    error: Float[Any, "..."], variance: Float[Any, "..."], freedom: Float[Any, "..."]
) -> Float[Array, "..."]:
    """Returns the logarithm of Student's t density of an error, of some squared scale."""
    constant = gammaln((freedom + 1) / 2) - gammaln(freedom / 2) - 0.5 * jnp.log(jnp.pi * freedom)
    far = (freedom + 1) / 2 * jnp.log1p(error**2 / variance / freedom)
    return constant - 0.5 * jnp.log(variance) - far


def _begin_body(drone: Parameters) -> dict[str, Any]:
    """What is fitted of a body, in numbers of about one."""
    inertia = drone.inertia
    return {
        "thrust": jnp.zeros(()),
        "drag": jnp.log(jnp.maximum(drone.drag, 0.3)),
        "flapping": drone.flapping_moment / inertia[:2] / 10.0,
        "damping": jnp.log(jnp.maximum(drone.rotational_damping / inertia[0], 1.0)),
    }


def _with_body(drone: Parameters, body: dict[str, Any]) -> Parameters:
    inertia = drone.inertia
    return replace(
        drone,
        thrust_to_weight=drone.thrust_to_weight * jnp.exp(body["thrust"]),
        drag=jnp.exp(body["drag"]),
        flapping_moment=10.0 * body["flapping"] * inertia[:2],
        rotational_damping=jnp.exp(body["damping"]) * inertia[0],
    )
