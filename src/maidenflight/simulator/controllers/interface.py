"""Control interface: what a policy's four outputs mean to a drone.

One `ControlInterface` is shared by the policy, the simulated controller, every exporter and the
radio link, so that none of them can scale an output differently from the others.
"""

import math
import re
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, Self, cast

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maidenflight.errors import InputError
from maidenflight.names import CONTROLS
from maidenflight.simulator.physics.battery import COUNTS, MOST_COUNTS

Four = tuple[float, float, float, float]

THRUST = "share of full thrust"
"""Unit of a command u from 0, of one motor or of all; 1 stands for `full_scale_counts`."""
HIGHEST_RATE_DEG = 60.0
"""Body rate [deg/s] that attitude-rate control can ask for (Gronauer et al. 2022, sec.
Discussion)."""
LARGEST_ANGLE_DEG = 10.0
"""Roll, pitch and yaw [deg] that attitude control can ask for. Source: the authors' code."""
THRUST_REACH = 0.25
"""Share of full thrust by which attitude control reaches to both sides of hovering, where it does
not have the paper's range."""
UNITS: dict[str, tuple[str, str, str, str]] = dict(
    zip(
        CONTROLS,
        (
            (THRUST, THRUST, THRUST, THRUST),
            (THRUST, "rad/s", "rad/s", "rad/s"),
            (THRUST, "rad", "rad", "rad"),
        ),
        strict=True,
    )
)
"""Units of the paper's control structures by their names, which mean nothing else."""

NOTE = "maidenflight"
"""Attribute of the space of observations of a Gymnasium environment of ours, which learners keep
beside their policies: control, rate, history and look-ahead."""

_LARGEST = 1e6
"""Of `centre` and `span`, in their units."""
_NAME = re.compile(r"[a-z][a-z0-9_]{0,39}")
_UNIT = re.compile(r"[A-Za-z0-9 /^.%()-]{1,40}")


@dataclass(frozen=True)
class ControlInterface:
    """What four actions command: command = centre + span clip(action, -1, 1).

    Hashable, for use as a static argument.

    Raises:
        InputError: a field is not what it should be.
    """

    name: str
    """Of the control structure: lower-case letters, digits and underscores."""
    centre: Four
    """Commands of actions of zero, in `units`."""
    span: Four
    """What an action of 1 adds, in `units`; positive."""
    units: tuple[str, str, str, str]
    """`THRUST`, `"rad/s"`, `"rad"` or others, one a command."""
    rate: int
    """Actions a second [Hz]."""
    full_scale_counts: float = COUNTS
    """Counts of a Crazyflie's firmware, at most 65535, that a share of 1 stands for: those of the
    logs from which the drone was identified."""

    def __post_init__(self) -> None:
        """Checks every field and makes numbers floats, so that equal interfaces are equal bytes."""
        if not isinstance(self.name, str) or not _NAME.fullmatch(self.name):
            raise InputError(
                f"control interface: name = {self.name!r}; expected lower-case letters, digits and "
                "underscores, such as 'attitude_rate'."
            )
        for name in ("centre", "span"):
            object.__setattr__(self, name, _four(name, getattr(self, name)))
        if min(self.span) < 1.0 / _LARGEST:
            raise InputError(
                f"control interface: span = {self.span}; expected numbers from {1 / _LARGEST:g}."
            )
        units: Any = self.units
        if (
            not isinstance(units, tuple | list)
            or len(units) != 4
            or not all(isinstance(unit, str) and _UNIT.fullmatch(unit) for unit in units)
        ):
            raise InputError(
                f"control interface: units = {units!r}; expected four, such as {THRUST!r}, 'rad/s'."
            )
        object.__setattr__(self, "units", tuple(units))
        if self.units != UNITS.get(self.name, self.units):
            raise InputError(
                f"control interface: units = {self.units}, but commands of {self.name} are in "
                f"{UNITS[self.name]}. Choose another name."
            )
        if type(self.rate) is not int or not 1 <= self.rate <= 1000:
            raise InputError(
                f"control interface: rate = {self.rate!r}; expected a whole number from 1 to 1000."
            )
        counts = self.full_scale_counts
        if not _is_number(counts) or not 0.0 < counts <= MOST_COUNTS:
            raise InputError(
                f"control interface: full_scale_counts = {counts!r}; expected a number above 0 and "
                f"at most {MOST_COUNTS:g}."
            )
        object.__setattr__(self, "full_scale_counts", float(counts))

    def command(
        self, action: Float[Array, "4"], factors: Four = (1.0, 1.0, 1.0, 1.0)
    ) -> Float[Array, "4"]:
        """Returns the command of an action: `scaled` of what is clipped to [-1, 1]."""
        return self.scaled(jnp.clip(action, -1.0, 1.0), factors)

    def scaled(
        self, action: Float[Array, "4"], factors: Four = (1.0, 1.0, 1.0, 1.0)
    ) -> Float[Array, "4"]:
        """Returns centre + span action, without clipping.

        Args:
            action: [-].
            factors: from `units` to those of the result.
        """
        centre, span = (
            jnp.asarray(np.multiply(numbers, factors).astype(np.float32))
            for numbers in (self.centre, self.span)
        )
        return centre + span * action

    @property
    def level_line(self) -> tuple[Four, Four]:
        """Slope and offset of `level`: action = slope u + offset."""
        slope = tuple(
            1.0 / span if unit == THRUST else 0.0
            for unit, span in zip(self.units, self.span, strict=True)
        )
        offset = tuple(
            0.0 - centre / span for centre, span in zip(self.centre, self.span, strict=True)
        )
        return cast(Four, slope), cast(Four, offset)

    def level(self, share: Float[Array, ""]) -> Float[Array, "4"]:
        """Returns the action that commands a share u of full thrust and zero of everything else."""
        slope, offset = (jnp.array(numbers, jnp.float32) for numbers in self.level_line)
        return slope * share + offset

    def to_dict(self) -> dict[str, Any]:
        """Returns plain values for a file."""
        return asdict(self)

    @classmethod
    def from_dict(cls, content: Any) -> Self:
        """Returns what `to_dict` gave, read back.

        Raises:
            InputError: a field is missing, unknown or not what it should be.
        """
        fields = cls.__dataclass_fields__.keys()
        if not isinstance(content, dict) or content.keys() != fields:
            raise InputError(
                f"control interface: {str(content)[:80]!r}; expected {', '.join(fields)}."
            )
        return cls(**content)


def pwm(
    action_rate: int = 100, full_scale_counts: float = COUNTS, most: float = 1.0
) -> ControlInterface:
    """Returns the thrust commands of the four motors, u = most (clip(a, -1, 1) + 1) / 2.

    Args:
        action_rate: actions a second [Hz].
        full_scale_counts: see `ControlInterface`.
        most: largest command [-]; above 1 for drones that need what the battery has beyond it.

    Source: Gronauer et al. 2022, sec. Motor Model and sec. Control Structures.
    """
    half: Four = (most / 2.0, most / 2.0, most / 2.0, most / 2.0)
    return ControlInterface("pwm", half, half, UNITS["pwm"], action_rate, full_scale_counts)


def attitude_rate(
    action_rate: int = 50,
    highest_rate: float = HIGHEST_RATE_DEG,
    full_scale_counts: float = COUNTS,
) -> ControlInterface:
    """Returns the collective thrust from 0 to 1 and body rates of up to `highest_rate` [deg/s].

    Raises:
        InputError: the highest rate is not positive and finite.

    Source: Gronauer et al. 2022, sec. Control Structures; scales from the authors' code.
    """
    if not _is_number(highest_rate) or not 0.0 < highest_rate < math.inf:
        raise InputError(
            f"highest_rate = {highest_rate} deg/s; expected a positive number. The paper's is "
            f"{HIGHEST_RATE_DEG:g}."
        )
    rate = math.radians(highest_rate)
    return ControlInterface(
        "attitude_rate",
        (0.5, 0.0, 0.0, 0.0),
        (0.5, rate, rate, rate),
        UNITS["attitude_rate"],
        action_rate,
        full_scale_counts,
    )


def attitude(
    action_rate: int = 25, full_scale_counts: float = COUNTS, hover: float | None = None
) -> ControlInterface:
    """Returns collective thrust about hovering, or from 7/12 to 11/12, and angles of up to 10 deg.

    The paper's range of thrust lifts a drone whose thrust-to-weight ratio is above 1.71: it cannot
    descend.

    Args:
        action_rate: actions a second [Hz].
        full_scale_counts: see `ControlInterface`.
        hover: share of full thrust that the drone hovers at; thrust then reaches `THRUST_REACH` to
            both sides of it, within 0 and 1. None: the paper's range.

    Raises:
        InputError: the share is not between 0 and 1.

    Source: Gronauer et al. 2022, sec. Control Structures; scales from the authors' code.
    """
    if hover is not None and not (_is_number(hover) and 0.0 < hover <= 1.0):
        raise InputError(
            f"hover = {hover}; expected the share of full thrust that the drone hovers at, above 0 "
            "and at most 1."
        )
    angle = math.radians(LARGEST_ANGLE_DEG)
    centre, span = 0.75, 1.0 / 6.0
    if hover is not None:
        least, most = max(hover - THRUST_REACH, 0.0), min(hover + THRUST_REACH, 1.0)
        centre, span = (most + least) / 2.0, (most - least) / 2.0
    return ControlInterface(
        "attitude",
        (centre, 0.0, 0.0, 0.0),
        (span, angle, angle, angle),
        UNITS["attitude"],
        action_rate,
        full_scale_counts,
    )


INTERFACES: dict[str, Callable[..., ControlInterface]] = {
    name: globals()[name] for name in CONTROLS
}
"""The paper's interfaces by name, each a function of this module; all take `action_rate` and
`full_scale_counts`."""


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _four(name: str, numbers: Any) -> Four:
    if (
        not isinstance(numbers, tuple | list)
        or len(numbers) != 4
        or not all(_is_number(number) and abs(number) <= _LARGEST for number in numbers)
    ):
        raise InputError(
            f"control interface: {name} = {numbers!r}; expected four numbers of at most "
            f"{_LARGEST:g}."
        )
    return cast(Four, tuple(map(float, numbers)))
