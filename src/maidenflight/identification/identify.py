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
from maidenflight.flights.windows import SAME_RATE
from maidenflight.identification import inertial, most_likely, replay
from maidenflight.identification.estimates import Identification, source_of
from maidenflight.identification.information import Expected
from maidenflight.identification.likelihood import Likelihood
from maidenflight.identification.problem import Problem
from maidenflight.identification.progress import Progress, Reporter
from maidenflight.identification.replay import Replay
from maidenflight.parameters import Parameters, crazyflie

LONGEST_PERIOD = 0.025
"""Time between two rows beyond which nothing is identified [s]. From a PID's flights inertia comes
out 2.8 times too large at 25 Hz, with a narrow interval, and at 20 Hz the fit fails
(docs/studies/identification.md)."""
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
    on_progress: Callable[[Progress], None] | None = None,
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
        on_progress: called with the stage and how far it is; once with `expected_intervals`, before
            anything is fitted by likelihood.

    Returns:
        The best point found in any trial, its interval, and how it was found. Cost grows linearly
        with the windows.

    Raises:
        InputError: an unknown or unbounded parameter, too little flight, or rows farther apart than
            `LONGEST_PERIOD`.
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
    flights, left_out = of_one_kind(flights)
    stateless = bool(flights) and not flights[0].has_state
    if stateless and isinstance(settings, Replay):
        raise InputError(
            f"{flights[0].name}: no position, velocity and attitude in it, which a replay is "
            "compared with. Use Likelihood (--objective likelihood)."
        )
    problem = _problem(flights, start, over, bounds, key, Reporter(on_progress))
    if isinstance(settings, Replay):
        found = replay.identified(problem, settings)
    elif stateless:
        found = inertial.identified(problem, settings)
    else:
        found = most_likely.identified(problem, settings)
    notes = (*left_out, *found.notes)
    return dataclasses.replace(found, notes=notes, seconds=time.perf_counter() - began)


def of_one_kind(flights: Iterable[Flight]) -> tuple[list[Flight], list[str]]:
    """The flights with a state if any has one, else all; and a note on those left out."""
    flights = list(flights)
    whole = [flight for flight in flights if flight.has_state]
    bare = list(dict.fromkeys(flight.name for flight in flights if not flight.has_state))
    if not whole or not bare:
        return flights, []
    return whole, [
        f"{len(bare)} flights without position, velocity and attitude left out "
        f"({', '.join(bare[:3])}{' ...' if len(bare) > 3 else ''}), since others have them; "
        "identify from those alone to compare."
    ]


def expected_intervals(
    flights: Iterable[Flight],
    settings: Likelihood | None = None,
    *,
    start: Parameters | None = None,
    over: Sequence[str] | str | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    key: Array | None = None,
) -> dict[str, Expected]:
    """What flights can tell of each parameter, before anything is fitted; in seconds.

    Args:
        flights: as of `identify`.
        settings: of the likelihood; `Likelihood()` unless given.
        start: the drone about which intervals are expected; the paper's Crazyflie unless given.
        over: names of `parameters.COMPONENTS`, or `AUTO`: all that may be chosen, as unless given.
        bounds: search bounds by name, SI units, which no plausible range exceeds.
        key: random key; `jax.random.key(0)` unless given.

    Returns:
        By parameter the plausible range, the interval to expect, and whether the flights say more
        than that range.

    Raises:
        InputError: an unknown or unbounded parameter, or too little flight.
    """
    flights, _ = of_one_kind(flights)
    if flights and not flights[0].has_state:
        raise InputError(
            f"{flights[0].name}: no position, velocity and attitude in it, without which nothing "
            "is said beforehand. Identify from it."
        )
    problem = _problem(flights, start, over, bounds, key, Reporter(None))
    return most_likely.expected_intervals(problem, settings or Likelihood())


def _problem(
    flights: Iterable[Flight],
    start: Parameters | None,
    over: Sequence[str] | str | None,
    bounds: Mapping[str, tuple[float, float]] | None,
    key: Array | None,
    reporter: Reporter,
) -> Problem:
    flights = list(flights)
    if not flights:
        raise InputError("no flights to identify from; give at least one.")
    _must_be_frequent(flights)
    seed = jax.random.bits(jax.random.key(0) if key is None else key, (2,))
    return Problem(
        flights=flights,
        source=source_of(flights),
        start=crazyflie() if start is None else start,
        over=_names(over),
        bounds=bounds or {},
        generator=np.random.default_rng(np.asarray(seed).tolist()),
        reporter=reporter,
    )


def _must_be_frequent(flights: Sequence[Flight]) -> None:
    slowest = max(flights, key=lambda flight: flight.period)
    if slowest.period > (1 + SAME_RATE) * LONGEST_PERIOD:
        raise InputError(
            f"{slowest.name}: rows are {1e3 * slowest.period:.4g} ms apart "
            f"({1 / slowest.period:.4g} Hz); the motors' lag needs {1 / LONGEST_PERIOD:g} Hz or "
            "more. Log at 100 Hz."
        )


def _names(over: Sequence[str] | str | None) -> tuple[str, ...] | None:
    if over is None or over == AUTO:
        return None
    return (over,) if isinstance(over, str) else tuple(over)
