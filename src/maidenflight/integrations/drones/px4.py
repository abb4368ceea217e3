"""Parameters of PX4, as QGroundControl loads them: geometry, thrust curve and thrust at hover.

Places are along x forward and y right; a rotor that turns counter-clockwise has a positive moment.
Rotors are numbered as in PX4's Quadrotor X. CA_ROTORn_CT matters by its proportions only.

Source: PX4-Autopilot, src/modules/control_allocator/module.yaml (CA_ROTORn_*), parameters
THR_MDL_FAC and MPC_THR_HOVER.
"""

from maidenflight.deployment.drone_format import (
    DroneFormat,
    DroneModel,
    digits,
    hash_comment,
)
from maidenflight.integrations.drones import thrust_curve
from maidenflight.integrations.raptor.px4 import CONTROLS
from maidenflight.parameters import Parameters, rotors

FLOAT, INTEGER = 9, 6
"""Types by MAVLink's specification: float32 and int32."""
COEFFICIENT = 6.5
"""CA_ROTORn_CT of a sound rotor, the default of PX4's firmware."""


def nearest_px4(drone: Parameters) -> Parameters:
    """Returns what PX4 holds of the drone; NaN where nothing."""
    names = ("rotor_x", "rotor_y", "rotor_direction", "rotor_thrust", "torque_to_thrust")
    return thrust_curve.only(drone, *names)


def write_px4(model: DroneModel) -> str:
    """Returns a parameter file."""
    drone = model.original
    entries: list[tuple[str, float, int]] = [
        ("CA_AIRFRAME", 0, INTEGER),
        ("CA_ROTOR_COUNT", 4, INTEGER),
    ]
    for number, rotor in enumerate(CONTROLS):
        x, y, _ = rotors(drone)[rotor]
        moment = -float(drone.rotor_direction[rotor]) * float(drone.torque_to_thrust)
        values = {
            "PX": x,
            "PY": -y,
            "PZ": 0.0,
            "KM": moment,
            "CT": COEFFICIENT * float(drone.rotor_thrust[rotor]),
        }
        entries += [(f"CA_ROTOR{number}_{key}", value, FLOAT) for key, value in values.items()]
    entries += [
        ("THR_MDL_FAC", thrust_curve.factor(drone), FLOAT),
        ("MPC_THR_HOVER", 1.0 / float(drone.thrust_to_weight), FLOAT),
    ]
    lines = [f"1\t1\t{name}\t{digits(value)}\t{kind}" for name, value, kind in entries]
    heading = "# Vehicle-Id\tComponent-Id\tName\tValue\tType"
    return "\n".join([hash_comment(model.comments()) + heading, *lines, ""])


FORMAT = DroneFormat(
    ".params",
    nearest_px4,
    write_px4,
    ("THR_MDL_FAC holds where a command u of the logs was the square of the ESC's input.",),
)
