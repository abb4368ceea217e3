"""`L2F`: quadrotors in l2f, the C++ simulator of Learning to Fly, as realities of its own physics.

l2f is installed from PyPI (extra `l2f`) and imported when first needed; nothing of it is here but
the numbers of its drones. Its package is built with one drone and takes others as JSON, in whose
own output numbers have six decimals, so all that fly here are in full.

World, body and motors have our axes, order and units; its quaternion begins with w, and its motors
are commanded by rotor speed in [-1, 1]: 2 sqrt(u) - 1 of a thrust command u. Each step is one of
Runge-Kutta of fourth order in float32, and so are motors, whose lag differs up and down. It has no
battery, latency, noise or drag, and there is no firmware in front of it.

Source: Eschmann et al. 2024, Learning to Fly in Seconds; l2f 2.0.18, rl_tools' parameters/dynamics.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from maidenflight.errors import InputError, imported
from maidenflight.integrations.drones.l2f import dynamics_of
from maidenflight.parameters import Parameters, crazyflie, h_frame, noiseless, replace
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.realities.reality import MOTORS, Truth

RATE = 500
"""Steps a second [Hz]."""
GRAVITY = 9.81


@dataclass(frozen=True)
class Body:
    """A quadrotor as l2f describes it, SI units; rotors are alike, front right first."""

    mass: float
    inertia: tuple[float, float, float]
    arms: tuple[float, float]
    """Distance of a rotor from the body's y and x axis: along x and along y [m]."""
    thrust: tuple[float, float, float]
    """Thrust of a rotor [N]: constant, linear and quadratic in rotor speed over its largest."""
    torque_to_thrust: float
    """Reaction torque per thrust [m]."""
    lag: tuple[float, float]
    """Time constants of rotor speed up and down [s]."""

    def parameters(self) -> Parameters:
        """Returns the same drone in our model."""
        full = sum(self.thrust)
        return replace(
            noiseless(crazyflie()),
            thrust_to_weight=4 * full / (self.mass * GRAVITY),
            thrust_offset=self.thrust[0] / full,
            thrust_linear=self.thrust[1] / full,
            motor_time_constant=self.lag[0],
            spin_down_ratio=self.lag[1] / self.lag[0],
            latency=0.0,
            torque_to_thrust=self.torque_to_thrust,
            torque_offset=0.0,
            mass=self.mass,
            inertia=self.inertia,
            **h_frame(*self.arms),
            ground_effect=0.0,
            gravity=GRAVITY,
            time_step=0.001,
        )


BODIES: Mapping[str, Body] = {
    "crazyflie": Body(
        mass=0.0326,
        inertia=(9.416556729130406e-06, 9.644051701582312e-06, 1.745951732253285e-05),
        arms=(0.028, 0.028),
        thrust=(0.00352526, 0.01437313, 0.09223048),
        torque_to_thrust=4.665e-3,
        lag=(0.05545454545454546, 0.24939393939393945),
    ),
    "x500": Body(
        mass=2.0,
        inertia=(0.0216666666666666, 0.0216666666666666, 0.04),
        arms=(0.176776695296636, 0.176776695296636),
        thrust=(0.0, 0.0, 8.74),
        torque_to_thrust=0.11697849233439939,
        lag=(0.03, 0.03),
    ),
    "arpl": Body(
        mass=0.782,
        inertia=(1.7665e-3, 1.3766e-3, (1.7665e-3 + 1.3766e-3) / 2 * 1.879),
        arms=(0.0775, 0.0981),
        thrust=(-0.5300192490953086, 8.971435376396558, -0.8911788522090669),
        torque_to_thrust=0.005964552,
        lag=(0.033, 0.033),
    ),
    "fs": Body(
        mass=3.35,
        inertia=(7.56e-2, 7.296e-2, 7.296e-2 * 1.879),
        arms=(0.20895, 0.240666),
        thrust=(0.7846629595902934, 9.15540123440728, 18.005569363583604),
        torque_to_thrust=0.01492,
        lag=(0.06532, 0.06532),
    ),
    "soft": Body(
        mass=0.97,
        inertia=(8.1547e-3, 5.2261e-3, 12.0427e-3),
        arms=(0.142, 0.169),
        thrust=(-0.13662779341843762, 4.247460030890121, 3.766033614431835),
        torque_to_thrust=0.2,
        lag=(0.04, 0.04),
    ),
}
"""Drones of l2f 2.0.18 by name, those of its source whose numbers agree with each other."""


class L2F:
    """A drone in l2f; follows the `Reality` protocol."""

    rate = RATE
    takes = MOTORS

    def __init__(self, drone: str) -> None:
        """Makes its world.

        Args:
            drone: a name of `BODIES`.

        Raises:
            InputError: no such drone, or l2f is not installed.
        """
        if drone not in BODIES:
            raise InputError(f"l2f:{drone}: l2f has {', '.join(BODIES)}.")
        self.name, body = f"l2f:{drone}", BODIES[drone]
        self.parameters = body.parameters()
        self.hover = float(dynamics.hover_command(self.parameters))
        remark = "pip compiles it: a C++ compiler, some 8 GB of memory and about ten minutes"
        l2f = imported("l2f", "l2f", "this drone", remark)
        self._l2f, self._device = l2f, l2f.Device()
        self._environment, self._random = l2f.Environment(), l2f.Rng()
        l2f.initialize_rng(self._device, self._random, 0)
        l2f.initialize_environment(self._device, self._environment)
        self._settings, self._state, self._next = l2f.Parameters(), l2f.State(), l2f.State()
        world = self._device, self._environment
        l2f.initial_parameters(*world, self._settings)
        settings = json.loads(l2f.parameters_to_json(*world, self._settings))
        settings["dynamics"] |= dynamics_of(self.parameters)
        settings["integration"]["dt"] = 1.0 / RATE
        l2f.parameters_from_json(*world, json.dumps(settings), self._settings)
        self.reset(np.zeros(3), 0)

    def reset(self, position: Float[np.ndarray, "3"], seed: int) -> None:
        """Resets to hover, level and at rest at a position [m]; nothing here is random."""
        l2f = self._l2f
        l2f.initial_state(self._device, self._environment, self._settings, self._state)
        self._state.position = [float(coordinate) for coordinate in position]
        self._state.orientation = [1.0, 0.0, 0.0, 0.0]
        self._state.linear_velocity = [0.0] * 3
        self._state.angular_velocity = [0.0] * 3
        self._state.rpm = [math.sqrt(self.hover)] * 4
        self._command = np.full(4, self.hover)

    def step(self, command: Float[np.ndarray, "4"]) -> None:
        """Holds thrust commands for 2 ms."""
        self._command = np.clip(np.asarray(command, np.float64), 0.0, 1.0)
        action = (2.0 * np.sqrt(self._command) - 1.0).tolist()
        world = self._device, self._environment, self._settings
        self._l2f.step(*world, self._state, action, self._next, self._random)
        self._state.assign(self._next)

    def observe(self) -> Measurement:
        """Returns the true state."""
        state: Any = self._state
        parts: Any = (
            np.array(state.position),
            np.array(state.linear_velocity),
            np.roll(state.orientation, -1),
            np.array(state.angular_velocity),
        )
        return Measurement(*parts)

    def truth(self) -> Truth:
        """Returns the true state and the last commands."""
        state: Any = self.observe()
        return Truth(state.position, state.quaternion, state.body_rates, self._command)
