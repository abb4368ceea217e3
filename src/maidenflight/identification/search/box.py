"""The search box of an identification, and its unit cube."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from maidenflight.errors import InputError
from maidenflight.identification.unknowns import UNKNOWNS, is_logarithmic
from maidenflight.parameters import COMPONENTS, QUANTITIES, Parameters, component, replace

PAPER_BOUNDS: dict[str, tuple[float, float]] = {
    "thrust_to_weight": (1.5, 2.5),
    "motor_time_constant": (0.01, 0.50),
    "latency": (0.0, 0.05),
}
"""Search bounds, SI units (Gronauer et al. 2022, sec. Simulation Optimization)."""


@dataclass(frozen=True)
class Box:
    """The search box, and the way between parameters' values and the unit cube."""

    names: tuple[str, ...]
    """Names of `parameters.COMPONENTS`."""
    lower: tuple[float, ...]
    """Their lower bounds, SI units."""
    upper: tuple[float, ...]
    """Their upper bounds, SI units."""

    @property
    def limits(self) -> dict[str, tuple[float, float]]:
        """Lower and upper bound by name, SI units."""
        return dict(zip(self.names, zip(self.lower, self.upper, strict=True), strict=True))

    def _ends(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        logarithmic = np.array([is_logarithmic(name) for name in self.names])
        low, high = np.array(self.lower), np.array(self.upper)
        with np.errstate(divide="ignore", invalid="ignore"):
            return (
                np.where(logarithmic, np.log(low), low),
                np.where(logarithmic, np.log(high), high),
                logarithmic,
            )

    def values(self, unit: Float[np.ndarray, "... d"]) -> Float[np.ndarray, "... d"]:
        """Returns parameter values at points of the unit cube."""
        low, high, logarithmic = self._ends()
        scaled = low + np.asarray(unit) * (high - low)
        return np.where(logarithmic, np.exp(scaled), scaled)

    def slope(self, unit: Float[np.ndarray, "d"]) -> Float[np.ndarray, "d"]:
        """Returns the derivative of each value with respect to its coordinate in the unit cube."""
        low, high, logarithmic = self._ends()
        return (high - low) * np.where(logarithmic, self.values(unit), 1.0)

    def unit(self, values: Float[np.ndarray, "... d"]) -> Float[np.ndarray, "... d"]:
        """Returns points of the unit cube at parameter values."""
        low, high, logarithmic = self._ends()
        with np.errstate(divide="ignore", invalid="ignore"):
            scaled = np.where(logarithmic, np.log(values), values)
        return (scaled - low) / (high - low)

    def unit_of(self, drone: Parameters) -> Float[np.ndarray, "d"]:
        """Returns where a drone lies, or comes nearest."""
        values = np.array([float(component(drone, name)) for name in self.names])
        return np.clip(self.unit(values), 0.0, 1.0)

    def drone(self, start: Parameters, unit: Float[np.ndarray, "d"]) -> Parameters:
        """Returns a drone with the values at a point of the unit cube in place."""
        values = zip(self.names, self.values(unit), strict=True)
        return replace(start, **{name: np.float32(value) for name, value in values})


def search_box(over: Sequence[str], bounds: Mapping[str, tuple[float, float]]) -> Box:
    """Returns the box of some parameters.

    Args:
        over: their names.
        bounds: search bounds by name, of these and perhaps others.

    Raises:
        InputError: a name is unknown or comes twice, or has no bounds or impossible ones.
    """
    for name in over:
        if name not in COMPONENTS:
            raise InputError(
                f"unknown parameter {name!r} to identify; known are {', '.join(COMPONENTS)}."
            )
        if name not in bounds:
            raise InputError(
                f"no search bounds for {name}; give them, as in --bounds {name}=LOWER,UPPER."
            )
        low, high = bounds[name]
        quantity = QUANTITIES[COMPONENTS[name][0]]
        if not quantity.lower <= low < high <= quantity.upper:
            raise InputError(
                f"bounds of {name} = [{low:g}, {high:g}]; expected a rising pair within "
                f"[{quantity.lower:g}, {quantity.upper:g}]"
                f"{'' if quantity.unit == '-' else f' {quantity.unit}'}, its physical range."
            )
    if not over or len(set(over)) != len(over):
        raise InputError("name each parameter to identify once, and at least one.")
    return Box(
        tuple(over),
        tuple(bounds[name][0] for name in over),
        tuple(bounds[name][1] for name in over),
    )


def thrust_bound(thrust_to_weight: float) -> float:
    """Returns the upper search bound of a drone whose ratio of thrust to weight is about so large.

    8 for those of a Crazyflie's kind; racing quadrotors have 6 to 14.
    """
    most = QUANTITIES["thrust_to_weight"].upper
    return float(np.clip(2.5 * thrust_to_weight, 8.0, most))


def physical_bounds(start: Parameters) -> dict[str, tuple[float, float]]:
    """Returns physical search bounds about a drone, by component."""
    bounds = {name: unknown.searched.about(start, name) for name, unknown in UNKNOWNS.items()}
    hovers = thrust_bound(float(start.thrust_to_weight))
    return bounds | {"thrust_to_weight": (bounds["thrust_to_weight"][0], hovers)}
