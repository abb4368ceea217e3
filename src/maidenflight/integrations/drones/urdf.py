"""URDF of gym-pybullet-drones: a body with four propellers, and the element `properties`.

Its rotors follow commands at once, and thrust is kf rpm^2 for all. Drag acts in proportion to the
rotor speeds, in `Physics.PYB_DRAG` and `PYB_GND_DRAG_DW`; it is right at hover, and alike along x
and y. Down-wash is not known of a drone and off.

Source: gym-pybullet-drones 2.1, envs/BaseAviary.py (_parseURDFParameters, _physics, _drag,
_groundEffect) and assets/cf2x.urdf.
"""

from xml.etree import ElementTree

import numpy as np

from maidenflight.deployment.drone_format import (
    RPM,
    DroneFormat,
    DroneModel,
    digits,
    simplest,
    xml_comment,
)
from maidenflight.parameters import QUANTITIES, Parameters, arm_length, replace, rotors

GROUND_EFFECT = 11.36859
"""gnd_eff_coeff in assets/cf2x.urdf, the source; the propeller's radius follows from ours."""
DOWNWASH = {"dw_coeff_1": "0", "dw_coeff_2": "0.16", "dw_coeff_3": "-0.11"}
"""Off: the first is the strength."""
FASTEST_KM_H = 30.0
"""max_speed_kmh in assets/cf2x.urdf, the source; it scales velocity commands."""


def nearest_urdf(drone: Parameters) -> Parameters:
    """Returns the drone that it simulates: no lag, and drag alike along x and y."""
    flat, high = float(np.mean(np.asarray(drone.drag)[:2])), float(drone.drag[2])
    return replace(
        simplest(drone),
        motor_time_constant=np.float32(QUANTITIES["motor_time_constant"].lower),
        drag=np.array([flat, flat, high], np.float32),
        ground_effect=drone.ground_effect,
    )


def write_urdf(model: DroneModel) -> str:
    """Returns the URDF; propellers that turn clockwise are the second and the fourth."""
    drone, rpm = model.drone, model.square_speed * RPM
    thrust = float(drone.mass * drone.gravity * drone.thrust_to_weight) / 4 / rpm**2
    drag = np.asarray(drone.drag, np.float64) * float(drone.mass) / (4 * model.hover_speed)
    radius = 4.0 * float(np.sqrt(float(drone.ground_effect) / GROUND_EFFECT))
    root = ElementTree.Element("robot", name=model.name)
    properties = {
        "arm": digits(arm_length(drone)),
        "kf": digits(thrust),
        "km": digits(thrust * float(drone.torque_to_thrust)),
        "thrust2weight": digits(drone.thrust_to_weight),
        "max_speed_kmh": digits(FASTEST_KM_H),
        "gnd_eff_coeff": digits(GROUND_EFFECT),
        "prop_radius": digits(radius),
        "drag_coeff_xy": digits(drag[0]),
        "drag_coeff_z": digits(drag[2]),
        **DOWNWASH,
    }
    ElementTree.SubElement(root, "properties", properties)
    base = _link(root, "base_link", np.zeros(3), float(drone.mass), np.asarray(drone.inertia))
    size = {"radius": digits(arm_length(drone) * 1.5), "length": digits(arm_length(drone) * 0.6)}
    # Its reader takes the shape from the third part of the first link.
    for part in ("visual", "collision"):
        shape = ElementTree.SubElement(base, part)
        ElementTree.SubElement(shape, "origin", rpy="0 0 0", xyz="0 0 0")
        geometry = ElementTree.SubElement(shape, "geometry")
        ElementTree.SubElement(geometry, "cylinder", size)
    places = rotors(drone)[order(drone)]
    links = [(f"prop{number}", position) for number, position in enumerate(places)]
    for name, position in [*links, ("center_of_mass", np.zeros(3))]:
        _link(root, f"{name}_link", position, 0.0, np.zeros(3))
        joint = ElementTree.SubElement(root, "joint", name=f"{name}_joint", type="fixed")
        ElementTree.SubElement(joint, "parent", link="base_link")
        ElementTree.SubElement(joint, "child", link=f"{name}_link")
    ElementTree.indent(root)
    numbers = ", ".join(str(rotor + 1) for rotor in order(drone))
    lines = [*model.comments(), f"prop0 to prop3 are our rotors {numbers}."]
    text = ElementTree.tostring(root, encoding="unicode")
    return '<?xml version="1.0" ?>\n' + xml_comment(lines) + text + "\n"


def order(drone: Parameters) -> list[int]:
    """Returns our rotors in the order of its propellers, of which the first turns the body right.

    They go round as ours do, so that neighbours turn opposite ways in both.
    """
    first = int(np.argmin(np.asarray(drone.rotor_direction)))
    return [(first + number) % 4 for number in range(4)]


def _link(
    root: ElementTree.Element, name: str, position: np.ndarray, mass: float, inertia: np.ndarray
) -> ElementTree.Element:
    link = ElementTree.SubElement(root, "link", name=name)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", rpy="0 0 0", xyz=digits(position))
    ElementTree.SubElement(inertial, "mass", value=digits(mass))
    moments: dict[str, str] = dict.fromkeys(("ixy", "ixz", "iyz"), "0")
    moments.update(zip(("ixx", "iyy", "izz"), map(digits, inertia), strict=True))
    ElementTree.SubElement(inertial, "inertia", moments)
    return link


FORMAT = DroneFormat(".urdf", nearest_urdf, write_urdf, needs_speed=True)
