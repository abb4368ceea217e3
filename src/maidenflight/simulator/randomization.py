"""Domain randomization: drawing a drone from a distribution over xi."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array

from maidenflight.parameters import QUANTITIES, Parameters, replace

PAPER_FIELDS = ("thrust_to_weight", "time_step", "mass", "inertia", "motor_time_constant", "torque_to_thrust", "torque_offset")
"""What the paper randomizes (Gronauer et al. 2022, sec. Simulation Environment, Domain Randomization)."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RelativeBox:
    """Independent uniform factors about one drone; each component of a vector has its own."""

    nominal: Parameters
    lower: Parameters
    """Smallest factor of each field; 1 where it is not randomized."""
    upper: Parameters
    """Largest factor of each field."""

    def __str__(self) -> str:
        lines = []
        for name, quantity in QUANTITIES.items():
            low, high = (float(jnp.ravel(getattr(side, name))[0]) for side in (self.lower, self.upper))
            if low != high:
                value = " ".join(f"{entry:.4g}" for entry in jnp.ravel(getattr(self.nominal, name)).tolist())
                lines.append(f"{name} ~ {value} U({low:g}, {high:g}) {quantity.unit}")
        return "\n".join(lines)


def relative_box(nominal: Parameters, fraction: float = 0.10, fields: Sequence[str] = PAPER_FIELDS) -> RelativeBox:
    """A box of +-`fraction` about one drone.

    Args:
        nominal: the centre.
        fraction: half width as a share of the nominal value, in [0, 1).
        fields: names of the fields to randomize.

    Raises:
        ValueError: the fraction is out of range.
        InputError: a field is unknown.
    """
    if not 0 <= fraction < 1:
        raise ValueError(f"fraction = {fraction}, expected a share in [0, 1).")
    ones = jax.tree.map(jnp.ones_like, jax.tree.map(jnp.asarray, nominal))
    factor = {name: jnp.ones_like(getattr(ones, name)) for name in fields if name in QUANTITIES}
    unknown = {name: None for name in fields if name not in QUANTITIES}
    lower = replace(ones, **{name: (1 - fraction) * one for name, one in factor.items()}, **unknown)
    upper = replace(ones, **{name: (1 + fraction) * one for name, one in factor.items()}, **unknown)
    return RelativeBox(nominal, lower, upper)


def randomize(box: RelativeBox, key: Array) -> Parameters:
    """Draws one drone."""
    leaves, structure = jax.tree.flatten(box.nominal)
    keys = jax.tree.unflatten(structure, list(jax.random.split(key, len(leaves))))

    def draw(value: Array, low: Array, high: Array, key: Array) -> Array:
        return value * jax.random.uniform(key, jnp.shape(value), minval=low, maxval=high)

    return jax.tree.map(draw, box.nominal, box.lower, box.upper, keys)
