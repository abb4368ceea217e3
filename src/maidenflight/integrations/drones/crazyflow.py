"""A section of crazyflow's `first_principles/params.toml`, which drone-models reads too.

It holds most of our model: a thrust curve with an offset and a linear part, rotors of unequal
thrust, lags up and down, the rotors' momentum, and drag along each axis.

Source: crazyflow 0.4.0, dynamics/first_principles/dynamics.py and params.toml.
"""

import json
import re

import numpy as np

from maidenflight.deployment.drone_format import (
    RPM,
    DroneFormat,
    DroneModel,
    hash_comment,
    rounded,
    simplest,
)
from maidenflight.parameters import Parameters, replace, rotors

FIELDS = (
    "thrust_offset",
    "thrust_linear",
    "rotor_thrust",
    "torque_offset",
    "motor_time_constant",
    "spin_down_ratio",
    "rotor_momentum",
    "drag",
)


def nearest_crazyflow(drone: Parameters) -> Parameters:
    """Returns the drone that crazyflow simulates."""
    return replace(simplest(drone), **{name: getattr(drone, name) for name in FIELDS})


def write_crazyflow(model: DroneModel) -> str:
    """Returns the section."""
    drone, rpm = model.drone, model.full_speed * RPM
    offset, linear = float(drone.thrust_offset), float(drone.thrust_linear)
    shares = np.array([offset, linear / rpm, (1.0 - offset - linear) / rpm**2])
    thrusts = model.thrusts[:, None] * shares
    torques = float(drone.torque_to_thrust) * thrusts
    torques[:, 0] += float(drone.torque_offset)
    x, y, _ = rotors(drone).T
    lever = float(np.mean(np.abs(np.concatenate([x, y]))))
    up = float(drone.motor_time_constant)
    down = up * float(drone.spin_down_ratio)
    is_even = bool(np.ptp(model.thrusts) == 0.0)
    entries = {
        "mass": float(drone.mass),
        "J": np.diag(np.asarray(drone.inertia, np.float64)),
        "thrust_min": 0.0,
        "thrust_max": float(np.max(model.thrusts)),
        "L": lever,
        "prop_inertia": float(drone.rotor_momentum) / model.full_speed,
        "rpm2thrust": thrusts[0] if is_even else thrusts,
        "rpm2torque": torques[0] if is_even else torques,
        "rotor_dyn_coef": np.array([1 / up, 0.0, 1 / down, 0.0]),
        "mixing_matrix": np.array([y / lever, -x / lever, np.asarray(drone.rotor_direction)]),
        "drag_matrix": np.diag(-np.asarray(drone.drag, np.float64) * float(drone.mass)),
    }
    lines = [f"{name} = {_toml(value)}" for name, value in entries.items()]
    section = model.name if re.fullmatch(r"[\w-]+", model.name) else json.dumps(model.name)
    return "\n".join([hash_comment(model.comments()), f"[{section}]", *lines, ""])


def _toml(value: float | np.ndarray) -> str:
    if isinstance(value, np.ndarray) and value.ndim:
        return f"[{', '.join(_toml(part) for part in value)}]"
    return repr(rounded(value))


FORMAT = DroneFormat(
    ".toml",
    nearest_crazyflow,
    write_crazyflow,
    ("Its gravity is 9.81 m/s2. Commands are rotor speeds [rpm].",),
    needs_speed=True,
)
