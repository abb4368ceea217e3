"""How XLA compiles the programs that JAX runs here."""

import os

from maidenflight import cache, cores

FLAGS = (
    "--xla_backend_extra_options=xla_cpu_use_multi_output_fusion,xla_cpu_disable_tiled_emitter",
)
"""What XLA has and does not do by itself, on CPUs.

With the first, one loop over the drones computes all that follows from the same numbers, instead of
a loop for each result that computes them anew; the second has the older emitter write these loops.
Programs run up to twice as fast, and fewer loops compile sooner (docs/studies/roofline.md).
"""


def set_flags() -> None:
    """Has XLA compile by `FLAGS`, unless the user's own `XLA_FLAGS` are set.

    To be called before JAX compiles anything.
    """
    os.environ.setdefault("XLA_FLAGS", " ".join(FLAGS))


def prepare_jax(number: int | None = None) -> None:
    """Has JAX run as fast as for the command line, which calls this itself.

    Three things: XLA's flags, all cores as devices, and compiled programs kept in the user's cache
    folder. To be called before JAX does anything; where it runs already, as in a notebook that has
    used it, what is set stays. Other programs of JAX in this process are compiled so too.

    Args:
        number: cores to use; all unless given.
    """
    set_flags()
    cache.keep_compiled()
    cores.as_devices(number)
