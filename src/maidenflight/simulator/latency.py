"""Latency as a delay line, continuous and differentiable in the delay.

Commands are held for one command period. Over a physics step the motor sees the delayed command's exact mean, so that a delay
between two steps, or between two commands, blends its neighbours instead of jumping: an index into a buffer would make every
objective flat in the latency between steps.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from maidenflight.parameters import QUANTITIES, Parameters

SLOWEST = QUANTITIES["latency"].upper
"""Longest latency [s] that a delay line is made for."""


def slots(command_period: float) -> int:
    """How many held commands a delay line must remember.

    Args:
        command_period: time between two commands [s]; one slot is spare for periods randomized to be up to 10 % shorter.
    """
    return int(SLOWEST / command_period + 1e-6) + 3


def push(line: Float[Array, "slots 4"], command: Float[Array, "4"]) -> Float[Array, "slots 4"]:
    """Puts the newest command in front and forgets the oldest."""
    return jnp.concatenate([command[None], line[:-1]])


def weights(parameters: Parameters, steps: int, length: int) -> Float[Array, "steps slots"]:
    """Share of each held command in each physics step of the period that the newest command starts.

    Step i sees the commands of the time from (i dt - Delta) to ((i + 1) dt - Delta), where the newest command (slot 0) starts
    at 0 and slot j holds from -j h to (1 - j) h, h = steps dt. Slot `length - 1` also stands for everything older.

    Args:
        parameters: uses `latency` Delta [s] and `time_step` dt [s].
        steps: physics steps a command period.
        length: slots of the delay line.

    Returns:
        Weights; each row sums to one.
    """
    dt = parameters.time_step
    opens = dt * jnp.arange(steps, dtype=jnp.float32)[:, None] - parameters.latency
    starts = -steps * dt * jnp.arange(length, dtype=jnp.float32)[None, :]
    ends = starts + steps * dt
    oldest = jnp.arange(length)[None, :] == length - 1
    newest = jnp.arange(length)[None, :] == 0
    overlap = jnp.minimum(opens + dt, jnp.where(newest, jnp.inf, ends)) - jnp.maximum(opens, jnp.where(oldest, -jnp.inf, starts))
    return jnp.clip(overlap / dt, 0.0, 1.0)
