"""Latency as a delay line, continuous and differentiable in the delay.

Commands pass a zero-order hold of one command period. Over a physics step the motor sees the exact
mean of the delayed command, so that a delay between two steps, or between two commands, is
interpolated: with an index into a buffer every objective would be constant in the latency between
steps.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from maidenflight.parameters import QUANTITIES, Parameters
from maidenflight.simulator.vectors import each

SLOWEST = QUANTITIES["latency"].upper
"""Longest latency [s] that a delay line is made for."""


def slots(command_period: float) -> int:
    """Number of commands that a delay line must hold.

    Args:
        command_period: time between two commands [s]; periods randomized to be up to 10 % shorter
            find room.
    """
    return int(np.ceil(SLOWEST / (0.9 * command_period) - 1e-6)) + 1


def push(line: Float[Array, "slots 4"], command: Float[Array, "4"]) -> Float[Array, "slots 4"]:
    """Puts the newest command in front and drops the oldest."""
    return jnp.concatenate([command[None], line[:-1]])


def place(number: Int[Array, ""], line: Float[Array, "slots 4"]) -> Int[Array, ""]:
    """Where commands go, `number` 0 first, in a line, newest first, that is a ring from now on.

    Each takes the place of the oldest, which is cheaper than a `push`, which moves all.
    """
    return (-1 - number) % _length(line)


def put(
    line: Float[Array, "slots 4"], command: Float[Array, "4"], place: Int[Array, ""] | int
) -> Float[Array, "slots 4"]:
    """Puts a command at a `place` of a line, both of arrays or of `Entries`."""
    return each(partial(lax.dynamic_update_index_in_dim, index=place, axis=0), line, command)


def in_front(line: Float[Array, "slots 4"], commands: int) -> Float[Array, "slots 4"]:
    """A ring into which so many commands were put as a line, newest first."""
    return each(partial(jnp.roll, shift=commands, axis=0), line)


def delayed(
    line: Float[Array, "slots 4"],
    parameters: Parameters,
    steps: int,
    newest: Int[Array, ""] | int = 0,
    ring: bool = False,
) -> Float[Array, "steps 4"]:
    """Mean of the delayed command in each physics step of the newest command's period.

    Args:
        line: held commands, newest first.
        parameters: uses `latency` Delta [s] and `time_step` dt [s].
        steps: physics steps a command period.
        newest: place of slot 0 in the line.
        ring: as of `in_step`.
    """
    return in_step(line, parameters, steps, newest, jnp.arange(steps), ring)


def in_step(
    line: Float[Array, "slots 4"],
    parameters: Parameters,
    steps: int | Int[Array, ""],
    newest: Int[Array, ""] | int,
    number: Int[Array, "..."],
    ring: bool = False,
) -> Float[Array, "... 4"]:
    """Mean of the delayed command in physics step `number` of the newest command's period.

    Step i sees the commands of the time from (i dt - Delta) to ((i + 1) dt - Delta), where the
    newest command (slot 0) starts at 0 and slot j holds from -j h to (1 - j) h, h = steps dt. A
    step is no longer than a command, so it sees two at most. The last slot also stands for
    everything older.

    Args:
        line: as of `delayed`, or `Entries` of each rotor's slots.
        parameters: as of `delayed`.
        steps: as of `delayed`, or an argument of the program.
        newest: as of `delayed`.
        number: i; or several.
        ring: whether commands older than those at the line's end are at its beginning, where
            `place` puts them; otherwise the last is the oldest.
    """
    size = _length(line)
    oldest = jnp.asarray(size - 1 if ring else size - 1 - newest, jnp.float32)
    opens = number.astype(jnp.float32) - parameters.latency / parameters.time_step
    steps = jnp.asarray(steps, jnp.float32)
    slot = jnp.clip(jnp.ceil(-opens / steps), 0.0, oldest)
    older = jnp.clip((1.0 - slot) * steps - opens, 0.0, 1.0)
    older = jnp.where(slot == 0, 0.0, older)
    # An index and not a sum over all slots: the line of a 500 Hz controller has 29.
    index = slot.astype(jnp.int32)
    before, after = newest + index, newest + jnp.maximum(index - 1, 0)
    if ring:
        before, after = (jnp.where(one < size, one, one - size) for one in (before, after))

    def mean(slots: Array) -> Array:
        share = older.reshape(*older.shape, *[1] * (slots.ndim - 1))
        return share * slots[before] + (1.0 - share) * slots[after]

    return each(mean, line)


def _length(line: Float[Array, "slots 4"]) -> int:
    return jax.tree.leaves(line)[0].shape[0]
