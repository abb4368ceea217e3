"""Drones exported to other simulators, flown there, and identified from those flights.

Three drones are drawn about named ones, each parameter within 15 %. Each is written in a
simulator's format, flown there by the firmware's PID with the sensors of a Crazyflie, and
identified from the named drone, with nothing else told but its mass; inertia about z is that of the
named drone, since yaw tells only its ratio to the torque. The truth is the nearest drone that the
format holds. Prints each estimate with its interval, and how many intervals hold it.

    pip install rotorpy && python paper/identification/round_trip.py rotorpy
    SCIPY_ARRAY_API=1 python paper/identification/round_trip.py crazyflow
    python paper/identification/round_trip.py mjcf
"""

import argparse
import importlib
import sys
import tempfile
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
from scipy.spatial.transform import Rotation

import maidenflight as mf
from maidenflight import parameters
from maidenflight.deployment.drone_format import drone_text
from maidenflight.flights import flight_csv
from maidenflight.flights.log import GYRO_DELAY
from maidenflight.flights.reading import read_flights
from maidenflight.flying.recording import record
from maidenflight.identification.identify import identify
from maidenflight.integrations.simulators.mujoco import MuJoCo
from maidenflight.parameters import Parameters, component, replace
from maidenflight.registry import DRONE_FORMATS
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.realities.additions import with_additions
from maidenflight.simulator.realities.reality import MOTORS, Truth

CENTRES = ("crazyflie_2.0", "crazyflie_2.1+", "x500")
DRAWN = (
    *("thrust_to_weight", "motor_time_constant", "torque_to_thrust"),
    *("inertia_x", "inertia_y"),
)
SPREAD = 0.15
FULL_SPEED = 20e3
"""Of all [rpm]: only shares of it matter."""


def drawn_drone(name: str, key: int) -> Parameters:
    """Returns a drone about a named one."""
    random, drone = np.random.default_rng([key, 78]), mf.drone(name)
    changes = {
        name: np.float32(component(drone, name) * random.uniform(1 - SPREAD, 1 + SPREAD))
        for name in DRAWN
    }
    return parameters.check(replace(drone, **changes), name)


class Flown:
    """A drone in another simulator, by the `Reality` protocol; subclasses step it."""

    rate, takes = 500, MOTORS

    def __init__(self, drone: Parameters, to: str) -> None:
        """Writes it in a format; the nearest drone that this holds is what it should fly as."""
        self.name, self.text = f"{to}-drone", drone_text(drone, to, "drone", full_speed=FULL_SPEED)
        self.parameters = DRONE_FORMATS[to].nearest(drone)
        self.hover = float(dynamics.hover_command(self.parameters))
        self.reset(np.zeros(3), 0)

    def reset(self, position: Any, seed: int) -> None:
        """Begins a flight at hover."""
        self.state = {
            "x": np.array(position, float),
            "v": np.zeros(3),
            "q": np.array([0.0, 0.0, 0.0, 1.0]),
            "w": np.zeros(3),
            "wind": np.zeros(3),
            "rotor_speeds": np.full(4, np.sqrt(self.hover)),
        }
        self.command = np.full(4, self.hover)

    def observe(self) -> Measurement:
        """Returns the true state."""
        parts: Any = (self.state[name].copy() for name in "xvqw")
        return Measurement(*parts)

    def truth(self) -> Truth:
        """Returns the true state and the last commands."""
        return Truth(self.state["x"], self.state["q"], self.state["w"], self.command)


class RotorPy(Flown):
    """RotorPy, from its vehicle parameters."""

    def __init__(self, drone: Parameters) -> None:
        """Makes its vehicle."""
        multirotor: Any = importlib.import_module("rotorpy.vehicles.multirotor")
        names: dict[str, Any] = {}
        exec(drone_text(drone, "rotorpy", full_speed=FULL_SPEED), names)
        self.fastest = names["quad_params"]["rotor_speed_max"]
        super().__init__(drone, "rotorpy")
        self.vehicle = multirotor.Multirotor(names["quad_params"], dict(self.state))

    def reset(self, position: Any, seed: int) -> None:
        """Begins a flight at hover."""
        super().reset(position, seed)
        self.state["rotor_speeds"] = self.state["rotor_speeds"] * self.fastest

    def step(self, command: Any) -> None:
        """Holds thrust commands for 2 ms."""
        self.command = np.clip(np.asarray(command, float), 0.0, 1.0)
        speeds = {"cmd_motor_speeds": self.fastest * np.sqrt(self.command)}
        self.state = self.vehicle.step(self.state, speeds, 1 / self.rate)


class Crazyflow(Flown):
    """crazyflow's dynamics, from its section."""

    def __init__(self, drone: Parameters) -> None:
        """Reads the section."""
        module: Any = importlib.import_module("crazyflow.dynamics.first_principles")
        self.dynamics = module.dynamics
        super().__init__(drone, "crazyflow")
        ((_, section),) = tomllib.loads(self.text).items()
        values = {name: np.asarray(value, float) for name, value in section.items()}
        gravity = {"gravity_vec": np.array([0, 0, -9.81]), "J_inv": np.linalg.inv(values["J"])}
        limits = ("thrust_min", "thrust_max")
        self.section = {name: one for name, one in (values | gravity).items() if name not in limits}

    def step(self, command: Any) -> None:
        """Holds thrust commands for 2 ms, by a midpoint step."""
        self.command, step = np.clip(np.asarray(command, float), 0.0, 1.0), 1 / self.rate
        middle = self._moved(self.state, self.state, step / 2)
        self.state = self._moved(self.state, middle, step)

    def _moved(self, start: dict[str, Any], at: dict[str, Any], seconds: float) -> dict[str, Any]:
        """Moves a state by the changes at another."""
        wanted, speed = FULL_SPEED * np.sqrt(self.command), FULL_SPEED * at["rotor_speeds"]
        parts = at["x"], at["q"], at["v"], at["w"], wanted, speed
        velocity, _, acceleration, turning, spin = self.dynamics(*parts, **self.section)
        turned = Rotation.from_quat(start["q"]) * Rotation.from_rotvec(seconds * at["w"])
        return start | {
            "x": start["x"] + seconds * velocity,
            "v": start["v"] + seconds * acceleration,
            "q": turned.as_quat(),
            "w": start["w"] + seconds * turning,
            "rotor_speeds": start["rotor_speeds"] + seconds * spin / FULL_SPEED,
        }


def in_mujoco(drone: Parameters) -> MuJoCo:
    """Returns a drone in MuJoCo, through its file."""
    with tempfile.TemporaryDirectory() as folder:
        return MuJoCo(str(parameters.write_drone(Path(folder, "drone.toml"), drone)))


SIMULATORS: dict[str, Callable[[Parameters], Any]] = {
    "rotorpy": RotorPy,
    "crazyflow": Crazyflow,
    "mjcf": in_mujoco,
}


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("simulator", choices=SIMULATORS)
    parser.add_argument("--flights", type=int, default=3)
    parser.add_argument("--duration", type=float, default=20.0)
    arguments = parser.parse_args()
    inside = total = 0
    for number, centre in enumerate(CENTRES):
        drone = drawn_drone(centre, number)
        reality = SIMULATORS[arguments.simulator](drone)
        settings = {"flights": arguments.flights, "duration": arguments.duration}
        noisy = with_additions(reality, ["sensors"])
        with tempfile.TemporaryDirectory() as folder:
            for place, flight in enumerate(record(noisy, jax.random.key(number), **settings)):
                flight_csv.write(Path(folder, f"flight_{place}.csv"), flight)
            flights = read_flights(folder).flights
        start = parameters.drone(centre, float(drone.mass))
        result = identify(flights, start=start, over="auto", key=jax.random.key(0))
        for name, estimate in result.estimates.items():
            truth, (low, high) = float(component(reality.parameters, name)), estimate.interval
            # The gyro's filter, which the sensors have, shows as latency.
            truth += GYRO_DELAY * (name == "latency")
            holds = low <= truth <= high
            inside, total = inside + holds, total + 1
            numbers = " ".join(f"{value:11.4g}" for value in (truth, estimate.value, low, high))
            print(f"{centre:15} {name:20} {numbers} {'holds' if holds else 'NO'}", flush=True)
    print(f"{arguments.simulator}: {inside} of {total} intervals hold the truth")


if __name__ == "__main__":
    sys.exit(main())
