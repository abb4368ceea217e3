"""Tests of the accelerometer: scale and sign by gravity, frame by drag against the gyro.

**Scale.** Specific force, turned into axes that do not turn by integrating the gyro, averages to
gravity plus the change of velocity by time. Over `WINDOW_S` that is 9.81 m/s2 to a few percent,
acrobatics included, wherever up is.

**Frame.** A rotor craft tilts by theta, gains speed g theta and meets drag against it: the force
along x is -k g times the integral of the tilt (k about 0.4 1/s), and an accelerometer beside the
centre of mass adds a share of the angular acceleration. Axes of the world show g theta instead.

Source: Leishman et al. 2014, Quadrotors and accelerometers; Titterton and Weston 2004, Strapdown
inertial navigation technology, ch. 3.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
import scipy
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from maidenflight.flights.checkup.kinematics import AXES, rotations
from maidenflight.flights.checkup.relations import (
    Samples,
    best_reading,
    block_mean,
    sample_spans,
    span_mean,
    take_enough,
)
from maidenflight.flights.checkup.result import FAILS, PASSES, WARNS, CheckResult, unknown
from maidenflight.flights.log import GRAVITY, Flight

WINDOW_S, SHORTEST_S = 6.0, 2.0
"""Time over which gravity is averaged, and a shorter piece's [s]."""
STEP_S = 0.01
"""Step of the integration, about [s]."""
SCALE = 1.15
"""Factor beyond which the accelerometer has a wrong scale."""
CERTAIN_SCALE = 1.6
"""Factor from which the log is refused for it; below it is a note."""
SPREAD = 1.35
"""Ratio of the upper to the lower quartile of windows from which they do not show it."""
BAND_HZ = (0.3, 4.0)
"""Band in which drag answers tilts."""
EXPLAINED = 0.6
"""Share of a horizontal force that drag has to explain for its axes to be judged."""
DRAG_MATCH, DRAG_MARGIN = 0.8, 0.35
"""Correlation of drag with velocity from which it shows the axes, and by how much they must be
better in another frame to be named."""
LEAST_DRAG_SPEED = 0.05
"""Standard deviation of the velocity from which drag shows [m/s]."""
FRAME = "accelerometer axes"
_UNITS = {
    1 / GRAVITY: "g; expected m/s2",
    1e3 / GRAVITY: "thousandths of g; expected m/s2",
    GRAVITY: "m/s2 that was multiplied by 9.81 once more",
    1 / 0.3048: "ft/s2; expected m/s2",
    0.5: "counts of half the range",
    2.0: "counts of twice the range",
}
"""By definition of the units."""


def check_accelerometer(pieces: Sequence[Flight], follows: bool = False) -> list[CheckResult]:
    """Checks scale, sign and frame of the accelerometer in pieces of one flight.

    Args:
        pieces: of the flight.
        follows: whether the force follows the throttle, so that it is measured well.
    """
    if pieces[0].accelerometer is None:
        return []
    return [_check_scale(pieces, follows), _check_frame(pieces)]


def _inertial(piece: Flight) -> tuple[Float[np.ndarray, "M 3"], Float[np.ndarray, "M 3"], float]:
    """Returns body rates, specific force and their step."""
    rows = max(1, round(STEP_S / piece.period))
    force = np.asarray(piece.accelerometer)
    return block_mean(piece.body_rates, rows), block_mean(force, rows), rows * piece.period


def mean_gravity(piece: Flight) -> Float[np.ndarray, "W"]:
    """Measures the size of the mean specific force in axes that do not turn, of each window."""
    rates, force, step = _inertial(piece)
    count = min(round(WINDOW_S / step), len(force))
    if count * step < SHORTEST_S:
        return np.zeros(0)
    turned = Rotation.from_rotvec(rates * step).as_matrix()
    shift = 1
    while shift < len(turned):
        turned = np.concatenate([turned[:shift], turned[:-shift] @ turned[shift:]])
        shift *= 2
    before = np.concatenate([np.eye(3)[None], turned[:-1]])
    summed = np.cumsum(np.einsum("nij,nj->ni", before, force), axis=0)
    summed = np.concatenate([np.zeros((1, 3)), summed])
    starts = np.arange(0, len(force) - count + 1, max(1, count // 2))
    return np.linalg.norm(summed[starts + count] - summed[starts], axis=1) / count


def _check_scale(pieces: Sequence[Flight], follows: bool) -> CheckResult:
    name = "accelerometer"
    windows = np.concatenate([mean_gravity(piece) for piece in pieces])
    upward = np.concatenate([np.asarray(piece.accelerometer)[:, 2] for piece in pieces])
    up, remedy = float(upward.mean()), ""
    if not len(windows):
        return unknown(name, f"no piece lasts {SHORTEST_S:g} s, over which gravity would show")
    ratio = float(np.median(windows)) / GRAVITY
    threshold = f"{1 / SCALE:.2f} .. {SCALE:.2f} g"
    low, high = np.quantile(windows, [0.25, 0.75]) / GRAVITY
    text = f"specific force averages to {ratio:.3g} g"
    if ratio < 0.06 or abs(up) < 0.02 * GRAVITY:
        fault = "gravity was removed from it"
        remedy = "Log the specific force, 9.81 m/s2 along z at rest."
    elif up < -0.3 * GRAVITY * ratio:
        fault = (
            "it points down: it has the opposite sign (gravity for specific force), or z points "
            "down (forward, right, down)"
        )
        remedy = "Turn the sign, or of y and z of all that is of the body."
    elif 1 / SCALE < ratio < SCALE:
        return CheckResult(name, PASSES, text, ratio, threshold)
    elif high / max(low, 1e-6) > SPREAD:
        text += f", but windows differ ({low:.2f} to {high:.2f})"
        if follows or (low < 1 / SCALE and high > SCALE):
            return unknown(name, f"{text}: speed is gained over longer times than these", ratio)
        sentence = (
            f"the accelerometer's {text}: it does not measure gravity as gyro and time have it "
            "(vibration, clipping or a wrong scale), and thrust found from it is worth little."
        )
        return CheckResult(name, WARNS, sentence, ratio, threshold)
    elif 1 / SCALE < (still := _still_scale(pieces)) < SCALE:
        sentence = (
            f"the accelerometer's {text}, though it reads {still:.2f} g where the drone is still: "
            "vibration or clipping, no wrong unit, and thrust found from it is worth little."
        )
        remedy = "Balance the propellers, or mount the board softly."
        return CheckResult(name, WARNS, sentence, ratio, threshold, remedy)
    else:
        unit = next((words for factor, words in _UNITS.items() if 0.8 < ratio / factor < 1.25), "")
        fault = f"it looks like {unit}" if unit else "its scale is wrong"
        remedy = "Convert it."
    sentence = f"the accelerometer's {text}, {up:.2f} m/s2 along z; {fault}."
    certain = not 1 / CERTAIN_SCALE < ratio < CERTAIN_SCALE or up < 0
    return CheckResult(name, FAILS if certain else WARNS, sentence, ratio, threshold, remedy)


def _still_scale(pieces: Sequence[Flight]) -> float:
    """Measures the size of the specific force [g] in the quietest tenth of half seconds."""
    force, deviation = [], []
    for piece in pieces:
        rows = max(1, round(0.5 / piece.period))
        signal = np.asarray(piece.accelerometer).astype(float)
        mean, square = block_mean(signal, rows), block_mean(signal**2, rows)
        force.append(np.linalg.norm(mean, axis=1))
        deviation.append((square - mean**2).sum(axis=1))
    each, spread = np.concatenate(force), np.concatenate(deviation)
    quiet = spread <= np.quantile(spread, 0.1) if len(spread) else spread > 0
    return float(np.median(each[quiet])) / GRAVITY if quiet.any() else 0.0


def _responses(
    pieces: Sequence[Flight],
) -> tuple[Float[np.ndarray, "M 2 3"], Float[np.ndarray, "M 2"]] | None:
    """Returns what pushes along x and y should follow, and the force along both, within `BAND_HZ`.

    Features are tilt, its integral and angular acceleration, signed as drag along each axis sees
    them.
    """
    features, forces = [], []
    for piece in pieces:
        rates, force, step = _inertial(piece)
        edge = round(1 / step)
        if len(rates) < 6 * edge:
            continue
        band = scipy.signal.butter(2, BAND_HZ, "band", fs=1 / step, output="sos")
        tilt = np.cumsum(rates[:, [1, 0]] - rates[:, [1, 0]].mean(axis=0), axis=0) * step
        tilt *= [1.0, -1.0]
        tilt -= np.linspace(0, 1, len(tilt))[:, None] * tilt[-1]
        drift = np.cumsum(tilt - tilt.mean(axis=0), axis=0) * step
        jerk = np.gradient(rates[:, [1, 0]], step, axis=0) * [1.0, -1.0]
        parts = tilt, drift, jerk, force[:, :2]
        parts = [scipy.signal.sosfiltfilt(band, part, axis=0) for part in parts]
        parts = [part[edge:-edge] for part in parts]
        features.append(np.stack(parts[:3], axis=2))
        forces.append(parts[3])
    return (np.concatenate(features), np.concatenate(forces)) if forces else None


def _fit(
    features: Float[np.ndarray, "M 3"], force: Float[np.ndarray, "M"]
) -> tuple[float, Float[np.ndarray, "3"]]:
    """Returns the explained share of a force, and its answers to tilt, integral and jerk."""
    solved = np.linalg.lstsq(features, force, rcond=None)[0]
    left = force - features @ solved
    return float(1 - left @ left / max(force @ force, 1e-12)), solved


def _drag(axes: Float[np.ndarray, "3 3"] | None, piece: Flight, rows: int) -> Samples:
    """Measures the force from the side, read in some axes, and the velocity that it drags against.

    Without axes the force is turned from the world's to the body's.
    """
    attitude = rotations(piece)
    force = np.asarray(piece.accelerometer).astype(float)
    force = attitude.inv().apply(force) if axes is None else force @ axes.T
    against = -attitude.inv().apply(piece.velocity.astype(float))[:, :2]
    return span_mean(force[:, :2], rows), span_mean(against, rows)


def _check_by_velocity(pieces: Sequence[Flight]) -> CheckResult | None:
    """Checks the frame of the accelerometer by the drag against a known velocity."""
    pieces = take_enough(pieces)
    ways: dict[str, Float[np.ndarray, "3 3"] | None] = {"": np.eye(3), **AXES}
    ways["turned from world to body axes"] = None
    readings = {
        name: sample_spans(pieces, partial(_drag, axes))
        for name, axes in ways.items()
        if "z with" not in name and "y and z" not in name and "x and z" not in name
    }
    best = best_reading(readings, LEAST_DRAG_SPEED)
    if best is None or best.score < DRAG_MATCH:
        return None
    threshold = f"within {DRAG_MARGIN:g} of the best reading"
    text = f"drag follows the velocity to {best.logged:.2f}"
    if best.score - best.logged < DRAG_MARGIN:
        return CheckResult(FRAME, PASSES, text, best.logged, threshold)
    sentence = (
        f"the accelerometer's {text} as logged, and to {best.score:.2f} with {best.name}. "
        "Expected specific force along the body's x forward, y left, z up."
    )
    return CheckResult(FRAME, FAILS, sentence, best.logged, threshold, "Convert it.")


def _check_frame(pieces: Sequence[Flight]) -> CheckResult:
    name = FRAME
    if pieces[0].has_state and (velocity_check := _check_by_velocity(pieces)) is not None:
        return velocity_check
    result = _responses(pieces)
    if result is None:
        return unknown(name, "no piece lasts 6 s, in which drag would show the axes")
    features, force = result
    own = [_fit(features[:, axis], force[:, axis]) for axis in (0, 1)]
    crossed = [_fit(features[:, 1 - axis], force[:, axis]) for axis in (0, 1)]
    shares = np.array([share for share, _ in own])
    others = np.array([share for share, _ in crossed])
    threshold = f"R2 {EXPLAINED:g}"
    best = float(shares.max())
    tilts = np.array([answers[0] for _, answers in own])
    if (np.abs(tilts / GRAVITY - 1) < 0.4).all() and shares.min() > 0.5:
        sentence = "the accelerometer follows the tilt itself, as along the world's axes."
        remedy = "Turn it into the body's axes, x forward, y left, z up."
        return CheckResult(name, FAILS, sentence, best, threshold, remedy)
    if others.min() > EXPLAINED and shares.max() < 0.5 * others.min():
        sentence = (
            "the accelerometer's x and y look swapped: the force along each follows the drag "
            f"along the other (R2 {others.min():.2f}, as logged {shares.max():.2f})."
        )
        return CheckResult(name, FAILS, sentence, best, threshold, "Put the columns in order.")
    wrong = [
        "xy"[axis]
        for axis, (share, answers) in enumerate(own)
        if share > EXPLAINED and answers[1] > 1.0 and share > others[axis] + 0.2
    ]
    if wrong:
        axes = " and ".join(wrong)
        sentence = (
            f"the accelerometer's {axes} and the drag that the gyro predicts have opposite signs "
            f"(R2 {best:.2f})."
        )
        remedy = f"Turn the sign of {axes} of one of both: x forward, y left."
        verdict = FAILS if len(wrong) == 2 else WARNS
        return CheckResult(name, verdict, sentence, best, threshold, remedy)
    if best < EXPLAINED:
        return unknown(name, f"drag explains {max(best, 0):.2f} of the force from the side", best)
    return CheckResult(name, PASSES, "drag has the right signs and axes", best, threshold)
