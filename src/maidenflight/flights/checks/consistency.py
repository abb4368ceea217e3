"""Consistency checks of a log: its signals are compared with each other.

Position must change as velocity says, attitude as body rates say, velocity as the tilt pushes, and
body rates as the motors turn the drone. Each relation is judged by a correlation and a slope over
hundreds of rows, so that noise cancels; with too few rows or too little motion it is not judged.
Thresholds leave room for what real logs show. Over the flights of Gronauer et al. (163 of 100 rows
or more) and NanoBench (25) the smallest correlations are 0.53 for body rates and 0.74 for tilt, and
over those of 300 rows or more 0.22 for velocity (-0.75 in a shorter one); the bounds of every slope
reach to 0.82 and 1.23 of what they should be at the worst; and in each the logged order of the
motors explains the body rates better than any other, 40 to 60 ms after the command.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations, permutations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from maidenflight.flights.log import Flight
from maidenflight.simulator.physics.geometry import TORQUES

FEWEST = 300
"""Samples below which nothing is concluded from estimates of position and velocity, which drift and
jump."""
FEWEST_TURNS = 100
"""The same for what hangs on the attitude, which is estimated far better."""
MAX_SCALE_ERROR = 1.45
"""Factor between two signals, certain despite their noise, above which one has a wrong scale."""
MAX_RESPONSE_S = 0.12
"""Delay after the command by which roll and pitch acceleration follow it on any small drone [s]."""
_LAGS_S = np.arange(-0.16, 0.2001, 0.02)
"""Delays that are tried [s]."""
_GRAVITY = 9.81
_PITCH = " Positive pitch is nose down here, a Crazyflie's stateEstimate.pitch is nose up."


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
    yield Relation(
        "yaw rate",
        "the change of yaw",
        ("",),
        ("z",),
        *_joined([_yaw(piece, 0.3) for piece in pieces]),
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
    if not pieces[0].has_state:
        return motor_contradictions(pieces)
    seen = [relation for relation in relations(pieces) if len(relation.first) >= relation.fewest]
    return (
        _scale_of_one_signal(seen)
        or [sentence for relation in seen for sentence in _judged(relation)]
        or motor_contradictions(pieces)
    )


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


def _yaw(piece: Flight, span: float) -> tuple[np.ndarray, np.ndarray]:
    rows = min(max(round(span / piece.period), 1), len(piece) - 2)
    roll, pitch, yaw = piece.attitude.astype(np.float64).T
    rate = (np.sin(roll) * piece.body_rates[:, 1] + np.cos(roll) * piece.body_rates[:, 2]) / np.cos(
        pitch
    )
    turned = np.unwrap(yaw)
    change = (turned[rows:] - turned[:-rows]) / (rows * piece.period)
    return _mean(rate[:, None], rows), change[:, None]


def _push(piece: Flight) -> np.ndarray:
    """Horizontal acceleration of a drone that keeps its height [m/s2]."""
    roll, pitch, yaw = piece.attitude.astype(np.float64).T
    forward, left = np.tan(pitch), -np.tan(roll) / np.cos(pitch)
    return _GRAVITY * np.stack(
        [np.cos(yaw) * forward - np.sin(yaw) * left, np.sin(yaw) * forward + np.cos(yaw) * left],
        axis=1,
    )


def _without_outliers(signal: np.ndarray) -> np.ndarray:
    """Every column within its own 5 and 95 % quantiles, so that single jumps count little."""
    return np.clip(signal, *np.quantile(signal, [0.05, 0.95], axis=0))


def _correlation(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Correlations of each column with each; 0 for what is constant."""
    first, second = first - first.mean(axis=0), second - second.mean(axis=0)
    scale = np.linalg.norm(first, axis=0)[:, None] * np.linalg.norm(second, axis=0)
    return first.T @ second / np.maximum(scale, 1e-9)


def slope_bounds(relation: Relation) -> Float[np.ndarray, "K 2"]:
    """Least and largest ratio of the first signal to the second that noise in either allows.

    With noise in the second alone the regression of the first on it is too flat, with noise in the
    first alone the inverse regression is too steep; the ratio lies between. NaN for an axis that is
    too quiet or too weakly correlated to judge.

    Source: Fuller 1987, Measurement error models, sec. 1.1.3.
    """
    first, second = _without_outliers(relation.first), _without_outliers(relation.second)
    own = np.diag(_correlation(first, second))
    one, two = first.std(axis=0), second.std(axis=0)
    judged = (own > 0.5) & (np.maximum(one, two) > relation.least) & (np.minimum(one, two) > 1e-6)
    ratio = np.where(judged, one, np.nan) / np.where(judged, two, 1.0)
    return np.stack([ratio * own, ratio / np.where(judged, own, 1.0)], axis=1)


def _scale(relation: Relation | None) -> float | None:
    """The factor between two signals.

    It is 1 if no axis has a wrong one, and `None` if no axis can be judged or wrong ones differ.
    """
    if relation is None:
        return None
    bounds = slope_bounds(relation)
    bounds = bounds[np.isfinite(bounds).all(axis=1)]
    if not len(bounds):
        return None
    wrong = (bounds[:, 0] > MAX_SCALE_ERROR) | (bounds[:, 1] < 1 / MAX_SCALE_ERROR)
    middle = np.sqrt(bounds.prod(axis=1))
    if not wrong.any():
        return 1.0
    alike = wrong.all() and middle.max() < 1.5 * middle.min()
    return float(np.exp(np.log(middle).mean())) if alike else None


def _scale_of_one_signal(relations: Sequence[Relation]) -> list[str]:
    """The one signal whose scale explains all wrong slopes of a flight, if there is one."""
    by_name = {relation.says: relation for relation in relations}
    turn, move, push = (
        _scale(by_name.get(name)) for name in ("body_rate", "velocity", "change of velocity")
    )

    def near(one: float | None, other: float | None) -> bool:
        return one is not None and other is not None and 1 / 1.4 < one / other < 1.4

    if turn not in (None, 1.0) and near(move, turn):
        scale, signal, evidence = turn, "time", "velocity and body rates both"
    elif move not in (None, 1.0) and push is not None and near(1 / push, move):
        scale, signal, evidence = move, "time", "velocity and tilt both"
    elif move not in (None, 1.0) and near(push, move):
        scale, signal, evidence = move, "velocity", "position and tilt both"
    elif move not in (None, 1.0) and push == 1.0:
        scale, signal, evidence = 1 / move, "position", "velocity, which fits the tilt,"
    elif turn not in (None, 1.0) and 1.0 in (move, push):
        scale, signal, evidence = turn, "body_rate", "attitude, while position fits velocity,"
    else:
        return []
    return [
        f"{signal} is {scale:.3g} times what it should be, as {evidence} tell;"
        f" expected 1.{_looks_like(scale)} Convert it."
    ]


_SCALES = {
    0.3048: " It looks like m where the rest has ft.",
    1 / 0.3048: " It looks like ft where the format has m.",
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
    own, bounds = np.diag(match), slope_bounds(relation)
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
        elif bounds[axis, 0] > MAX_SCALE_ERROR or bounds[axis, 1] < 1 / MAX_SCALE_ERROR:
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


def motor_contradictions(pieces: Sequence[Flight]) -> list[str]:
    """Whether roll and pitch acceleration follow the commands in the order and at the time logged.

    The order of the motors and the delay are searched together, since commands that are late look
    like another order at the delay that a drone has.
    """
    orders = list(permutations(range(4)))
    logged = orders.index((0, 1, 2, 3))
    responses = _responses(pieces)
    scores = np.stack([_scores(responses, float(lag), orders) for lag in _LAGS_S])
    if not np.isfinite(scores).all():
        return []
    possible = (_LAGS_S > -0.01) & (_LAGS_S < MAX_RESPONSE_S + 0.01)
    at, order = np.unravel_index(int(np.argmax(scores)), scores.shape)
    best, as_logged = scores[at, order], scores[possible, logged].max()
    if order == logged and best > 0.4 and best - as_logged > 0.35:
        return [
            f"roll and pitch acceleration follow the commands by {_LAGS_S[at]:.2f} s; expected 0 to"
            f" {MAX_RESPONSE_S:g} s. The commands have another clock than the rest: shift them."
        ]
    if order == logged or not possible[at] or best < 0.6 or best - as_logged < 0.5:
        return []
    right = ", ".join(f"command_{motor + 1}" for motor in orders[order])
    return [
        f"the motors look permuted: in the order {right} they explain roll and pitch acceleration "
        f"(correlations sum to {best:.2f}, as logged to {as_logged:.2f}). Expected front right, "
        "back right, back left, front left."
    ]


def _responses(pieces: Sequence[Flight]) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Roll and pitch acceleration, commands and period of each piece long enough to shift."""
    found = []
    for piece in pieces:
        rows = max(round(0.08 / piece.period), 1)
        if len(piece) <= 3 * rows + round(_LAGS_S[-1] / piece.period):
            continue
        rates, command = _mean(piece.body_rates[:, :2], rows), _mean(piece.command, rows)
        found.append(((rates[2:] - rates[:-2]) / (2 * piece.period), command[1:-1], piece.period))
    return found


def _scores(
    responses: Sequence[tuple[np.ndarray, np.ndarray, float]],
    lag: float,
    orders: Sequence[tuple[int, ...]],
) -> Float[np.ndarray, "24"]:
    """How well the commands a time `lag` [s] before explain roll and pitch acceleration.

    The sum of the correlations with their torques, for each order of the motors; NaN where there
    are too few rows.
    """
    accelerations, commands = [], []
    for acceleration, command, period in responses:
        late = round(lag / period)
        end = len(command) - abs(late)
        accelerations.append(acceleration[late:] if late >= 0 else acceleration[:end])
        commands.append(command[:end] if late >= 0 else command[-late:])
    if sum(map(len, commands)) < FEWEST:
        return np.full(len(orders), np.nan)
    command = np.concatenate(commands)
    match = _correlation(np.concatenate(accelerations), command)
    spread = np.cov((command - command.mean(axis=0)).T)
    signs = np.stack([TORQUES[np.argsort(order), :2] for order in orders])
    power = np.sqrt(np.maximum(np.einsum("oik,ij,ojk->ok", signs, spread, signs), 1e-12))
    sums = np.einsum("ki,oik->ok", match * np.sqrt(np.diag(spread)), signs)
    return np.sum(sums / power, axis=1)
