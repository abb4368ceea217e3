"""What single flights say cheaply: the thrust and the constant torques that balance their means.

Over a flight a drone gains hardly any momentum, so the mean thrust carries its weight and the mean
torque of its rotors cancels whatever constant torque acts on it. Thrust is that of the speeds which
the motors reach: it grows with a speed's square, so that lag takes from it where commands vary
fast, and rotors that slow down more slowly than they speed up add to it. `identify` finds the same
numbers with everything else, and how sure they are.
"""

from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from maidenflight import compiler
from maidenflight.flights.log import Flight
from maidenflight.parameters import Parameters, crazyflie, levers, replace
from maidenflight.simulator.physics import actuators, dynamics, latency

STEP_S = 0.002
"""Physics step, about [s]."""
BEGIN_S = 0.25
"""A few lags of a motor [s]."""
_FEWEST = 1024
"""Rows for which a program is compiled at least; there is one for each power of two."""


class Rotors(NamedTuple):
    """What the rotors do in each row of a log; NaN where its commands are not finite."""

    speed: Float[np.ndarray, "N 4"]
    """nu at the end of the row's period [-]."""
    thrust: Float[np.ndarray, "N 4"]
    """Mean over the period, as a share of full thrust [-]."""


def rotors(flight: Flight, drone: Parameters) -> Rotors:
    """Simulates a drone's motors under a log's commands.

    They begin at the mean command of the first `BEGIN_S`: a piece of a log does not say what was
    before it. Where commands are not finite, the last one lasts. Cost grows linearly with rows.

    Args:
        flight: a log, or a piece of one.
        drone: its motors, latency and thrust curve.

    Source: see `dynamics.motor_derivative` and `dynamics.rotor_forces`.
    """
    command = np.asarray(flight.mean_command, np.float32)
    is_finite = np.all(np.isfinite(command), axis=1)[:, None]
    if not is_finite.any():
        return Rotors(*[np.full(command.shape, np.nan)] * 2)
    last = np.maximum.accumulate(np.where(is_finite[:, 0], np.arange(len(command)), -1))
    last_command = command[np.where(last < 0, np.argmax(is_finite), last)]
    rows = max(_FEWEST, 1 << (len(last_command) - 1).bit_length())
    padded = np.pad(last_command, ((0, rows - len(last_command)), (0, 0)), "edge")
    begin = np.sqrt(last_command[: max(1, round(BEGIN_S / flight.period))].clip(0.0)).mean(axis=0)
    steps, time_step = latency.physics_steps(flight.period, STEP_S)
    motors = replace(drone, time_step=time_step)
    speeds = _followed(padded, begin, jax.device_put(motors), steps)
    parts = (np.asarray(part, np.float64)[: len(last_command)] for part in speeds)
    return Rotors(*(np.where(is_finite, part, np.nan) for part in parts))


@partial(jax.jit, static_argnums=3, compiler_options=compiler.loop())
def _followed(
    command: Float[Array, "N 4"], begin: Float[Array, "4"], drone: Parameters, steps: int
) -> tuple[Float[Array, "N 4"], Float[Array, "N 4"]]:
    commands = actuators.rotor_speed_command(command)[::-1]
    unit = replace(drone, thrust_to_weight=jnp.ones(()))
    full, numbers = drone.mass * drone.gravity / 4, jnp.arange(steps)

    def turn(speed: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
        command, time_step = now
        motors = replace(drone, time_step=time_step)
        after = speed + time_step * dynamics.spin_up(speed, command, motors)
        return after, time_step * dynamics.rotor_forces((speed + after) / 2, unit)

    def spin(speed: Array, newest: Array) -> tuple[Array, tuple[Array, Array]]:
        line = latency.DelayLine(commands, newest)
        last, impulses = lax.scan(turn, speed, latency.in_step(line, drone, steps, numbers))
        return last, (last, impulses.sum(axis=0) / (full * steps * drone.time_step))

    return lax.scan(spin, begin, jnp.arange(commands.shape[0])[::-1])[1]


SEGMENT_S = 0.5
"""Length of the parts of a flight whose means tell how sure the whole's is [s]."""
ENOUGH_FLIGHTS = 8
"""That tell how flights differ: of eight, a standard deviation is known to a quarter."""


class Trim(NamedTuple):
    """Of a flight; NaN where the log does not tell, or is shorter than `SEGMENT_S`."""

    thrust_to_weight: float
    """k_F [-] with which the mean thrust carries the weight."""
    torque_bias: Float[np.ndarray, "3"]
    """Constant torque about body x, y and z that the mean thrusts cancel [N m]."""
    thrust_to_weight_error: float
    """Standard error, from how parts of the flight differ."""
    torque_bias_error: Float[np.ndarray, "3"]
    """[N m]."""
    command: Float[np.ndarray, "4"]
    """Mean command u of each motor."""
    battery: float
    """Mean voltage [V]."""


def trim(pieces: Sequence[Flight], drone: Parameters) -> Trim:
    """Returns the thrust and constant torques that balance the means of a flight.

    With F_i = m g / 4 k_F s_i, where s_i is the share of full thrust that a rotor has at its speed,
    the mean of sum(F_i) R_zz is m (g + dv_z / T), and the mean of all torques on the body that of
    I domega/dt + omega x (I omega).

    Args:
        pieces: the flight, whole or in pieces, such as checking leaves of a log with gaps; those
            shorter than `SEGMENT_S` tell nothing, and others as much as they are long.
        drone: its mass, inertia, rotors, motors and ratio of torque to thrust; its k_F for the
            torques where that of the flight is not known.

    Source: Gronauer et al. 2022, eq:motor-force, eq:linear-acceleration, eq:torque and
    eq:angular-acceleration.
    """
    rows = [piece.part(piece.lead, len(piece)) for piece in pieces]
    long = [
        (piece_rows, rotors(piece, drone).thrust[piece.lead :])
        for piece, piece_rows in zip(pieces, rows, strict=True)
        if piece.duration >= SEGMENT_S
    ]
    lengths, each = [len(piece) for piece, _ in long], []
    whole = np.reshape([_balance(piece, shares, drone) for piece, shares in long], (-1, 4))
    for piece, shares in long:
        edges = np.linspace(0, len(piece), round(piece.duration / SEGMENT_S) + 1).astype(int)
        each += [
            _balance(piece.part(first, last), shares[first:last], drone)
            for first, last in pairwise(edges)
        ]
    values = np.array([_weighted(column, lengths) for column in whole.T])
    error = np.array([_standard_error(column) for column in np.reshape(each, (-1, 4)).T])
    return Trim(
        float(values[0]),
        values[1:],
        float(error[0]),
        error[1:],
        finite_mean(np.concatenate([piece.command for piece in rows])),
        float(finite_mean(np.concatenate([piece.battery for piece in rows])[:, None])[0]),
    )


def hover_command(flight: Flight) -> tuple[float, float]:
    """Returns the mean command that carries the weight, and its standard error [-].

    It needs no drone: lag and thrust curve are left out, so it compares flights of one drone and
    is not its inverse thrust-to-weight ratio.
    """
    rows = flight.part(flight.lead, len(flight))
    edges = np.linspace(0, len(rows), max(1, round(rows.duration / SEGMENT_S)) + 1).astype(int)
    unit = crazyflie()  # of its balance only the ratio is used, which depends on gravity alone
    parts = [rows.part(first, last) for first, last in pairwise(edges)]
    each = [1 / _balance(part, part.command, unit)[0] for part in (rows, *parts) if len(part)]
    return float(each[0]), _standard_error(np.array(each[1:]))


def with_standard_errors(
    trims: Sequence[Trim],
) -> tuple[Float[np.ndarray, "n 4"], Float[np.ndarray, "n 4"]]:
    """Returns k_F [-] and torques [N m] of trims whose errors are known, and the errors."""
    values = [[trim.thrust_to_weight, *trim.torque_bias] for trim in trims]
    errors = [[trim.thrust_to_weight_error, *trim.torque_bias_error] for trim in trims]
    values, errors = np.reshape(values, (-1, 4)), np.reshape(errors, (-1, 4))
    is_finite = np.isfinite(errors).all(axis=1)
    return values[is_finite], errors[is_finite]


def between_flights(trims: Sequence[Trim]) -> Float[np.ndarray, "4"] | None:
    """Returns standard deviations between flights of k_F [-] and the constant torques [N m].

    Each flight counts alike, however long it was: the next one is one more of them. Counted by
    their rows, those that flew long for the good trim that they had would hide the others.

    Returns:
        In the order of `with_standard_errors`; None for less than `ENOUGH_FLIGHTS`.

    Source: Hedges 1983, A random effects model for effect sizes (the unweighted estimator).
    """
    values, errors = with_standard_errors(trims)
    if len(values) < ENOUGH_FLIGHTS:
        return None
    beyond = values.var(axis=0, ddof=1) - np.mean(errors**2, axis=0)
    return np.sqrt(np.maximum(beyond, 0.0))


def _balance(
    rows: Flight, shares: Float[np.ndarray, "N 4"], drone: Parameters
) -> Float[np.ndarray, "4"]:
    """The ratio of thrust to weight and three torques [N m]."""
    up = np.cos(rows.attitude[:, 0]) * np.cos(rows.attitude[:, 1])
    seconds = max((len(rows) - 1) * rows.period, rows.period)
    rates, speed = rows.body_rates.astype(np.float64), rows.velocity[:, 2].astype(np.float64)
    gravity, weight = float(drone.gravity), float(drone.mass * drone.gravity)
    needed = 1.0 + (speed[-1] - speed[0]) / seconds / gravity
    lifted = float(finite_mean((shares.mean(axis=1) * up)[:, None])[0])
    ratio = needed / lifted if lifted > 0 else np.nan
    full = weight / 4 * (ratio if ratio > 0 else float(drone.thrust_to_weight))
    forces = full * finite_mean(shares)
    wrench = forces @ (levers(drone) * [1.0, 1.0, float(drone.torque_to_thrust)])
    inertia = np.asarray(drone.inertia, np.float64)
    spun = inertia * (rates[-1] - rates[0]) / seconds
    return np.array([ratio, *(spun + finite_mean(np.cross(rates, inertia * rates)) - wrench)])


def _weighted(values: Float[np.ndarray, "n"], weights: Sequence[float]) -> float:
    """Mean of the values that are finite; NaN where none is."""
    good = np.isfinite(values)
    return float(np.average(values[good], weights=np.array(weights)[good])) if any(good) else np.nan


def _standard_error(means: Float[np.ndarray, "n"]) -> float:
    means = means[np.isfinite(means)]
    return float(np.std(means, ddof=1) / np.sqrt(len(means))) if len(means) > 1 else float("nan")


def finite_mean(values: Float[np.ndarray, "N d"]) -> Float[np.ndarray, "d"]:
    """Returns the mean of the rows that are finite; NaN where none is."""
    good = values[np.isfinite(values).all(axis=1)]
    return good.mean(axis=0) if len(good) else np.full(values.shape[1], np.nan)
