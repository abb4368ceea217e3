"""`VirtualDrone`, a simulated drone to fly unseen, and `virtual_drone`, which draws one by seed.

What is made with them is marked as simulated. Constants are drawn from a seed and hidden from
identification and training. There are three variants, with growing mismatch to the model that
policies train on: `near` has other numbers; `virtual` also effects that the paper's model lacks
(a battery that sags behind 8-bit PWM and the firmware's compensation, motors that slow down more
slowly than they speed up, rotor drag, a late estimator and gyro); `far` also those that the
authors' flights show. All are integrated by RK4 at 1 kHz.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maidenflight.errors import InputError
from maidenflight.parameters import (
    GEOMETRY,
    QUANTITIES,
    Parameters,
    arm_length,
    crazyflie,
    replace,
)
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.physics.battery import FIRMWARE_2021, Supply, ThrustLaw
from maidenflight.simulator.physics.dynamics import Integrator
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.tasks.tasks import Task


class ParameterChange(NamedTuple):
    """What a virtual drone becomes in the course of a flight."""

    parameters: Parameters
    """From then on; like those before in `latency`, `time_step` and what else is static."""
    at: float
    """When [s] after the flight's start."""

    def __call__(self, drone: Parameters, elapsed: Float[Array, ""]) -> Parameters:
        """Returns the drone at a time; it changes in the first control period that begins then."""
        # The time is a sum of periods in float32.
        before = elapsed + drone.time_step / 2 < self.at
        return jax.tree.map(lambda new, old: jnp.where(before, old, new), self.parameters, drone)


@dataclass(frozen=True)
class VirtualDrone:
    """A simulated drone that differs from the training model."""

    name: str
    parameters: Parameters
    """The true parameters; `time_step` is 1 ms."""
    integrator: Integrator = dynamics.rk4
    """The physics engine."""
    thrust_law: ThrustLaw | None = FIRMWARE_2021
    """By which its firmware compensates for a battery that sags, behind 8-bit PWM; None: it has
    neither."""
    later: ParameterChange | None = None
    """What it becomes in the course of a flight; it stays as it is by default."""

    def must_not_change(self) -> None:
        """Refuses a drone that changes in the course of a flight, where that is not simulated.

        Raises:
            InputError: it does.
        """
        if self.later is not None:
            raise InputError(
                f"{self.name} changes {self.later.at:g} s after the flight's start; only transfers "
                "of our own policies simulate that. Expected a reality that stays as it is: leave "
                f"out @{self.later.at:g}, so that the change holds from the start."
            )

    def supply(self, full_scale_counts: float) -> Supply:
        """Returns what becomes of thrust commands, of which 1 stands for so many counts."""
        return Supply(self.thrust_law, full_scale_counts, battery=self.thrust_law is not None)

    def environment(
        self,
        task: Task,
        controller: Controller,
        *,
        spec: PolicySpec = PolicySpec(),
        changing: bool = False,
    ) -> Environment:
        """Returns the environment in which this drone flies a task under a control structure.

        Args:
            task: the task to fly.
            controller: what carries out the commands.
            spec: what the policy sees.
            changing: whether the caller makes the drone become what `later` says.

        Raises:
            InputError: the drone changes in the course of a flight, and the caller does not make
                it; or its time step does not divide the controller's period.
        """
        if not changing:
            self.must_not_change()
        memory = 2 + math.ceil(
            max(0.010, float(self.parameters.estimator_delay)) * Environment.estimate_rate - 1e-6
        )
        settings = {
            "integrator": self.integrator,
            "thrust_law": self.thrust_law,
            "battery": self.thrust_law is not None,
            "estimator_memory": memory,
            "spec": spec,
        }
        return Environment.matching(self.parameters, task, controller, **settings)


def must_be_virtual(reality: object, cure: str) -> VirtualDrone:
    """Returns a virtual drone.

    Args:
        reality: any.
        cure: what to do where its physics are not ours.

    Raises:
        InputError: it is none.
    """
    if not isinstance(reality, VirtualDrone):
        name = getattr(reality, "name", reality)
        raise InputError(f"{name} has physics of its own, which are not ours to change. {cure}")
    return reality


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

The random-walk drift of their estimates is left out; a drone about another has that one's.
"""
FAR_TORQUE_BIAS_STD_N_M = np.array([5e-5, 5e-5, 3e-5], np.float32)
"""Standard deviation of the constant torques of the `far` variant [N m]; those of the authors'
flights have 2e-5 to 1.3e-4."""

LARGEST_CRAZYFLIE = 0.06
"""Mass above which a drone is no Crazyflie and has neither its battery nor its 8-bit PWM [kg]."""

VARIANTS = ("near", "virtual", "far")
"""Variants of virtual drones, by growing mismatch to the training model."""


def virtual_drone(
    seed: int,
    variant: str = "virtual",
    centre: Parameters | None = None,
    thrust_law: ThrustLaw = FIRMWARE_2021,
) -> VirtualDrone:
    """Returns a virtual drone whose hidden constants are drawn from a seed.

    Args:
        seed: a whole number, not negative; the same seed is the same drone.
        variant: `near`: the paper's model with other numbers, and the mean motor lag of the virtual
            drone of the same seed. `virtual`: the effects above. `far`: in addition a lower
            thrust-to-weight ratio, motors that slow down half as fast as they speed up, the
            rotors' angular momentum, a flapping moment and constant torques.
        centre: the drone about which constants are drawn, each in the same proportion as about the
            Crazyflie; what it lacks, such as drag or a battery that sags, is drawn as the
            Crazyflie's. A drone of more than `LARGEST_CRAZYFLIE` has no battery compensation. The
            published Crazyflies by default.
        thrust_law: of its firmware.

    Raises:
        InputError: the seed is negative, or there is no such variant.
    """
    if seed < 0:
        raise InputError(f"virtual drone {seed}: expected a seed of 0 or more.")
    if variant not in VARIANTS:
        raise InputError(
            f"virtual drone of variant {variant!r}: expected one of {', '.join(VARIANTS)}."
        )
    drone = _drawn(np.random.default_rng([seed, 0x0D201E]))
    if centre is not None:
        drone = _about(drone, centre)
    if variant == "near":
        drone = _in_the_papers_model(drone)
    if variant == "far":
        generator = np.random.default_rng([seed, 0x0D201E, 1])
        further = {
            name: float(generator.uniform(low, high)) for name, (low, high) in FAR_RANGES.items()
        }
        torques = FAR_TORQUE_BIAS_STD_N_M * generator.standard_normal(3).astype(np.float32)
        if centre is not None:
            further, torques = _far_about(further, drone, centre), torques * _size(centre)
        flapping = further.pop("flapping_moment", None)
        if flapping is not None:
            further |= {"flapping_moment_x": flapping, "flapping_moment_y": flapping}
        drone = replace(drone, **further, torque_bias=torques)
    compensated = centre is None or float(centre.mass) <= LARGEST_CRAZYFLIE
    law = thrust_law if compensated else None
    return VirtualDrone(f"{variant}:{seed}", drone, thrust_law=law)


_UNCHANGED = (
    "thrust_linear",
    "thrust_offset",
    "motor_coasting",
    "rotor_momentum",
    "flapping_moment",
    "rotational_damping",
    "torque_bias",
    "torque_offset",
    *GEOMETRY,
    "rotor_thrust",
    "wind",
    "ground_effect",
    "gravity",
    "position_walk",
    "height_walk",
    "velocity_walk",
    "turn_drift",
    "disturbance_torque",
    "disturbance_torque_time",
    "disturbance_force",
    "disturbance_force_time",
    "platform",
)
"""What a drone about another has as that one."""


def _about(drone: Parameters, centre: Parameters) -> Parameters:
    """A drone that differs from another as a drawn Crazyflie from the middle of its ranges."""
    nominal = crazyflie()

    def scaled(name: str, middle: np.ndarray | float) -> np.ndarray:
        own = np.asarray(getattr(centre, name), np.float32)
        other = np.asarray(getattr(drone, name), np.float32)
        return np.where(own == 0, other, own * other / np.float32(middle))

    of_ranges = {
        name: scaled(name, (RANGES[name][0] + RANGES[name][1]) / 2)
        for name in ("thrust_to_weight", "motor_time_constant", "spin_down_ratio", "mass")
    }
    # A latency of zero is one that the logs did not show.
    late = float(centre.latency) + float(drone.latency) - RANGES["latency"][0]
    own = {name: getattr(centre, name) for name in _UNCHANGED}
    return replace(
        drone,
        **own,
        **of_ranges,
        latency=min(late, QUANTITIES["latency"].upper),
        inertia=scaled("inertia", nominal.inertia),
        drag=scaled("drag", np.array([0.275, 0.275, 0.125], np.float32)),
        torque_to_thrust=scaled("torque_to_thrust", nominal.torque_to_thrust),
    )


def _far_about(
    further: Mapping[str, float], drone: Parameters, centre: Parameters
) -> dict[str, float]:
    """What the `far` variant has instead about a drone: less thrust, and what `around` lacks."""
    lacking = {
        name: further[name] * _size(centre)
        for name in ("rotor_momentum", "flapping_moment")
        if not np.any(getattr(centre, name))
    }
    thrust = 0.9 * float(drone.thrust_to_weight)
    return {
        "thrust_to_weight": thrust,
        "spin_down_ratio": further["spin_down_ratio"],
        **lacking,
    }


def _size(drone: Parameters) -> float:
    """Weight times arm, over that of the Crazyflie."""
    nominal = crazyflie()
    return float(drone.mass) * arm_length(drone) / (float(nominal.mass) * arm_length(nominal))


def _drawn(generator: np.random.Generator) -> Parameters:
    values = {name: float(generator.uniform(low, high)) for name, (low, high) in RANGES.items()}
    nominal = crazyflie()
    drawn_vectors = {
        "inertia": nominal.inertia * generator.uniform(0.95, 1.15, 3).astype(np.float32),
        "drag": np.array(
            [*generator.uniform(0.15, 0.40, 2), generator.uniform(0.05, 0.20)], np.float32
        ),
    }
    return replace(
        nominal,
        **values,
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
