"""Domain randomization: drawing a drone from a distribution over xi.

A distribution is a pytree that can draw one drone and prints like mathematics: factors about a
drone (`relative_box`), ranges of values (`uniform_box`), drones of any make (`AnyDrone`), or drones
to choose from (`Ensemble`), such as the posterior samples of an identification.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from maidenflight.errors import InputError
from maidenflight.parameters import QUANTITIES, Parameters, check, replace

PAPER_FIELDS = (
    "thrust_to_weight",
    "time_step",
    "mass",
    "inertia",
    "motor_time_constant",
    "torque_to_thrust",
    "torque_offset",
)
"""What the paper randomizes (Gronauer et al. 2022, sec. Simulation Environment, Domain
Randomization)."""


class Distribution(Protocol):
    """A distribution over drones."""

    @property
    def centre(self) -> Parameters:
        """The drone in the middle; its `time_step` is that of the simulation."""
        ...

    def draw(self, key: Array) -> Parameters:
        """One drone."""
        ...


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RelativeBox:
    """Independent uniform factors about one drone; each component of a vector has its own."""

    nominal: Parameters
    lower: Parameters
    """Smallest factor of each field; 1 where it is not randomized."""
    upper: Parameters
    """Largest factor of each field."""

    @property
    def centre(self) -> Parameters:
        """The nominal drone."""
        return self.nominal

    def draw(self, key: Array) -> Parameters:
        """One drone."""
        factors = _uniform(self.lower, self.upper, key)
        return jax.tree.map(lambda value, factor: value * factor, self.nominal, factors)

    def __str__(self) -> str:
        lines = []
        for name, quantity in QUANTITIES.items():
            low, high = (
                float(jnp.ravel(getattr(side, name))[0]) for side in (self.lower, self.upper)
            )
            if low != high:
                value = " ".join(
                    f"{entry:.4g}" for entry in jnp.ravel(getattr(self.nominal, name)).tolist()
                )
                lines.append(f"{name} ~ {value} U({low:g}, {high:g}) {quantity.unit}")
        return "\n".join(lines)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class UniformBox:
    """Independent uniform values between two drones; each component of a vector has its own."""

    lower: Parameters
    upper: Parameters

    @property
    def centre(self) -> Parameters:
        """The middle of the box."""
        return jax.tree.map(lambda low, high: (low + high) / 2, self.lower, self.upper)

    def draw(self, key: Array) -> Parameters:
        """One drone."""
        return _uniform(self.lower, self.upper, key)

    def __str__(self) -> str:
        lines = []
        for name, quantity in QUANTITIES.items():
            low, high = (
                np.ravel(getattr(side, name)).tolist() for side in (self.lower, self.upper)
            )
            if low != high:
                ranges = " ".join(f"U({a:.4g}, {b:.4g})" for a, b in zip(low, high, strict=True))
                lines.append(f"{name} ~ {ranges} {quantity.unit}")
        return "\n".join(lines)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Ensemble:
    """Equally likely drones."""

    drones: Parameters
    """Stacked along a first axis."""

    @property
    def centre(self) -> Parameters:
        """The mean drone."""
        return jax.tree.map(
            lambda leaf: np.mean(leaf, axis=0, dtype=np.float64).astype(np.float32), self.drones
        )

    def draw(self, key: Array) -> Parameters:
        """One drone."""
        number = jax.random.randint(key, (), 0, jnp.shape(self.drones.mass)[0])
        return jax.tree.map(lambda leaf: jnp.asarray(leaf)[number], self.drones)

    def __str__(self) -> str:
        count, lines = np.shape(self.drones.mass)[0], []
        for name, quantity in QUANTITIES.items():
            values = np.asarray(getattr(self.drones, name), np.float64).reshape(count, -1)
            if np.ptp(values, axis=0).any():
                spreads = " ".join(
                    f"{mean:.4g} +- {deviation:.2g}"
                    for mean, deviation in zip(values.mean(0), values.std(0), strict=True)
                )
                lines.append(f"{name} ~ {spreads} {quantity.unit}, one of {count} drones")
        return "\n".join(lines)


def relative_box(
    nominal: Parameters, fraction: float = 0.10, fields: Sequence[str] = PAPER_FIELDS
) -> RelativeBox:
    """A box of +-`fraction` about one drone.

    Args:
        nominal: the centre.
        fraction: half width as a share of the nominal value, in [0, 1).
        fields: names of the fields to randomize.

    Raises:
        InputError: the fraction is out of range, a field is unknown, or the drone is none that
            could be.
    """
    if not 0 <= fraction < 1:
        raise InputError(f"fraction = {fraction}, expected a share in [0, 1).")
    check(nominal)
    ones = jax.tree.map(lambda leaf: np.ones(np.shape(leaf), np.float32), nominal)
    lower, upper = (
        replace(
            ones,
            **{
                name: getattr(ones, name, np.float32(1)) * np.float32(1 + side * fraction)
                for name in fields
            },
        )
        for side in (-1, 1)
    )
    return RelativeBox(nominal, lower, upper)


def uniform_box(nominal: Parameters, **ranges: tuple[float, float]) -> UniformBox:
    """A box of values in SI units, such as `uniform_box(crazyflie(), latency=(0.0, 0.03))`.

    Args:
        nominal: the values of all other fields.
        ranges: smallest and largest value by field; every component of a vector gets the same.

    Raises:
        InputError: a field is unknown, or its range is not two numbers in order within its physical
            range.
    """
    for name, given in ranges.items():
        quantity = QUANTITIES.get(name)
        if quantity is None:
            raise InputError(f"unknown parameter {name!r}; known are {', '.join(QUANTITIES)}.")
        if len(given) != 2 or not quantity.lower <= given[0] <= given[1] <= quantity.upper:
            raise InputError(
                f"{name} = {given}: expected two numbers in order in [{quantity.lower:g}, "
                f"{quantity.upper:g}] {quantity.unit}."
            )
    lower, upper = (
        replace(
            nominal,
            **{
                name: np.full_like(getattr(nominal, name), given[end], np.float32)
                for name, given in ranges.items()
            },
        )
        for end in (0, 1)
    )
    return UniformBox(lower, upper)


_LOOSE = {"position_walk": (0.5, 0.5), "velocity_walk": (0.5, 0.5)}
"""Half the random-walk drift of the estimates: with all of it policies hold their position so
weakly that they lose it on drones unlike theirs."""
_LIKE = {
    **_LOOSE,
    "motor_time_constant": (0.8, 1.6),
    "inertia": (0.9, 1.2),
    "mass": (0.9, 1.1),
    "thrust_to_weight": (0.85, 1.3),
}
WIDTHS: dict[str, dict[str, tuple[float, float]]] = {
    "pwm": {
        **_LIKE,
        "spin_down_ratio": (0.9, 2.2),
        "latency": (0.8, 1.6),
        "torque_to_thrust": (0.9, 2.8),
    },
    "attitude_rate": _LIKE,
    "attitude": {**_LIKE, "latency": (0.8, 1.6)},
}
"""Least and greatest factors of `wide_box`, by control structure: published Crazyflies have
thrust-to-weight ratios of up to 1.97 and lags of up to 136 ms, in both directions. No drone has a
rotor torque so large; trained over less, PWM policies flew worse on all others."""
LATER = 0.015
"""Least width of `wide_box` above the latency where that is randomized [s]: no factor widens an
identified latency of zero, and another link or controller adds milliseconds to any. From 6 to 18 ms
it costs 0.5 mm on the circle (docs/studies/training.md)."""
TRIM_WIDTHS = {"pwm": 2.0, "attitude_rate": 2.0, "attitude": 1.0}
"""Half width of `wide_box` in constant torques, in their deviations between flights."""


def wide_box(
    nominal: Parameters, structure: str, trims: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0)
) -> UniformBox:
    """A wide box about an identified drone, for policies that fly drones unlike it too.

    Chosen by how well policies transfer to virtual drones (docs/studies/randomization.md).

    Args:
        nominal: the identified drone.
        structure: name of the control structure that the policy commands.
        trims: standard deviation of the constant torque about each axis from flight to flight [N
            m].
    """
    reach = TRIM_WIDTHS[structure] * np.asarray(trims, np.float32)
    lower, upper = (
        replace(
            nominal,
            **{
                name: getattr(nominal, name) * np.float32(factors[end])
                for name, factors in WIDTHS[structure].items()
            },
            torque_bias=np.asarray(nominal.torque_bias + (2 * end - 1) * reach, np.float32),
        )
        for end in (0, 1)
    )
    if "latency" in WIDTHS[structure]:
        latest = min(float(nominal.latency) + LATER, QUANTITIES["latency"].upper)
        upper = replace(upper, latency=max(float(upper.latency), latest))
    return UniformBox(lower, upper)


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
"""Ranges of `AnyDrone`; those above zero at both ends are log-uniform, the others uniform."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class AnyDrone:
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
        """One drone."""
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
class AnyDay:
    """A drone as it may be on any day, for policies that find out in flight how it is today.

    Drawn from a box about the identified drone; with the trims, the weak rotor, the latency (that
    much more) and the wind of `AnyDrone`, which no log of yesterday tells, and up to 20 % more mass
    at its centre.
    """

    box: UniformBox

    @property
    def centre(self) -> Parameters:
        """The middle of the box."""
        return self.box.centre

    def draw(self, key: Array) -> Parameters:
        """One drone."""
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
        return replace(
            drone,
            torque_bias=drone.torque_bias + thrust * trims,
            rotor_thrust=drone.rotor_thrust * jnp.where(jnp.arange(4.0) == rotor, weak, 1.0),
            mass=drone.mass * heavier,
            thrust_to_weight=drone.thrust_to_weight / heavier,
            latency=jnp.minimum(drone.latency + within("latency"), latest),
            wind=drone.wind + jnp.stack([within("wind"), within("wind"), jnp.zeros(())]),
        )

    def __str__(self) -> str:
        more = ("tilt_trim", "yaw_trim", "weak_rotor", "latency", "wind")
        lines = [
            f"{name} + U({ANY_RANGES[name][0]:g}, {ANY_RANGES[name][1]:g}) {ANY_RANGES[name][2]}"
            for name in more
        ]
        return "\n".join([str(self.box), *lines, "mass + U(0, 0.2) of it"])


def ensemble(drones: Sequence[Parameters]) -> Ensemble:
    """An ensemble of given drones.

    Raises:
        InputError: no drone.
    """
    if not drones:
        raise InputError("an ensemble of no drones; give one or more.")
    return Ensemble(jax.tree.map(lambda *leaves: np.stack(leaves), *drones))


def randomize(distribution: Distribution, key: Array) -> Parameters:
    """Draws one drone."""
    return distribution.draw(key)


def _uniform(lower: Parameters, upper: Parameters, key: Array) -> Parameters:
    """Values between two drones, from one draw.

    A draw for each field would take longer to compile than a step of the simulator.
    """
    lows, structure = jax.tree.flatten(lower)
    sizes = [np.size(low) for low in lows]
    shares = jnp.split(jax.random.uniform(key, (sum(sizes),)), np.cumsum(sizes)[:-1])
    shares = jax.tree.unflatten(
        structure, [share.reshape(np.shape(low)) for share, low in zip(shares, lows, strict=True)]
    )
    return jax.tree.map(lambda low, high, share: low + share * (high - low), lower, upper, shares)
