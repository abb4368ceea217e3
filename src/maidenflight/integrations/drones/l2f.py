"""The dynamics of l2f's JSON, on which RAPTOR was trained: curve, lags and torque of each rotor.

The object `dynamics` replaces the one in what `l2f.parameters_to_json` gives. JSON has no comments:
what is lost stands under `comments`, which l2f does not read.

Source: l2f 2.0.18, parameters_to_json; its rotor speeds are 1 at u = 1.
"""

import json
import math
from typing import Any

import numpy as np

from maidenflight.deployment.drone_format import DroneFormat, DroneModel, simplest
from maidenflight.parameters import Parameters, replace, rotors
from maidenflight.simulator.physics import dynamics

FIELDS = (
    "thrust_offset",
    "thrust_linear",
    "rotor_thrust",
    "motor_time_constant",
    "spin_down_ratio",
)


def nearest_l2f(drone: Parameters) -> Parameters:
    """Returns the drone that l2f simulates."""
    return replace(simplest(drone), **{name: getattr(drone, name) for name in FIELDS})


def dynamics_of(drone: Parameters) -> dict[str, Any]:
    """Returns what l2f's JSON says of a drone's dynamics."""
    offset, linear = float(drone.thrust_offset), float(drone.thrust_linear)
    weight = float(drone.mass) * float(drone.gravity)
    full = weight * float(drone.thrust_to_weight) / 4 * np.asarray(drone.rotor_thrust, np.float64)
    curve = full[:, None] * [offset, linear, 1.0 - offset - linear]
    inertia = np.asarray(drone.inertia, np.float64)
    up = float(drone.motor_time_constant)
    return {
        "rotor_positions": rotors(drone).tolist(),
        "rotor_thrust_directions": [[0.0, 0.0, 1.0]] * 4,
        "rotor_torque_directions": [[0.0, 0.0, float(sign)] for sign in drone.rotor_direction],
        "rotor_thrust_coefficients": curve.tolist(),
        "rotor_torque_constants": [float(drone.torque_to_thrust)] * 4,
        "rotor_time_constants_rising": [up] * 4,
        "rotor_time_constants_falling": [up * float(drone.spin_down_ratio)] * 4,
        "mass": float(drone.mass),
        "gravity": [0.0, 0.0, -float(drone.gravity)],
        "J": np.diag(inertia).tolist(),
        "J_inv": np.diag(1.0 / inertia).tolist(),
        "hovering_throttle_relative": math.sqrt(dynamics.hover_command(drone)),
        "action_limit": {"min": 0.0, "max": 1.0},
    }


def write_l2f(model: DroneModel) -> str:
    """Returns the JSON."""
    content = {"comments": model.comments(), "dynamics": dynamics_of(model.drone)}
    return json.dumps(content, indent=2) + "\n"


FORMAT = DroneFormat(
    ".json",
    nearest_l2f,
    write_l2f,
    ("Actions in [-1, 1] are rotor speeds: front right, back right, back left, front left.",),
)
