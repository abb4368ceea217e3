"""`VirtualDrone`, a simulated drone to fly unseen, and `virtual_drone`, which draws one by seed.

What is made with them is marked as simulated. Constants are drawn from a seed and not shown to
identification and training. There are three variants, with growing mismatch to the model that
policies train on: `near` has other numbers; `virtual` also effects that the paper's model lacks
(a battery that sags behind 8-bit PWM and the firmware's compensation, motors that slow down more
slowly than they speed up, rotor drag, a late estimator and gyro); `far` also those that the
authors' flights show. All are integrated by RK4 at 1 kHz.
"""

import math
from dataclasses import dataclass

import numpy as np

from maidenflight.errors import InputError
from maidenflight.parameters import Parameters, crazyflie, replace
from maidenflight.simulator import dynamics
from maidenflight.simulator.control import Controller
from maidenflight.simulator.dynamics import Integrator
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.tasks import Task


@dataclass(frozen=True)
class VirtualDrone:
    """A simulated drone that differs from the training model."""

    name: str
    parameters: Parameters
    """The true parameters; `time_step` is 1 ms."""
    integrator: Integrator = dynamics.rk4
    """The physics engine."""
    battery: bool = True
    """Whether commands pass through battery compensation, 8-bit PWM and a battery that sags."""

    def environment(self, task: Task, controller: Controller) -> Environment:
        """The environment in which this drone flies a task under a control structure."""
        memory = 2 + math.ceil(
            max(0.010, float(self.parameters.estimator_delay)) * Environment.estimate_rate - 1e-6
        )
        settings = {
            "integrator": self.integrator,
            "battery": self.battery,
            "estimator_memory": memory,
        }
        return Environment.matching(self.parameters, task, controller, **settings)


RANGES: dict[str, tuple[float, float]] = {
    "thrust_to_weight": (1.55, 1.85),
    "motor_time_constant": (0.050, 0.080),
    "spin_down_ratio": (1.2, 1.6),
    "latency": (0.004, 0.010),
    "mass": (0.0275, 0.0295),
    "battery_voltage": (3.9, 4.2),
    "battery_resistance": (0.4, 0.8),
    "battery_discharge": (0.002, 0.005),
    "estimator_delay": (0.002, 0.008),
}
"""Uniform range of each hidden constant, SI units; drag, inertia and torque factors vary about the
paper's values.

The ranges lie within those of published Crazyflies: thrust-to-weight ratios of 1.47 to 1.97, lags
of 55 to 136 ms, 27 to 33 g. Battery resistance and discharge have the size that the 2.7 to 3.8 V of
the authors' flights show. Latency is below what the firmware's PID tolerates: its rate loop crosses
over near 40 rad/s, where 17 ms take the whole phase margin.
"""


FAR_RANGES: dict[str, tuple[float, float]] = {
    "thrust_to_weight": (1.42, 1.55),
    "motor_time_constant": (0.045, 0.055),
    "spin_down_ratio": (2.0, 2.5),
    "rotor_momentum": (6e-5, 9e-5),
    "flapping_moment": (2e-4, 4e-4),
}
"""What the `far` variant has instead, of the size identified from the authors' flights
(docs/identification.md).

The random-walk drift of their estimates is left out: guards of zero-shot flights look at the true
position, which no policy could then hold.
"""
FAR_TORQUE_BIAS_STD_N_M = np.array([5e-5, 5e-5, 3e-5], np.float32)
"""Standard deviation of the constant torques of the `far` variant [N m]; those of the authors'
flights have 2e-5 to 1.3e-4."""

VARIANTS = ("near", "virtual", "far")
"""Variants of virtual drones, by growing mismatch to the training model."""


def virtual_drone(seed: int, variant: str = "virtual") -> VirtualDrone:
    """A virtual Crazyflie whose hidden constants are drawn from a seed.

    Args:
        seed: a whole number, not negative; the same seed is the same drone.
        variant: `near`: the paper's model with other numbers, and the mean motor lag of the virtual
            drone of the same seed. `virtual`: the effects above. `far`: in addition a lower
            thrust-to-weight ratio, motors that slow down half as fast as they speed up, the
            rotors' angular momentum, a flapping moment and constant torques.

    Raises:
        InputError: the seed is negative, or there is no such variant.
    """
    if seed < 0:
        raise InputError(f"virtual drone {seed}: expected a seed of 0 or more.")
    if variant not in VARIANTS:
        raise InputError(
            f"virtual drone of variant {variant!r}: expected one of {', '.join(VARIANTS)}."
        )
    drawn = _drawn(np.random.default_rng([seed, 0x0D201E]))
    if variant == "near":
        drawn = _in_the_papers_model(drawn)
    if variant == "far":
        generator = np.random.default_rng([seed, 0x0D201E, 1])
        further = {
            name: float(generator.uniform(low, high)) for name, (low, high) in FAR_RANGES.items()
        }
        torques = FAR_TORQUE_BIAS_STD_N_M * generator.standard_normal(3).astype(np.float32)
        drawn = replace(drawn, **further, torque_bias=torques)
    return VirtualDrone(f"{variant}-{seed}", drawn)


def _drawn(generator: np.random.Generator) -> Parameters:
    drawn = {name: float(generator.uniform(low, high)) for name, (low, high) in RANGES.items()}
    nominal = crazyflie()
    drawn_vectors = {
        "inertia": nominal.inertia * generator.uniform(0.95, 1.15, 3).astype(np.float32),
        "drag": np.array(
            [*generator.uniform(0.15, 0.40, 2), generator.uniform(0.05, 0.20)], np.float32
        ),
    }
    return replace(
        nominal,
        **drawn,
        **drawn_vectors,
        torque_to_thrust=nominal.torque_to_thrust * np.float32(generator.uniform(0.9, 1.2)),
        # What the firmware's low-pass filter of 80 Hz leaves of the gyro's noise, and its delay:
        # sqrt(2) / (2 pi 80 Hz).
        gyro_noise=0.01,
        gyro_time_constant=0.0028,
        actuator_noise=0.01,
        position_noise=0.003,
        velocity_noise=0.015,
        time_step=0.001,
    )


def _in_the_papers_model(drone: Parameters) -> Parameters:
    """The same drone without what the paper's model lacks."""
    lag = drone.motor_time_constant * np.float32((1.0 + float(drone.spin_down_ratio)) / 2.0)
    neutral = {
        name: getattr(crazyflie(), name)
        for name in (
            "spin_down_ratio",
            "drag",
            "gyro_time_constant",
            "estimator_delay",
            "battery_resistance",
        )
    }
    return replace(drone, **neutral, motor_time_constant=lag, battery_discharge=0.0)
