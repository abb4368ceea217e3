"""A reality in plain NumPy, the quadrotor of the paper by RK4 at 1 kHz, and the same one in JAX."""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from maidenflight.parameters import crazyflie, noiseless, replace
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.realities.reality import MOTORS, Truth
from maidenflight.simulator.realities.virtual_drone import VirtualDrone
from numpy_reference import PAPER, rk4

STEP = 0.001
TWIN = VirtualDrone(
    "jax",
    replace(noiseless(crazyflie()), time_step=STEP, latency=0.008),
    thrust_law=None,
)
"""The same drone in JAX."""


@dataclass
class NumpyDrone:
    """State as in `numpy_reference`: r, v, q (w, x, y, z), omega, nu."""

    name: str = "numpy"
    rate: int = 500
    takes: str = MOTORS
    latency_steps: int = 8
    constants: dict[str, Any] = field(default_factory=lambda: PAPER)
    resets: list[int] = field(default_factory=list)

    @property
    def hover(self) -> float:
        return 1 / self.constants["k_F"]

    def reset(self, position: Any, seed: int) -> None:
        level, none, speed = np.array([1.0, 0, 0, 0]), np.zeros(3), np.sqrt(self.hover)
        self.state = [np.array(position), none, level, none, np.full(4, speed)]
        self.line = deque([np.full(4, self.hover)] * (self.latency_steps + 1))
        self.commands = 0
        self.resets.append(seed)
        self._estimate()

    def step(self, command: Any) -> None:
        for _ in range(round(1 / self.rate / STEP)):
            self.line.append(np.array(command))
            self.line.popleft()
            self.state = rk4(self.state, np.sqrt(self.line[0]), self.constants, STEP)
        self.commands += 1
        if self.commands % (self.rate // 100) == 0:
            self._estimate()

    def _estimate(self) -> None:
        """Position, velocity and attitude are estimated at 100 Hz, as on a Crazyflie."""
        position, velocity, quaternion, *_ = self.state
        self.estimate = position, velocity, np.roll(quaternion, -1)

    def observe(self) -> Measurement:
        return Measurement(*self.estimate, self.state[3])

    def truth(self) -> Truth:
        return Truth(self.state[0], np.roll(self.state[2], -1), self.state[3], self.line[-1])
