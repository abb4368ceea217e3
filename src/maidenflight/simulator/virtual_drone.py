"""Virtual drones: realities that differ from the training model in variant, not only in numbers.

They are simulated, and everything made with them says so. A virtual drone has effects that the
paper's model lacks: RK4 at 1 kHz, a battery that sags behind 8-bit PWM and the firmware's
compensation, motors that slow down more lazily than they speed up, rotor drag, and an estimator and
a gyro that are late. Its constants are drawn from a seed and hidden from identification and
training.
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
    """A simulated reality."""

    name: str
    parameters: Parameters
    """The truth; `time_step` is 1 ms."""
    integrator: Integrator = dynamics.rk4
    """The engine."""

    def environment(self, task: Task, controller: Controller) -> Environment:
        """How this drone is simulated for a task and a control structure."""
        memory = 2 + math.ceil(
            max(0.010, float(self.parameters.estimator_delay)) * Environment.estimate_rate - 1e-6
        )
        settings = {"integrator": self.integrator, "battery": True, "estimator_memory": memory}
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
"""Range from which each hidden constant is drawn, SI units. Drag, inertia and torque factors
scatter about the paper's.

The ranges lie within published Crazyflies: thrust-to-weight ratios of 1.47 to 1.97, lags of 55 to
136 ms, 27 to 33 g; battery resistance and discharge are of the size that the 2.7 to 3.8 V of the
authors' flights tell. Latency stays below what the firmware's own PID bears: its rate loop crosses
over near 40 rad/s, where 17 ms cost the whole phase margin.
"""


FAR_RANGES: dict[str, tuple[float, float]] = {
    "thrust_to_weight": (1.42, 1.55),
    "motor_time_constant": (0.045, 0.055),
    "spin_down_ratio": (2.0, 2.5),
    "rotor_momentum": (6e-5, 9e-5),
    "flapping_moment": (2e-4, 4e-4),
}
"""What a far drone has instead: the size of each is that of the authors' drone, identified from its
flights (docs/identification.md).

Its estimates do not walk as theirs do: guards of zero-shot flights look at the true position, from
which no policy could then keep.
"""
FAR_TORQUE_BIAS_STD_N_M = np.array([5e-5, 5e-5, 3e-5], np.float32)
"""Standard deviation of a far drone's constant torques [N m]; those of the authors' flights have
2e-5 to 1.3e-4."""

VARIANTS = ("near", "virtual", "far")
"""Of virtual drones, of growing strangeness."""


def virtual_drone(seed: int, variant: str = "virtual") -> VirtualDrone:
    """A virtual Crazyflie whose hidden constants are drawn from a seed.

    Args:
        seed: a whole number, not negative; the same seed is the same drone.
        variant: `near`: only its numbers differ from the paper's model, which it shares, its motors'
            mean lag being that of the virtual drone. `virtual`: see above. `far`: what flights of
            the authors' drone tell comes on top; a weak battery, motors that slow down twice as
            lazily, turning rotors, a moment against the flight's direction, constant torques.

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
        strange = {
            name: float(generator.uniform(low, high)) for name, (low, high) in FAR_RANGES.items()
        }
        drawn = replace(
            drawn,
            **strange,
            torque_bias=FAR_TORQUE_BIAS_STD_N_M * generator.standard_normal(3).astype(np.float32),
        )
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
        # What the firmware's low-pass filter of 80 Hz leaves of the gyro's noise, and how long it
        # takes: sqrt(2) / (2 pi 80 Hz).
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
