"""How XLA compiles the programs that JAX runs here, and on how many cores they run."""

import functools
import os
from contextlib import suppress
from typing import Any

from maidenflight import cache

QUICK = "--xla_backend_optimization_level=1"
"""Compiles a sixth sooner; programs run a tenth to a third slower. For commands that compile much
and compute little."""
SMALLEST = "--xla_cpu_use_fusion_emitters=false"
"""Takes a third less memory to compile, by XLA's older emitter of loops: a process that flies 1,000
drones has 290 MB for 418. Environments are as fast as by XLA's own choice, motors alone a quarter
slower. Where XLA has none (`has_older_emitter`) this flag ends the process."""
FUSED = "--xla_backend_extra_options=xla_cpu_use_multi_output_fusion,xla_cpu_disable_tiled_emitter"
"""Trains and identifies up to twice as fast on CPUs, and compiles sooner.

One loop over the drones computes all that follows from the same numbers, instead of a loop for each
result that computes them anew; the second has no tiles in these loops. XLA does neither by itself,
and it is not for everything: a rate PID of arrays, simulated without derivatives, takes half as
long again (one of `vectors.Entries` half as long), and a loop whose body holds several steps of
physics computes the first again for each use of the next and takes for ever
(paper/notes/roofline.md). XLA newer than jaxlib 0.10's ignores both.
"""


@functools.cache
def has_older_emitter() -> bool:
    """Returns whether XLA still has its older emitter of loops, as up to jaxlib 0.10."""
    from jaxlib.version import __version__

    return tuple(map(int, __version__.split(".")[:2])) < (0, 11)


def once() -> dict[str, Any]:
    """Options of `jax.jit` for a program that runs once and for a moment.

    It compiles in a fifth to a quarter of the time, without optimization.
    """
    older = {"xla_cpu_use_fusion_emitters": False} if has_older_emitter() else {}
    return {"xla_backend_optimization_level": 0} | older


def loop() -> dict[str, Any]:
    """Options of `jax.jit` for a loop over all rows of a log, `once` and never by `FUSED`.

    By that each row copies the results of all: 8 s for 190 s of flight at 506 Hz, else 0.02 s.
    """
    return once() | {"xla_backend_extra_options": ""}


def set_flags(flags: str) -> None:
    """Has XLA compile by flags of this module, unless the user's own `XLA_FLAGS` are set.

    To be called before JAX compiles anything; a later call takes the place of an earlier one.
    """
    if os.environ.get("XLA_FLAGS") in (None, QUICK, FUSED):
        os.environ["XLA_FLAGS"] = flags
    # On a busy machine XLA asks to file a bug of its slow compilation; what fails is an exception.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")


def count_cores() -> int:
    """Returns how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def count_devices() -> int:
    """Returns how many devices JAX sees of a processor: a core each, and two of a single one.

    Sums over another number of devices are rounded differently. So one core gives the same bytes
    as two, which are the machines on which results are compared most.
    """
    return max(2, count_cores())


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


def prepare_jax(number: int | None = None, *, fused: bool = False) -> None:
    """Has JAX run here as the command line does: on all cores, and compiled programs are stored.

    To be called before JAX does anything; where it runs already, as in a notebook that has used it,
    its devices and flags stay. Other programs of JAX in this process are compiled alike.

    Args:
        number: cores to use; all by default.
        fused: compile by `FUSED`, in a process that trains or identifies.
    """
    if fused:
        set_flags(FUSED)
    cache.keep_compiled()
    as_devices(number)
