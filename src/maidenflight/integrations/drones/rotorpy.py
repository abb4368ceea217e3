"""RotorPy's vehicle parameters: a Python module with `quad_params`.

Thrust is k_eta w^2 for all rotors, which lag by one time. Drag and flapping of a rotor grow with
its speed and with the velocity of its place; they are right at hover, alike along x and y, and drag
along z then damps roll and pitch.

Source: RotorPy 3.0, vehicles/multirotor.py (compute_body_wrench) and vehicles/crazyflie_params.py.
"""

import numpy as np

from maidenflight.deployment.drone_format import (
    DroneFormat,
    DroneModel,
    digits,
    hash_comment,
    simplest,
)
from maidenflight.parameters import Parameters, replace, rotors


def nearest_rotorpy(drone: Parameters) -> Parameters:
    """Returns the drone that RotorPy simulates."""
    flat, high = float(np.mean(np.asarray(drone.drag)[:2])), float(drone.drag[2])
    flapping = float(np.mean(np.asarray(drone.flapping_moment)))
    _, y, _ = rotors(drone).T
    return replace(
        simplest(drone),
        drag=np.array([flat, flat, high], np.float32),
        flapping_moment=np.full(2, flapping, np.float32),
        rotational_damping=np.float32(float(drone.mass) * high * np.mean(y**2)),
    )


def write_rotorpy(model: DroneModel) -> str:
    """Returns the module's text."""
    drone, full = model.drone, model.square_speed
    thrust = float(drone.mass * drone.gravity * drone.thrust_to_weight) / 4 / full**2
    per_speed = 1.0 / (4 * model.hover_speed)
    drag = np.asarray(drone.drag, np.float64) * float(drone.mass) * per_speed
    inertia = zip(("Ixx", "Iyy", "Izz"), np.asarray(drone.inertia), strict=True)
    numbers = {
        "mass": drone.mass,
        **dict(inertia),
        **dict.fromkeys(("Ixy", "Iyz", "Ixz"), 0.0),
        **dict.fromkeys(("c_Dx", "c_Dy", "c_Dz"), 0.0),
        "k_eta": thrust,
        "k_m": thrust * float(drone.torque_to_thrust),
        "k_d": drag[0],
        "k_z": drag[2],
        "k_h": 0.0,
        "k_flap": -float(drone.flapping_moment[0]) * per_speed,
        "tau_m": drone.motor_time_constant,
        "rotor_speed_min": 0.0,
        "rotor_speed_max": full,
        "motor_noise_std": 0.0,
    }
    lines = [f'    "{name}": {digits(value)},' for name, value in numbers.items()]
    places = [
        f'        "r{number}": np.array([{", ".join(digits(position).split())}]),'
        for number, position in enumerate(rotors(drone), start=1)
    ]
    turns = ", ".join(digits(drone.rotor_direction).split())
    return "\n".join(
        [
            hash_comment(model.comments()),
            "import numpy as np",
            "",
            "quad_params = {",
            *lines,
            '    "num_rotors": 4,',
            '    "rotor_pos": {',
            *places,
            "    },",
            f'    "rotor_directions": np.array([{turns}]),',
            '    "rI": np.zeros(3),',
            "}",
            "",
        ]
    )


FORMAT = DroneFormat(
    ".py",
    nearest_rotorpy,
    write_rotorpy,
    (
        "Its gravity is 9.81 m/s2. Commands are rotor speeds [rad/s]: front right, back right, "
        "back left, front left.",
    ),
    needs_speed=True,
)
