"""Look-ahead: where the reference will be at the next instants, as part of an observation.

Source: Chen et al. 2024, "What Matters in Learning a Zero-Shot Sim-to-Real RL Policy for Quadrotor
Control?" (SimpleFlight), whose policies see the next positions of the reference relative to the
drone.
"""

from dataclasses import dataclass
from typing import Any, Self

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maidenflight.errors import InputError
from maidenflight.simulator.tasks.trajectories import Trajectory

MOST_POINTS = 50
SPACING = 0.1
"""Time between two points by default [s]."""
_SHORTEST, _LONGEST = 1e-3, 10.0


@dataclass(frozen=True)
class LookAhead:
    """K points of the reference, at t + spacing, t + 2 spacing, ..., t + K spacing.

    An observation has their positions relative to the drone's measured position, world [m], behind
    its last instant. Where a trajectory has ended, its last point repeats. Hashable,
    for use as a static argument.

    Raises:
        InputError: a field is not what it should be.
    """

    points: int = 0
    """K; 0: no look-ahead."""
    spacing: float = SPACING
    """Time between two points [s]."""

    def __post_init__(self) -> None:
        """Checks both fields."""
        if type(self.points) is not int or not 0 <= self.points <= MOST_POINTS:
            raise InputError(
                f"look-ahead: points = {self.points!r}; expected a whole number from 0 to "
                f"{MOST_POINTS}."
            )
        spacing = self.spacing
        if (
            isinstance(spacing, bool)
            or not isinstance(spacing, int | float)
            or not _SHORTEST <= spacing <= _LONGEST
        ):
            raise InputError(
                f"look-ahead: spacing = {spacing!r} s; expected {_SHORTEST:g} to {_LONGEST:g} s "
                "between two points."
            )
        object.__setattr__(self, "spacing", float(spacing))

    @property
    def size(self) -> int:
        """Numbers that it adds to an observation."""
        return 3 * self.points

    @property
    def times(self) -> Float[np.ndarray, "K"]:
        """How far ahead the points are [s]."""
        return (np.arange(1, self.points + 1) * self.spacing).astype(np.float32)

    @property
    def deviations(self) -> Float[np.ndarray, "3K"]:
        """By which a new policy scales it [m]: 0.1, as the present error, and 1 m/s times ahead."""
        return np.repeat(np.float32(0.1) + self.times, 3)

    def of(self, reference: Trajectory, time: Float[Array, ""]) -> Float[Array, "K 3"]:
        """Positions of a reference ahead of a time [s], world [m]."""
        return jax.vmap(reference)(time + jnp.asarray(self.times))

    def to_dict(self) -> dict[str, Any]:
        """Returns plain values for a file."""
        return {"points": self.points, "spacing": self.spacing}

    @classmethod
    def from_dict(cls, content: Any) -> Self:
        """Returns what `to_dict` gave, read back.

        Raises:
            InputError: a field is missing, unknown or not what it should be.
        """
        fields = cls.__dataclass_fields__.keys()
        if not isinstance(content, dict) or content.keys() != fields:
            raise InputError(f"look-ahead: {str(content)[:80]!r}; expected {', '.join(fields)}.")
        return cls(**content)


NONE = LookAhead()
"""No look-ahead, as in the paper."""
