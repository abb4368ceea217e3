"""Parameters of ArduPilot's Copter: its thrust curve and thrust at hover.

MOT_THST_EXPO (e) bends the curve (1 - e) x + e x^2 of the throttle x between MOT_SPIN_MIN and
MOT_SPIN_MAX. Frames are chosen from a list by FRAME_CLASS and FRAME_TYPE: a square X is written,
and others are left to the user.

Source: ArduPilot, libraries/AP_Motors/AP_Motors_Thrust_Linearization.cpp and Copter's parameters.
"""

import numpy as np

from maidenflight.deployment.drone_format import (
    DroneFormat,
    DroneModel,
    digits,
    hash_comment,
)
from maidenflight.integrations.drones import thrust_curve
from maidenflight.parameters import Parameters, levers

SQUARE_X = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]])
"""Signs of what a rotor's thrust turns about x and y, by definition of an X."""


def nearest_ardupilot(drone: Parameters) -> Parameters:
    """Returns what ArduPilot holds of the drone; NaN where nothing."""
    return thrust_curve.only(drone)


def is_square_x(drone: Parameters) -> bool:
    """Returns whether rotors are at the corners of a square and turn as ArduPilot's X."""
    about = levers(drone)
    flat = about[:, :2]
    square = np.allclose(flat, SQUARE_X * np.abs(flat).mean(), rtol=0.02)
    return bool(square and np.array_equal(about[:, 2], [-1, 1, -1, 1]))


def write_ardupilot(model: DroneModel) -> str:
    """Returns a parameter file."""
    drone = model.original
    frame = {"FRAME_CLASS": 1, "FRAME_TYPE": 1} if is_square_x(drone) else {}
    entries = {
        **frame,
        "MOT_THST_EXPO": digits(thrust_curve.factor(drone)),
        "MOT_THST_HOVER": digits(1.0 / float(drone.thrust_to_weight)),
    }
    lines = [f"{name},{value}" for name, value in entries.items()]
    return "\n".join([hash_comment(model.comments()).rstrip("\n"), *lines, ""])


FORMAT = DroneFormat(
    ".parm",
    nearest_ardupilot,
    write_ardupilot,
    ("MOT_THST_EXPO holds where a command u of the logs was the square of the ESC's input.",),
)
