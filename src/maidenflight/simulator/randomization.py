"""Domain randomization: drawing a drone from a distribution over xi.

A distribution is a pytree that can draw one drone and prints like mathematics: factors about a
drone (`relative_box`), ranges of values (`UniformBox`) or drones to choose from (`Ensemble`), such
as the posterior samples of an identification. `any_drone` has drones of any make.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

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
        """Returns one drone."""
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
        """Returns one drone."""
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
        """Returns one drone."""
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
        """Returns one drone."""
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
    """Returns a box of +-`fraction` about one drone.

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


_LIKE = {
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
UNIDENTIFIED = {"motor_time_constant": (0.6, 1.6), "latency": (0.2, 1.6)}
"""The same for PWM about a drone that nobody identified: published lags begin at 55 ms. On drones
quicker than all in training policies hunted and sank (paper/notes/training.md#any-reference)."""
LATER = 0.015
"""Least width of `wide_box` above the latency where that is randomized [s]: no factor widens an
identified latency of zero, and another link or controller adds milliseconds to any. From 6 to 18 ms
it costs 0.5 mm on the circle (paper/notes/training.md)."""
TRIM_WIDTHS = {"pwm": 2.0, "attitude_rate": 2.0, "attitude": 1.0}
"""Half width of `wide_box` in constant torques, in their deviations between flights."""


def wide_box(
    nominal: Parameters,
    structure: str,
    trims: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0),
    identified: bool = True,
) -> UniformBox:
    """Returns a wide box about a drone, for policies that fly drones unlike it too.

    Chosen by how well policies transfer to virtual drones (paper/notes/randomization.md).

    Args:
        nominal: the drone.
        structure: name of the control structure that the policy commands; one of your own is
            randomized as PWM.
        trims: standard deviation of the constant torque about each axis from flight to flight [N
            m].
        identified: whether flights told anything of the drone; else it may be far quicker.
    """
    widths = WIDTHS.get(structure, WIDTHS["pwm"])
    if widths is WIDTHS["pwm"] and not identified:
        widths = widths | UNIDENTIFIED
    reach = TRIM_WIDTHS.get(structure, TRIM_WIDTHS["pwm"]) * np.asarray(trims, np.float32)
    lower, upper = (
        replace(
            nominal,
            **{
                name: getattr(nominal, name) * np.float32(factors[end])
                for name, factors in widths.items()
            },
            torque_bias=np.asarray(nominal.torque_bias + (2 * end - 1) * reach, np.float32),
        )
        for end in (0, 1)
    )
    if "latency" in widths:
        latest = min(float(nominal.latency) + LATER, QUANTITIES["latency"].upper)
        upper = replace(upper, latency=max(float(upper.latency), latest))
    return UniformBox(lower, upper)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class InSteps:
    """A distribution of drones, simulated in other time steps."""

    drones: Distribution
    time_step: Float[Any, ""]
    """[s]."""

    @property
    def centre(self) -> Parameters:
        """The drone in the middle."""
        return replace(self.drones.centre, time_step=self.time_step)

    def draw(self, key: Array) -> Parameters:
        """Returns one drone."""
        return replace(self.drones.draw(key), time_step=self.time_step)


def ensemble(drones: Sequence[Parameters]) -> Ensemble:
    """Returns an ensemble of drones.

    Raises:
        InputError: no drone.
    """
    if not drones:
        raise InputError("an ensemble of no drones; give one or more.")
    return Ensemble(jax.tree.map(lambda *leaves: np.stack(leaves), *drones))


def stacked(distributions: Sequence[Distribution]) -> Distribution:
    """Distributions of one kind as one pytree, each leaf with a first axis of them, for `vmap`.

    Raises:
        InputError: they are of different kinds, or ensembles of different numbers of drones.
    """
    forms = {
        (jax.tree.structure(distribution), *map(np.shape, jax.tree.leaves(distribution)))
        for distribution in distributions
    }
    if len(forms) > 1:
        kinds = sorted({type(distribution).__name__ for distribution in distributions})
        raise InputError(
            f"distributions of different kinds or sizes ({', '.join(kinds)}); expected all of one "
            "kind, such as what mf.simulator.relative_box gives for each drone."
        )
    return jax.tree.map(lambda *leaves: np.stack(leaves), *distributions)


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
