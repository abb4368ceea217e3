"""Windows simulated open loop, in chunks that all cores compute side by side.

Each is simulated from its measured start with its recorded commands. The motors' speed and the
delay line at the start are those that the recorded commands before it imply.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from maidenflight import compiler
from maidenflight.flights.windows import Windows
from maidenflight.parameters import Parameters
from maidenflight.simulator.physics import actuators, dynamics, motion, rotations
from maidenflight.simulator.physics.dynamics import State
from maidenflight.simulator.physics.latency import DelayLine
from maidenflight.simulator.physics.vectors import entries

PHYSICS_STEP = 0.005
"""Mean physics step [s]: the paper simulates at 200 Hz."""
CHUNK = 256
"""Windows simulated side by side; their state fits a core's cache, which is 2 to 3 times faster
than one large batch. Harmless (paper/identification/constants.py)."""


def simulate(window: Windows, parameters: Parameters, steps: int) -> Float[Array, "T 12"]:
    """Simulates one window.

    Args:
        window: one of `Windows` (no leading axis).
        parameters: the drone; its `time_step` times `steps` is the period of the rows.
        steps: physics steps a row.

    Returns:
        Position, velocity, attitude and body rates in the T rows after the start.
    """
    commands_in, places, speed = initial_delay_line(window, parameters, steps)

    def advance(state: State, newest: Array) -> tuple[State, Array]:
        line = DelayLine(commands_in, newest)
        state = motion.drive_entries(dynamics.midpoint, state, line, steps, parameters)
        return state, jnp.stack(columns(state))

    position, velocity, quaternion, body_rates, _ = map(jnp.asarray, window[:5])
    start = entries(State(position, velocity, quaternion, body_rates, speed))
    return lax.scan(advance, start, places)[1]


def columns(state: State) -> list[Float[Array, ""]]:
    """Returns position, velocity, attitude and body rates of a state of `Entries`."""
    attitude = rotations.to_attitude(state.quaternion)
    return [*state.position, *state.velocity, *attitude, *state.body_rates]


def initial_delay_line(
    window: Windows, parameters: Parameters, steps: int | Array, stride: int = 1
) -> tuple[Float[Array, "history+TS 4"], Int[Array, "TS"], Float[Array, "4"]]:
    """Returns what the recorded commands before a window's start imply.

    Args:
        window: one of `Windows` (no leading axis).
        parameters: the drone.
        steps: physics steps from a command to the next.
        stride: S, commands to a measured row.

    Returns:
        All rotor speed commands, newest first; the place among them of each row's newest command;
        and the rotor speeds at the start.
    """
    commands_in, rows = commands(window), places(window, stride)

    def spin(speed: Array, newest: Array) -> tuple[Array, None]:
        return motion.spin(speed, DelayLine(commands_in, newest), steps, parameters), None

    before = jnp.arange(rows.shape[0], commands_in.shape[0])[::-1]
    speed, _ = lax.scan(spin, commands_in[-1], before)
    return commands_in, rows, speed


def commands(window: Windows) -> Float[Array, "history+TS 4"]:
    """Returns all rotor speed commands of a window, newest first."""
    return actuators.rotor_speed_command(jnp.asarray(window.command))[::-1]


def places(window: Windows, stride: int = 1) -> Int[Array, "TS"]:
    """Returns where among them each row's newest command is; S = `stride` commands to a row."""
    return jnp.arange(window.measured.shape[0] * stride)[::-1]


def wrapped(angles: Float[Array, "..."]) -> Float[Array, "..."]:
    """Angles to +-pi."""
    return (angles + jnp.pi) % (2 * jnp.pi) - jnp.pi


def in_chunks(windows: Windows, size: int = CHUNK) -> Windows:
    """Windows by chunks of some size.

    The last chunk is filled up with windows that stand for nothing new.
    """
    count = len(windows.segment)
    chunks = -(-count // size)
    order = np.resize(np.arange(count), chunks * size)
    return jax.tree.map(
        lambda array: np.asarray(array)[order].reshape(chunks, size, *array.shape[1:]), windows
    )


def on_all_cores(
    compute: Callable[[int, int], tuple[Array | np.ndarray, ...]], chunks: int
) -> list[np.ndarray]:
    """Computes chunks of windows on all cores; XLA alone would use one for arrays this small.

    Every number belongs to one chunk, so the result does not depend on the number of cores.

    Args:
        compute: (first chunk, end) to arrays with a row for each chunk from the first to the end.
        chunks: how many there are.

    Returns:
        The arrays for all chunks.
    """
    workers = min(compiler.count_cores(), chunks) if jax.default_backend() == "cpu" else 1
    ends = [chunks * worker // workers for worker in range(workers + 1)]

    def compute_part(first: int, end: int) -> list[np.ndarray]:
        # The copies to NumPy wait for the results, and let go of Python's lock meanwhile.
        return [np.asarray(part) for part in compute(first, end)]

    others = [_pool().submit(compute_part, *part) for part in pairwise(ends[1:])]
    parts = [compute_part(*ends[:2]), *(other.result() for other in others)]
    return [np.concatenate(pieces) for pieces in zip(*parts, strict=True)]


@cache
def _pool() -> ThreadPoolExecutor:
    """Threads that stay: to begin and end them took as long as a tenth of what they compute."""
    return ThreadPoolExecutor(compiler.count_cores())
