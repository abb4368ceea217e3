"""Latency as a delay line, continuous and differentiable in the delay.

Commands pass a zero-order hold of one command period. Over a physics step the motor sees the exact
mean of the delayed command, so that a delay between two steps, or between two commands, is
interpolated: with an index into a buffer every objective would be constant in the latency between
steps.
"""

from dataclasses import dataclass, field
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from maidenflight.parameters import QUANTITIES, Parameters
from maidenflight.simulator.physics.vectors import each

SLOWEST = QUANTITIES["latency"].upper
"""Longest latency [s] that a delay line is made for."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DelayLine:
    """Rotor speed commands on their way to the motors. Older commands have higher places."""

    commands: Float[Array, "slots 4"]
    """Constant commands, or `vectors.Entries` of each rotor's."""
    newest: Int[Array, ""] | int = 0
    """Place of the newest command."""
    ring: bool = field(default=False, metadata={"static": True})
    """Whether commands older than the last place's are at the first; otherwise there is none
    older."""


def slots(command_period: float) -> int:
    """Returns the number of commands that a delay line must hold.

    Args:
        command_period: time between two commands [s]; periods randomized to be up to 10 % shorter
            find room.
    """
    return int(np.ceil(SLOWEST / (0.9 * command_period) - 1e-6)) + 1


def push(commands: Float[Array, "slots 4"], newest: Float[Array, "4"]) -> Float[Array, "slots 4"]:
    """Puts the newest command in front and drops the oldest."""
    return jnp.concatenate([newest[None], commands[:-1]])


def put(
    commands: Float[Array, "slots 4"], newest: Float[Array, "4"], number: Int[Array, ""]
) -> DelayLine:
    """Puts the newest command in the place of the oldest.

    It is cheaper than a `push`, which moves all.

    Args:
        commands: an array or `Entries`; before any was put, newest first.
        newest: of the same form.
        number: how many were put before.
    """
    place = (-1 - number) % _length(commands)
    set_at = partial(lax.dynamic_update_index_in_dim, index=place, axis=0)
    return DelayLine(each(set_at, commands, newest), place, ring=True)


def in_front(commands: Float[Array, "slots 4"], number: int) -> Float[Array, "slots 4"]:
    """Commands, newest first, of a ring in which so many were `put`."""
    return each(partial(jnp.roll, shift=number, axis=0), commands)


def delayed(line: DelayLine, parameters: Parameters, steps: int) -> Float[Array, "steps 4"]:
    """Returns the mean of the delayed command in each physics step of the newest command's period.

    Args:
        line: the commands.
        parameters: uses `latency` Delta [s] and `time_step` dt [s].
        steps: physics steps a command period.
    """
    return in_step(line, parameters, steps, jnp.arange(steps))


def in_step(
    line: DelayLine,
    parameters: Parameters,
    steps: int | Int[Array, ""],
    number: Int[Array, "..."],
) -> Float[Array, "... 4"]:
    """Returns mean of the delayed command in physics step `number` of the newest command's period.

    Step i sees the commands of the time from (i dt - Delta) to ((i + 1) dt - Delta), where the
    newest command (slot 0) starts at 0 and slot j holds from -j h to (1 - j) h, h = steps dt. A
    step is no longer than a command, so it sees two at most. The last slot also stands for
    everything older.

    Args:
        line: as of `delayed`.
        parameters: as of `delayed`.
        steps: as of `delayed`, or an argument of the program.
        number: i; or several.
    """
    size = _length(line.commands)
    oldest = jnp.asarray(size - 1 if line.ring else size - 1 - line.newest, jnp.float32)
    opens = number.astype(jnp.float32) - parameters.latency / parameters.time_step
    steps = jnp.asarray(steps, jnp.float32)
    slot = jnp.clip(jnp.ceil(-opens / steps), 0.0, oldest)
    older = jnp.clip((1.0 - slot) * steps - opens, 0.0, 1.0)
    older = jnp.where(slot == 0, 0.0, older)
    # An index and not a sum over all slots: the line of a 500 Hz controller has 29.
    index = slot.astype(jnp.int32)
    before, after = line.newest + index, line.newest + jnp.maximum(index - 1, 0)
    if line.ring:
        before, after = (jnp.where(one < size, one, one - size) for one in (before, after))

    def mean(commands: Array) -> Array:
        share = older.reshape(*older.shape, *[1] * (commands.ndim - 1))
        return share * commands[before] + (1.0 - share) * commands[after]

    return each(mean, line.commands)


def _length(commands: Float[Array, "slots 4"]) -> int:
    return jax.tree.leaves(commands)[0].shape[0]
