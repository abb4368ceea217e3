"""The exported app flies a simulated drone: plant, estimator, the firmware's PID and the app."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from app_in_firmware import LEGACY, App, built, hovering
from jax.flatten_util import ravel_pytree

from flying_policy import flying_policy
from maidenflight.parameters import replace
from maidenflight.simulator.controllers import firmware
from maidenflight.simulator.controllers.control import NOTHING
from maidenflight.simulator.controllers.firmware import ABSOLUTE, DISABLE
from maidenflight.simulator.physics import battery, dynamics, rotations
from maidenflight.simulator.realities.virtual_drone import VirtualDrone, virtual_drone
from maidenflight_plant.running_plant import POSE_EVERY, RunningPlant

CLIMB_S, ENABLED_S, GRAVITY = 1.0, 1.7, 9.80665
SUPPLY = battery.Supply(battery.PLUS, 65535.0, battery=True)
MODES = (ABSOLUTE, ABSOLUTE, ABSOLUTE, DISABLE, DISABLE, ABSOLUTE)

Fault = Callable[["Loop", float], None]


class Pid:
    """The simulated PID of firmware 2026.08, compiled once for all flights."""

    def __init__(self) -> None:
        first = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), firmware.switched_on())
        self.first, whole = ravel_pytree(first)

        @jax.jit
        def tick(memory: Any, seen: Any, number: Any) -> tuple[Any, Any]:
            known: Any = whole(memory)
            known = known._replace(mode=known.mode.astype(jnp.int32))
            state = firmware.StateEstimate(
                seen[:3],
                seen[3:6],
                jnp.degrees(rotations.to_attitude(seen[6:10])),
                jnp.degrees(seen[10:13]),
            )
            wanted = NOTHING._replace(position=seen[13:16], mode=np.array(MODES, np.int32))
            after, motors = firmware.tick(known, wanted, state, "2026.08", number % 10 == 0, True)
            return ravel_pytree(jax.tree.map(lambda leaf: leaf.astype(jnp.float32), after))[
                0
            ], motors

        self.tick = tick


class Loop:
    """One flight of a virtual drone, a millisecond at a time.

    A fault changes what the loop holds: `offset` is added to the measured position [m], `sag` taken
    from the voltage [V], `wanted` is where the ground sends the drone [m].
    """

    def __init__(self, app: App, plant: RunningPlant, pid: Pid) -> None:
        self.app, self.plant, self.pid = app, plant, pid
        self.memory, self.motors = pid.first, np.zeros(4, np.float32)
        self.position, self.velocity = np.zeros(3), np.zeros(3)
        self.volts = float(plant.readings[16])
        self.offset, self.leapt, self.sag = np.zeros(3), False, 0.0
        self.wanted = np.array([0.0, 0.0, 0.0])
        self.row = hovering(1)

    def estimate(self) -> None:
        """Position and velocity from accelerometer and pose, as the Kalman filter finds them."""
        seen = self.plant.readings.astype(np.float64)
        x, y, z, w = seen[9:13]
        upright = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        self.pull = upright @ seen[3:6] - [0, 0, GRAVITY]
        self.position += 0.001 * self.velocity
        self.velocity += 0.001 * self.pull
        if self.plant.number % POSE_EVERY == 0:
            off = seen[6:9] + self.offset - self.position
            self.position += 0.2 * off
            self.velocity += 2.0 * off

    def step(self) -> None:
        """A millisecond."""
        self.estimate()
        seen, row, number = self.plant.readings, self.row, self.plant.number
        if number % 2 == 0:
            given = np.concatenate(
                [self.position, self.velocity, seen[9:13], seen[:3], self.wanted], dtype=np.float32
            )
            self.memory, motors = self.pid.tick(self.memory, given, np.int32(number))
            self.motors = np.asarray(motors)
        row["position"], row["velocity"] = self.position, self.velocity
        row["quaternion"], row["gyro"] = seen[9:13], np.degrees(seen[:3])
        row["wanted"], row["thrust"] = self.wanted, self.motors.mean()
        row["acceleration"] = self.pull / GRAVITY
        row["battery"] = seen[16] - self.sag
        self.volts += 0.01 * (float(seen[16]) - self.volts)  # firmware, stabilizer.c
        (found,) = self.app.fly(row)
        counts = self.motors
        if found["mode"] != LEGACY:
            counts = 65535.0 * np.maximum(found["forces"], 0.0)
        share = counts.astype(np.float32) / np.float32(65535.0)
        ratio = battery.motor_ratio(share, np.array(self.volts, np.float32), SUPPLY)
        self.plant.step(65535.0 * ratio + 1.0)

    def fly(self, seconds: float, fault: Fault = lambda loop, time: None) -> float:
        """Takes off, hands over and flies; returns when the policy's flight ended [s].

        Time counts from the hand-over.

        Args:
            seconds: longest flight of the policy.
            fault: called before each step from then on.
        """
        while (time := self.plant.number / 1000 - ENABLED_S) < seconds:
            if time < 0.0:
                self.wanted[2] = min(self.plant.number / 1000 / CLIMB_S, 1.0)
            if time == 0.0:
                self.app.set(x=self.position[0], y=self.position[1], enable=1)
            if time >= 0.0:
                fault(self, time)
            self.step()
            if time > 0.02 and not self.app.log("active"):
                return time
        return seconds


def sprightly(seed: int) -> VirtualDrone:
    """A virtual drone with motors as quick as the linear policy of `flying_policy` needs."""
    drone = virtual_drone(seed, "near", thrust_law=battery.PLUS)
    quick = {"motor_time_constant": np.float32(0.02), "latency": np.float32(0.002)}
    return dataclasses.replace(drone, parameters=replace(drone.parameters, **quick))


def app_for(drone: VirtualDrone, folder: Path) -> App:
    """The app of a linear policy that holds a drone, built."""
    hover = float(dynamics.hover_command(drone.parameters))
    app = App(built(flying_policy(drone.parameters), folder, hover=hover))
    app.set(task=2)
    return app
