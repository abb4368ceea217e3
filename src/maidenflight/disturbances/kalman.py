"""The filter of motion and disturbances, and predictions by logged inputs from where it stands.

Errors are in the body's axes, in which they grow alike wherever the drone is. Covariances and gains
therefore depend on nothing but the rows since a flight began, and one recursion serves all rows and
windows. Means follow the whole physics.

Source: Kalman 1960, A new approach to linear filtering and prediction problems; Barrau and Bonnabel
2017, The invariant extended Kalman filter as a stable observer.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from maidenflight import compiler
from maidenflight.disturbances.motion import (
    MEASURED,
    SIZE,
    Motion,
    Processes,
    Slow,
    advance,
    angular_acceleration,
    as_logged,
    difference,
    linearise,
    move,
    regulator,
    sizes,
    times,
)
from maidenflight.disturbances.rows import FIRST, Rows, Stretches
from maidenflight.parameters import Parameters, replace

GAINS = 300
"""Rows after which the gain is taken as constant."""
_AT_START = (0.01, 0.1, 0.01, 0.3)
"""Standard deviations of a flight's first row: position [m], velocity [m/s], attitude [rad], body
rates [rad/s], chosen wide."""
_EARLIER = 6
"""Rows among which delayed inputs are interpolated."""

QUANTITY = np.repeat(np.arange(4), 3)
"""Of each entry of an error: position, velocity, attitude, body rates."""


class Gains(NamedTuple):
    """What follows from the model alone, for any flight."""

    filtering: Float[Array, "GAINS 27 15"]
    """By rows since a flight began."""
    covariance: Float[Array, "27 27"]
    """Of what is filtered, after `GAINS` rows."""
    surprise: Float[Array, "15"]
    """Variance of what a row surprises with, after `GAINS` rows."""
    ahead: Float[Array, "H 27 3"]
    """Of the regulator's answer to inputs, by rows since a window began."""
    variance: Float[Array, "H 12"]
    """Of predictions of the log, squared scale, body axes."""


def gains(drone: Parameters, processes: Processes, period: float | Array, length: int) -> Gains:
    """Returns gains and variances, of predictions of some rows.

    Args:
        drone: its parameters.
        processes: what changes slowly.
        period: of the rows [s].
        length: H, rows that are predicted.
    """
    growth, answer = linearise(drone, processes, period)
    noise, start, errors = _covariances(processes, period)
    logged = jnp.eye(MEASURED, SIZE).at[3:6, -3:].set(jnp.eye(3))
    logged = logged.at[3:6, 3:6].set(jnp.diag(processes.velocity_scale))
    measured = jnp.concatenate([logged, answer])

    def correct(covariance: Array, slope: Array, error: Array) -> tuple[Array, Array]:
        along = slope @ covariance
        gain = jnp.linalg.solve(along @ slope.T + jnp.diag(error), along).T
        left = jnp.eye(SIZE) - gain @ slope
        # Joseph's form stays positive.
        return gain, left @ covariance @ left.T + gain @ jnp.diag(error) @ gain.T

    def grow(covariance: Array) -> Array:
        return growth @ covariance @ growth.T + noise

    def filter_row(covariance: Array, _: None) -> tuple[Array, tuple[Array, Array]]:
        gain, after = correct(covariance, measured, errors)
        return grow(after), (gain, after)

    def predict_row(covariance: Array, is_first: Array) -> tuple[Array, tuple[Array, Array]]:
        # The filter has used the first row's answer already.
        gain, after = correct(covariance, answer, errors[MEASURED:])
        later = grow(jnp.where(is_first, covariance, after))
        return later, (
            jnp.where(is_first, 0.0, gain),
            jnp.diagonal(logged @ later @ logged.T),
        )

    _, (filtering, after) = lax.scan(filter_row, start, None, length=GAINS)
    _, (ahead, variance) = lax.scan(predict_row, after[-1], jnp.arange(length) == 0)
    surprise = jnp.diagonal(measured @ grow(after[-1]) @ measured.T) + errors
    return Gains(filtering, after[-1], surprise, ahead, variance + errors[None, :MEASURED])


def _covariances(processes: Processes, period: float | Array) -> tuple[Array, Array, Array]:
    model = processes
    stationary = jnp.concatenate([size**2 for size in sizes(model)])
    decay = jnp.concatenate([-jnp.expm1(-2 * period / time) for time in times(model)])
    tiny = jnp.full(3, 1e-12)
    walks = [tiny, model.velocity_walk**2 * period, tiny, model.rate_walk**2 * period]
    errors = model.position_error, model.velocity_error, model.attitude_error, model.rate_error
    return (
        jnp.diag(jnp.concatenate([*walks, stationary * decay])),
        jnp.diag(jnp.concatenate([jnp.repeat(jnp.array(_AT_START) ** 2, 3), stationary])),
        jnp.concatenate([*errors, model.regulator_error]) ** 2,
    )


def filter_rows(
    rows: Rows,
    model: tuple[Parameters, Processes],
    speeds: Float[Array, "C N 4"],
    every: Gains,
    period: float,
) -> tuple[Motion, Float[Array, "C N 5"]]:
    """Returns the filtered motion in each row, and the unrest of those before.

    Unrest is the mean square of what rows surprise with, over its variance, of position, velocity,
    attitude, body rates and the regulator's answer: shares of variance that predictions take over.

    Args:
        rows: stretches of flights.
        model: drone, and what changes slowly.
        speeds: of rotors until the next row, of `delay_speeds`.
        every: of `gains`.
        period: of the rows [s].

    Source: Mehra 1970, On the identification of variances and adaptive Kalman filtering.
    """
    drone, processes = model
    share = -jnp.expm1(-period / processes.unrest_time)

    def follow(stretch: Rows) -> tuple[Motion, Array]:
        none = jnp.zeros((len(stretch.position), 3))
        logged = Motion(*stretch[:4], Slow(*[none] * 5))

        def correct(
            before: tuple[Motion, Array], now: tuple[Motion, Array, Array]
        ) -> tuple[tuple[Motion, Array], tuple[Motion, Array]]:
            (motion, unrest), (row, speed, number) = before, now
            gain = every.filtering[jnp.minimum(number, GAINS - 1)]
            left = _unexplained(motion, speed, drone, processes)
            new = jnp.concatenate([difference(as_logged(motion, processes), row), left])
            after = move(motion, gain @ new)
            excess = jnp.mean((new**2 / every.surprise).reshape(5, 3), axis=1) - unrest
            unrest = unrest + share * excess
            return (advance(after, speed, drone, processes, period), unrest), (after, unrest)

        first = jax.tree.map(lambda leaf: leaf[0], logged), jnp.ones(5)
        numbers = jnp.arange(len(stretch.position))
        return lax.scan(correct, first, (logged, stretch.rotor_speed, numbers))[1]

    return jax.vmap(follow)(rows._replace(rotor_speed=speeds))


def scale_variance(
    every: Gains, unrest: Float[Array, "W 5"], processes: Processes
) -> Float[Array, "H W 12"]:
    """Returns the squared scale of predictions, by the unrest before each window.

    Args:
        every: of `gains`.
        unrest: of `filter_rows`, at each window's start.
        processes: uses `unrest_power` and `core`.
    """
    logs, powers = jnp.log(jnp.maximum(unrest, 1e-3)), processes.unrest_power[None]
    loud = jnp.mean(logs[:, 3:], axis=1, keepdims=True)
    quiet, growing = jnp.exp(powers[..., 0] * logs[:, :4]), jnp.exp(powers[..., 1] * loud)
    now = jnp.minimum(every.variance[:1], every.variance)[:, None]
    later = every.variance[:, None] - now
    variance = now * quiet[None, :, QUANTITY] + later * growing[None, :, QUANTITY]
    return processes.core[QUANTITY][None, None] * variance


def predict_rows(
    rows: Rows,
    model: tuple[Parameters, Processes],
    speeds: Float[Array, "C N 4"],
    first: Motion,
    starts: tuple[Int[Any, "W"], Int[Any, "W"]],
    ahead: Float[Array, "H 27 3"],
    period: float,
) -> Float[Array, "H W 12"]:
    """Returns by how much predictions miss the log, in the body's axes.

    Args:
        rows: stretches of flights.
        model: drone, and what changes slowly.
        speeds: of rotors until the next row, of `delay_speeds`.
        first: motion at the start of each window.
        starts: stretch and row of each window.
        ahead: of `gains`; zeros for a drone that nobody holds.
        period: of the rows [s].
    """
    (drone, processes), (stretch, row) = model, starts

    def predict(motion: Motion, now: tuple[Array, Array]) -> tuple[Motion, Array]:
        number, gain = now

        def step(motion: Motion, speed: Array) -> Motion:
            answer = gain @ _unexplained(motion, speed, drone, processes)
            return advance(move(motion, answer), speed, drone, processes, period)

        later = jax.vmap(step)(motion, speeds[stretch, row + number])
        logged = logged_motion(rows, (stretch, row + number + 1), later.slow)
        own = jax.vmap(as_logged, (0, None))(later, processes)
        return later, jax.vmap(difference)(own, logged)

    return lax.scan(predict, first, (jnp.arange(len(ahead)), ahead))[1]


def logged_motion(rows: Rows, places: tuple[Any, Any], slow: Slow) -> Motion:
    """Returns what logs hold of the motion in some rows, by stretch and row."""
    position, velocity, quaternion, rates = (jnp.asarray(signal)[places] for signal in rows[:4])
    return Motion(position, velocity, quaternion, rates, slow)


def delay_speeds(rows: Rows, processes: Processes, period: float) -> Float[Array, "C N 4"]:
    """Returns rotor speeds in the middle between each row and the next, as late as they act.

    Args:
        rows: stretches of flights.
        processes: uses `speed_delay`.
        period: of the rows [s].
    """
    speeds, late = jnp.asarray(rows.rotor_speed), processes.speed_delay / period
    count, offsets = speeds.shape[1], jnp.arange(2 - _EARLIER, 2)
    places = (jnp.arange(count)[:, None] + offsets[None]).clip(0, count - 1)
    weights = jnp.clip(1.0 - jnp.abs(offsets.astype(float) - (0.5 - late)), 0.0, 1.0)
    return jnp.einsum("cnkm,k->cnm", speeds[:, places], weights)


def _unexplained(
    motion: Motion, speed: Array, drone: Parameters, processes: Processes
) -> Float[Array, "3"]:
    return angular_acceleration(motion, speed, drone) - regulator(motion, processes)


class Filtered(NamedTuple):
    """Motion and disturbances of one flight, in rows of about 10 ms; N rows."""

    position: Float[np.ndarray, "N 3"]
    velocity: Float[np.ndarray, "N 3"]
    quaternion: Float[np.ndarray, "N 4"]
    body_rates: Float[np.ndarray, "N 3"]
    torque: Float[np.ndarray, "N 3"]
    """That parameters lack, body axes [N m]."""
    force: Float[np.ndarray, "N 3"]
    """That parameters lack, body axes [N]."""
    torque_covariance: Float[np.ndarray, "3 3"]
    """Of the torque's error, once the filter has settled [N2 m2]."""
    force_covariance: Float[np.ndarray, "3 3"]
    """[N2]."""
    period: float
    """[s]."""


@partial(jax.jit, compiler_options=compiler.loop())
def _filtered(
    rows: Rows, model: tuple[Parameters, Processes], period: float
) -> tuple[Motion, Array]:
    every = gains(*model, period, 1)
    speeds = delay_speeds(rows, model[1], period)
    motion, _ = filter_rows(rows, model, speeds, every, period)
    return motion, every.covariance


def filter_stretches(
    stretches: Stretches, drone: Parameters, processes: Processes
) -> list[Filtered]:
    """Returns the filtered motion of each flight; see `fitting.filter_flights`."""
    with jax.enable_x64(True):
        numbers = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), (drone, processes))
        motion, covariance = _filtered(stretches.rows, numbers, stretches.period)
        motion, covariance = jax.tree.map(np.asarray, (motion, covariance))
    inertia, mass = np.asarray(drone.inertia, float), float(drone.mass)
    both = np.concatenate([np.eye(3), np.eye(3)], axis=1)  # gust and trim
    torques = inertia[:, None] * both @ covariance[12:18, 12:18] @ both.T * inertia
    flights = []
    for number in range(stretches.flight.max() + 1):
        parts = np.flatnonzero(stretches.flight == number)
        own = stretches.is_own[parts]
        # The flight's first rows, too.
        own[0] |= np.arange(own.shape[1]) < min(FIRST, stretches.row_count[parts[0]])
        slow = motion.slow
        position, velocity, quaternion, rates = (signal[parts][own] for signal in motion[:4])
        torque = inertia * (slow.gust + slow.trim)[parts][own]
        force, forces = mass * slow.push[parts][own], mass**2 * covariance[18:21, 18:21]
        flights.append(
            Filtered(
                *(position, velocity, quaternion, rates, torque, force, torques, forces),
                period=stretches.period,
            )
        )
    return flights


def with_disturbances(drone: Parameters, flights: Sequence[Filtered]) -> Parameters:
    """Returns a drone on which act what flights show, as large and as slow, for simulations of it.

    Variances are those about each flight's mean, which is a trim, and those of the filter's errors.
    A correlation time is that after which the autocorrelation has fallen to 1/e.

    Args:
        drone: a point.
        flights: of `filter_flights`.

    Source: law of total variance; Uhlenbeck and Ornstein 1930, On the theory of the Brownian
    motion.
    """
    errors = [[flight.torque_covariance, flight.force_covariance] for flight in flights]
    rows = np.array([len(flight.torque) for flight in flights])
    unknown = np.average(np.diagonal(errors, axis1=2, axis2=3), axis=0, weights=rows)
    period = flights[0].period
    torque, torque_time = _spread([flight.torque for flight in flights], period)
    force, force_time = _spread([flight.force for flight in flights], period)
    return replace(
        drone,
        disturbance_torque=np.sqrt(torque + unknown[0]).astype(np.float32),
        disturbance_torque_time=np.float32(torque_time),
        disturbance_force=np.sqrt(force + unknown[1]).astype(np.float32),
        disturbance_force_time=np.float32(force_time),
    )


def _spread(
    parts: Sequence[Float[np.ndarray, "N 3"]], period: float
) -> tuple[Float[np.ndarray, "3"], float]:
    """Returns the variance of each axis about the mean of each part, and a correlation time [s]."""
    off = [part - part.mean(axis=0) for part in parts]
    variance = np.maximum(np.concatenate(off).var(axis=0), np.finfo(float).tiny)
    longest = max(map(len, off)) - 1
    for lag in range(1, longest):
        pairs = np.concatenate([part[:-lag] * part[lag:] for part in off if len(part) > lag])
        if np.mean(pairs.mean(axis=0) / variance) < np.exp(-1.0):
            return variance, lag * period
    return variance, longest * period
