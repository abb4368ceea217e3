"""Frames: where a drone's four rotors are and which way they turn, in the order of the motors.

The functions give fields of `Parameters`, for `replace(drone, **plus_frame(0.2))`. Rotors that turn
as a Crazyflie's, 1 and 3 counter-clockwise from above, are those of PX4's and ArduPilot's quadrotor
X and of Betaflight's "props in"; `reversed_rotors` turns all the other way, as "props out" do.

Mixers say which motors make thrust, roll, pitch and yaw on a frame. The Crazyflie's firmware mixes
for an X, in whole counts (`firmware.mix`). PIDs that fly another frame get a mixer from the places
and directions of its rotors, as PX4's control allocation makes one: the pseudo-inverse of what the
rotors' thrusts do. Its columns are scaled so that the mixer of every X, and of every rectangle, is
the firmware's own, and that of a turned frame the turned one.

Source: PX4-Autopilot, ControlAllocationPseudoInverse (pseudo-inverse of the effectiveness matrix,
columns normalised); the scale is ours.
"""

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from maidenflight.errors import InputError

if TYPE_CHECKING:
    from maidenflight.parameters.quantities import Parameters

PLACES = ("rotor_x", "rotor_y")
"""Fields that place the rotors."""
GEOMETRY = (*PLACES, "rotor_direction")
"""Fields that are the geometry."""
Four = tuple[float, float, float, float]
Frame = dict[str, Any]
"""Values of `GEOMETRY`."""


def h_frame(forward: float, sideways: float, reversed_rotors: bool = False) -> Frame:
    """Rotors at the corners of a rectangle: an H, a stretched X or a wide one.

    Args:
        forward: from the centre to the rotors' line in front, and to that behind [m].
        sideways: from the centre to the rotors' line on either side [m].
        reversed_rotors: whether the front right rotor turns clockwise from above.

    Raises:
        InputError: a distance is not a positive number.
    """
    for name, value in (("forward", forward), ("sideways", sideways)):
        if not 0.0 < value < math.inf:
            raise InputError(f"{name} = {value} m; expected a positive distance of the rotors.")
    x, y = float(forward), float(sideways)
    return _frame((x, -x, -x, x), (-y, -y, y, y), reversed_rotors)


def x_frame(arm: float, reversed_rotors: bool = False) -> Frame:
    """Returns a square X: front right, back right, back left, front left.

    Args:
        arm: from the centre to a rotor [m], half of what is between opposite rotors.
        reversed_rotors: whether the front right rotor turns clockwise from above.

    Raises:
        InputError: the arm is not a positive number.
    """
    return h_frame(arm / math.sqrt(2.0), arm / math.sqrt(2.0), reversed_rotors)


def plus_frame(arm: float, reversed_rotors: bool = False) -> Frame:
    """Returns a +, which is the X turned to the left by 45 degrees: front, right, back, left.

    Args:
        arm: from the centre to a rotor [m].
        reversed_rotors: whether the front rotor turns clockwise from above.

    Raises:
        InputError: the arm is not a positive number.

    Source: Crazyflie firmware, power_distribution_stock.c, normal formation (the motors' order).
    """
    if not 0.0 < arm < math.inf:
        raise InputError(f"arm = {arm} m; expected a positive distance of the rotors.")
    length = float(arm)
    return _frame((length, 0.0, -length, 0.0), (0.0, -length, 0.0, length), reversed_rotors)


def _frame(x: Four, y: Four, reversed_rotors: bool) -> Frame:
    turns = (1.0, -1.0, 1.0, -1.0) if reversed_rotors else (-1.0, 1.0, -1.0, 1.0)
    return {"rotor_x": x, "rotor_y": y, "rotor_direction": turns}


LAYOUTS = {"x": x_frame, "+": plus_frame}
"""Frames that an arm describes, by what a drone's TOML file calls them."""


def arm_length(drone: "Parameters") -> float:
    """Returns the mean distance of the rotors from the centre of mass [m], of a point."""
    x, y, _ = rotors(drone).T
    return float(np.hypot(x, y).mean())


def rotors(drone: "Parameters") -> Float[np.ndarray, "4 3"]:
    """Returns places of the rotors in body axes [m], of a point."""
    x, y = (np.asarray(getattr(drone, name), np.float64) for name in PLACES)
    return np.stack([x, y, np.zeros(4)], axis=1)


def levers(drone: "Parameters") -> Float[np.ndarray, "4 3"]:
    """Returns what a newton of each rotor turns about, of a point: y [m], -x [m] and direction [-].

    Source: the torque r x F of a thrust along body z.
    """
    x, y, _ = rotors(drone).T
    return np.stack([y, -x, np.asarray(drone.rotor_direction, np.float64)], axis=1)


def effectiveness(drone: "Parameters") -> Float[np.ndarray, "4 4"]:
    """Returns total thrust and three torques of each rotor's thrust, in rows.

    Lengths are in units of the mean arm, the torque about z in units of the reaction torque.
    """
    arm = arm_length(drone)
    turned = levers(drone) / [arm or 1.0, arm or 1.0, 1.0]
    return np.concatenate([np.ones((1, 4)), turned.T])


def check(drone: "Parameters", source: str) -> "Parameters":
    """Returns a drone whose rotors can hover it and turn it about every axis.

    Args:
        drone: a point.
        source: what the error names, usually a file.

    Raises:
        InputError: a direction is neither 1 nor -1, the rotors' thrusts cannot make thrust and
            three torques independently, or a rotor would have to pull downwards to hover.
    """
    direction = np.asarray(drone.rotor_direction)
    if not np.all(np.abs(direction) == 1.0):
        raise InputError(
            f"{source}: rotor_direction = {direction.tolist()}, expected 1 or -1 for each rotor: 1 "
            "where it turns clockwise from above, and so turns the body to the left."
        )
    works = effectiveness(drone)
    steered = np.linalg.cond(works) < 1e3
    if not steered or np.linalg.inv(works)[:, 0].min() < 0.01:
        x, y = (np.round(np.asarray(getattr(drone, name), float), 5).tolist() for name in PLACES)
        lack = "hover" if steered else "steer roll, pitch, yaw and thrust independently"
        raise InputError(
            f"{source}: rotors at x = {x} m, y = {y} m with directions {direction.tolist()} do not "
            f"{lack}. Give their places from the centre of mass, which must lie between them, in "
            "the order front right, back right, back left, front left, and the direction of each; "
            "neighbours usually turn opposite ways."
        )
    return drone


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


def shares(drone: "Parameters") -> Float[np.ndarray, "4 4"]:
    """Returns each motor's shares of thrust, roll, pitch and yaw, of a point.

    Thrust is spread so that it turns the drone about no axis, with a mean of 1. The columns of roll
    and pitch have length 1, that of yaw has length 2.
    """
    inverse = np.linalg.inv(effectiveness(drone))
    lengths = np.linalg.norm(inverse[:, 1:], axis=0) / [1.0, 1.0, 2.0]
    return inverse / [inverse[:, 0].mean(), *lengths]


def mixer_of(drone: "Parameters") -> Mixer | None:
    """Returns the mixer of a drone's frame; None where the firmware's own fits it.

    Args:
        drone: a point, of NumPy's numbers.
    """
    torque_shares = shares(drone)
    if np.abs(torque_shares - np.array(CRAZYFLIE)).max() < _ALIKE:
        return None
    return tuple((float(a), float(b), float(c), float(d)) for a, b, c, d in torque_shares)
