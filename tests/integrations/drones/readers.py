"""Programs that read a drone's file, each with one manoeuvre: rotors at one thrust, then another.

Where the program is on PyPI it flies itself, and the test skips without it. Gazebo and Isaac Lab
are not: there a reader accepts just the documented names, and steps what the documentation says.
"""

import ast
import importlib
import json
import math
import os
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

SECONDS = 0.5


class Flown(NamedTuple):
    """Where a drone is after `SECONDS`."""

    position: np.ndarray
    velocity: np.ndarray
    quaternion: np.ndarray
    """x, y, z, w."""
    body_rates: np.ndarray


Reader = Callable[[str, np.ndarray, np.ndarray, Path], Flown]
"""Of a text, thrusts [N] of the rotors before and from the start on, and a folder."""


class Body:
    """A rigid body at rest, stepped under a force and a torque in body axes by midpoints."""

    def __init__(self, mass: float, inertia: np.ndarray, gravity: float) -> None:
        self.mass, self.inertia, self.gravity = mass, inertia, gravity
        self.position, self.velocity, self.rates = (np.zeros(3) for _ in range(3))
        self.attitude = Rotation.identity()

    def step(self, force: np.ndarray, torque: np.ndarray, seconds: float) -> None:
        turning = (torque - np.cross(self.rates, self.inertia * self.rates)) / self.inertia
        rates = self.rates + seconds / 2 * turning
        halfway = self.attitude * Rotation.from_rotvec(seconds / 2 * rates)
        pull = halfway.apply(force) / self.mass - [0.0, 0.0, self.gravity]
        self.position = self.position + seconds * (self.velocity + seconds / 2 * pull)
        self.velocity = self.velocity + seconds * pull
        self.attitude = self.attitude * Rotation.from_rotvec(seconds * rates)
        self.rates = self.rates + seconds * turning

    def flown(self) -> Flown:
        return Flown(self.position, self.velocity, self.attitude.as_quat(), self.rates)


def mujoco(text: str, before: np.ndarray, after: np.ndarray, folder: Path) -> Flown:
    """MuJoCo itself, its delays filled with what was commanded before."""
    mujoco: Any = pytest.importorskip("mujoco", reason="not installed (extra [mujoco])")
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    for motor in range(4):
        count = int(model.actuator_history[motor][0])
        if count:
            times = model.opt.timestep * np.arange(-count, 0.0)
            mujoco.mj_initCtrlHistory(model, data, motor, times, np.full(count, before[motor]))
    data.act[:], data.ctrl[:] = before, after
    for _ in range(round(SECONDS / model.opt.timestep)):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    position, wxyz, velocity, rates = (
        np.array(data.sensor(name).data)
        for name in ("position", "quaternion_wxyz", "body_velocity", "body_rates")
    )
    quaternion = np.roll(wxyz, -1)
    return Flown(position, Rotation.from_quat(quaternion).apply(velocity), quaternion, rates)


def gym_pybullet_drones(text: str, before: np.ndarray, after: np.ndarray, folder: Path) -> Flown:
    """PyBullet, under the forces that gym-pybullet-drones applies with `PYB_GND_DRAG`.

    Attributes are found as `BaseAviary._parseURDFParameters` finds them, by their places. Its
    drones keep Bullet's damping of 4 % a second, which is no part of the file and off here.
    """
    bullet: Any = pytest.importorskip("pybullet", reason="not installed (extra [pybullet])")
    path = folder / "drone.urdf"
    path.write_text(text)
    tree = ElementTree.parse(path).getroot()
    properties = {name: float(value) for name, value in tree[0].attrib.items()}
    mass = float(tree[1][0][1].attrib["value"])
    assert {"arm", "max_speed_kmh", "gnd_eff_coeff", "prop_radius"} <= properties.keys()
    assert {"dw_coeff_1", "dw_coeff_2", "dw_coeff_3"} <= properties.keys()
    assert float(tree[1][2][1][0].attrib["length"]) > 0.0
    assert float(tree[1][2][1][0].attrib["radius"]) > 0.0
    (rotors,) = re.findall(r"prop0 to prop3 are our rotors (\d), (\d), (\d), (\d)", text)
    rpm = np.sqrt(after[[int(rotor) - 1 for rotor in rotors]] / properties["kf"])
    largest = math.sqrt(properties["thrust2weight"] * 9.81 * mass / (4 * properties["kf"]))
    assert rpm.max() <= largest * (1 + 1e-6)
    client = bullet.connect(bullet.DIRECT)
    world = {"physicsClientId": client}
    try:
        bullet.setGravity(0, 0, -9.81, **world)
        bullet.setTimeStep(1e-3, **world)
        flags = bullet.URDF_USE_INERTIA_FROM_FILE
        body = bullet.loadURDF(str(path), [0, 0, 0], flags=flags, **world)
        for link in range(-1, bullet.getNumJoints(body, **world)):
            bullet.changeDynamics(body, link, linearDamping=0, angularDamping=0, **world)
        torques = properties["km"] * rpm**2
        yaw = float(-torques[0] + torques[1] - torques[2] + torques[3])
        coefficients = np.array([properties[f"drag_coeff_{axes}"] for axes in ("xy", "xy", "z")])
        for _ in range(round(SECONDS / 1e-3)):
            turned = Rotation.from_quat(bullet.getBasePositionAndOrientation(body, **world)[1])
            moving = np.array(bullet.getBaseVelocity(body, **world)[0])
            drag = turned.inv().apply(-coefficients * np.sum(2 * np.pi * rpm / 60) * moving)
            pushes = [(link, [0, 0, force]) for link, force in enumerate(rpm**2 * properties["kf"])]
            for link, force in [*pushes, (4, drag.tolist())]:
                bullet.applyExternalForce(body, link, force, [0, 0, 0], bullet.LINK_FRAME, **world)
            bullet.applyExternalTorque(body, 4, [0, 0, yaw], bullet.LINK_FRAME, **world)
            bullet.stepSimulation(**world)
        position, quaternion = bullet.getBasePositionAndOrientation(body, **world)
        velocity, rates = bullet.getBaseVelocity(body, **world)
    finally:
        bullet.disconnect(client)
    body_rates = Rotation.from_quat(quaternion).inv().apply(rates)
    return Flown(np.array(position), np.array(velocity), np.array(quaternion), body_rates)


MOTOR_MODEL = {
    "robotNamespace",
    "jointName",
    "linkName",
    "turningDirection",
    "timeConstantUp",
    "timeConstantDown",
    "maxRotVelocity",
    "motorConstant",
    "momentConstant",
    "commandSubTopic",
    "motorNumber",
    "rotorDragCoefficient",
    "rollingMomentCoefficient",
    "rotorVelocitySlowdownSim",
    "motorType",
}
"""Parameters that Gazebo's `MulticopterMotorModel` documents."""


def gazebo(text: str, before: np.ndarray, after: np.ndarray, folder: Path) -> Flown:
    """What Gazebo's motor model documents, of links put together to one body."""
    (model,) = ElementTree.fromstring(text)
    links = {one.attrib["name"]: one for one in model.findall("link")}

    def number(element: ElementTree.Element, path: str) -> float:
        found = element.find(path)
        assert found is not None, path
        return float(str(found.text))

    places = {
        name: np.array(str(one.findtext("pose")).split(), float)[:3] for name, one in links.items()
    }
    mass = sum(number(one, "inertial/mass") for one in links.values())
    inertia = np.zeros(3)
    for name, one in links.items():
        x, y, z = places[name]
        away = number(one, "inertial/mass") * np.array([y**2 + z**2, x**2 + z**2, x**2 + y**2])
        inertia += away + [
            number(one, f"inertial/inertia/{axis}") for axis in ("ixx", "iyy", "izz")
        ]
    motors = []
    for plugin in model.findall("plugin"):
        assert plugin.attrib["filename"] == "gz-sim-multicopter-motor-model-system"
        assert plugin.attrib["name"] == "gz::sim::systems::MulticopterMotorModel"
        told = {one.tag: str(one.text) for one in plugin}
        assert told.keys() == MOTOR_MODEL
        assert told["motorType"] == "velocity"
        joint = model.find(f"joint[@name='{told['jointName']}']")
        assert joint is not None
        assert joint.findtext("child") == told["linkName"]
        assert joint.findtext("parent") == "base_link"
        motors.append(told)
    assert [int(one["motorNumber"]) for one in motors] == [0, 1, 2, 3]
    column = {
        key: np.array([float(one[key]) for one in motors])
        for key in MOTOR_MODEL
        if (key.endswith(("Constant", "Up", "Down", "Coefficient", "Velocity")))
    }
    sign = np.array([{"ccw": 1.0, "cw": -1.0}[one["turningDirection"]] for one in motors])
    speed = np.sqrt(before / column["motorConstant"])
    command = np.minimum(np.sqrt(after / column["motorConstant"]), column["maxRotVelocity"] + 1e-6)
    arms = np.array([places[one["linkName"]] for one in motors])
    body, step = Body(mass, inertia, 9.81), 1e-3
    for _ in range(round(SECONDS / step)):
        lag = np.where(command > speed, column["timeConstantUp"], column["timeConstantDown"])
        after_step = command + (speed - command) * np.exp(-step / lag)
        middle, speed = (speed + after_step) / 2, after_step
        thrust = column["motorConstant"] * middle**2
        moving = body.attitude.inv().apply(body.velocity) + np.cross(body.rates, arms)
        force = -(middle * column["rotorDragCoefficient"])[:, None] * moving * [1, 1, 0]
        force[:, 2] = thrust
        torque = np.cross(arms, force).sum(axis=0)
        torque[2] -= np.sum(sign * thrust * column["momentConstant"])
        body.step(force.sum(axis=0), torque, step)
    return body.flown()


def rotorpy(text: str, before: np.ndarray, after: np.ndarray, folder: Path) -> Flown:
    """RotorPy itself, with its aerodynamics."""
    pytest.importorskip("rotorpy", reason="not on this machine: pip install rotorpy")
    multirotor: Any = importlib.import_module("rotorpy.vehicles.multirotor")
    names: dict[str, Any] = {}
    exec(text, names)  # what RotorPy imports
    settings = names["quad_params"]
    state = {
        "x": np.zeros(3),
        "v": np.zeros(3),
        "q": np.array([0.0, 0.0, 0.0, 1.0]),
        "w": np.zeros(3),
        "wind": np.zeros(3),
        "rotor_speeds": np.sqrt(before / settings["k_eta"]),
    }
    exact = {"method": "RK45", "rtol": 1e-8, "atol": 1e-10}
    vehicle = multirotor.Multirotor(settings, dict(state), integrator_kwargs=exact)
    command = {"cmd_motor_speeds": np.sqrt(after / settings["k_eta"])}
    for _ in range(round(SECONDS / 0.01)):
        state = vehicle.step(state, command, 0.01)
    return Flown(state["x"], state["v"], state["q"], state["w"])


def crazyflow(text: str, before: np.ndarray, after: np.ndarray, folder: Path) -> Flown:
    """crazyflow's own dynamics, with the section in place of one of its params.toml."""
    if os.environ.get("SCIPY_ARRAY_API") != "1":
        pytest.skip("crazyflow needs SCIPY_ARRAY_API=1 before SciPy is first imported")
    pytest.importorskip("crazyflow", reason="not installed (extra [crazyflow])")
    physics: Any = importlib.import_module("crazyflow.dynamics.first_principles")
    ((_, section),) = tomllib.loads(text).items()
    arrays = {name: np.asarray(value, np.float64) for name, value in section.items()}
    largest, _ = arrays.pop("thrust_max"), arrays.pop("thrust_min")
    assert after.max() <= largest * (1 + 1e-6)
    arrays |= {"gravity_vec": np.array([0, 0, -9.81]), "J_inv": np.linalg.inv(arrays["J"])}
    curves = np.broadcast_to(np.atleast_2d(arrays["rpm2thrust"]), (4, 3))

    def speeds(thrust: np.ndarray) -> np.ndarray:
        offset, linear, square = curves.T
        root = np.sqrt(linear**2 + 4 * square * np.maximum(thrust - offset, 0.0))
        return (root - linear) / (2 * square)

    body = Body(float(arrays["mass"]), np.diag(arrays["J"]), 0.0)
    rotor, command, step = speeds(before), speeds(after), 5e-4

    def changes(rotor: np.ndarray) -> tuple[np.ndarray, ...]:
        return physics.dynamics(
            body.position,
            body.attitude.as_quat(),
            body.velocity,
            body.rates,
            command,
            rotor,
            **arrays,
        )

    for _ in range(round(SECONDS / step)):
        middle = rotor + step / 2 * changes(rotor)[4]
        _, _, acceleration, turning, spin = changes(middle)
        rates = body.rates + step / 2 * turning
        body.position = body.position + step * (body.velocity + step / 2 * acceleration)
        body.velocity = body.velocity + step * acceleration
        body.attitude = body.attitude * Rotation.from_rotvec(step * rates)
        body.rates, rotor = body.rates + step * turning, rotor + step * spin
    return body.flown()


class ThrusterCfg:
    """The fields that Isaac Lab documents, and no others."""

    REQUIRED = (
        *("dt", "thrust_range", "thrust_const_range", "tau_inc_range", "tau_dec_range"),
        *("torque_to_thrust_ratio", "thruster_names_expr"),
    )
    OPTIONAL = ("max_thrust_rate", "use_discrete_approximation", "integration_scheme")

    def __init__(self, **fields: Any) -> None:
        assert set(self.REQUIRED) <= fields.keys()
        assert fields.keys() <= {*self.REQUIRED, *self.OPTIONAL}
        for name, value in fields.items():
            assert not name.endswith("_range") or (len(value) == 2 and value[0] <= value[1])
        vars(self).update(fields)


def isaac_module(text: str) -> dict[str, Any]:
    """What the module defines; of Isaac Lab it may import its thruster alone."""
    tree = ast.parse(text)
    imports = [one for one in tree.body if isinstance(one, ast.Import | ast.ImportFrom)]
    assert [ast.unparse(one) for one in imports] == [
        "from isaaclab_contrib.actuators import ThrusterCfg"
    ]
    tree.body = [one for one in tree.body if one not in imports]
    names: dict[str, Any] = {"ThrusterCfg": ThrusterCfg}
    exec(compile(tree, "drone.py", "exec"), names)
    return names


def isaac_lab(text: str, before: np.ndarray, after: np.ndarray, folder: Path) -> Flown:
    """What Isaac Lab's thruster documents: Euler steps of rotor speed, in the time of its rate."""
    names = isaac_module(text)
    cfg: Any = names["THRUSTER"]
    constant, (up, _), (down, _) = cfg.thrust_const_range[0], cfg.tau_inc_range, cfg.tau_dec_range
    assert not cfg.use_discrete_approximation
    assert cfg.integration_scheme == "euler"
    wrenches = np.array(names["ALLOCATION_MATRIX"])
    np.testing.assert_allclose(
        np.abs(wrenches[5]), cfg.torque_to_thrust_ratio * np.ones(4), rtol=1e-6
    )
    body = Body(names["MASS"], np.array(names["DIAGONAL_INERTIA"]), 9.81)
    thrust, wanted, step = before, np.clip(after, *cfg.thrust_range), 1e-3
    for _ in range(round(SECONDS / step)):
        speed, goal = np.sqrt(thrust / constant), np.sqrt(wanted / constant)
        lag = np.where(wanted < thrust, down, up)
        new = constant * (speed + (goal - speed) * step / lag) ** 2
        wrench = wrenches @ ((thrust + new) / 2)
        thrust = new
        body.step(wrench[:3], wrench[3:], step)
    return body.flown()


def l2f(text: str, before: np.ndarray, after: np.ndarray, folder: Path) -> Flown:
    """l2f itself, with the object `dynamics` in place of its own."""
    l2f: Any = pytest.importorskip("l2f", reason="not installed (extra [l2f]; pip compiles it)")
    device, environment, random = l2f.Device(), l2f.Environment(), l2f.Rng()
    l2f.initialize_rng(device, random, 0)
    l2f.initialize_environment(device, environment)
    settings, state, later = l2f.Parameters(), l2f.State(), l2f.State()
    l2f.initial_parameters(device, environment, settings)
    content = json.loads(l2f.parameters_to_json(device, environment, settings))
    dynamics = json.loads(text)["dynamics"]
    assert dynamics.keys() <= content["dynamics"].keys()
    content["dynamics"] |= dynamics
    content["integration"]["dt"] = 1e-3
    l2f.parameters_from_json(device, environment, json.dumps(content), settings)
    offset, linear, square = np.array(dynamics["rotor_thrust_coefficients"]).T

    def speeds(thrust: np.ndarray) -> np.ndarray:
        root = np.sqrt(linear**2 + 4 * square * np.maximum(thrust - offset, 0.0))
        return (root - linear) / (2 * square)

    l2f.initial_state(device, environment, settings, state)
    state.position, state.orientation = [0.0] * 3, [1.0, 0.0, 0.0, 0.0]
    state.linear_velocity, state.angular_velocity = [0.0] * 3, [0.0] * 3
    state.rpm = speeds(before).tolist()
    action = (2.0 * speeds(after) - 1.0).tolist()
    for _ in range(round(SECONDS / 1e-3)):
        l2f.step(device, environment, settings, state, action, later, random)
        state.assign(later)
    parts: Any = state.position, state.linear_velocity, np.roll(state.orientation, -1)
    position, velocity, quaternion = map(np.array, parts)
    return Flown(position, velocity, quaternion, np.array(state.angular_velocity))


READERS: dict[str, Reader] = {
    "mjcf": mujoco,
    "urdf": gym_pybullet_drones,
    "sdf": gazebo,
    "rotorpy": rotorpy,
    "crazyflow": crazyflow,
    "isaac-lab": isaac_lab,
    "l2f": l2f,
}
