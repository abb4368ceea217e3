"""Reference trajectories: position as a function of time, never of step counts, so that every control rate sees the same one."""

from collections.abc import Callable
from functools import cache

import jax.numpy as jnp
from jaxtyping import Array, Float

Trajectory = Callable[[Float[Array, ""]], Float[Array, "3"]]
"""Time [s] to set-point [m], world."""


@cache
def circle(diameter: float = 0.5, period: float = 3.0, height: float = 1.0) -> Trajectory:
    """A level circle, clock-wise seen from above, that starts at (0, 0, height) towards +y with its centre on the x axis.

    Args:
        diameter: [m].
        period: [s].
        height: [m].

    Source: Gronauer et al. 2022, sec. Experimental Setup; start point from the authors' code.
    """
    radius = diameter / 2

    def reference(time: Float[Array, ""]) -> Float[Array, "3"]:
        angle = 2 * jnp.pi * time / period
        return jnp.stack([radius * (1 - jnp.cos(angle)), radius * jnp.sin(angle), jnp.full_like(angle, height)])

    return reference
