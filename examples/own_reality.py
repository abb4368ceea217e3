"""A reality of your own: a quadrotor in NumPy, one command at a time.

In Python by `python examples/own_reality.py`; on the command line, in this folder, by
`maidenflight transfer policies --reality own_reality:Mine`.
"""

import jax
import numpy as np
from scipy.spatial.transform import Rotation

import maidenflight as mf


class Mine:
    """Flies like a Crazyflie."""

    name, rate, takes, hover = "mine", 500, "pwm", 0.55

    def reset(self, position, seed):
        """Begins a flight, level and at rest."""
        self.position, self.velocity, self.rates = np.array(position), np.zeros(3), np.zeros(3)
        self.attitude = Rotation.identity()
        self.thrust = self.command = np.full(4, self.hover)

    def step(self, command):
        """Holds four thrust commands for a period; motors lag by 50 ms."""
        inertia, dt = np.array([1.4e-5, 1.4e-5, 2.2e-5]), 1 / self.rate
        self.command, self.thrust = command, self.thrust + (command - self.thrust) * dt / 0.05
        f1, f2, f3, f4 = self.thrust / self.hover * 0.028 * 9.81 / 4
        roll, pitch, yaw = -f1 - f2 + f3 + f4, -f1 + f2 + f3 - f4, -f1 + f2 - f3 + f4
        torque = np.array([0.028 * roll, 0.028 * pitch, 0.006 * yaw])
        self.rates += dt * (torque - np.cross(self.rates, inertia * self.rates)) / inertia
        self.attitude = self.attitude * Rotation.from_rotvec(dt * self.rates)
        self.velocity += dt * (
            self.attitude.apply([0, 0, f1 + f2 + f3 + f4]) / 0.028 - [0, 0, 9.81]
        )
        self.position = self.position + dt * self.velocity

    def observe(self):
        """Returns what the sensors say."""
        return mf.simulator.Measurement(
            self.position, self.velocity, self.attitude.as_quat(), self.rates
        )

    def truth(self):
        """Returns the true state."""
        return mf.simulator.Truth(self.position, self.attitude.as_quat(), self.rates, self.command)


if __name__ == "__main__":
    print(mf.record(Mine(), jax.random.key(0), flights=1, duration=4.0)[0])
