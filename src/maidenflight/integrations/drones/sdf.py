"""SDF of Gazebo: a base with four rotors that turn, each driven by `MulticopterMotorModel`.

Speeds lag up and down by times of their own. Drag of a rotor grows with its speed and acts along x
and y alike; it is right at hover. The system's rolling moment acts along the velocity, where
flapping turns about an axis across it, and is off.

Source: gz-sim, systems/multicopter_motor_model/MulticopterMotorModel.cc; SDFormat 1.9.
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

ROTOR_MASS = 1e-3
"""Of a rotor's link, as a share of the drone's mass, chosen small; the base has the rest."""
SLOWDOWN = 10
"""Rotors are shown turning slower by this; the default of MulticopterMotorModel.cc, the source."""
Element = ElementTree.SubElement


def nearest_sdf(drone: Parameters) -> Parameters:
    """Returns the drone that Gazebo simulates: both lags, unequal rotors, drag along x and y."""
    flat = float(np.mean(np.asarray(drone.drag)[:2]))
    return replace(
        simplest(drone),
        motor_time_constant=drone.motor_time_constant,
        spin_down_ratio=drone.spin_down_ratio,
        rotor_thrust=drone.rotor_thrust,
        drag=np.array([flat, flat, 0.0], np.float32),
    )


def write_sdf(model: DroneModel) -> str:
    """Returns the SDF of one model."""
    drone, arm = model.drone, arm_length(model.drone)
    root = ElementTree.Element("sdf", version="1.9")
    body = Element(root, "model", name=model.name)
    places, rotor = rotors(drone), ROTOR_MASS * float(drone.mass)
    flat = rotor * (arm / 4) ** 2
    own = np.array([flat, flat, 2 * flat])
    x, y, _ = places.T
    moved = rotor * np.array([(y**2).sum(), (x**2).sum(), (x**2 + y**2).sum()])
    base = np.asarray(drone.inertia, np.float64) - moved - 4 * own
    _link(body, "base_link", np.zeros(3), float(drone.mass) - 4 * rotor, base, arm)
    for number, position in enumerate(places):
        _link(body, f"rotor_{number}", position, rotor, own, arm / 2)
        joint = Element(body, "joint", name=f"rotor_{number}_joint", type="revolute")
        Element(joint, "parent").text = "base_link"
        Element(joint, "child").text = f"rotor_{number}"
        axis = Element(joint, "axis")
        Element(axis, "xyz").text = "0 0 1"
        limit = Element(axis, "limit")
        Element(limit, "lower").text, Element(limit, "upper").text = "-1e16", "1e16"
    for number in range(4):
        plugin = Element(
            body,
            "plugin",
            filename="gz-sim-multicopter-motor-model-system",
            name="gz::sim::systems::MulticopterMotorModel",
        )
        for name, value in motor(model, number).items():
            Element(plugin, name).text = value
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return '<?xml version="1.0" ?>\n' + xml_comment(model.comments()) + text + "\n"


def motor(model: DroneModel, number: int) -> dict[str, str]:
    """Returns what the motor model of a rotor reads, by its names."""
    drone, up = model.drone, float(model.drone.motor_time_constant)
    drag = float(drone.drag[0]) * float(drone.mass) / (4 * model.hover_speed)
    return {
        "robotNamespace": model.name,
        "jointName": f"rotor_{number}_joint",
        "linkName": f"rotor_{number}",
        "turningDirection": "ccw" if float(drone.rotor_direction[number]) < 0 else "cw",
        "timeConstantUp": digits(up),
        "timeConstantDown": digits(up * float(drone.spin_down_ratio)),
        "maxRotVelocity": digits(model.square_speed),
        "motorConstant": digits(model.thrusts[number] / model.square_speed**2),
        "momentConstant": digits(drone.torque_to_thrust),
        "commandSubTopic": "command/motor_speed",
        "motorNumber": str(number),
        "rotorDragCoefficient": digits(drag),
        "rollingMomentCoefficient": "0",
        "rotorVelocitySlowdownSim": str(SLOWDOWN),
        "motorType": "velocity",
    }


def _link(
    body: ElementTree.Element,
    name: str,
    position: np.ndarray,
    mass: float,
    inertia: np.ndarray,
    size: float,
) -> None:
    link = Element(body, "link", name=name)
    Element(link, "pose").text = digits(position, np.zeros(3))
    inertial = Element(link, "inertial")
    Element(inertial, "mass").text = digits(mass)
    tensor = Element(inertial, "inertia")
    for axes, moment in zip(("ixx", "iyy", "izz"), inertia, strict=True):
        Element(tensor, axes).text = digits(moment)
    for axes in ("ixy", "ixz", "iyz"):
        Element(tensor, axes).text = "0"
    visual = Element(link, "visual", name=f"{name}_visual")
    cylinder = Element(Element(visual, "geometry"), "cylinder")
    Element(cylinder, "radius").text, Element(cylinder, "length").text = (
        digits(size),
        digits(size / 5),
    )


FORMAT = DroneFormat(
    ".sdf",
    nearest_sdf,
    write_sdf,
    ("Commands are rotor speeds [rad/s]: front right, back right, back left, front left.",),
    needs_speed=True,
)
