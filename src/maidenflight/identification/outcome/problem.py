"""Request for an identification, whatever its method."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import jax
import numpy as np
from jaxtyping import Array

from maidenflight import inputs
from maidenflight.errors import InputError
from maidenflight.flights.checkup.in_flight import load_factor
from maidenflight.flights.log import Flight
from maidenflight.flights.windows import SAME_RATE
from maidenflight.identification.drone_file import Source
from maidenflight.identification.outcome.estimates import source_of
from maidenflight.identification.outcome.plausible import HOVERING
from maidenflight.identification.outcome.progress import Progress, Reporter
from maidenflight.identification.unknowns import (
    Box,
    check_gyration,
    physical_bounds,
    search_box,
    thrust_bound,
)
from maidenflight.parameters import Parameters, crazyflie

LONGEST_PERIOD = 0.025
"""Time between two rows beyond which nothing is identified [s]. From a PID's flights inertia comes
out 2.8 times too large at 25 Hz, with a narrow interval, and at 20 Hz the fit fails
(paper/notes/identification.md)."""
AUTO = "auto"
"""Instead of parameters' names: let the flights choose them."""


@dataclass(frozen=True)
class Problem:
    """Flights, parameters to identify from them, and where to begin."""

    flights: Sequence[Flight]
    """Checked flights of one rate, at least one."""
    source: Source
    """What is recorded of them."""
    start: Parameters
    """Where the first trial begins, and the other parameters."""
    over: tuple[str, ...] | None
    """Names of the parameters to identify; `None`: the flights choose."""
    bounds: Mapping[str, tuple[float, float]]
    """Search bounds by name, SI units, in place of the method's."""
    generator: np.random.Generator
    """Random numbers."""
    reporter: Reporter
    """What is told how far it is."""

    @property
    def by_battery_law(self) -> bool:
        """Whether a battery law gave the thrust of all flights."""
        return all(
            flight.by_battery_law and np.isfinite(flight.battery).any() for flight in self.flights
        )

    def box(self, names: Sequence[str]) -> Box:
        """Returns the search box of some parameters.

        Raises:
            InputError: one of them cannot be searched.
        """
        return search_box(names, {**physical_bounds(self.start), **self.bounds})

    @classmethod
    def of(
        cls,
        flights: Iterable[Flight],
        start: Parameters | None = None,
        over: Sequence[str] | str | None = None,
        bounds: Mapping[str, tuple[float, float]] | None = None,
        key: Array | int | None = None,
        on_progress: Callable[[Progress], None] | None = None,
    ) -> Self:
        """Returns the problem of some flights; arguments are those of `identify.identify`.

        Raises:
            InputError: there are no flights, their rows are farther apart than `LONGEST_PERIOD`, or
                the start's mass, inertia and arms are not of one drone.
        """
        flights = list(flights)
        if not flights:
            raise InputError("no flights to identify from; give at least one.")
        _must_be_frequent(flights)
        start = crazyflie() if start is None else start
        check_gyration(start, "start")
        most = {HOVERING: (1.01, thrust_bound(max(map(calm_thrust, flights))))}
        if most[HOVERING][1] <= thrust_bound(float(start.thrust_to_weight)):
            most = {}
        names = None if over is None or over == AUTO else over
        return cls(
            flights=flights,
            source=source_of(flights),
            start=start,
            over=names if names is None else tuple([names] if isinstance(names, str) else names),
            bounds={**most, **(bounds or {})},
            generator=generator_of(key),
            reporter=Reporter(on_progress),
        )


def generator_of(key: Array | int | None) -> np.random.Generator:
    """Returns NumPy's random numbers of a key; of `jax.random.key(0)` without one."""
    bits = jax.random.bits(inputs.random_key(key), (2,))
    return np.random.default_rng(np.asarray(bits).tolist())


def _must_be_frequent(flights: Sequence[Flight]) -> None:
    slowest = max(flights, key=lambda flight: flight.period)
    if slowest.period > (1 + SAME_RATE) * LONGEST_PERIOD:
        raise InputError(
            f"{slowest.name}: rows are {1e3 * slowest.period:.4g} ms apart "
            f"({1 / slowest.period:.4g} Hz); the motors' lag needs {1 / LONGEST_PERIOD:g} Hz or "
            "more. Log at 100 Hz."
        )


def calm_thrust(flight: Flight) -> float:
    """Returns the ratio of thrust to weight that mean force and mean command of a flight show.

    Zero where nothing does.
    """
    load = load_factor(flight)
    if load is None:
        return 0.0
    ratio = np.nanmean(load, dtype=float) / max(np.nanmean(flight.command, dtype=float), 1e-3)
    return float(np.nan_to_num(ratio))


def require_identifiable(names: Collection[str], unidentifiable: Collection[str]) -> None:
    """Refuses flights that determine none of the requested parameters.

    Args:
        names: parameters that they tell.
        unidentifiable: the others.

    Raises:
        InputError: there are no `names`.
    """
    if not names:
        raise InputError(
            f"not identifiable from these flights: {', '.join(unidentifiable)}; "
            "intervals are as wide as what is plausible without them. Fly with more excitation."
        )
