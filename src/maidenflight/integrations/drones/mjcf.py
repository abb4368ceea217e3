"""MJCF of MuJoCo: a free body with four sites, each with a motor that lags and acts late.

A control is the thrust of a rotor [N]. The lag acts on the thrust, where in our model it acts on
the rotor speed: the same for small changes, and 2 % of a step's way apart for one of a fifth of the
thrust. MuJoCo has one lag for both ways, no drag of a body's own axes, and from 3.5 on a delay.

Source: MuJoCo, XML reference: actuator/general (dyntype filterexact, delay, nsample), site
transmission (gear).
"""

from xml.etree import ElementTree

import numpy as np

from maidenflight.deployment.drone_format import (
    DroneFormat,
    DroneModel,
    digits,
    simplest,
    xml_comment,
)
from maidenflight.parameters import Parameters, arm_length, replace, rotors

STEP_S = 0.002
"""Time step of the model, chosen; MuJoCo's own default."""
THRUST_FOLLOWS = {"thrust_linear": np.float32(1.0)}
"""Thrust in proportion to what lags: the lag acts on the thrust."""


def nearest_mjcf(drone: Parameters) -> Parameters:
    """Returns the drone that MuJoCo simulates: latency and unequal rotors are kept."""
    own = {"latency": drone.latency, "rotor_thrust": drone.rotor_thrust}
    return replace(simplest(drone), **own, **THRUST_FOLLOWS)


def write_mjcf(model: DroneModel) -> str:
    """Returns the MJCF, with a sensor for each part of the state."""
    drone = model.drone
    root = ElementTree.Element("mujoco", model=model.name)
    gravity = digits(0.0, 0.0, -float(drone.gravity))
    ElementTree.SubElement(
        root, "option", timestep=digits(STEP_S), gravity=gravity, integrator="implicitfast"
    )
    world = ElementTree.SubElement(root, "worldbody")
    body = ElementTree.SubElement(world, "body", name="drone")
    ElementTree.SubElement(body, "freejoint", name="root")
    ElementTree.SubElement(
        body,
        "inertial",
        pos="0 0 0",
        mass=digits(drone.mass),
        diaginertia=digits(drone.inertia),
    )
    arm = arm_length(drone)
    look = {"contype": "0", "conaffinity": "0", "mass": "0", "group": "1"}
    ElementTree.SubElement(body, "geom", {"type": "sphere", "size": digits(arm / 4), **look})
    ElementTree.SubElement(body, "site", name="imu")
    actuators = ElementTree.SubElement(root, "actuator")
    turns = np.asarray(drone.rotor_direction, np.float64) * float(drone.torque_to_thrust)
    for number, (position, turn, most) in enumerate(
        zip(rotors(drone), turns, model.thrusts, strict=True), start=1
    ):
        ends = {"fromto": digits(np.zeros(3), position), "size": digits(arm / 20)}
        ElementTree.SubElement(body, "geom", {"type": "capsule", **ends, **look})
        ElementTree.SubElement(body, "site", name=f"rotor_{number}", pos=digits(position))
        motor = {
            "name": f"thrust_{number}",
            "site": f"rotor_{number}",
            "gear": digits(0, 0, 1, 0, 0, turn),
            "ctrlrange": digits(0.0, most),
            "dyntype": "filterexact",
            "dynprm": digits(drone.motor_time_constant),
            # Without it a force is a step older than what it follows.
            "actearly": "true",
            **delayed(float(drone.latency)),
        }
        ElementTree.SubElement(actuators, "general", motor)
    sensors = ElementTree.SubElement(root, "sensor")
    for kind, name in (("framepos", "position"), ("framequat", "quaternion_wxyz")):
        ElementTree.SubElement(sensors, kind, name=name, objtype="site", objname="imu")
    for kind, name in (("velocimeter", "body_velocity"), ("gyro", "body_rates")):
        ElementTree.SubElement(sensors, kind, name=name, site="imu")
    ElementTree.indent(root)
    return xml_comment(model.comments()) + ElementTree.tostring(root, encoding="unicode") + "\n"


def delayed(latency: float) -> dict[str, str]:
    """Returns what delays an actuator, with room for the commands that are on their way.

    Forces act half a step early, which the delay makes up for. Between two commands it is
    interpolated: held, it would grow to whole steps.
    """
    if latency <= 0.0:
        return {}
    delay = latency + STEP_S / 2
    samples = str(int(np.ceil(delay / STEP_S)) + 1)
    return {"delay": digits(delay), "interp": "linear", "nsample": samples}


FORMAT = DroneFormat(
    ".xml",
    nearest_mjcf,
    write_mjcf,
    (
        "Controls are the rotors' thrusts [N]: front right, back right, back left, front left.",
        "The lag acts on the thrust, not on the rotor speed. A delay needs MuJoCo 3.5 or later.",
    ),
)
