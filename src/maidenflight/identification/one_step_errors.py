"""One-step prediction errors of windows of flight, their products, and their derivatives.

Compiled for a chunk of windows; `one_step` says what they are for and joins the chunks.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from maidenflight.flights.windows import Windows
from maidenflight.identification.objective import under_way, wrapped
from maidenflight.parameters import Parameters
from maidenflight.simulator import dynamics, rotations, stepping
from maidenflight.simulator.dynamics import State

ORDER = 16
"""Rows of the past in an error's autoregression. Half as many cannot tell slow disturbances from a
lag: on simulated flights it then comes out up to 2 ms off, and intervals are too narrow to hold the
truth."""
VERTICAL = 5
"""Where the vertical velocity stands in a row."""
COLUMNS = (3, 4, 5, 9, 10, 11)
"""Where velocity and body rates stand in a row. Position and attitude follow from them, and say
nothing more of the drone."""


def errors(
    window: Windows, parameters: Parameters, steps: int, stride: int = 1
) -> Float[Array, "T 12"]:
    """Measured minus predicted position, velocity, attitude and body rates.

    Each row is predicted from the measured one before it.

    Args:
        window: one of `Windows` (no leading axis).
        parameters: the drone; its `time_step` times `steps` is the period of the commands.
        steps: physics steps a command.
        stride: commands to a row.
    """
    line, places, speed = under_way(window, parameters, steps, stride)
    measured = jnp.asarray(window.measured)
    first = jnp.concatenate(
        [
            window.position,
            window.velocity,
            rotations.to_attitude(jnp.asarray(window.quaternion)),
            window.body_rates,
        ]
    )
    before = jnp.concatenate([first[None], measured[:-1]])

    def advance(speed: Array, row: tuple[Array, Array]) -> tuple[Array, Array]:
        newest, row_before = row
        start = State(
            row_before[:3],
            row_before[3:6],
            rotations.from_attitude(row_before[6:9]),
            row_before[9:],
            speed,
        )
        state = start
        for place in newest:
            state = stepping.drive(dynamics.midpoint, state, line, steps, parameters, newest=place)
        ahead = jnp.concatenate(
            [
                state.position,
                state.velocity,
                rotations.to_attitude(state.quaternion),
                state.body_rates,
            ]
        )
        return state.rotor_speed, ahead

    return wrapped(measured - lax.scan(advance, speed, (places.reshape(-1, stride), before))[1])


@partial(jax.jit, static_argnums=(2, 3))
def products(
    chunk: Windows, parameters: Parameters, steps: int, stride: int
) -> Float[Array, "64 12 P+1 P+1"]:
    """Products of the errors in each window of a chunk."""

    def one(window: Windows) -> Float[Array, "12 P+1 P+1"]:
        wrong = errors(window, parameters, steps, stride)
        late = jnp.stack(
            [wrong[ORDER - lag : wrong.shape[0] - lag] for lag in range(ORDER + 1)], axis=-1
        )
        return jnp.einsum("tci,tcj->cij", late, late)

    return jax.vmap(one)(chunk)


@partial(jax.jit, static_argnums=(2, 3))
def sums(chunk: Windows, parameters: Parameters, steps: int, stride: int) -> Float[Array, "64 12"]:
    """Sums of the errors in each window of a chunk."""
    return jax.vmap(lambda window: errors(window, parameters, steps, stride)[ORDER:].sum(axis=0))(
        chunk
    )


@partial(jax.jit, static_argnums=(7, 8))
def derivatives(
    chunk: Windows,
    parameters: Parameters,
    directions: Parameters,
    coefficients: Array,
    deviation: Array,
    share: Array,
    by_moment: Array,
    steps: int,
    stride: int,
) -> tuple[
    Float[Array, "64 d"], Float[Array, "64 d d"], Float[Array, "64 d 6 P"], Float[Array, "64 d"]
]:
    """Derivatives of half the sum of squared innovations in each window of a chunk.

    They are gradient, curvature, the slopes' products with the past errors, and the sum of the
    vertical errors' slopes.

    Where `by_moment`, half the sum of squares of the errors themselves, over their own variance:
    `share` is the deviation of the innovations over theirs.
    """

    def one(
        window: Windows,
    ) -> tuple[Float[Array, "d"], Float[Array, "d d"], Float[Array, "d 6 P"], Float[Array, "d"]]:
        def scaled(drone: Parameters) -> Float[Array, "T 6"]:
            return errors(window, drone, steps, stride)[:, np.array(COLUMNS)] / deviation[None]

        def before(wrong: Float[Array, "T 6"], lag: int) -> Float[Array, "T-P 6"]:
            return wrong[ORDER - lag : wrong.shape[0] - lag]

        def new(wrong: Float[Array, "T 6"]) -> Float[Array, "T-P 6"]:
            left = wrong[ORDER:]
            for lag in range(1, ORDER + 1):
                left = left - coefficients[None, :, lag - 1] * before(wrong, lag)
            return left

        def along(direction: Parameters) -> tuple[Array, Array]:
            wrong, slope = jax.jvp(scaled, (parameters,), (direction,))
            return wrong, jnp.where(jnp.isfinite(slope), slope, 0.0)

        def apart(some: Array) -> Array:
            """By moment or by likelihood, for an array with a leading axis of directions."""
            return by_moment.reshape(-1, *(1,) * (some.ndim - 1))

        wrong, slopes = jax.vmap(along, out_axes=(None, 0))(directions)
        climbs = jnp.sum(slopes[:, ORDER:, COLUMNS.index(VERTICAL)], axis=1)
        left, plain = wrong[ORDER:] * share[None], slopes[:, ORDER:] * share[None, None]
        slopes = jnp.where(apart(slopes), plain, jax.vmap(new)(slopes))
        score = jnp.sum(slopes * jnp.where(apart(slopes), left, new(wrong)), axis=(1, 2))
        flat = slopes.reshape(slopes.shape[0], -1)
        curvature = jnp.where(by_moment[:, None] == by_moment[None], flat @ flat.T, 0.0)
        past = jnp.stack([before(wrong, lag) for lag in range(1, ORDER + 1)], axis=-1)
        shared = jnp.einsum("dtc,tcp->dcp", slopes, past)
        return score, curvature, jnp.where(apart(shared), 0.0, shared), climbs

    return jax.vmap(one)(chunk)
