"""Whether a log counts true seconds.

Gyros count turns by the second, and gravity is a clock too: a tilt pushes by g tan(tilt), which
position shows as its second derivative, so that time which is s times too long makes that 1 / s^2
times too small. Velocity that an estimator or a motion capture made may follow either clock.
Without attitude and position nothing in a log counts time but the gyro, and no clock can be told.

Measured, body rates and gravity show 0.94 to 1.02 times in 87 sound logs (benchmarks/checkup.py).
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from maidenflight.flights.checkup.relations import LASTING, span_mean
from maidenflight.flights.checkup.result import FAILS, PASSES, WARNS, CheckResult, unknown
from maidenflight.flights.log import GRAVITY, Flight

CLOCK = "clock"
WORST = 1.14
"""Factor beyond which body rates and velocity show that time is wrong, and a log is refused."""
SCALES = 0.92, 1.04
"""Scales of time, by body rates and gravity, that sound logs do not leave."""
_OPPOSED = 1.02
"""By which one of them may speak against the other."""
_SPAN_S = 0.4
"""Time between positions of which second differences are taken [s]; shorter ones are noise."""
_CLEAR = 1.12
"""Ratio of the bounds of a scale by gravity up to which an axis tells."""


def push_of_tilt(
    roll: Float[np.ndarray, "N"], pitch: Float[np.ndarray, "N"], yaw: Float[np.ndarray, "N"]
) -> Float[np.ndarray, "N 2"]:
    """Returns the horizontal acceleration of a drone that keeps its height [m/s2]."""
    forward, left = np.tan(pitch), -np.tan(roll) / np.cos(pitch)
    along_x = np.cos(yaw) * forward - np.sin(yaw) * left
    along_y = np.sin(yaw) * forward + np.cos(yaw) * left
    return GRAVITY * np.stack([along_x, along_y], axis=1)


def time_by_gravity(pieces: Sequence[Flight]) -> float | None:
    """Measures by which factor time is too long, as g tan(tilt) bends the path.

    What velocity explains is drag, and taken out. Noise is in either signal, so that a scale lies
    between the two regressions.

    Args:
        pieces: of one flight with a state, whose tilt is right.

    Returns:
        None where the path bends too little.

    Source: Fuller 1987, Measurement error models, sec. 1.1.3 (bounds by two regressions).
    """
    bent = [_bends(piece) for piece in pieces]
    if sum(map(len, bent)) * pieces[0].period < LASTING * _SPAN_S:
        return None
    table = np.concatenate(bent)
    scales = []
    for bend, push, speed in (table - table.mean(axis=0)).T:
        drag = speed / max(float(np.sqrt(speed @ speed)), 1e-9)
        own, pushed = (vector - drag * (drag @ vector) for vector in (bend, push))
        shared = float(own @ pushed)
        if shared <= 0.0:
            continue
        bounds = shared / float(pushed @ pushed), float(own @ own) / shared
        if bounds[1] < _CLEAR**2 * bounds[0]:
            scales.append(-0.25 * np.log(bounds).sum())
    return float(np.exp(np.mean(scales))) if scales else None


def _bends(piece: Flight) -> Float[np.ndarray, "M 3 2"]:
    """Returns acceleration by position, that which tilt gives, and velocity, along x and y."""
    rows = max(2, round(_SPAN_S / piece.period))
    if len(piece) < 4 * rows:
        return np.zeros((0, 3, 2))
    position, span = piece.position[:, :2].astype(float), rows * piece.period
    push = push_of_tilt(*piece.attitude.astype(float).T)
    before, at, after = position[: -2 * rows], position[rows:-rows], position[2 * rows :]
    # A second difference weighs acceleration by a triangle: a mean of means.
    return np.stack(
        [
            (after - 2 * at + before) / span**2,
            span_mean(span_mean(push, rows), rows),
            (after - before) / (2 * span),
        ],
        axis=1,
    )


def check_clock(turns: float | None, moves: float | None, bends: float | None) -> CheckResult:
    """Checks whether time is true.

    Args:
        turns: by which factor body rates exceed the change of attitude.
        moves: by which velocity exceeds the change of position.
        bends: by which gravity shows time to be too long.
    """
    if turns is None or (moves is None and bends is None):
        return unknown(CLOCK, "the state moves too little to show a wrong clock")
    clocks = [f"body rates against attitude ({turns:.2f})"]
    clocks += [] if moves is None else [f"velocity against position ({moves:.2f})"]
    clocks += [] if bends is None else [f"gravity against the bends of the path ({bends:.2f})"]
    by_state = None if moves is None else float(np.sqrt(turns * moves))
    by_gravity = None if bends is None else float(np.sqrt(turns * bends))
    measured = by_state if by_gravity is None else by_gravity
    low, high = SCALES
    is_wrong = is_far = False
    if moves is not None and by_state is not None:
        alike = (turns > 1) == (moves > 1) and _is_near(turns / moves, 1.45)
        alike &= not _is_near(turns, 1.06) and not _is_near(moves, 1.04)
        is_far = alike and not _is_near(by_state, WORST)
        is_wrong = alike and turns > 1 and bends is None
        measured = by_state if is_far else measured
    if bends is not None and by_gravity is not None and not low < by_gravity < high:
        side = 1.0 if by_gravity > 1 else -1.0
        is_wrong = bends**side > _OPPOSED and turns**side > 1 / _OPPOSED
    limits = SCALES if bends is not None else (1 / WORST, WORST)
    threshold = f"{limits[0]:.2f} .. {limits[1]:.2f}"
    if is_far or is_wrong:
        cause = f"time is {measured:.3g} times what it should be, as {_listed(clocks)} show alike."
        remedy = "Convert the column of time."
        return CheckResult(CLOCK, FAILS if is_far else WARNS, cause, measured, threshold, remedy)
    if by_state is not None and not _is_near(by_state, WORST):
        return unknown(CLOCK, "scales of body rates and velocity have to be mended first", by_state)
    if bends is None and not _is_near(turns, 1.06):
        return unknown(CLOCK, f"{_listed(clocks)} do not show which is wrong", by_state)
    return CheckResult(CLOCK, PASSES, f"{_listed(clocks)} keep time", measured, threshold)


def _is_near(factor: float, limit: float) -> bool:
    return bool(abs(np.log(max(factor, 1e-9))) <= np.log(limit))


def _listed(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else names[0]
