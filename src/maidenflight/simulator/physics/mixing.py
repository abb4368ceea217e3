"""Mixers: which motors make thrust, roll, pitch and yaw on a drone's frame.

The Crazyflie's firmware mixes for an X, in whole counts (`firmware.mix`). PIDs that fly another
frame get a mixer from the places and directions of its rotors, as PX4's control allocation makes
one: the pseudo-inverse of what the rotors' thrusts do. Its columns are scaled so that the mixer of
every X, and of every rectangle, is the firmware's own, and that of a turned frame the turned one.

Source: PX4-Autopilot, ControlAllocationPseudoInverse (pseudo-inverse of the effectiveness matrix,
columns normalised); the scale is ours.
"""

import numpy as np
from jaxtyping import Float

from maidenflight.parameters import Parameters
from maidenflight.parameters.frames import effectiveness

Mixer = tuple[tuple[float, float, float, float], ...]
"""Each motor's shares of thrust, roll, pitch and yaw [-]; hashable, for static arguments."""

CRAZYFLIE: Mixer = (
    (1.0, -0.5, -0.5, -1.0),
    (1.0, -0.5, 0.5, 1.0),
    (1.0, 0.5, 0.5, -1.0),
    (1.0, 0.5, -0.5, 1.0),
)
"""What the firmware does, but for its whole counts (power_distribution_stock.c)."""
_ALIKE = 1e-3
"""Shares that differ by less are alike."""


def shares(drone: Parameters) -> Float[np.ndarray, "4 4"]:
    """Returns each motor's shares of thrust, roll, pitch and yaw, of a point.

    Thrust is spread so that it turns the drone about no axis, with a mean of 1. The columns of roll
    and pitch have length 1, that of yaw has length 2.
    """
    inverse = np.linalg.inv(effectiveness(drone))
    lengths = np.linalg.norm(inverse[:, 1:], axis=0) / [1.0, 1.0, 2.0]
    return inverse / [inverse[:, 0].mean(), *lengths]


def mixer_of(drone: Parameters) -> Mixer | None:
    """Returns the mixer of a drone's frame; None where the firmware's own fits it.

    Args:
        drone: a point, of NumPy's numbers.
    """
    torque_shares = shares(drone)
    if np.abs(torque_shares - np.array(CRAZYFLIE)).max() < _ALIKE:
        return None
    return tuple((float(a), float(b), float(c), float(d)) for a, b, c, d in torque_shares)
