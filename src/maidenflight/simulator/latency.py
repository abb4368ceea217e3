"""Latency as a delay line, continuous and differentiable in the delay.

Commands pass a zero-order hold of one command period. Over a physics step the motor sees the exact
mean of the delayed command, so that a delay between two steps, or between two commands, is
interpolated: with an index into a buffer every objective would be constant in the latency between
steps.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from maidenflight.parameters import QUANTITIES, Parameters

SLOWEST = QUANTITIES["latency"].upper
"""Longest latency [s] that a delay line is made for."""


def slots(command_period: float) -> int:
    """Number of commands that a delay line must hold.

    Args:
        command_period: time between two commands [s]; one slot is spare for periods randomized to
            be up to 10 % shorter.
    """
    return int(SLOWEST / command_period + 1e-6) + 3


def push(line: Float[Array, "slots 4"], command: Float[Array, "4"]) -> Float[Array, "slots 4"]:
    """Puts the newest command in front and drops the oldest."""
    return jnp.concatenate([command[None], line[:-1]])


def with_room(line: Float[Array, "slots 4"], commands: int) -> Float[Array, "slots+commands 4"]:
    """A line with room in front for commands to come.

    Cheaper than a `push` for each, which moves the whole line.
    """
    return jnp.concatenate([jnp.zeros((commands, 4)), line])


def put(
    line: Float[Array, "slots 4"], command: Float[Array, "4"], place: Int[Array, ""] | int
) -> Float[Array, "slots 4"]:
    """Puts the newest command at a place kept for it."""
    return lax.dynamic_update_index_in_dim(line, command, place, 0)


def delayed(
    line: Float[Array, "slots 4"],
    parameters: Parameters,
    steps: int,
    newest: Int[Array, ""] | int = 0,
) -> Float[Array, "steps 4"]:
    """Mean of the delayed command in each physics step of the newest command's period.

    Args:
        line: held commands, newest first.
        parameters: uses `latency` Delta [s] and `time_step` dt [s].
        steps: physics steps a command period.
        newest: place of slot 0 in the line.
    """
    return in_step(line, parameters, steps, newest, jnp.arange(steps))


def in_step(
    line: Float[Array, "slots 4"],
    parameters: Parameters,
    steps: int | Int[Array, ""],
    newest: Int[Array, ""] | int,
    number: Int[Array, "..."],
) -> Float[Array, "... 4"]:
    """Mean of the delayed command in physics step `number` of the newest command's period.

    Step i sees the commands of the time from (i dt - Delta) to ((i + 1) dt - Delta), where the
    newest command (slot 0) starts at 0 and slot j holds from -j h to (1 - j) h, h = steps dt. A
    step is no longer than a command, so it sees two at most. The last slot also stands for
    everything older.

    Args:
        line: as of `delayed`.
        parameters: as of `delayed`.
        steps: as of `delayed`, or an argument of the program.
        newest: as of `delayed`.
        number: i; or several.
    """
    opens = number.astype(jnp.float32) - parameters.latency / parameters.time_step
    steps = jnp.asarray(steps, jnp.float32)
    slot = jnp.clip(
        jnp.ceil(-opens / steps), 0.0, jnp.asarray(line.shape[0] - 1 - newest, jnp.float32)
    )
    older = jnp.clip((1.0 - slot) * steps - opens, 0.0, 1.0)
    older = jnp.where(slot == 0, 0.0, older)[..., None]
    # An index and not a sum over all slots: the line of a 500 Hz controller has 28.
    index = slot.astype(jnp.int32)
    return older * line[newest + index] + (1.0 - older) * line[newest + jnp.maximum(index - 1, 0)]
