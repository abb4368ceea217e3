"""Do the columns of a log tell one story? Wrong signs, units and orders are found by holding one
signal against another.

Position must change as velocity says, attitude as body rates say, velocity as the tilt pushes, and
body rates as the motors turn the drone. Each relation is a correlation over hundreds of rows, so
that noise cancels; with too few rows or too little motion a relation stays silent. Thresholds leave
room for what real logs show. Over the flights of Gronauer et al. (163 of 100 rows or more) and
NanoBench (25) the least correlations are 0.53 for body rates and 0.74 for tilt, and over those of
300 rows or more 0.22 for velocity (-0.75 in a shorter one); and no other order of the motors
explains their body rates better.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations, permutations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from maidenflight.flights.log import Flight

FEWEST = 300
"""Samples below which nothing is concluded from estimates of position and velocity, which drift and
jump."""
FEWEST_TURNS = 100
"""The same for what hangs on the attitude, which is estimated far better."""
_GRAVITY = 9.81
_PITCH = " Positive pitch is nose down here, a Crazyflie's stateEstimate.pitch is nose up."
_TORQUES = np.array([[-1, -1, 1, 1], [-1, 1, 1, -1]]).T
"""Signs of the motors' roll and pitch torque; Gronauer et al. 2022, eq:torque."""


class Relation(NamedTuple):
    """Two signals that should be one: M samples of K axes."""

    says: str
    """What the first is called."""
    shows: str
    """What the second is called."""
    cures: tuple[str, ...]
    """What to look at where they have opposite signs, for each axis."""
    axes: tuple[str, ...]
    first: Float[np.ndarray, "M K"]
    second: Float[np.ndarray, "M K"]
    least: float
    """Standard deviation of both below which an axis is too quiet to judge."""
    fewest: int = FEWEST
    """Samples below which nothing is concluded."""


def relations(pieces: Sequence[Flight]) -> Iterator[Relation]:
    """The relations that can be looked at in gapless pieces of one flight."""
    xyz = ("x", "y", "z")
    changes = [_change(piece, 0.15, piece.position, piece.velocity) for piece in pieces]
    yield Relation(
        "velocity", "the change of position", ("", "", ""), xyz, *_joined(changes), least=0.08
    )
    turns = [_turn(piece, 0.06) for piece in pieces]
    yield Relation(
        "body_rate",
        "the change of attitude",
        ("", _PITCH, ""),
        xyz,
        *_joined(turns),
        least=0.15,
        fewest=FEWEST_TURNS,
    )
    push, gain = _joined(
        [_change(piece, 0.15, piece.velocity[:, :2], _push(piece)) for piece in pieces]
    )
    yield Relation(
        "change of velocity",
        "the push of the tilt",
        (_PITCH, ""),
        xyz[:2],
        gain,
        push,
        least=0.4,
        fewest=FEWEST_TURNS,
    )


def contradictions(pieces: Sequence[Flight]) -> list[str]:
    """What contradicts itself in gapless pieces of one flight.

    Empty if nothing does or too little can be seen.

    Returns:
        Sentences without the file's name: what, by how much, what to do.
    """
    if sum(map(len, pieces)) < FEWEST_TURNS:
        return []
    seen = (relation for relation in relations(pieces) if len(relation.first) >= relation.fewest)
    return [sentence for relation in seen for sentence in _judged(relation)] or _motors(pieces)


def _joined(parts: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    return np.concatenate([first for first, _ in parts]), np.concatenate(
        [second for _, second in parts]
    )


def _mean(values: np.ndarray, rows: int) -> np.ndarray:
    """Mean over `rows` steps, by the trapezium rule; `rows` fewer rows."""
    summed = np.cumsum((values[1:] + values[:-1]).astype(np.float64) / 2, axis=0)
    return np.concatenate([summed[rows - 1 : rows], summed[rows:] - summed[:-rows]]) / rows


def _change(
    piece: Flight, span: float, state: np.ndarray, rate: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A rate's mean over a span [s], and the state's change over it by time."""
    rows = min(max(round(span / piece.period), 1), len(piece) - 2)
    return _mean(rate, rows), (state[rows:] - state[:-rows]).astype(np.float64) / (
        rows * piece.period
    )


def _turn(piece: Flight, span: float) -> tuple[np.ndarray, np.ndarray]:
    rows = min(max(round(span / piece.period), 1), len(piece) - 2)
    attitude = Rotation.from_euler("ZYX", piece.attitude[:, ::-1])
    return _mean(piece.body_rates, rows), (attitude[:-rows].inv() * attitude[rows:]).as_rotvec() / (
        rows * piece.period
    )


def _push(piece: Flight) -> np.ndarray:
    """Horizontal acceleration of a drone that keeps its height [m/s2]."""
    roll, pitch, yaw = piece.attitude.astype(np.float64).T
    forward, left = np.tan(pitch), -np.tan(roll) / np.cos(pitch)
    return _GRAVITY * np.stack(
        [np.cos(yaw) * forward - np.sin(yaw) * left, np.sin(yaw) * forward + np.cos(yaw) * left],
        axis=1,
    )


def _correlation(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Correlations of each column with each; 0 for what is constant."""
    first, second = first - first.mean(axis=0), second - second.mean(axis=0)
    scale = np.linalg.norm(first, axis=0)[:, None] * np.linalg.norm(second, axis=0)
    return first.T @ second / np.maximum(scale, 1e-9)


_SCALES = {
    np.pi / 180: " It looks like rad where the format has deg, as a Crazyflie's own log has.",
    180 / np.pi: " It looks like deg where the format has rad.",
    1000.0: " It looks like mm where the format has m.",
    0.001: " It looks like m where the format has mm.",
}


def _looks_like(scale: float) -> str:
    """Which units were taken for each other, if a scale tells."""
    return next((said for known, said in _SCALES.items() if 0.9 < scale / known < 1.1), "")


def _judged(relation: Relation) -> Iterator[str]:
    match = _correlation(relation.first, relation.second)
    one, two = relation.first.std(axis=0), relation.second.std(axis=0)
    loud = np.minimum(one, two) > relation.least
    own = np.diag(match)
    over = f"over {len(relation.first)} rows"
    for a, b in combinations(range(len(own)), 2):
        crossed = np.abs([match[a, b], match[b, a]]).min()
        if loud[[a, b]].all() and crossed > 0.7 and np.abs(own[[a, b]]).max() < 0.5:
            yield (
                f"{relation.says} in {relation.axes[a]} and {relation.axes[b]} look swapped "
                f"against {relation.shows} (correlation across"
                f" {crossed:.2f} {over}). Put the columns in order."
            )
    for axis, name in enumerate(relation.axes):
        quiet, lively = sorted((one[axis], two[axis]))
        if loud[axis] and own[axis] < -0.6:
            yield (
                f"{relation.says} and {relation.shows} have opposite signs in {name} (correlation "
                f"{own[axis]:.2f} {over}). Turn the sign"
                f" of one.{relation.cures[axis]}"
            )
        elif lively > relation.least and own[axis] > 0.8 and lively > 4 * quiet:
            yield (
                f"{relation.says} is {one[axis] / two[axis]:.3g} times {relation.shows} in {name} "
                f"(correlation {own[axis]:.2f} {over});"
                f" expected 1.{_looks_like(one[axis] / two[axis])} Convert one."
            )
        elif lively > 3 * relation.least and quiet < 1e-6:
            still = relation.says if one[axis] == quiet else relation.shows
            yield (
                f"{still} never changes in {name} although the other does {over}. Log both, or "
                "leave the file out."
            )


def _motors(pieces: Sequence[Flight]) -> list[str]:
    """Says so if another order of the motors explains roll and pitch acceleration far better, 40 ms
    after the command.
    """
    accelerations, commands = [], []
    for piece in pieces:
        rows, late = max(round(0.08 / piece.period), 1), max(round(0.04 / piece.period), 1)
        if len(piece) > 3 * rows + late:
            rates, command = _mean(piece.body_rates[:, :2], rows), _mean(piece.command, rows)
            accelerations.append((rates[2:] - rates[:-2])[late:] / (2 * piece.period))
            commands.append(command[1:-1][:-late])
    if sum(map(len, commands)) < FEWEST:
        return []
    match = _correlation(np.concatenate(accelerations), np.concatenate(commands))
    spread = np.concatenate(commands)
    spread = np.cov((spread - spread.mean(axis=0)).T)

    def score(order: tuple[int, ...]) -> float:
        """Sum of the correlations of roll and pitch acceleration with their torques."""
        signs = _TORQUES[np.argsort(order)]
        power = np.sqrt(np.maximum(np.einsum("ik,ij,jk->k", signs, spread, signs), 1e-12))
        return float(np.sum(np.einsum("ki,ik->k", match * np.sqrt(np.diag(spread)), signs) / power))

    best = max(permutations(range(4)), key=score)
    gain = score(best) - score((0, 1, 2, 3))
    if score(best) < 0.6 or gain < 0.5:
        return []
    order = ", ".join(f"command_{motor + 1}" for motor in best)
    return [
        f"the motors look permuted: in the order {order} they explain roll and pitch acceleration "
        "(correlations sum to"
        f" {score(best):.2f}, as logged to {score(best) - gain:.2f}). Expected front right, back "
        "right, back left, front left."
    ]
