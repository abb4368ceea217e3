"""The cores that this process may use, and how JAX comes to use all of them."""

import os
from contextlib import suppress


def count() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def as_devices(number: int | None = None) -> None:
    """Makes JAX see each core as a device, over which drones are laid.

    XLA uses one core for arrays this small.

    To be called before JAX does anything. Where it runs already, as in a notebook, its devices stay
    what they are.

    Args:
        number: cores to use; all by default.
    """
    import jax

    with suppress(RuntimeError):
        jax.config.update("jax_num_cpu_devices", number or count())
