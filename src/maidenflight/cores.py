"""The cores that this process may use, and how JAX comes to use all of them."""

import os
from contextlib import suppress


def count() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def count_devices() -> int:
    """Returns how many devices JAX sees of a processor: a core each, and two of a single one.

    Sums over another number of devices are rounded differently. So one core gives the same bytes
    as two, which are the machines on which results are compared most.
    """
    return max(2, count())


def as_devices(number: int | None = None) -> None:
    """Makes JAX see each core as a device, over which drones are laid.

    XLA uses one core for arrays this small.

    To be called before JAX does anything. Where it runs already, as in a notebook, its devices stay
    what they are.

    Args:
        number: of devices; see `count_devices` by default.
    """
    import jax

    with suppress(RuntimeError):
        jax.config.update("jax_num_cpu_devices", number or count_devices())
