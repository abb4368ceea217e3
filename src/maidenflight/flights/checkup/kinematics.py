"""Tests of the state: body rates turn the attitude, velocity moves the position, tilt pushes.

Kinematics holds to 1 or 2 %, so that signs, axes, frames, units and clocks show. Where a signal
matches another as it was logged far worse than under another reading, that reading is named.

Real estimates leave room. Over the flights of Gronauer et al., NanoBench and three other sources,
and in flights of virtual drones, scales of body rates lie within 0.87 and 1.08, of velocity within
0.7 and 1.4, and the gyro is 9 ms before to 5 ms behind the attitude.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from maidenflight.flights.checkup import relations
from maidenflight.flights.checkup.clock import check_clock, push_of_tilt, time_by_gravity
from maidenflight.flights.checkup.relations import Match, Measure, Samples, span_mean
from maidenflight.flights.checkup.result import FAILS, PASSES, WARNS, CheckResult, unknown
from maidenflight.flights.log import Flight

LEAST_RATE, LEAST_SPEED, LEAST_PUSH = 0.03, 0.012, 0.25
"""Standard deviations below which an axis is too quiet to judge [rad/s, m/s, m/s2]."""
MATCH = 0.7
"""Mean correlation from which a reading explains a signal."""
MARGIN = 0.35
"""By which it must explain it better than the signal as logged."""
FRAME, FRAME_MARGIN, FRAME_ERRORS = "velocity frame", 1.5, 2.0
"""Test of the axes of velocity: by which squared errors must differ between those of world and
body, as a ratio and in standard errors; measured, 1.3 at most in 111 sound logs."""
_FRAME_SPAN_S = 0.3
"""Time over which velocity is averaged for that [s]."""
_FROM_WORLD = "turned from world to body axes"
NEAR = 6.0
"""Or so many times more closely, where it matches to `CLOSE`."""
CLOSE = 0.97
SCALES = {"body_rate": 1.2, "velocity": 1.3}
"""Factors beyond which a scale is wrong."""
CERTAIN = {"body_rate": 1.4, "velocity": 1.9}
"""Those beyond which the log is refused for it, not only warned of."""
LATEST_S, FAR_S = 0.018, 0.045
"""Delay of the gyro against the attitude beyond which one of both is late, and beyond which the log
is refused for it: an attitude that came by radio is late too [s]."""
_LAG_SPAN_S, _LAGS_S = 0.15, 0.12
_UNITS = {
    "body_rate": {np.pi / 180: "rad where the format has deg", 180 / np.pi: "deg for rad"}
    | {1e3: "mrad for rad", 1e-3: "rad where the format has mrad"},
    "velocity": {0.3048: "velocity in m, position in ft", 1 / 0.3048: "velocity in ft"}
    | {1e-3: "position in mm", 1e3: "velocity in mm", 1e-2: "position in cm", 1e2: "in cm"}
    | {3.6: "velocity in km/h"},
}
"""By definition of the units."""
_EXPECTED = " Expected x forward, y left, z up."
_PITCH = " Positive pitch is nose down here, a Crazyflie's stateEstimate.pitch is nose up."

AXES: Mapping[str, Float[np.ndarray, "3 3"]] = {
    "x with the opposite sign": np.diag([-1.0, 1.0, 1.0]),
    "y with the opposite sign": np.diag([1.0, -1.0, 1.0]),
    "z with the opposite sign": np.diag([1.0, 1.0, -1.0]),
    "x and y with opposite signs (a frame turned by 180 deg)": np.diag([-1.0, -1.0, 1.0]),
    "y and z with opposite signs (forward, right, down)": np.diag([1.0, -1.0, -1.0]),
    "x and z with opposite signs": np.diag([-1.0, 1.0, -1.0]),
    "all axes with the opposite sign": -np.eye(3),
    "x and y swapped": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]),
    "x and y swapped, z with the opposite sign": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]),
    "a frame turned by 90 deg": np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
    "a frame turned by -90 deg": np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
}
"""Ways in which a vector's axes may be read, by definition of each."""


def rotations(flight: Flight) -> Rotation:
    """Returns the attitude of each row, body to world.

    As `physics.rotations.from_attitude`: `Rotation.from_euler` takes nine times as long.
    """
    half = flight.attitude.T.astype(float) / 2
    (sin_r, sin_p, sin_y), (cos_r, cos_p, cos_y) = np.sin(half), np.cos(half)
    quaternion = (
        sin_r * cos_p * cos_y - cos_r * sin_p * sin_y,
        cos_r * sin_p * cos_y + sin_r * cos_p * sin_y,
        cos_r * cos_p * sin_y - sin_r * sin_p * cos_y,
        cos_r * cos_p * cos_y + sin_r * sin_p * sin_y,
    )
    return Rotation.from_quat(np.stack(quaternion, axis=1))


def turn(piece: Flight, rows: int) -> Samples:
    """Measures mean body rates, and the turn of the attitude by time [rad/s]."""
    attitude = rotations(piece)
    turned = (attitude[:-rows].inv() * attitude[rows:]).as_rotvec()
    return span_mean(piece.body_rates, rows), turned / (rows * piece.period)


def move(piece: Flight, rows: int) -> Samples:
    """Measures mean velocity, and the change of position by time [m/s]."""
    moved = (piece.position[rows:] - piece.position[:-rows]).astype(np.float64)
    return span_mean(piece.velocity, rows), moved / (rows * piece.period)


def _turn_of_world(piece: Flight, rows: int) -> Samples:
    first, second = turn(piece, rows)
    middle = rotations(piece)[rows // 2 : rows // 2 + len(first)]
    return middle.inv().apply(first), second


def push(
    change: Callable[[Float[np.ndarray, "3 N"]], Float[np.ndarray, "3 N"]],
    piece: Flight,
    rows: int,
) -> Samples:
    """Measures the change of horizontal velocity by time, and what a tilt pushes [m/s2].

    Of a drone that keeps its height; `change` is how roll, pitch and yaw are read.
    """
    roll, pitch, yaw = change(piece.attitude.astype(np.float64).T)
    pushed = push_of_tilt(roll, pitch, yaw)
    gained = (piece.velocity[rows:, :2] - piece.velocity[:-rows, :2]).astype(np.float64)
    return gained / (rows * piece.period), span_mean(pushed, rows)


def _push_swapped(piece: Flight, rows: int) -> Samples:
    gained, pushed = push(_scaled(1, 1, 1), piece, rows)
    return gained[:, ::-1], pushed


def _scaled(*factors: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda angles: angles * np.array(factors)[:, None]


def _yaw_turned(by: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda angles: angles + np.array([0.0, 0.0, by])[:, None]


_PUSHES: Mapping[str, Measure] = {
    "": partial(push, _scaled(1, 1, 1)),
    "pitch with the opposite sign": partial(push, _scaled(1, -1, 1)),
    "roll with the opposite sign": partial(push, _scaled(-1, 1, 1)),
    "roll and pitch with opposite signs": partial(push, _scaled(-1, -1, 1)),
    "yaw with the opposite sign": partial(push, _scaled(1, 1, -1)),
    "pitch and yaw with opposite signs": partial(push, _scaled(1, -1, -1)),
    "yaw turned by 90 deg": partial(push, _yaw_turned(np.pi / 2)),
    "yaw turned by -90 deg": partial(push, _yaw_turned(-np.pi / 2)),
    "x and y of the world swapped": _push_swapped,
    "roll and pitch swapped": partial(push, lambda angles: angles[[1, 0, 2]]),
}


def check_state(pieces: Sequence[Flight]) -> list[CheckResult]:
    """Checks body rates, velocity, tilt and clock of pieces of one flight with a state."""
    pieces = relations.take_enough(pieces)
    turned, moved = (relations.sample_spans(pieces, relation) for relation in (turn, move))
    turns, moves = (relations.match(samples) if samples else None for samples in (turned, moved))
    scale = {
        "body_rate": _scale(turns, LEAST_RATE, (0, 1)),
        "velocity": _scale(moves, LEAST_SPEED, (0, 1, 2)),
    }
    turns_read, moves_read = _read_axes(turned), _read_axes(moved)
    turns_read[_FROM_WORLD] = relations.sample_spans(pieces, _turn_of_world)
    frames = [
        _check_reading("body_rate", "the change of attitude", turns_read, LEAST_RATE),
        _check_reading("velocity", "the change of position", moves_read, LEAST_SPEED),
    ]
    frame = unknown(FRAME, "velocity has to be mended first")
    if frames[1].verdict == FAILS:
        frames.append(unknown("tilt", "velocity has to be mended first"))
    else:
        frame = _check_frame(pieces)
        pushes = {name: relations.sample_spans(pieces, change) for name, change in _PUSHES.items()}
        frames.append(_check_reading("tilt", "the change of velocity", pushes, LEAST_PUSH))
    frames = _blame(frames)
    if dead := _dead_axis(turned):
        cause = f"body_rate never changes in {dead} although the attitude does."
        frames[0] = CheckResult("body_rate", FAILS, cause, 0.0, remedy="Log all axes.")
    turned_by, moved_by = (
        None if bounds is None else float(np.sqrt(bounds.prod())) for bounds in scale.values()
    )
    # Gravity is a clock where the tilt is right.
    is_read = all(result.verdict == PASSES for result in frames)
    clock = check_clock(turned_by, moved_by, time_by_gravity(pieces) if is_read else None)
    scales = [_check_scale(name, bounds) for name, bounds in scale.items()]
    return [*frames, frame, clock, *scales, _check_gyro_delay(pieces)]


def _check_frame(pieces: Sequence[Flight]) -> CheckResult:
    """Checks by the change of position whether velocity is along the axes of world or body."""
    parts = []
    for piece in pieces:
        rows = max(1, round(_FRAME_SPAN_S / piece.period))
        if len(piece) > 4 * rows:
            velocity, moved = move(piece, rows)
            turned = span_mean(rotations(piece).apply(piece.velocity.astype(float)), rows)
            parts.append(np.stack([velocity, turned, moved])[:, ::rows])
    if sum(part.shape[1] for part in parts) < _FEWEST_BLOCKS:
        return unknown(FRAME, "too short to tell velocity in the world's axes from the body's")
    read = np.concatenate(parts, axis=1)
    as_world, as_body, moved = read - read.mean(axis=1, keepdims=True)
    world, body = (
        ((moved - model * (model * moved).sum() / max((model**2).sum(), 1e-12)) ** 2).sum(axis=1)
        for model in (as_world, as_body)
    )
    ratio = float(world.mean() / max(body.mean(), 1e-12))
    error = float((world - body).std() / np.sqrt(len(world)))
    threshold = f"below {FRAME_MARGIN:g}"
    text = f"squared errors of velocity in the world's axes are {ratio:.2f} times the body's"
    difference = float(np.mean(world - body))
    if max(ratio, 1 / max(ratio, 1e-9)) < FRAME_MARGIN or abs(difference) < FRAME_ERRORS * error:
        return unknown(FRAME, f"{text}: it yaws and moves too little to tell", ratio)
    if ratio < 1:
        return CheckResult(FRAME, PASSES, text, ratio, threshold)
    cause = f"velocity looks like that along the body's axes: {text}."
    remedy = "Turn it into the world's axes by the attitude."
    certain = ratio > 2 * FRAME_MARGIN and difference > 2 * FRAME_ERRORS * error
    return CheckResult(FRAME, FAILS if certain else WARNS, cause, ratio, threshold, remedy)


def _dead_axis(samples: Sequence[Samples]) -> str:
    """Returns the axis of which the first signal never changes while the second does."""
    for first, second in samples[:1]:
        for axis, name in enumerate("xyz"):
            if first[:, axis].std() < 1e-6 and second[:, axis].std() > 5 * LEAST_RATE:
                return name
    return ""


def _blame(frames: list[CheckResult]) -> list[CheckResult]:
    """Says which of two signals that contradict each other is wrong, where a third one tells."""
    rates, _, tilt = frames
    if rates.verdict != FAILS:
        return frames
    remark = {
        FAILS: " The change of velocity contradicts the attitude too: mend the attitude first.",
        PASSES: " The change of velocity fits the attitude, so that the body rates are wrong.",
    }.get(tilt.verdict, "")
    pitch = _PITCH if tilt.verdict != PASSES and "y with" in rates.cause else ""
    cause = rates.cause.replace(_EXPECTED, remark + _EXPECTED)
    return [replace(rates, cause=cause, remedy=rates.remedy + pitch), *frames[1:]]


def _read_axes(samples: Sequence[Samples]) -> dict[str, list[Samples]]:
    """Returns samples of the first signal as logged, and with its axes read in other ways."""
    readings = {"": [*samples]}
    for name, axes in AXES.items():
        readings[name] = [(first @ axes.T, second) for first, second in samples]
    return readings


def _check_reading(
    name: str, other: str, readings: Mapping[str, Sequence[Samples]], least: float
) -> CheckResult:
    best = relations.best_reading(readings, least)
    if best is None:
        return unknown(name, f"{name} and {other} move too little, or for too short a time")
    is_clear = best.score > MATCH and best.score - best.logged > MARGIN
    is_clear |= best.score > CLOSE and 1 - best.logged > max(NEAR * (1 - best.score), 0.05)
    threshold = f"within {MARGIN:g} of the best reading"
    if best.name and is_clear:
        pitch = _PITCH if name == "tilt" and best.name.startswith("pitch") else ""
        return CheckResult(
            name,
            FAILS,
            f"{name} and {other} match to {best.logged:.2f} as logged, and to {best.score:.2f} "
            f"with {best.name}.{_EXPECTED}",
            best.logged,
            threshold,
            f"Convert it.{pitch}",
        )
    if best.logged < 0.5:
        return unknown(name, f"{name} and {other} match to {best.logged:.2f} only", best.logged)
    sentence = f"{name} and {other} match to {best.logged:.2f}"
    return CheckResult(name, PASSES, sentence, best.logged, threshold)


def _scale(
    matched: Match | None, least: float, axes: tuple[int, ...]
) -> Float[np.ndarray, "2"] | None:
    """Bounds of the scale that the axes agree on; None where none tells."""
    if matched is None:
        return None
    clear_axes = [
        axis for axis in axes if matched.correlation[axis] > 0.9 and matched.size[axis] > least / 2
    ]
    # A wrong unit hides the lesser signal; a strong match is enough then.
    if not clear_axes:
        clear_axes = [axis for axis in axes if matched.correlation[axis] > 0.97]
    if not clear_axes:
        return None
    bounds = matched.bounds()[clear_axes]
    middle = float(np.median(np.sqrt(bounds.prod(axis=1))))
    width = float(np.max(np.sqrt(bounds[:, 1] / bounds[:, 0])))
    return np.array([middle / width, middle * width])


def _check_scale(name: str, bounds: Float[np.ndarray, "2"] | None) -> CheckResult:
    title = f"{name} scale"
    if bounds is None:
        return unknown(title, f"{name} moves too little to show its scale")
    limit = SCALES[name]
    middle = float(np.sqrt(bounds.prod()))
    threshold = f"{1 / limit:.2f} .. {limit:.2f}"
    other = "attitude" if name == "body_rate" else "position"
    if bounds[0] < limit and bounds[1] > 1 / limit:
        sentence = f"{name} is {middle:.3g} times the change of {other}"
        return CheckResult(title, PASSES, sentence, middle, threshold)
    units = _UNITS[name].items()
    unit = next((text for factor, text in units if 0.93 < middle / factor < 1.07), "")
    hint = f" It looks like {unit}." if unit else ""
    certain = not 1 / CERTAIN[name] < middle < CERTAIN[name]
    return CheckResult(
        title,
        FAILS if certain else WARNS,
        f"{name} is {middle:.3g} times the change of {other}; expected 1.{hint}",
        middle,
        threshold,
        "Convert one.",
    )


def _check_gyro_delay(pieces: Sequence[Flight]) -> CheckResult:
    name = "gyro delay"
    delay = gyro_delay(pieces)
    if delay is None:
        return unknown(name, "attitude and body rates show no delay between them")
    late = 1e3 * delay
    threshold = f"-{1e3 * LATEST_S:.0f} .. {1e3 * LATEST_S:.0f} ms"
    if abs(delay) <= LATEST_S:
        sentence = f"body rates are {late:.0f} ms behind the attitude"
        return CheckResult(name, PASSES, sentence, late, threshold)
    side = "late" if late > 0 else "early"
    return CheckResult(
        name,
        FAILS if abs(delay) > FAR_S else WARNS,
        f"body rates are {side} by about {abs(late):.0f} ms against the attitude; expected less "
        f"than {1e3 * LATEST_S:.0f} ms. They have clocks or filters of their own.",
        late,
        threshold,
        "Shift one.",
    )


def gyro_delay(pieces: Sequence[Flight]) -> float | None:
    """Measures by how much body rates are behind the attitude [s]; None where it does not show."""
    period = pieces[0].period
    most = round(_LAGS_S / period)
    step = max(1, round(0.01 / period))
    shifts = np.arange(-most, most + 1, step)
    sums = np.zeros((3, len(shifts)))
    for piece in pieces:
        rows = max(round(_LAG_SPAN_S / period), 1)
        count = len(piece) - rows - 2 * most
        if count < FEWEST_LAG:
            continue
        first, second = (rates[:, :2] - rates[:, :2].mean(axis=0) for rates in turn(piece, rows))
        later = second[most : most + count]
        for index, shift in enumerate(shifts):
            early = first[most + shift : most + shift + count]
            sums[:, index] += np.sum(early * later), np.sum(early**2), np.sum(later**2)
    if not sums.any():
        return None
    match = sums[0] / np.sqrt(np.maximum(sums[1] * sums[2], 1e-12))
    best = int(np.argmax(match))
    if match[best] < 0.8 or not 0 < best < len(shifts) - 1:
        return None
    before, at, after = match[best - 1 : best + 2]
    bent = before - 2 * at + after
    return float((shifts[best] + step * (0.5 * (before - after) / bent if bent else 0.0)) * period)


_FEWEST_BLOCKS = 8
"""Blocks below which no axes are judged; chosen."""
FEWEST_LAG = 60
"""Samples below which no delay is measured."""
