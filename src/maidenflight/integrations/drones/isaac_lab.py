"""Isaac Lab's `ThrusterCfg`, and what a multirotor's asset needs beside it, as a Python module.

Each environment and motor draws its lags and thrust constant from ranges: the middle 90 % of the
posterior, where the drone has one. Commands are thrusts, so that the constant moves no flight by
itself. Its thruster is integrated by Euler steps without the discrete approximation: then lags
mean what they do here. (Its rk4 adds the change to what is left of the step.)

Source: Isaac Lab, isaaclab_contrib/actuators/thruster.py and thruster_cfg.py.
"""

from collections.abc import Callable

import numpy as np

from maidenflight.deployment.drone_format import (
    DroneFormat,
    DroneModel,
    digits,
    hash_comment,
    simplest,
)
from maidenflight.parameters import Parameters, levers, replace

MIDDLE = (0.05, 0.95)
"""Quantiles of the posterior that are the ends of a range, chosen."""


def nearest_isaac_lab(drone: Parameters) -> Parameters:
    """Returns the drone that Isaac Lab simulates: lags up and down."""
    return replace(
        simplest(drone),
        motor_time_constant=drone.motor_time_constant,
        spin_down_ratio=drone.spin_down_ratio,
    )


def write_isaac_lab(model: DroneModel) -> str:
    """Returns the module's text."""
    drone = model.drone
    revolutions = model.square_speed / (2 * np.pi)

    def full_thrust(drone: Parameters) -> float:
        return float(drone.mass * drone.gravity * drone.thrust_to_weight) / 4

    ranges = {
        "thrust_const_range": _ends(model, lambda drone: full_thrust(drone) / revolutions**2),
        "tau_inc_range": _ends(model, lambda drone: float(drone.motor_time_constant)),
        "tau_dec_range": _ends(
            model, lambda drone: float(drone.motor_time_constant) * float(drone.spin_down_ratio)
        ),
    }
    force = np.zeros((6, 4))
    force[2], force[3:5] = 1.0, levers(drone).T[:2]
    force[5] = np.asarray(drone.rotor_direction) * float(drone.torque_to_thrust)
    lines = [
        hash_comment(model.comments()),
        "from isaaclab_contrib.actuators import ThrusterCfg",
        "",
        f"MASS = {digits(drone.mass)}  # [kg], of the USD asset",
        f"DIAGONAL_INERTIA = {_tuple(drone.inertia)}  # [kg m2], likewise",
        'ROTORS = ["rotor_1", "rotor_2", "rotor_3", "rotor_4"]',
        "THRUSTER = ThrusterCfg(",
        "    dt=0.005,  # your simulation's",
        f"    thrust_range={_tuple([0.0, full_thrust(drone)])},",
        *(f"    {name}={_tuple(ends)}," for name, ends in ranges.items()),
        f"    torque_to_thrust_ratio={digits(drone.torque_to_thrust)},",
        "    use_discrete_approximation=False,",
        '    integration_scheme="euler",',
        "    thruster_names_expr=ROTORS,",
        ")",
        "# Force and torque along x, y, z of each rotor's thrust.",
        "ALLOCATION_MATRIX = [",
        *(f"    [{', '.join(digits(row).split())}]," for row in force),
        "]",
        "",
    ]
    return "\n".join(lines)


def _ends(model: DroneModel, value: Callable[[Parameters], float]) -> tuple[float, float]:
    """Ends of a range: of the posterior's middle, or the drone's own value twice."""
    if not model.samples:
        return value(model.drone), value(model.drone)
    low, high = np.quantile([value(nearest_isaac_lab(sample)) for sample in model.samples], MIDDLE)
    return float(low), float(high)


def _tuple(values: object) -> str:
    return f"({', '.join(digits(values).split())})"


FORMAT = DroneFormat(
    ".py",
    nearest_isaac_lab,
    write_isaac_lab,
    ("Commands are the rotors' thrusts [N]: front right, back right, back left, front left.",),
    needs_speed=True,
)
