"""What is known of each parameter before flights tell it: an `Unknown`.

Whoever adds a parameter that flights may tell says here where it is searched, what is plausible and
what determines it.
"""

from collections.abc import Mapping
from typing import NamedTuple

from maidenflight.parameters import COMPONENTS, QUANTITIES, Parameters, arm_length, component


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
        Ends(-0.2, 0.2, "torque"),
        Ends(-0.05, 0.05, "torque"),
        "hover for half a minute",
        is_torque=True,
        step=1e-6,
    ),
    "torque_bias_z": Unknown(
        Ends(-0.2, 0.2, "torque"),
        Ends(-0.014, 0.014, "torque"),
        "hover for half a minute",
        is_torque=True,
        step=1e-6,
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
UNKNOWNS: Mapping[str, Unknown] = {
    name: _KINDS.get(name) or _KINDS[field]
    for name, (field, _) in COMPONENTS.items()
    if name in _KINDS or field in _KINDS
}
"""By name of `parameters.COMPONENTS`."""


def is_logarithmic(name: str) -> bool:
    """Tests whether a parameter is searched by its logarithm."""
    return name in UNKNOWNS and UNKNOWNS[name].is_logarithmic
