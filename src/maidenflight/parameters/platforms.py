"""Platforms: what a drone's firmware is built with, beside its frame, by which its inner loops fly.

A drone names its platform (`Parameters.platform`), and all that flies the firmware takes gains from
there. Units are the firmware's: m, deg, deg/s and PWM counts.

Source: Crazyflie firmware, src/platform/interface/platform_defaults_cf2.h (0555cb1273fa) and
platform_defaults_cf21bl.h (13e6794c3cca); described from reading, not copied.
"""

from typing import NamedTuple

from maidenflight.errors import InputError

Three = tuple[float, float, float]


class Gains(NamedTuple):
    """Three PID controllers, one an axis. Hashable, for static arguments."""

    proportional: Three
    integral: Three
    derivative: Three
    integral_limit: Three
    output_limit: Three


class Platform(NamedTuple):
    """What a firmware is built with. Hashable, for static arguments."""

    rate: Gains
    """Of body rates; their output is torque [counts]."""
    attitude: Gains
    velocity: Gains
    position: Gains
    thrust_base: float
    """Thrust that the velocity PID adds its output to [counts]."""
    mass: float
    """What the Mellinger controller takes for the drone's (CF_MASS) [kg]."""


_INT16, _NONE = 32767.0, float("inf")
"""Limits of a PID's output: of torques, and where there is none (firmware, pid.h)."""
_CRAZYFLIE = Platform(
    rate=Gains(
        (250.0, 250.0, 120.0),
        (500.0, 500.0, 16.7),
        (2.5, 2.5, 0.0),
        (33.3, 33.3, 166.7),
        (_INT16, _INT16, _INT16),
    ),
    attitude=Gains(
        (6.0, 6.0, 6.0),
        (3.0, 3.0, 1.0),
        (0.0, 0.0, 0.35),
        (20.0, 20.0, 360.0),
        (_NONE, _NONE, _NONE),
    ),
    velocity=Gains(
        (25.0, 25.0, 25.0),
        (1.0, 1.0, 15.0),
        (0.0, 0.0, 0.0),
        (5000.0, 5000.0, 5000.0),
        (22.0, 22.0, 32.767),
    ),
    position=Gains(
        (2.0, 2.0, 2.0),
        (0.0, 0.0, 0.5),
        (0.0, 0.0, 0.0),
        (5000.0, 5000.0, 5000.0),
        (1.1, 1.1, 1.1),
    ),
    thrust_base=36000.0,
    mass=0.027,
)
CRAZYFLIE = "crazyflie"
"""The platform of drones that name none."""
PLATFORMS: dict[str, Platform] = {
    CRAZYFLIE: _CRAZYFLIE,
    "crazyflie_2.1+": _CRAZYFLIE._replace(mass=0.029),
    "crazyflie_thrust_upgrade": _CRAZYFLIE._replace(mass=0.0325),
    "crazyflie_brushless": _CRAZYFLIE._replace(
        rate=_CRAZYFLIE.rate._replace(
            proportional=(200.0, 200.0, 120.0), integral=(400.0, 400.0, 16.7)
        ),
        thrust_base=30000.0,
        mass=0.0393,
    ),
}
"""By name. The first has the mass of firmware 2021.10, as the paper's drone."""


def platform_of(name: str, source: str = "drone") -> Platform:
    """Returns the platform of a name.

    Args:
        name: of `PLATFORMS`.
        source: what the error names, usually a file.

    Raises:
        InputError: there is none.
    """
    if name not in PLATFORMS:
        raise InputError(
            f"{source}: platform = {str(name)[:40]!r}; expected one of {', '.join(PLATFORMS)}."
        )
    return PLATFORMS[name]
