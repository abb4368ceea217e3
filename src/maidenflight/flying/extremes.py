"""How far simulated flights went."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from maidenflight.flights.flight_plan import Extremes
from maidenflight.flying.rows import Rows


def extremes_of(rows: Rows) -> Extremes:
    """Returns how far a flight went."""
    true = np.asarray(rows.true_position, float)
    away = np.asarray(rows.true_setpoint, float) - true
    upright = np.cos(rows.true_attitude[:, 0]) * np.cos(rows.true_attitude[:, 1])
    command = np.asarray(rows.ratio)
    return Extremes(
        lateral_x=_largest(np.abs(true[:, 0])),
        lateral_y=_largest(np.abs(true[:, 1])),
        lowest=-_largest(-true[:, 2]),
        highest=_largest(true[:, 2]),
        tilt=_largest(np.arccos(np.clip(upright, -1.0, 1.0))),
        speed=_largest(np.linalg.norm(rows.true_velocity, axis=1)),
        astray=_largest(np.linalg.norm(away, axis=1)),
        sunk=_largest(away[:, 2]),
        at_limits=float(np.mean((command <= 0.0) | (command >= 1.0))),
    )


def _largest(values: Float[np.ndarray, "N"]) -> float:
    """The largest; a large number where a flight left the numbers."""
    worst = float(np.max(values)) if np.isfinite(values).all() else 1e6
    return min(worst, 1e6)


def worst_of(several: Sequence[Extremes]) -> Extremes:
    """Returns the extremes of several flights together."""
    rows = np.array([[getattr(one, name) for name in _NAMES] for one in several])
    lows = {"lowest": rows[:, _NAMES.index("lowest")].min()}
    highs = dict(zip(_NAMES, rows.max(axis=0), strict=True))
    return Extremes(**{name: float(value) for name, value in (highs | lows).items()})


_NAMES = list(Extremes.__dataclass_fields__)
