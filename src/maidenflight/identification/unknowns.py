"""What is known of each parameter before flights tell it, an `Unknown`, and the box of a search.

Whoever adds a parameter that flights may tell says here where it is searched, what is plausible and
what determines it. A `Box` leads from values of parameters to the unit cube and back.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from maidenflight.errors import InputError
from maidenflight.parameters import (
    COMPONENTS,
    QUANTITIES,
    Parameters,
    arm_length,
    component,
    replace,
)


class Ends(NamedTuple):
    """Lowest and highest value, SI units or as multiples."""

    low: float
    high: float
    of: str = ""
    """Of what they are multiples: start (its own value there), torque (weight times arm), arm."""

    def about(self, start: Parameters, name: str) -> tuple[float, float]:
        """Returns the ends of a parameter about a drone, SI units, within its physical range."""
        unit = 1.0
        if self.of == "start":
            unit = float(component(start, name))
        elif self.of:
            unit = arm_length(start)
            unit *= float(start.mass * start.gravity) if self.of == "torque" else 1.0
        quantity = QUANTITIES[COMPONENTS[name][0]]
        return max(self.low * unit, quantity.lower), min(self.high * unit, quantity.upper)


class Unknown(NamedTuple):
    """What is known of a parameter before flights tell it."""

    searched: Ends
    """Physical bounds of the search."""
    plausible: Ends
    """What real Crazyflies and virtual drones have (paper/notes/identification.md)."""
    advice: str
    """What to log or fly that determines it."""
    is_logarithmic: bool = False
    """Whether it is searched by its logarithm, in which its posterior is normal: errors are
    factors."""
    is_torque: bool = False
    """Whether it is in proportion to the torque of a command."""
    step: float | None = None
    """Change over which a sensor's slopes are taken [SI]; None: a hundredth of the value."""


_QUICK = "turn quickly about x and y, at 250 Hz or more"
_FAST = "fly faster than 1 m/s along x and y"
_CUT = "cut the throttle now and then"
_YAW = "yaw to and fro"
_HOVER = "hover for half a minute"
_THROTTLE = "climb and sink with a fifth to four fifths of the throttle"
_KINDS: Mapping[str, Unknown] = {
    "thrust_to_weight": Unknown(
        # `box.thrust_bound` says where above a drone's own it ends.
        Ends(1.01, 20.0),
        Ends(0.8, 1.25, "start"),
        "hover longer, on more days",
    ),
    "motor_time_constant": Unknown(
        Ends(0.003, 0.5),
        Ends(0.5, 1.6, "start"),
        "log gyro and motors at 250 Hz or more, or rotor speeds",
        is_logarithmic=True,
    ),
    "latency": Unknown(
        Ends(0.0, 0.05),
        Ends(0.0, 0.03),
        "log gyro and motors with one clock, each command of the loop",
        step=1e-3,
    ),
    "spin_down_ratio": Unknown(Ends(0.2, 5.0), Ends(0.7, 2.5), _CUT, is_logarithmic=True),
    "motor_coasting": Unknown(Ends(0.0, 0.5), Ends(0.0, 0.16), _CUT, step=5e-3),
    "thrust_offset": Unknown(Ends(-0.5, 0.5), Ends(-0.5, 0.5), _THROTTLE, step=1e-2),
    "thrust_linear": Unknown(Ends(0.0, 1.0), Ends(0.0, 1.0), _THROTTLE, step=1e-2),
    # Rotors have 0.06 to 0.15 of their diameter, which is about an arm.
    "torque_to_thrust": Unknown(Ends(0.02, 20.0, "arm"), Ends(0.5, 1.5, "start"), _YAW, step=1e-4),
    "rotor_momentum": Unknown(
        Ends(0.0, 0.1, "torque"), Ends(0.0, 0.013, "torque"), _YAW, is_torque=True, step=1e-6
    ),
    "flapping_moment": Unknown(
        Ends(-0.1, 0.2, "torque"), Ends(0.0, 0.037, "torque"), _FAST, is_torque=True
    ),
    "rotational_damping": Unknown(
        Ends(0.0, 0.05, "torque"), Ends(0.0, 0.01, "torque"), _QUICK, is_torque=True, step=1e-6
    ),
    "torque_bias": Unknown(
        Ends(-0.2, 0.2, "torque"), Ends(-0.05, 0.05, "torque"), _HOVER, is_torque=True, step=1e-6
    ),
    "torque_bias_z": Unknown(
        Ends(-0.2, 0.2, "torque"), Ends(-0.014, 0.014, "torque"), _HOVER, is_torque=True, step=1e-6
    ),
    "drag": Unknown(Ends(0.0, 3.0), Ends(0.0, 0.5), _FAST),
    "drag_z": Unknown(Ends(0.0, 3.0), Ends(0.0, 0.5), "climb and sink", step=1e-2),
    "inertia": Unknown(
        Ends(0.3, 3.0, "start"),
        Ends(0.7, 1.5, "start"),
        _QUICK,
        is_logarithmic=True,
        is_torque=True,
    ),
}
"""By parameter or its field. Plausible ranges hold what real flights show
(paper/notes/identification.md#real-flights, #nanobench) and what virtual drones have
(simulator/realities/virtual_drone.py), and searches end beyond; factors of a start are chosen."""
UNKNOWNS: Mapping[str, Unknown] = {
    name: _KINDS.get(name) or _KINDS[field]
    for name, (field, _) in COMPONENTS.items()
    if name in _KINDS or field in _KINDS
}
"""By name of `parameters.COMPONENTS`."""


INERTIA = ("inertia_x", "inertia_y")
"""About the axes that rolling and pitching turn."""


def is_logarithmic(name: str) -> bool:
    """Tests whether a parameter is searched by its logarithm."""
    return name in UNKNOWNS and UNKNOWNS[name].is_logarithmic


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

    def part(self, names: Sequence[str]) -> "Box":
        """Returns the box of some of its parameters."""
        indices = [self.names.index(name) for name in names]
        ends = ([side[index] for index in indices] for side in (self.lower, self.upper))
        return Box(tuple(names), *map(tuple, ends))

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
    return Box(tuple(over), *zip(*(bounds[name] for name in over), strict=True))


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


PUBLISHED_INERTIA: Mapping[str, tuple[float, float, float]] = {
    "Crazyflie 2.0 (Foerster 2015)": (1.657e-5, 1.666e-5, 2.926e-5),
    "Crazyflie 2.1 (Gronauer et al. 2022)": (1.33e-5, 1.33e-5, 2.64e-5),
    "Crazyflie Brushless (Graefe et al. 2026)": (3.3e-5, 3.6e-5, 5.9e-5),
    "3-inch (INDIflight, arXiv 2406.11723)": (7.206e-4, 7.757e-4, 8.860e-4),
    "X500 v2 (PX4's Gazebo model)": (0.0216, 0.0216, 0.0400),
    "Crazyflie 2.1 (SimpleFlight, arXiv 2412.11764)": (1.4e-5, 1.4e-5, 2.17e-5),
}
"""Published inertia about x, y and z [kg m2], by its source."""
_LOG_RATIOS = np.log([z / (x + y) for x, y, z in PUBLISHED_INERTIA.values()])
RATIO_SD = 1.4826 * float(np.median(np.abs(_LOG_RATIOS - np.median(_LOG_RATIOS))))
"""Standard error of the start's I_z / (I_x + I_y), a share: by definition of the median deviation,
the robust standard deviation of its logarithm."""
GYRATION = (0.15, 1.3)
"""Radius of gyration about x or y by the rotors' distance; chosen: a third of the least and over
twice the largest of named drones, 0.43 to 0.55 (parameters/named.py)."""


def check_body(drone: Parameters, source: str) -> None:
    """Refuses masses, inertias and places of rotors that cannot be of one body.

    Args:
        drone: whose they are.
        source: where they come from, for errors.

    Raises:
        InputError: they are not of one body.

    Source: Goldstein, Classical mechanics, sec. 5.3 (inertia obeys the triangle inequality).
    """
    check_gyration(drone, source)
    inertia = np.asarray(drone.inertia, float)
    # No body exceeds 1, but estimates may.
    if inertia[2] > np.exp(1.96 * RATIO_SD) * (inertia[0] + inertia[1]):
        raise InputError(
            f"{source}: inertia_z {inertia[2]:.3g} kg m2 is larger than inertia_x and inertia_y "
            f"together ({inertia[0] + inertia[1]:.3g}), which no body has. Mend one."
        )


def check_gyration(drone: Parameters, source: str) -> None:
    """Refuses a mass, inertias about x and y, and places of rotors that cannot be of one drone.

    Args:
        drone: whose they are.
        source: where they come from, for errors.

    Raises:
        InputError: they are not of one drone.
    """
    inertia, mass = np.asarray(drone.inertia, float), float(drone.mass)
    arm, radius = arm_length(drone), np.sqrt(inertia[:2] / mass)
    low, high = GYRATION
    if not (low < radius / arm).all() or not (radius / arm < high).all():
        raise InputError(
            f"{source}: mass {1e3 * mass:.3g} g, inertia {inertia[0]:.3g}, {inertia[1]:.3g} kg m2 "
            f"and rotors {1e3 * arm:.3g} mm from the centre are not of one drone: the radius of "
            f"gyration is {radius.max() / arm:.2g} times the rotors' distance; expected {low:g} to "
            f"{high:g}, which is {mass * (low * arm) ** 2:.2g} to {mass * (high * arm) ** 2:.2g} "
            "kg m2 here. Compare the units: kg, kg m2 (1 kg cm2 is 1e-4), m."
        )
