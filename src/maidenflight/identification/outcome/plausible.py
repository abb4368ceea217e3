"""What is plausible of a drone's parameters before any flight, and when flights say more."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from maidenflight.identification.unknowns import UNKNOWNS
from maidenflight.parameters import Parameters, component

HOVERING = "thrust_to_weight"
"""The parameter that is found by its moment: mean thrust carries the weight and what accelerates
the drone. A likelihood of one row ahead hardly weighs what lasts."""
NEXT_FLIGHT = 6
"""Segments of the flight that intervals are to hold, by definition of them: 30 s."""
OTHER_DAY = 0.015
"""Standard deviation of thrust from day to day, a share: that of the air's density over 4.5 K or 15
hPa, without battery and propellers. Three sets of flights of one Crazyflie differ by 3 % in what
hovering takes (paper/notes/identification.md)."""
VARIANCE_SHARE = 0.5
"""Share of its variance beforehand below which a parameter's variance must lie for flights to tell
it, by definition of more: they then hold more information than is known without them."""
UNIFORM = 12.0
"""Squared width of a uniform distribution over its variance, by definition of it."""

Ranges = Mapping[str, tuple[float, float]]
"""Lowest and highest value by parameter, SI units."""


@dataclass(frozen=True)
class ExpectedInterval:
    """What flights can tell of one parameter, in its SI unit."""

    prior: tuple[float, float]
    """Range that is plausible beforehand."""
    interval: tuple[float, float]
    """95 % interval to expect about the start's value, within the prior."""
    identifiable: bool
    """Whether flights say more of it than the prior does."""


def prior_ranges(start: Parameters, bounds: Ranges) -> dict[str, tuple[float, float]]:
    """Returns plausible ranges by parameter; search bounds for others than these.

    Args:
        start: the drone, whose own value each range holds.
        bounds: search bounds, which no range exceeds.
    """
    ranges = {}
    for name, (lowest, highest) in bounds.items():
        here, low, high = float(component(start, name)), lowest, highest
        if name in UNKNOWNS:
            low, high = UNKNOWNS[name].plausible.about(start, name)
        ranges[name] = (max(min(low, here), lowest), min(max(high, here), highest))
    return ranges


def is_identifiable(
    deviation: float, prior: tuple[float, float], share: float = VARIANCE_SHARE
) -> bool:
    """Tests whether flights say more of a parameter than the range that is plausible beforehand.

    Args:
        deviation: standard deviation that the flights leave.
        prior: lowest and highest plausible value.
        share: of the prior's variance, below which that of the flights must lie.
    """
    return bool(deviation**2 < share * (prior[1] - prior[0]) ** 2 / UNIFORM)


def other_days(
    drone: Parameters, count: int, generator: np.random.Generator
) -> Float[np.ndarray, "N"]:
    """Draws how much the thrust-to-weight ratio differs on other days.

    Args:
        drone: on the day of the flights.
        count: of samples.
        generator: random numbers.
    """
    return generator.normal(0.0, OTHER_DAY * float(drone.thrust_to_weight), count)
