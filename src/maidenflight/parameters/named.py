"""Drones with a name: the paper's Crazyflie, and others to begin an identification with.

Thrust-to-weight ratio is that at 60000 counts of the firmware, as everywhere for a drone without
logs; motors' lags are where identification begins, not what every drone has.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from maidenflight.errors import InputError
from maidenflight.parameters.components import check, replace
from maidenflight.parameters.frames import PLACES, h_frame, x_frame
from maidenflight.parameters.quantities import QUANTITIES, Parameters


def with_mass(drone: Parameters, mass: float, name: str) -> Parameters:
    """Returns the same frame and motors with another mass, as of a battery or a deck.

    Inertia is in proportion to the mass, as if it were spread as before, and full thrust stays.

    Args:
        drone: a point.
        mass: [kg].
        name: of the drone, for errors.

    Raises:
        InputError: the motors do not lift the mass, or it is outside its physical range.
    """
    share = mass / float(drone.mass)
    thrust_to_weight = float(drone.thrust_to_weight) / share
    if thrust_to_weight < 1.0:
        lifted = 1e3 * float(drone.mass) * float(drone.thrust_to_weight)
        raise InputError(
            f"a mass of {1e3 * mass:.4g} g is more than the motors of {name} lift, {lifted:.3g} g. "
            "Give another drone, or a TOML file with its thrust_to_weight."
        )
    return check(
        replace(
            drone,
            mass=np.float32(mass),
            inertia=np.asarray(drone.inertia) * np.float32(share),
            thrust_to_weight=np.float32(thrust_to_weight),
        ),
        f"{name} of {1e3 * mass:.4g} g",
    )


def isometric(drone: Parameters, mass: float, name: str) -> Parameters:
    """Returns a drone of the same shape and density and another mass.

    Lengths grow with the cube root of the mass, inertia with its power of 5/3; ratios and times
    stay.

    Args:
        drone: a point.
        mass: [kg].
        name: of the drone, for errors.

    Raises:
        InputError: a value is outside its physical range.

    Source: Kushleyev et al. 2013, Towards a swarm of agile micro quadrotors (scaling).
    """
    length = np.cbrt(mass / float(drone.mass))
    return check(
        replace(
            drone,
            mass=np.float32(mass),
            inertia=np.asarray(drone.inertia) * np.float32(length**5),
            **{
                field: (np.asarray(getattr(drone, field)) * length).astype(np.float32)
                for field in (*PLACES, "torque_to_thrust")
            },
            ground_effect=np.float32(drone.ground_effect * length**2),
        ),
        f"{name} of {1e3 * mass:.4g} g",
    )


def crazyflie() -> Parameters:
    """Returns the Crazyflie 2.1 as the paper models it.

    Body and torque constants are those of the paper's appendix (table:drone-parameters);
    thrust-to-weight ratio, motor time constant and latency those that its Bayesian optimisation
    found for T = 30 (table:results-sim-opt); noise is that of the authors' code.
    """
    return Parameters(**{name: quantity.paper for name, quantity in QUANTITIES.items()})


_COUNTS = 60000.0 / 65535.0
"""Share of the firmware's full thrust that u = 1 is."""
_GRAVITY = 9.81


class NamedDrone(NamedTuple):
    """A drone that is known by name."""

    summary: str
    """What it is, in a line."""
    make: Callable[[], Parameters]
    sources: Mapping[str, str] = {}
    """Source of each value that is not the paper's, by field of `Parameters`."""
    frameless: bool = False
    """Whether it is a flight controller that flies frames of any size, so that the mass must be
    given."""


def crazyflie_2_0() -> Parameters:
    """Returns the Crazyflie 2.0 and 2.1 with their original propellers; sources are in `DRONES`."""
    return replace(
        crazyflie(),
        thrust_to_weight=4 * 0.12 * _COUNTS / (0.027 * _GRAVITY),
        motor_time_constant=0.076,
        latency=0.004,
        torque_to_thrust=5.964552e-3,
        torque_offset=1.563383e-5,
        mass=0.027,
        inertia=(1.657171e-5, 1.6655602e-5, 2.9261652e-5),
        **x_frame(0.046),
    )


def crazyflie_2_1_plus() -> Parameters:
    """Returns the Crazyflie 2.1+; sources are in `DRONES`."""
    lighter = crazyflie_2_0()
    return replace(
        lighter,
        thrust_to_weight=4 * 0.12 * _COUNTS / (0.029 * _GRAVITY),
        torque_to_thrust=6.99e-3,
        torque_offset=0.0,
        mass=0.029,
        platform="crazyflie_2.1+",
        inertia=tuple(float(value) * 29 / 27 for value in lighter.inertia),
    )


def crazyflie_brushless() -> Parameters:
    """Returns the Crazyflie 2.1 Brushless; sources are in `DRONES`."""
    return replace(
        crazyflie(),
        thrust_to_weight=4 * 0.2 * _COUNTS / (0.037 * _GRAVITY),
        motor_time_constant=0.039,
        latency=0.004,
        torque_to_thrust=5.94e-3,
        torque_offset=0.0,
        mass=0.037,
        platform="crazyflie_brushless",
        inertia=tuple(value * 37 / 43.38 for value in (25e-6, 28e-6, 49e-6)),
        **x_frame(0.05),
        ground_effect=11.37 * (0.0275 / 4) ** 2,
    )


def x500() -> Parameters:
    """Returns the Holybro X500 v2 as PX4 simulates it; sources are in `DRONES`."""
    body, rotor, offset = 2.0, 0.016076923, 0.174
    mass, thrust = body + 4 * rotor, 8.54858e-6 * 1000.0**2
    along, about = 4 * rotor * offset**2, 8 * rotor * offset**2
    return replace(
        crazyflie(),
        thrust_to_weight=4 * thrust / (mass * _GRAVITY),
        motor_time_constant=0.0125,
        spin_down_ratio=2.0,
        latency=0.005,
        torque_to_thrust=0.016,
        torque_offset=0.0,
        mass=mass,
        inertia=(0.02166667 + along, 0.02166667 + along, 0.04 + about),
        **h_frame(offset, offset),
        ground_effect=11.37 * (0.127 / 4) ** 2,
    )


def racer_5_inch() -> Parameters:
    """Returns a racing quadrotor with propellers of five inches; all of it is guessed."""
    mass, arm = 0.65, 0.11
    flat = mass * arm**2
    return replace(
        crazyflie(),
        thrust_to_weight=6.0,
        motor_time_constant=0.03,
        latency=0.005,
        torque_to_thrust=0.012,
        torque_offset=0.0,
        mass=mass,
        inertia=(0.25 * flat, 0.25 * flat, 0.45 * flat),
        **x_frame(arm),
        ground_effect=11.37 * (0.0635 / 4) ** 2,
    )


_FOERSTER = "Förster 2015, System identification of the Crazyflie 2.0"
_MODELS = "drone-models 0.1.0 of crazyflow, cf21B_500"
_MEASURED_SPEEDS = "rotor speeds measured by IMRCLab 2026, docs/identification.md"
_ARM = "Crazyflie firmware, ARM_LENGTH; motors 92 mm apart across"
_FULL = "{} N a motor at 65535 counts, here of 60000, over weight"
_FIRMWARE = f"Crazyflie firmware, THRUST_MAX: {_FULL.format(0.12)}"
_BRUSHED = f"of a brushed Crazyflie 2.1: {_MEASURED_SPEEDS}"
_BRUSHLESS = f"of a Crazyflie 2.1 Brushless: {_MEASURED_SPEEDS}"
_GAZEBO = "PX4 gazebo models, x500"
_SCALED = "no frame of its own: crazyflie_brushless scaled in all lengths to the mass"

DRONES: dict[str, NamedDrone] = {
    "crazyflie": NamedDrone("Crazyflie 2.1 as Gronauer et al. 2022 model it", crazyflie),
    "crazyflie_2.0": NamedDrone(
        "Crazyflie 2.0 or 2.1, original propellers, no deck",
        crazyflie_2_0,
        {
            "thrust_to_weight": _FIRMWARE,
            "motor_time_constant": _BRUSHED,
            "latency": _BRUSHED,
            "torque_to_thrust": _FOERSTER,
            "torque_offset": _FOERSTER,
            "mass": "Bitcraze, product pages of the Crazyflie 2.0 and 2.1",
            "inertia": f"{_FOERSTER}, diagonal",
            **dict.fromkeys(PLACES, _ARM),
        },
    ),
    "crazyflie_2.1+": NamedDrone(
        "Crazyflie 2.1+, no deck",
        crazyflie_2_1_plus,
        {
            "thrust_to_weight": _FIRMWARE,
            "motor_time_constant": f"{_BRUSHED}; not measured with these propellers",
            "latency": _BRUSHED,
            "torque_to_thrust": "Crazyflie firmware, THRUST2TORQUE of the 2.1+ propellers",
            "torque_offset": "Crazyflie firmware, whose torque is proportional to thrust",
            "mass": "Bitcraze, product page of the Crazyflie 2.1+; firmware, CF_MASS",
            "inertia": "none published; computed: that of crazyflie_2.0 times 29/27",
            **dict.fromkeys(PLACES, _ARM),
        },
    ),
    "crazyflie_brushless": NamedDrone(
        "Crazyflie 2.1 Brushless with a micro-SD deck",
        crazyflie_brushless,
        {
            "thrust_to_weight": f"{_MODELS}: {_FULL.format(0.2)}",
            "motor_time_constant": _BRUSHLESS,
            "latency": _BRUSHLESS,
            "torque_to_thrust": _MODELS,
            "torque_offset": f"{_MODELS}, whose torque is proportional to thrust",
            "mass": "IMRCLab 2026, crazyflie-data-collection, with a micro-SD deck",
            "inertia": f"{_MODELS}: (25, 28, 49) 1e-6 of 43.38 g; computed: times 37/43.38",
            **dict.fromkeys(PLACES, f"{_MODELS}: 35.355 mm along x and y"),
            "ground_effect": f"computed: 11.37 (r/4)^2 with r = 27.5 mm of {_MODELS}",
        },
    ),
    "crazyflie_bolt": NamedDrone(
        "Crazyflie Bolt on a frame of your own",
        crazyflie_brushless,
        {
            "thrust_to_weight": "not known: that of crazyflie_brushless",
            "motor_time_constant": "not known: that of crazyflie_brushless",
            "latency": "not known: that of crazyflie_brushless",
            "torque_to_thrust": f"{_SCALED}, with its cube root",
            "torque_offset": "Crazyflie firmware, whose torque is proportional to thrust",
            "mass": "as given",
            "inertia": f"{_SCALED}, with its power of 5/3",
            **dict.fromkeys(PLACES, f"{_SCALED}, with its cube root"),
            "ground_effect": f"{_SCALED}, with its power of 2/3",
        },
        frameless=True,
    ),
    "x500": NamedDrone(
        "Holybro X500 v2 as PX4's Gazebo model has it",
        x500,
        {
            "thrust_to_weight": f"{_GAZEBO}: motorConstant 8.54858e-6 at 1000 rad/s, over weight",
            "motor_time_constant": f"{_GAZEBO}: timeConstantUp",
            "spin_down_ratio": f"{_GAZEBO}: timeConstantDown of 25 ms over timeConstantUp",
            "latency": "guess, 0 to 15 ms",
            "torque_to_thrust": f"{_GAZEBO}: momentConstant",
            "torque_offset": f"{_GAZEBO}, whose torque is proportional to thrust",
            "mass": f"{_GAZEBO}: 2 kg and four rotors of 16.1 g",
            "inertia": f"{_GAZEBO}: (21.667, 21.667, 40) 1e-3; computed: with the rotors' masses",
            **dict.fromkeys(PLACES, f"{_GAZEBO}: rotors 174 mm along x and y"),
            "ground_effect": "computed: 11.37 (r/4)^2 with propellers of 10 inches",
        },
    ),
    "racer_5_inch": NamedDrone(
        "Racing quadrotor, propellers of 5 inches; guessed, weigh and identify yours",
        racer_5_inch,
        {
            "thrust_to_weight": "guess, 4 to 10",
            "motor_time_constant": "guess, 15 to 60 ms",
            "latency": "guess, 0 to 15 ms",
            "torque_to_thrust": "guess, 0.008 to 0.025",
            "torque_offset": "guess: torque proportional to thrust",
            "mass": "guess, 0.45 to 0.8 kg",
            "inertia": "guess: (0.25, 0.25, 0.45) of mass times arm squared, within a factor of 2",
            **dict.fromkeys(PLACES, "guess: 220 mm between opposite motors, 200 to 250"),
            "ground_effect": "computed: 11.37 (r/4)^2 with propellers of 5 inches",
        },
    ),
}
"""Named drones, for the command line's `--drone NAME` and `--start NAME`."""


def drone(name: str, mass: float | None = None) -> Parameters:
    """Returns a named drone.

    Args:
        name: of `DRONES`.
        mass: of what flies [kg], batteries and decks included; its own by default.

    Raises:
        InputError: no such drone, it has no mass of its own, or it cannot lift that mass.
    """
    if name not in DRONES:
        raise InputError(f"{name!r}: no named drone. Expected one of {', '.join(DRONES)}.")
    named = DRONES[name]
    if mass is not None:
        return (isometric if named.frameless else with_mass)(named.make(), mass, name)
    if named.frameless:
        raise InputError(
            f"{name} is a flight controller without a frame. Say how much yours weighs, as in "
            f"maidenflight drone {name} --mass GRAMS -o mine.toml, and correct what is in that "
            "file."
        )
    return named.make()


def sources(name: str, mass: float | None = None) -> dict[str, str]:
    """Sources of a named drone's values that are not the paper's, by field.

    Args:
        name: of `DRONES`.
        mass: as in `named`.
    """
    drone = DRONES[name]
    if mass is None or drone.frameless:
        return dict(drone.sources)
    scaled = {
        "mass": "as given",
        "inertia": f"computed: that of {name} in proportion to the mass",
        "thrust_to_weight": f"computed: the thrust of {name} over the weight",
    }
    return {**drone.sources, **scaled}
