"""Lines for Betaflight's command line: thrust linearization and, off a square X, the mixer.

With `thrust_linear` of e percent a motor's output x becomes x (1 + e/100 (1 - x)^2) before it is
sent. The e is written for which thrust grows nearest to linearly: within 8 % of full thrust, where
a square is 25 % off. Rotors are numbered as Betaflight's: back right, front right, back left, front
left.

Source: Betaflight, flight/pid.c (pidApplyThrustLinearization) and flight/mixer_init.c.
"""

import numpy as np

from maidenflight.deployment.drone_format import DroneFormat, DroneModel, hash_comment
from maidenflight.integrations.drones import thrust_curve
from maidenflight.integrations.drones.ardupilot import is_square_x
from maidenflight.parameters import Parameters, levers

ROTORS = (1, 0, 2, 3)
"""Ours in the order of the firmware's motors."""
LARGEST = 150
"""Of `thrust_linear` [%], by the firmware."""


def nearest_betaflight(drone: Parameters) -> Parameters:
    """Returns what Betaflight holds of the drone; NaN where nothing."""
    return thrust_curve.only(drone, "rotor_x", "rotor_y", "rotor_direction")


def thrust_linear(drone: Parameters) -> int:
    """Returns the whole percentage for which thrust follows the mixer's output most linearly."""
    output = thrust_curve.INPUTS

    def bend(percent: int) -> float:
        sent = output * (1.0 + percent / 100 * (1.0 - output) ** 2)
        return float(np.mean((thrust_curve.share(drone, sent) - output) ** 2))

    return min(range(LARGEST + 1), key=bend)


def write_betaflight(model: DroneModel) -> str:
    """Returns lines to paste into the command line."""
    drone, lines = model.original, []
    if not is_square_x(drone):
        x_and_y = levers(drone)[:, :2] / np.abs(levers(drone)[:, :2]).max()
        lines = ["mixer CUSTOM", "mmix reset"]
        for number, rotor in enumerate(ROTORS):
            roll, pitch = x_and_y[rotor]
            yaw = -float(drone.rotor_direction[rotor])
            lines.append(f"mmix {number} 1.000 {roll:.3f} {pitch:.3f} {yaw:.3f}")
    lines += [f"set thrust_linear = {thrust_linear(drone)}", "save", ""]
    return "\n".join([hash_comment(model.comments()).rstrip("\n"), *lines])


FORMAT = DroneFormat(
    ".txt",
    nearest_betaflight,
    write_betaflight,
    (
        "thrust_linear is as in Betaflight 4.3 and later; earlier ones bend another curve.",
        "It raises the gains at low throttle: try it in steps.",
    ),
)
