"""A stand-in for a firmware at a plant: estimator, the simulated PID, battery compensation.

As a program it flies by its standard input and output.
"""

import struct
import sys
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from maidenflight.simulator.controllers import firmware
from maidenflight.simulator.controllers.control import NOTHING
from maidenflight.simulator.controllers.firmware import ABSOLUTE, DISABLE, VELOCITY, StateEstimate
from maidenflight.simulator.physics import battery, rotations
from maidenflight_plant.running_plant import SIZE

STRUCTURES = ("position", "pwm", "attitude", "attitude_rate")
MODES = {
    "position": (ABSOLUTE, ABSOLUTE, ABSOLUTE, DISABLE, DISABLE, ABSOLUTE),
    "pwm": (ABSOLUTE, ABSOLUTE, ABSOLUTE, DISABLE, DISABLE, ABSOLUTE),
    "attitude": (DISABLE, DISABLE, DISABLE, ABSOLUTE, ABSOLUTE, ABSOLUTE),
    "attitude_rate": (DISABLE, DISABLE, DISABLE, VELOCITY, VELOCITY, VELOCITY),
}
SUPPLY = battery.Supply(battery.PLUS, 65535.0, battery=True)
HOVER = 36000.0
CLIMB = 2.0
SENSORS = struct.Struct(f"<II{SIZE}f")


class Mind(NamedTuple):
    memory: firmware.Memory
    position: jax.Array
    velocity: jax.Array


def reference(time):
    """From the floor to 1 m, then a circle of 0.25 m in 3 s."""
    angle = 2 * jnp.pi * jnp.maximum(time - CLIMB, 0.0) / 3.0
    height = jnp.minimum(time / CLIMB, 1.0)
    return jnp.stack([0.25 * (1 - jnp.cos(angle)), 0.25 * jnp.sin(angle), height])


def setpoint(structure, goal, estimate):
    """What a policy of a structure would ask for: PD control of the position."""
    wanted = NOTHING._replace(mode=np.array(MODES[structure], np.int32))
    if structure in ("position", "pwm"):
        return wanted._replace(position=goal)
    push = 6.0 * (goal - estimate.position) - 4.0 * estimate.velocity
    tilt = jnp.clip(jnp.degrees(jnp.stack([-push[1], push[0], 0.0]) / 9.81), -20.0, 20.0)
    thrust = jnp.clip(HOVER * (1 + push[2] / 9.81), 10000.0, 60000.0)
    rates = 6.0 * (tilt - estimate.attitude)
    return wanted._replace(attitude=tilt, body_rates=rates, thrust=thrust)


def tick(structure, mind, seen, number, fresh):
    """Two milliseconds of the firmware, and four motors' PWM."""
    gyro, force, position, quaternion, volts = (
        seen[:3],
        seen[3:6],
        seen[6:9],
        seen[9:13],
        seen[16],
    )
    axes = jnp.stack([jnp.stack(axis) for axis in rotations.axes(quaternion)])
    pull = (force[:, None] * axes).sum(axis=0).at[2].add(-9.81)
    here, speed = mind.position + 0.002 * mind.velocity, mind.velocity + 0.002 * pull
    off = jnp.where(fresh > 0, position - here, 0.0)
    here, speed = here + 0.2 * off, speed + 2.0 * off
    estimate = StateEstimate(
        here, speed, jnp.degrees(rotations.to_attitude(quaternion)), jnp.degrees(gyro)
    )
    wanted = setpoint(structure, reference(number.astype(jnp.float32) * 0.001), estimate)
    memory, motors = firmware.tick(mind.memory, wanted, estimate, "2026.08", number % 10 == 0, True)
    if structure == "pwm":  # Forces of single motors end at full scale before compensation.
        motors = jnp.minimum(motors, 65535.0)
    ratio = battery.motor_ratio(motors / 65535.0, volts, SUPPLY)
    return Mind(memory, here, speed), 65535.0 * ratio + 1.0


class Firmware:
    """Answers one message after the other."""

    def __init__(self, structure):
        none = jnp.zeros(3)
        first: Any = Mind(firmware.switched_on(), none, none)
        first = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), first)
        self.mind, whole = ravel_pytree(first)

        @jax.jit
        def compiled(mind, seen, number, fresh):
            mind = whole(mind)
            mode = mind.memory.mode.astype(jnp.int32)
            mind = mind._replace(memory=mind.memory._replace(mode=mode))
            after, pwm = tick(structure, mind, seen, number, fresh)
            after: Any = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), after)
            return ravel_pytree(after)[0], pwm

        self.compiled = compiled
        self.path = []
        self.pwm = [0, 0, 0, 0]

    def answer(self, message):
        number, fresh, *_ = SENSORS.unpack(message)
        seen = np.frombuffer(message, "<f4", SIZE, 8)
        if number % 2 == 0:  # As the firmware's attitude and rate PIDs.
            self.mind, pwm = self.compiled(self.mind, seen, np.int32(number), np.int32(fresh))
            self.pwm = np.asarray(pwm).astype(int).tolist()
        self.path.append(seen[6:9])
        return struct.pack("<I4H", number, *self.pwm)

    def error(self):
        """Largest distance from the circle from a second after it began [m]."""
        x, y, z = np.array(self.path)[3000:].T
        return float(np.hypot(np.hypot(x - 0.25, y) - 0.25, z - 1.0).max())


def main():
    pilot = Firmware(sys.argv[1])
    while message := sys.stdin.buffer.read(SENSORS.size):
        sys.stdout.buffer.write(pilot.answer(message))
        sys.stdout.buffer.flush()
    print(pilot.error(), file=sys.stderr)


if __name__ == "__main__":
    main()
