"""`foreign_policy`, policies by others by name."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maidenflight.flying.pilots import ForeignPolicy
from maidenflight.registry import POLICIES
from maidenflight.simulator.tasks.tasks import Task


def foreign_policy(name: str | Path) -> ForeignPolicy | None:
    """Returns a policy of others by the words of a command line, or nothing if it is none.

    Args:
        name: `NAME` or `NAME:MORE` with a name of `registry.POLICIES`, such as `raptor:500hz`, or a
            file with an ending in it: a TOML file that describes a network in ONNX or of
            Stable-Baselines3, or a file of the latter (`.zip`) that our environments trained.

    Raises:
        InputError: its package is not installed, or the file makes no sense.
    """
    path = Path(name)
    kind = str(name).partition(":")[0]
    if not path.exists() and path.suffix != ".json" and kind in POLICIES:
        return POLICIES[kind](str(name))
    if path.suffix not in ("", ".json") and path.suffix in POLICIES:
        return POLICIES[path.suffix](name)
    return None


@cache
def reference_velocity(task: Task) -> Callable[[float], Float[np.ndarray, "3"]]:
    """Returns the velocity of a task's set-point by time [s]: [m/s]."""

    @jax.jit
    def velocity(time: Float[Array, ""]) -> Float[Array, "3"]:
        return jax.jvp(task.reference, (time,), (jnp.ones_like(time),))[1]

    return lambda time: np.asarray(velocity(jnp.float32(time)))
