"""`foreign_policy`, policies by others by name."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maidenflight.errors import InputError
from maidenflight.flying.pilots import ForeignPolicy
from maidenflight.registry import POLICIES, import_part
from maidenflight.settings import is_code
from maidenflight.simulator.tasks.tasks import Task


def foreign_policy(name: str | Path) -> ForeignPolicy | None:
    """Returns a policy of others by the words of a command line, or nothing if it is none.

    Args:
        name: `NAME` or `NAME:MORE` with a name of `registry.POLICIES`, such as `raptor:500hz`; a
            file with an ending in it, such as one of Stable-Baselines3 (`.zip`) that our
            environments trained; or `MODULE:NAME` of your own.

    Raises:
        InputError: its package is not installed, the file makes no sense, or what `MODULE:NAME`
            names makes no `ForeignPolicy`.
    """
    path = Path(name)
    kind = str(name).partition(":")[0]
    if not path.exists() and path.suffix != ".json" and kind in POLICIES:
        return POLICIES[kind](str(name))
    if path.suffix not in ("", ".json") and path.suffix in POLICIES:
        return POLICIES[path.suffix](name)
    return _imported(str(name)) if imports_code(str(name)) else None


def imports_code(name: str) -> bool:
    """Tests whether a policy's name is `MODULE:NAME`, which is imported."""
    return is_code(name) and name.partition(":")[0] not in POLICIES and not Path(name).exists()


def _imported(name: str) -> ForeignPolicy:
    part = import_part(name, "policy")
    policy = part() if callable(part) else part
    if not isinstance(policy, ForeignPolicy):
        lacking = [member for member in _MEMBERS if not hasattr(policy, member)]
        raise InputError(
            f"{name}: {str(policy)[:60]!r} is no policy; it lacks {', '.join(lacking)}. Expected "
            "a class or function that makes a ForeignPolicy (docs/evaluation.md)."
        )
    return policy


_MEMBERS = ("name", "rate", "command_rate", "begin")


@cache
def reference_velocity(task: Task) -> Callable[[float], Float[np.ndarray, "3"]]:
    """Returns the velocity of a task's set-point by time [s]: [m/s]."""

    @jax.jit
    def velocity(time: Float[Array, ""]) -> Float[Array, "3"]:
        return jax.jvp(task.reference, (time,), (jnp.ones_like(time),))[1]

    return lambda time: np.asarray(velocity(jnp.float32(time)))
