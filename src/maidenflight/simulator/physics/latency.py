"""Latency as a delay line, continuous and differentiable in the delay.

Commands pass a zero-order hold of one command period. A physics step ends where a command arrives,
so that the lengths of the steps vary smoothly with the latency: with an index into a buffer every
objective would be constant in the latency between steps.
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


def physics_steps(period: float, step: float) -> tuple[int, np.float32]:
    """Returns physics steps a command, an even number (see `in_step`), and their mean length [s].

    Args:
        period: between two commands [s].
        step: about how long a physics step is [s].
    """
    steps = 2 * max(1, round(period / (2 * step)))
    return steps, np.float32(period / steps)


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
    index = (-1 - number) % _length(commands)
    set_at = partial(lax.dynamic_update_index_in_dim, index=index, axis=0)
    return DelayLine(each(set_at, commands, newest), index, ring=True)


def in_front(commands: Float[Array, "slots 4"], number: int) -> Float[Array, "slots 4"]:
    """Commands, newest first, of a ring in which so many were `put`."""
    return each(partial(jnp.roll, shift=number, axis=0), commands)


def in_step(
    line: DelayLine,
    parameters: Parameters,
    steps: int | Int[Array, ""],
    number: Int[Array, "..."] | int,
) -> tuple[Float[Array, "... 4"], Float[Array, "..."]]:
    """Returns the command that acts in a step of the newest command's period, and how long it does.

    The newest command (slot 0) starts at 0 and slot j holds from -j h to (1 - j) h, h = steps dt.
    Two commands act in the period, the newer one from (Delta mod h) on. Each has half of the steps,
    so that none sees both: motors that slow down slower than they speed up do not follow the mean
    of two commands. A single step sees that mean. The last slot also stands for everything older.

    Args:
        line: the commands.
        parameters: uses `latency` Delta [s] and `time_step` dt [s], the mean length of a step.
        steps: physics steps a command period. As an argument of the program at least two.
        number: of the step in the period; or several.

    Returns:
        The rotor speed command, and how long the step is [s].
    """
    size = _length(line.commands)
    oldest = size - 1 if line.ring else size - 1 - line.newest
    count = jnp.asarray(steps, jnp.float32)
    periods = parameters.latency / (parameters.time_step * count)
    whole = jnp.floor(lax.stop_gradient(periods))
    share = periods - whole

    def at(slot: Array) -> Float[Array, "... 4"]:
        index = line.newest + jnp.clip(slot.astype(jnp.int32), 0, oldest)
        if line.ring:
            index = jnp.where(index < size, index, index - size)
        return each(lambda commands: commands[index], line.commands)

    if isinstance(steps, int) and steps == 1:
        slot = jnp.broadcast_to(whole, jnp.shape(number))
        mean = each(
            lambda older, newer: share * older + (1.0 - share) * newer, at(slot + 1.0), at(slot)
        )
        return mean, jnp.broadcast_to(parameters.time_step, jnp.shape(number))
    first = steps // 2
    is_older = number < first
    parts = jnp.where(is_older, first, steps - first).astype(jnp.float32)
    length = jnp.where(is_older, share, 1.0 - share) * count / parts * parameters.time_step
    return at(jnp.where(is_older, whole + 1.0, whole)), length


def _length(commands: Float[Array, "slots 4"]) -> int:
    return jax.tree.leaves(commands)[0].shape[0]
