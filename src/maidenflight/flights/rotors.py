"""What a drone's rotors do under the commands of a log."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from maidenflight import compiler
from maidenflight.flights.log import Flight
from maidenflight.parameters import Parameters, replace
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
