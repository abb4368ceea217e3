"""Identifying a drone's parameters from flights: values, intervals and the noise.

The class of the settings chooses the method. `Likelihood` looks one row ahead and models what it
cannot predict; feedback does not bias it. `Replay` is the paper's: it looks many rows ahead, open
loop.
"""

import dataclasses
import time
from collections.abc import Callable, Iterable, Mapping, Sequence

import jax
import numpy as np
from jaxtyping import Array

from maidenflight.errors import InputError
from maidenflight.flights.log import Flight
from maidenflight.identification import likelihood, replay
from maidenflight.identification.drone_file import GroupGain
from maidenflight.identification.estimates import Identification, source_of
from maidenflight.identification.likelihood import Likelihood
from maidenflight.identification.problem import Problem
from maidenflight.identification.replay import Replay
from maidenflight.parameters import Parameters, crazyflie

AUTO = "auto"
"""Instead of parameters' names: let the flights choose them."""


def identify(
    flights: Iterable[Flight],
    settings: Likelihood | Replay | None = None,
    *,
    start: Parameters | None = None,
    over: Sequence[str] | str | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    key: Array | None = None,
    on_evaluation: Callable[[int, int], None] | None = None,
    on_group: Callable[[GroupGain], None] | None = None,
) -> Identification:
    """Identifies parameters from flights.

    Args:
        flights: checked flights of one rate. All of them are held in memory; of many hours, give
            what `sampling.sampled` keeps.
        settings: of the method, which their class chooses; `Likelihood()` unless given.
        start: the drone whose other parameters are kept; the paper's Crazyflie unless given.
        over: names of `parameters.COMPONENTS` to identify, or `AUTO`: those that predict held-out
            flights better (likelihood only). Unless given `AUTO`; for a replay the paper's three.
        bounds: search bounds by name, SI units; unless given physical ones for a likelihood and
            the paper's for a replay.
        key: random key; `jax.random.key(0)` unless given.
        on_evaluation: called with (evaluations done, evaluations planned); 0 planned where that is
            not known, as for a likelihood.
        on_group: called with the log-likelihood gain of each group of parameters that is tried.

    Returns:
        The best point found in any trial, its interval, and how it was found. Cost grows linearly
        with the windows.

    Raises:
        InputError: an unknown or unbounded parameter, or too little flight.
    """
    began = time.perf_counter()
    settings = Likelihood() if settings is None else settings
    if not isinstance(settings, Likelihood | Replay):
        raise InputError(f"settings = {settings!r}; expected Likelihood(...) or Replay(...).")
    if over == AUTO and isinstance(settings, Replay):
        raise InputError(
            "parameters are chosen by likelihood only: a replay rewards whatever damps. Use "
            "Likelihood, or name them."
        )
    flights = list(flights)
    if not flights:
        raise InputError("no flights to identify from; give at least one.")
    bare = [flight.name for flight in flights if not flight.has_state]
    if bare:
        raise InputError(
            f"{bare[0]}: no position, velocity and attitude in it, and so in {len(bare)} of "
            f"{len(flights)} flights. Log stateEstimate beside the sensors, or leave it out."
        )
    seed = jax.random.bits(jax.random.key(0) if key is None else key, (2,))
    done = 0

    def evaluated(planned: int) -> None:
        nonlocal done
        done += 1
        if on_evaluation is not None:
            on_evaluation(done, planned)

    problem = Problem(
        flights=flights,
        source=source_of(flights),
        start=crazyflie() if start is None else start,
        over=_names(over),
        bounds=bounds or {},
        generator=np.random.default_rng(np.asarray(seed).tolist()),
        evaluated=evaluated,
        on_group=on_group,
    )
    if isinstance(settings, Replay):
        found = replay.identified(problem, settings)
    else:
        found = likelihood.identified(problem, settings)
    return dataclasses.replace(found, seconds=time.perf_counter() - began)


def _names(over: Sequence[str] | str | None) -> tuple[str, ...] | None:
    if over is None or over == AUTO:
        return None
    return (over,) if isinstance(over, str) else tuple(over)
