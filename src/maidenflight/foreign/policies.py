"""`foreign_policy`, policies by others by name."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maidenflight.flying.pilots import ForeignPolicy
from maidenflight.simulator.tasks import Task


def foreign_policy(name: str | Path) -> ForeignPolicy | None:
    """A policy of others by the words of a command line, or nothing if it is none.

    Args:
        name: `raptor`, `raptor:500hz`, a key of `firmware.CONTROLLERS`, a TOML file that describes
            a network in ONNX or of Stable-Baselines3, or a file of the latter (`.zip`) that our
            environments trained.

    Raises:
        InputError: its package is not installed, or the file makes no sense.
    """
    from maidenflight.foreign.described import described, of_own_environment
    from maidenflight.foreign.firmware import CONTROLLERS, FirmwareController
    from maidenflight.foreign.raptor import RATES, Raptor

    if str(name) in RATES and not Path(name).exists():
        return Raptor(str(name))
    if str(name) in CONTROLLERS and not Path(name).exists():
        return FirmwareController(str(name))
    if Path(name).suffix == ".toml":
        return described(name)
    if Path(name).suffix == ".zip":
        return of_own_environment(name)
    return None


@cache
def reference_velocity(task: Task) -> Callable[[float], Float[np.ndarray, "3"]]:
    """Velocity of a task's set-point by time [s]: [m/s]."""

    @jax.jit
    def velocity(time: Float[Array, ""]) -> Float[Array, "3"]:
        return jax.jvp(task.reference, (time,), (jnp.ones_like(time),))[1]

    return lambda time: np.asarray(velocity(jnp.float32(time)))
