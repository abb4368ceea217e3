"""One-step prediction errors of windows of flight, their products, and their derivatives.

Compiled for a chunk of windows; `one_step` says what they are for and joins the chunks.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from maidenflight.flights.windows import Windows
from maidenflight.identification.likelihood.observation import MOTORS
from maidenflight.identification.replay.open_loop import (
    columns,
    commands,
    initial_delay_line,
    places,
    wrapped,
)
from maidenflight.parameters import Parameters, replace
from maidenflight.simulator.physics import dynamics, motion, rotations, sensors
from maidenflight.simulator.physics.dynamics import State
from maidenflight.simulator.physics.latency import DelayLine
from maidenflight.simulator.physics.vectors import entries

ORDER = 16
"""Rows of the past in an error's autoregression. Half as many cannot tell slow disturbances from a
lag: on simulated flights it then comes out up to 2 ms off, and intervals are too narrow to hold the
truth (paper/identification/planted_drones.py)."""
VERTICAL = 5
"""Where the vertical velocity stands in a row, by definition of `errors`."""
AT_ONCE = 4
"""Directions that are differentiated along side by side. Time grows linearly from four on; results
are the same to the last digit (paper/identification/constants.py)."""
TURNING = (9, 10, 11)
"""Where the body rates stand in a row, by definition of `errors`."""
COLUMNS = (3, 4, VERTICAL, *TURNING)
"""Where velocity and body rates stand in a row, by definition of `errors`. Position and attitude
follow from them, and say nothing more of the drone."""


def errors(
    window: Windows, parameters: Parameters, steps: int | Array, stride: int = 1
) -> Float[Array, "T 12"]:
    """Returns measured minus predicted position, velocity, attitude and body rates.

    Each row is predicted from the measured one before it.

    Args:
        window: one of `Windows` (no leading axis).
        parameters: the drone; its `time_step` times `steps` is the period of the commands.
        steps: physics steps a command.
        stride: commands to a row.
    """
    speeds = _speeds(window, parameters, steps, stride)
    return jnp.stack(_by_column(window, speeds, parameters, steps, stride), axis=1)


@partial(jax.jit, static_argnums=3)
def _speeds(
    window: Windows, parameters: Parameters, steps: int | Array, stride: int
) -> Float[Array, "T 4"]:
    """Speeds of the rotors before each row; they depend on commands and `MOTORS` alone."""
    commands_in, places, speed = initial_delay_line(window, parameters, steps, stride)

    def turn(speed: Array, newest: Array) -> tuple[Array, Array]:
        def spin(speed: Array, newest: Array) -> tuple[Array, None]:
            return motion.spin(speed, DelayLine(commands_in, newest), steps, parameters), None

        return lax.scan(spin, speed, newest)[0], speed

    return lax.scan(turn, speed, places.reshape(-1, stride))[1]


@partial(jax.jit, static_argnums=4)
def _by_column(
    window: Windows,
    speeds: Float[Array, "T 4"],
    parameters: Parameters,
    steps: int | Array,
    stride: int,
) -> list[Float[Array, "T"]]:
    """The twelve columns of `errors`.

    Once the rotors' speeds are known, rows do not depend on each other: all side by side they are a
    few long loops, where one after the other they were many short ones.
    """
    commands_in, period = commands(window), parameters.time_step * steps * stride

    def predicted(speed: Array, newest: Array, before: Sequence[Array]) -> list[Array]:
        position, velocity, attitude, rates = (
            jnp.stack(before[first : first + 3]) for first in range(0, 12, 3)
        )
        quaternion = rotations.from_attitude(attitude)
        state = start = entries(State(position, velocity, quaternion, rates, speed))

        def drive(state: State, newest: Array) -> tuple[State, None]:
            line = DelayLine(commands_in, newest)
            return motion.drive_entries(dynamics.midpoint, state, line, steps, parameters), None

        state, _ = lax.scan(drive, state, newest)
        estimate = sensors.estimate_after_turn(start, state, period, parameters)
        return columns(estimate)

    measured = list(jnp.asarray(window.measured).T)
    first = [
        *window.position,
        *window.velocity,
        *rotations.to_attitude(jnp.asarray(window.quaternion)),
        *window.body_rates,
    ]
    before = [
        jnp.concatenate([start[None], column[:-1]])
        for start, column in zip(first, measured, strict=True)
    ]
    rows = places(window, stride).reshape(-1, stride)
    ahead = jax.vmap(predicted)(speeds, rows, before)
    wrong = [real - simulated for real, simulated in zip(measured, ahead, strict=True)]
    return [*wrong[:6], *map(wrapped, wrong[6:9]), *wrong[9:]]


def _late(wrong: Any, lag: int) -> Any:
    """Errors so many rows ago, of the rows that have `ORDER` before them."""
    return wrong[..., ORDER - lag : wrong.shape[-1] - lag]


@partial(jax.jit, static_argnums=3)
def errors_of_chunk(
    chunk: Windows, parameters: Parameters, steps: int | Array, stride: int
) -> Float[Array, "W 12 T"]:
    """Errors in each window of a chunk, by column."""
    return jax.vmap(lambda window: errors(window, parameters, steps, stride).T)(chunk)


def products(wrong: Float[np.ndarray, "W C T"]) -> Float[np.ndarray, "W C P+1 P+1"]:
    """Products of the errors in each window with those 0 ... P rows before, both 0 ... P rows late.

    A row later for both, all but the first and the last term of a sum are the same; so these cost a
    seventeenth of all sums. In double precision, for what is added and taken away again.
    """
    wrong = wrong.astype(np.float64)
    now = _late(wrong, 0)
    out = np.empty((*wrong.shape[:2], ORDER + 1, ORDER + 1))
    for lag in range(ORDER + 1):
        out[..., 0, lag] = out[..., lag, 0] = np.einsum("wct,wct->wc", now, _late(wrong, lag))
    begin, end = wrong[..., ORDER - 1 :: -1], wrong[..., : -ORDER - 1 : -1]
    ends = begin[..., :, None] * begin[..., None, :] - end[..., :, None] * end[..., None, :]
    for lag in range(1, ORDER + 1):
        later = out[..., lag - 1, lag - 1 : -1] + ends[..., lag - 1, lag - 1 :]
        out[..., lag, lag:] = out[..., lag:, lag] = later
    return out


class Innovations(NamedTuple):
    """What of the errors is new, and whether it is that which counts."""

    coefficients: Float[Array | np.ndarray, "6 P"]
    """Of the noise model."""
    deviation: Float[Array | np.ndarray, "6"]
    """Of the innovations."""
    share: Float[Array | np.ndarray, "6"]
    """That deviation over the errors'."""
    by_moment: bool | Bool[Array, ""]
    """Whether the errors themselves count instead."""


@partial(jax.jit, static_argnums=3)
def spins(
    chunk: Windows, parameters: Parameters, steps: int | Array, stride: int
) -> tuple[Float[Array, "W T 4"], Float[Array, "4 W T 4"]]:
    """Speeds of the rotors before each row, and their slopes by `MOTORS`.

    Rotors are simulated row by row, so that a slope of their speeds costs as much as all else. It
    takes four, and no more: along a direction it is a sum of these.
    """

    def speeds(motors: dict[str, Array]) -> Float[Array, "W T 4"]:
        drone = replace(parameters, **motors)
        return jax.vmap(lambda window: _speeds(window, drone, steps, stride))(chunk)

    motors = {name: getattr(parameters, name) for name in MOTORS}
    units = dict(zip(MOTORS, jnp.eye(len(MOTORS)), strict=True))
    return jax.vmap(lambda unit: jax.jvp(speeds, (motors,), (unit,)), out_axes=(None, 0))(units)


@partial(jax.jit, static_argnums=6)
def slopes(
    chunk: Windows,
    parameters: Parameters,
    speed: Float[Array, "W T 4"],
    by_motor: Float[Array, "4 W T 4"],
    directions: Parameters,
    steps: int | Array,
    stride: int,
) -> tuple[Float[Array, "W 6 T"], Float[Array, "d W 6 T"]]:
    """Errors of `COLUMNS` in each window of a chunk, and their slopes along d directions.

    Args:
        chunk: the windows.
        parameters: the drone.
        speed: see `spins`.
        by_motor: likewise.
        directions: stacked; `AT_ONCE`, as one program serves all numbers of them.
        steps: physics steps a command.
        stride: commands to a row.
    """

    def wrong(drone: Parameters, speeds: Array) -> Float[Array, "W 6 T"]:
        def window_errors(window: Windows, speeds: Array) -> Float[Array, "6 T"]:
            columns = _by_column(window, speeds, drone, steps, stride)
            return jnp.stack([columns[column] for column in COLUMNS])

        return jax.vmap(window_errors)(chunk, speeds)

    def along(direction: Parameters) -> tuple[Array, Array]:
        parts = jnp.stack([getattr(direction, name) for name in MOTORS])
        faster = jnp.tensordot(parts, by_motor, 1)
        now, slope = jax.jvp(wrong, (parameters, speed), (direction, faster))
        return now, jnp.where(jnp.isfinite(slope), slope, 0.0)

    # Directions before windows, so that what all directions share is computed once for them.
    return jax.vmap(along, out_axes=(None, 0))(directions)


@jax.jit
def derivatives(
    wrong: Float[Array, "W 6 T"],
    parts: Sequence[Float[Array, "d W 6 T"]],
    new: Innovations,
) -> tuple[
    Float[Array, "W D"],
    Float[Array, "W D D"],
    Float[Array, "W D 6 P"],
    Float[Array, "W D"],
]:
    """Derivatives of half the sum of squared innovations in each window of a chunk.

    They are gradient, curvature, the slopes' products with the past errors, and the sum of the
    vertical errors' slopes, along the directions of all parts of `slopes`.

    If `by_moment`, half the sum of squares of the errors themselves, over their own variance.
    """
    coefficients, deviation, share, by_moment = new
    scale = deviation[None, :, None]
    wrong, slopes = wrong / scale, jnp.concatenate(parts) / scale[None]

    def innovations(wrong: Float[Array, "W 6 T"]) -> Float[Array, "W 6 T-P"]:
        left = wrong[..., ORDER:]
        for lag in range(1, ORDER + 1):
            left = left - coefficients[None, :, lag - 1, None] * _late(wrong, lag)
        return left

    climbs = jnp.sum(slopes[:, :, COLUMNS.index(VERTICAL), ORDER:], axis=2)
    part = share[None, :, None]
    left, plain = wrong[..., ORDER:] * part, slopes[..., ORDER:] * part[None]
    slopes = jnp.where(by_moment, plain, jax.vmap(innovations)(slopes))
    new_errors = innovations(wrong)
    score = jnp.sum(slopes * jnp.where(by_moment, left, new_errors)[None], axis=(2, 3))
    curvature = jnp.einsum("dwct,ewct->wde", slopes, slopes)
    past = jnp.stack([_late(wrong, lag) for lag in range(1, ORDER + 1)], axis=2)
    shared = jnp.where(by_moment, 0.0, jnp.einsum("dwct,wcpt->wdcp", slopes, past))
    return score.T, curvature, shared, climbs.T
