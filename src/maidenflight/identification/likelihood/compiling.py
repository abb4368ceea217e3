"""Compiles what the likelihood of one row ahead needs, before it is needed."""

from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache, partial
from threading import Thread

import jax
import numpy as np

from maidenflight import compiler
from maidenflight.flights.log import Flight
from maidenflight.flights.windows import Windows
from maidenflight.identification.likelihood import one_step_errors
from maidenflight.identification.likelihood.observation import BY_MOMENT, MOTORS
from maidenflight.identification.likelihood.one_step import CHUNK, JOINED, LENGTH, directions
from maidenflight.identification.likelihood.one_step_errors import AT_ONCE, ORDER, Innovations
from maidenflight.identification.signals.flight_signals import stride
from maidenflight.parameters import crazyflie


def start_compiling(flight: Flight, lead_in: int) -> list[Thread]:
    """Begins to compile all programs that identification from flights like one needs.

    They depend on its rate alone, so that others can be read meanwhile. Side by side they take half
    as long as one after the other; what the latest call has begun is not begun again.

    Args:
        flight: a flight with a state.
        lead_in: rows of commands before a window; at least one.

    Returns:
        Threads, all of which have ended once all is compiled.
    """
    return _start_threads(stride(flight), max(lead_in, 1))


@lru_cache(1)
def _start_threads(every: int, before: int) -> list[Thread]:
    """Returns threads that the verb begins as it reads, and the estimator waits for."""
    left = iter(_programs(every, before))

    def compile_next() -> None:
        # What fails here fails again where it is needed, which says it.
        with suppress(Exception):
            for program in left:
                program()

    threads = [Thread(target=compile_next, daemon=True) for _ in range(compiler.count_cores())]
    for thread in threads:
        thread.start()
    return threads


def _programs(every: int, before: int) -> list[Callable[[], object]]:
    """What runs each program once, the largest first.

    Args:
        every: rows of the log to a row of the windows.
        before: rows of commands before a window.
    """

    def zeros(*shape: int) -> np.ndarray:
        return np.zeros(shape, np.float32)

    chunk, drone = jax.device_put(
        (
            Windows(
                position=zeros(CHUNK, 3),
                velocity=zeros(CHUNK, 3),
                quaternion=zeros(CHUNK, 4),
                body_rates=zeros(CHUNK, 3),
                command=zeros(CHUNK, every * (before + LENGTH), 4),
                measured=zeros(CHUNK, LENGTH, 12),
                segment=np.zeros(CHUNK, int),
            ),
            crazyflie(),
        )
    )
    motors = zeros(CHUNK, LENGTH, 4), zeros(len(MOTORS), CHUNK, LENGTH, 4)
    speed, by_motor, wrong, part = jax.device_put(
        (*motors, zeros(CHUNK, 6, LENGTH), zeros(AT_ONCE, CHUNK, 6, LENGTH))
    )
    new = Innovations(zeros(6, ORDER), zeros(6), zeros(6), False)
    along = directions(drone, [BY_MOMENT[0]])[0]
    return [
        partial(one_step_errors.slopes, chunk, drone, speed, by_motor, along, 2, every),
        partial(one_step_errors.errors_of_chunk, chunk, drone, 2, every),
        partial(one_step_errors.spins, chunk, drone, 2, every),
        partial(one_step_errors.derivatives, wrong, [part] * JOINED, new),
        partial(one_step_errors.derivatives, wrong, [part] * 2 * JOINED, new),
    ]
