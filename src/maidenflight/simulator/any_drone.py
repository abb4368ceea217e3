"""Drones of any make, and a drone as it may be on any day, for policies that adapt in flight.

Both are distributions, as those of `randomization` are.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from maidenflight.parameters import QUANTITIES, Parameters, replace
from maidenflight.simulator.physics.balance import balanced_shares
from maidenflight.simulator.randomization import UniformBox

ANY_RANGES: dict[str, tuple[float, float, str]] = {
    "mass": (0.8, 90.0, "of the nominal drone's"),
    "arm": (0.8, 1.25, "of the nominal drone's, times the cube root of the mass's factor"),
    "inertia": (0.7, 1.5, "of the nominal drone's, times mass and arm squared; about each axis"),
    "thrust_to_weight": (1.3, 5.0, ""),
    "motor_time_constant": (0.015, 0.15, "s"),
    "spin_down_ratio": (0.7, 4.0, ""),
    "torque_to_thrust": (0.1, 0.8, "of the arm"),
    "latency": (0.0, 0.025, "s"),
    "estimator_delay": (0.0, 0.01, "s"),
    "drag": (0.0, 0.4, "1/s"),
    "weak_rotor": (0.8, 1.0, "thrust of one rotor, in half of the drones"),
    "tilt_trim": (-0.04, 0.04, "of full thrust on the arms, about roll and pitch"),
    "yaw_trim": (-0.1, 0.1, "of the rotors' torque at full thrust"),
    "wind": (-2.0, 2.0, "m/s, forward and left"),
}
"""Ranges of `GenericQuadrotor`; log-uniform where both ends are above zero, else uniform."""

MOST_THRUST = 0.9
"""Share of full thrust that rotors of `DayToDay` hover with at most, unless the drone itself needs
more: beyond it training learns to lose drones, and lets the yaw of the others go (by
`paper/policies/defaults.py`; paper/notes/training.md#attitude-rate-by-default)."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GenericQuadrotor:
    """Small quadrotors of 20 g to 2.5 kg, for policies that shall fly without identification.

    Mass, arms and inertia grow together as those of similar bodies do; lag, latency, thrust, trims,
    a weak rotor and the wind are independent (`ANY_RANGES`). Sensors and their noise are those of
    the nominal drone. A trim is a constant torque in shares of what the drone's own rotors give.

    Source: similar bodies: arms as the cube root of the mass, inertia as mass times arm squared,
    as in the sampling of RAPTOR's drones (Eschmann et al. 2025); ranges of lag and thrust are ours.
    """

    nominal: Parameters

    @property
    def centre(self) -> Parameters:
        """The nominal drone."""
        return self.nominal

    def draw(self, key: Array) -> Parameters:
        """Returns one drone."""
        drone, numbers = self.nominal, iter(jax.random.uniform(key, (20,)))

        def within(name: str) -> Array:
            low, high, _ = ANY_RANGES[name]
            share = next(numbers)
            return low * (high / low) ** share if low > 0 else low + (high - low) * share

        heavier = within("mass")
        longer = within("arm") * jnp.cbrt(heavier)
        shape = jnp.stack([within("inertia") for _ in range(3)])
        mass, ratio = drone.mass * heavier, within("thrust_to_weight")
        x, y = drone.rotor_x * longer, drone.rotor_y * longer
        arm = jnp.mean(jnp.sqrt(x * x + y * y))
        thrust, torque = ratio * mass * drone.gravity, within("torque_to_thrust") * arm
        tilts, yaw = [within("tilt_trim") * arm for _ in range(2)], within("yaw_trim") * torque
        weak = jnp.where(next(numbers) < 0.5, within("weak_rotor"), 1.0)
        rotor = jnp.floor(4.0 * next(numbers))
        return replace(
            drone,
            mass=mass,
            inertia=drone.inertia * heavier * longer**2 * shape,
            rotor_x=x,
            rotor_y=y,
            thrust_to_weight=ratio,
            torque_to_thrust=torque,
            torque_bias=thrust * jnp.stack([*tilts, yaw]),
            rotor_thrust=drone.rotor_thrust * jnp.where(jnp.arange(4.0) == rotor, weak, 1.0),
            wind=jnp.stack([within("wind"), within("wind"), jnp.zeros(())]),
            drag=jnp.broadcast_to(within("drag"), (3,)),
            **{
                name: within(name)
                for name in ("motor_time_constant", "spin_down_ratio", "latency", "estimator_delay")
            },
        )

    def __str__(self) -> str:
        return "\n".join(
            f"{name} ~ {'log ' if low > 0 else ''}U({low:g}, {high:g}) {unit}".rstrip()
            for name, (low, high, unit) in ANY_RANGES.items()
        )


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DayToDay:
    """A drone as it may be on any day, for policies that find out in flight how it is today.

    Drawn from a box about the identified drone; with the trims, the weak rotor and the wind of
    `GenericQuadrotor`, which no earlier log determines, more latency, and up to 20 % more mass at
    its centre. What could not hover so (`MOST_THRUST`) has as much more thrust as it lacks.
    """

    box: UniformBox
    later: Float[Any, ""] = ANY_RANGES["latency"][1]
    """Most latency added [s]."""

    @property
    def centre(self) -> Parameters:
        """The middle of the box."""
        return self.box.centre

    def draw(self, key: Array) -> Parameters:
        """Returns one drone."""
        box_key, key = jax.random.split(key)
        drone, numbers = self.box.draw(box_key), iter(jax.random.uniform(key, (12,)))

        def within(name: str) -> Array:
            low, high, _ = ANY_RANGES[name]
            return low + (high - low) * next(numbers)

        x, y = drone.rotor_x, drone.rotor_y
        arm = jnp.mean(jnp.sqrt(x * x + y * y))
        thrust = drone.thrust_to_weight * drone.mass * drone.gravity
        tilts = [within("tilt_trim") * arm for _ in range(2)]
        trims = jnp.stack([*tilts, within("yaw_trim") * drone.torque_to_thrust])
        weak = jnp.where(next(numbers) < 0.5, within("weak_rotor"), 1.0)
        rotor = jnp.floor(4.0 * next(numbers))
        heavier = 1.0 + 0.2 * next(numbers)
        latest = QUANTITIES["latency"].upper
        drone = replace(
            drone,
            torque_bias=drone.torque_bias + thrust * trims,
            rotor_thrust=drone.rotor_thrust * jnp.where(jnp.arange(4.0) == rotor, weak, 1.0),
            mass=drone.mass * heavier,
            thrust_to_weight=drone.thrust_to_weight / heavier,
            latency=jnp.minimum(drone.latency + self.later * next(numbers), latest),
            wind=drone.wind + jnp.stack([within("wind"), within("wind"), jnp.zeros(())]),
        )
        most, own = (jnp.max(balanced_shares(hovering)) for hovering in (drone, self.box.centre))
        lacking = most / jnp.maximum(own, MOST_THRUST)
        return replace(drone, thrust_to_weight=drone.thrust_to_weight * jnp.maximum(lacking, 1.0))

    def __str__(self) -> str:
        more = ("tilt_trim", "yaw_trim", "weak_rotor", "wind")
        lines = [
            f"{name} + U({ANY_RANGES[name][0]:g}, {ANY_RANGES[name][1]:g}) {ANY_RANGES[name][2]}"
            for name in more
        ]
        latency = f"latency + U(0, {self.later:g}) s"
        thrust = f"thrust_to_weight raised where a rotor hovers above {MOST_THRUST:g}"
        return "\n".join([str(self.box), *lines, latency, "mass + U(0, 0.2) of it", thrust])
