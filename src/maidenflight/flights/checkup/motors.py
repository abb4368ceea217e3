"""Tests of the motors: whether commands turn the drone, in which order, when, and by which curve.

All 24 orders of four motors are tried at lags that a motor can have. Commands that are late or
early show as a delay that none has, of the logged order alone: a feedback answers a turn in the
opposite sense, and so makes a mirrored drone look like one whose commands come too late.
"""

from collections.abc import Sequence
from itertools import permutations

import numpy as np
from jaxtyping import Float

from maidenflight.flights.checkup.in_flight import belongs, load_factor
from maidenflight.flights.checkup.relations import block_mean
from maidenflight.flights.checkup.response import (
    DELAYS_S,
    EARLIEST_S,
    FEWEST,
    FORCE,
    LAGS_S,
    LATEST_S,
    QUICK,
    SLOW,
    Fit,
    Responses,
    Spectra,
    check_delay,
    gain_error,
    place_of_largest,
    responses,
    spectra,
)
from maidenflight.flights.checkup.result import FAILS, PASSES, WARNS, CheckResult, unknown
from maidenflight.flights.log import GRAVITY, TORQUES, Flight

ORDER = "motor order"
ORDERS = tuple(permutations(range(4)))
"""Orders of the motors, by definition; the first is the one of our format."""
DRIVEN, DRIVEN_LONG = 0.75, 0.55
"""Correlations of roll and pitch, summed, below which commands do not drive the motion, and
of long flights: 0.9 to 1.95 in 96 logs; with the commands of another time of the flight at most
0.69 and 0.42."""
CLEARLY = {QUICK: 1.0, SLOW: 1.4}
"""Those from which another order of the motors is named; in slow motion chance reaches 0.95."""
MANY = 12.0
"""Segments from which a flight is long."""
BETTER = 0.06
"""By which another order must correlate better to be named; the next best one of sound logs is
worse by 0.18 and more."""
YAW, YAW_DOMINATES = 0.2, 1.5
"""Correlation of yaw with its command that shows its sign, and its ratio to the opposite one's."""
_YAW_LEADS_S = (0.0, 0.02, 0.05, 0.1, 0.3)
"""How much the rotors' inertia lets yaw lead the drag of the blades [s]."""
CURVE_NAME, CURVE = "thrust curve", (0.58, 1.35)
"""Change of thrust by that of command, both as shares, that a thrust command may have: 0.63 to 1.18
in 22 logs. Of sqrt(u) it is twice, of u squared half as much."""
CABLE_S = 0.055
"""Difference of the lags of force and of roll and pitch that shows a load on a cable [s]."""
_SETTLED_S = 0.25
"""Time in which motors settle [s]; chosen."""
FORCE_EXPLAINED = 0.6
"""Correlation of the force along z with the commands from which the curve is judged."""
THRUST_TO_WEIGHT = (1.02, 16.0)
"""Ratio of full thrust to weight that a quadrotor can have."""
_POSSIBLE = np.abs(DELAYS_S - (EARLIEST_S + LATEST_S) / 2) < (LATEST_S - EARLIEST_S) / 2 + 1e-6
"""Delays that motors can have."""
_OUR_ORDER = "front right, back right, back left, front left"


def check_motors(pieces: Sequence[Flight], yaw_is_right: bool = False) -> list[CheckResult]:
    """Checks the motors' commands against the motion of pieces of one flight.

    Args:
        pieces: of the flight.
        yaw_is_right: whether attitude and velocity confirm the sign of yaw and its rate.
    """
    motion = spectra(pieces)
    if motion is None:
        return [unknown("motors drive", "no piece lasts 0.6 s")]
    answer = responses(motion)
    fits = best_fits(answer)
    drive = _check_drive(fits, answer.segments, pieces)
    if drive.verdict != PASSES and (slow := spectra(pieces, SLOW)) is not None:
        # A very smooth flight may be all below the usual band.
        slow_answer = responses(slow)
        slowly = best_fits(slow_answer)
        if max(fit.score for fit in slowly.values()) > CLEARLY[SLOW]:
            motion, answer, fits = slow, slow_answer, slowly
            drive = _check_drive(fits, answer.segments, pieces)
    if drive.verdict == FAILS:
        return [drive, _check_thrust(pieces)]
    order = _check_order(fits, motion, answer.segments)
    results = [drive, order]
    if order.verdict == FAILS:
        return results
    if motion.band == QUICK:
        logged = fits[ORDERS[0]]
        is_driven = logged.score >= (DRIVEN if answer.segments >= FEWEST else 2 * DRIVEN)
        results.append(check_delay(pieces, logged, answer, is_driven))
        results.append(_check_yaw(motion, logged, yaw_is_right))
        if pieces[0].accelerometer is not None:
            results.append(_check_curve(pieces, answer, logged))
    return [*results, _check_thrust(pieces, results[-1])]


def best_fits(answer: Responses) -> dict[tuple[int, ...], Fit]:
    """Finds lag and delay at which roll and pitch follow each order of the motors best.

    Other orders than the logged one are tried at possible delays alone.
    """
    fits = {}
    for order in ORDERS:
        torques = TORQUES[np.argsort(order)]
        roll, pitch = (answer.correlation(axis, torques[:, axis]) for axis in (0, 1))
        scores = roll + pitch
        if order != ORDERS[0]:
            scores = np.where(_POSSIBLE, scores, -2.0)
        lag, delay = place_of_largest(scores)
        score = float(scores[lag, delay])
        fits[order] = Fit(order, score, float(LAGS_S[lag]), float(DELAYS_S[delay]))
    return fits


def _check_drive(
    fits: dict[tuple[int, ...], Fit], segments: float, pieces: Sequence[Flight]
) -> CheckResult:
    name = "motors drive"
    best = max(fit.score for fit in fits.values())
    text = f"roll and pitch follow the motors' torques with correlations of {best / 2:.2f}"
    if segments < FEWEST and best < 2 * DRIVEN:
        return unknown(name, f"{text}; the flight is too short to judge that", best / 2)
    least = DRIVEN if segments < MANY else DRIVEN_LONG
    threshold = f"{least / 2:.2f} or more"
    if best >= least:
        return CheckResult(name, PASSES, text, best / 2, threshold)
    belong, coherence = belongs(pieces)
    if belong is not False:
        reason = "a calm flight, wind or rare rows hide how they drive it"
        return unknown(name, f"{text}; {coherence}: {reason}" if belong else text, best / 2)
    cause = (
        f"commands have nothing to do with the motion: {text}, in any order of the motors, and "
        f"neither answers the other ({coherence}). They are of another flight or clock, or "
        "something else than the motors was logged."
    )
    return CheckResult(name, FAILS, cause, best / 2, threshold, "Leave it out.")


def _check_order(fits: dict[tuple[int, ...], Fit], motion: Spectra, segments: float) -> CheckResult:
    name = ORDER
    logged = fits[ORDERS[0]]
    best = max(fits.values(), key=lambda fit: fit.score)
    gain = max(best.score - logged.score, 0.0)
    threshold = f"below {BETTER / 2:.2f}"
    text = f"roll and pitch follow the motors as logged, correlation {logged.score / 2:.2f}"
    if gain < BETTER:
        return CheckResult(name, PASSES, text, gain / 2, threshold)
    few = segments < FEWEST and (best.score < 1.6 or gain < 0.4 or segments < 1.5)
    least = DRIVEN if segments >= MANY and motion.band == QUICK else CLEARLY[motion.band]
    if best.score < least or few:
        return unknown(name, "too little shows the order of the motors", gain / 2)
    right = ", ".join(f"command_{motor + 1}" for motor in best.order)
    sentence = (
        f"roll and pitch follow the motors in the order {right} with correlations of "
        f"{best.score / 2:.2f}, as logged of {logged.score / 2:.2f}: the motors look permuted; "
        f"expected {_OUR_ORDER}."
    )
    other = _as_frame(best.order)
    if other:
        sentence += f" Or {other}.{_decide_by_yaw(motion, best)}"
    return CheckResult(name, FAILS, sentence, gain / 2, threshold)


def _as_frame(order: tuple[int, ...]) -> str:
    """Says which fault of the body's axes has the same effect on roll and pitch; "" if none has."""
    torques = TORQUES[np.argsort(order)]
    turned = np.linalg.lstsq(TORQUES[:, :2], torques[:, :2], rcond=None)[0]
    readings = {
        (-1, 0, 0, 1): "body_rate_x has the opposite sign",
        (1, 0, 0, -1): "body_rate_y has the opposite sign",
        (-1, 0, 0, -1): "the body's axes are turned by 180 deg",
        (0, 1, 1, 0): "x and y of the body are swapped",
        (0, -1, -1, 0): "x and y of the body are swapped, with opposite signs",
        (0, 1, -1, 0): "the body's axes are turned by 90 deg",
        (0, -1, 1, 0): "the body's axes are turned by -90 deg",
    }
    return readings.get(tuple(np.round(turned.ravel()).astype(int).tolist()), "")


def _decide_by_yaw(motion: Spectra, best: Fit) -> str:
    """Says whether yaw speaks for the order of the motors or for the frame."""
    torques = TORQUES[np.argsort(best.order)]
    if np.array_equal(torques[:, 2], TORQUES[:, 2]):
        return " Yaw is alike in both: compare the order with the firmware's."
    for_order, against = yaw_correlations(motion, best, torques[:, 2])
    low, high = sorted((for_order, against))
    if high < YAW or high < YAW_DOMINATES * low:
        return " Yaw does not tell which."
    if for_order > against:
        return " Yaw follows that order of the motors."
    return " Yaw speaks for the body's axes, not for the order of the motors."


def yaw_correlations(
    motion: Spectra, fit: Fit, pattern: Float[np.ndarray, "4"]
) -> tuple[float, float]:
    """Measures how yaw follows motors, and how it follows them with the opposite sign.

    Drag of the blades turns the drone as their thrust rises, and so does the rotors' inertia while
    they speed up, the more the quicker.
    """
    turn = 2j * np.pi * motion.frequency
    lag = np.exp(-turn * fit.delay) / (1 + turn * fit.lag)
    own, weight = motion.channels[:, 2], motion.weight(2)
    power = np.einsum("u,fuv,v->f", pattern, motion.commands, pattern).real
    across = motion.across[:, :, 2] @ pattern
    matches = []
    for lead in _YAW_LEADS_S:
        answer = lag * (1 + turn * lead)
        size = (np.abs(answer) ** 2 * power * weight).sum() * (own * weight).sum()
        product = (answer.conj() * across * weight).sum().real
        matches.append(float(product / np.sqrt(max(float(size), 1e-20))))
    return max(matches), -min(matches)


def _check_yaw(motion: Spectra, logged: Fit, yaw_is_right: bool) -> CheckResult:
    name = "yaw direction"
    along, against = yaw_correlations(motion, logged, TORQUES[:, 2])
    threshold = f"{YAW:g} or more"
    if against > YAW and against > YAW_DOMINATES * max(along, 0.0):
        cause = "the rotors turn the other way (props out), "
        if yaw_is_right:
            cause += "since attitude and velocity confirm yaw"
        else:
            cause += "or yaw and body_rate_z have the opposite sign: look at your drone"
        sentence = (
            f"yaw answers its command the wrong way round (correlation -{against:.2f}): {cause}. "
            "With the usual directions torque_to_thrust is worth nothing, and a policy turns yaw "
            "the wrong way round."
        )
        remedy = (
            "With props out begin with --start mine.toml, a drone of rotor_direction = "
            "[1, -1, 1, -1] (maidenflight drone NAME prints one)."
        )
        return CheckResult(name, WARNS, sentence, -against, threshold, remedy)
    if along > YAW and along > YAW_DOMINATES * against:
        return CheckResult(name, PASSES, "yaw follows its command", along, threshold)
    return unknown(name, "yaw follows its command too little to show its sign", along)


def _check_curve(pieces: Sequence[Flight], answer: Responses, logged: Fit) -> CheckResult:
    name = CURVE_NAME
    matches = answer.correlation(FORCE, np.ones(4))[:, _POSSIBLE]
    lag, delay = place_of_largest(matches)
    match = float(matches[lag, delay])
    command = np.concatenate([piece.mean_command for piece in pieces]).mean(dtype=np.float64)
    force = np.concatenate([np.asarray(piece.accelerometer)[:, 2] for piece in pieces])
    if match < FORCE_EXPLAINED or answer.segments < FEWEST or command <= 0:
        return unknown(name, f"the force along z follows the commands to {match:.2f} only", match)
    slot = int(np.flatnonzero(_POSSIBLE)[delay])
    difference = float(LAGS_S[lag] + DELAYS_S[slot]) - logged.lag - logged.delay
    if abs(difference) > CABLE_S:
        late = f"{1e3 * difference:.0f} ms after roll and pitch"
        text = f"the force along z follows the commands {late}, as with a load on a cable"
        return unknown(name, text, difference)
    product = answer.products[FORCE, lag, slot].sum()
    gain = 4 * product / answer.power[FORCE, lag].sum()
    share = float(gain * command / max(float(force.mean(dtype=np.float64)), 0.1 * GRAVITY))
    error = share * gain_error(pieces, float(LAGS_S[lag]), float(DELAYS_S[slot]))
    low, high = CURVE
    threshold = f"{low:g} .. {high:g}"
    text = f"1 % more command gives {share:.2f} % +- {error:.2f} % more thrust"
    if low < share < high:
        return CheckResult(name, PASSES, text, share, threshold)
    if share <= low and low < (gentle := _gentle_share(pieces)) < high:
        text += f", at low throttle {gentle:.2f} %: motors or battery saturate above"
        return CheckResult(name, PASSES, text, share, threshold)
    if low < share + error and share - error < high:
        return unknown(name, f"{text}, too little to tell it from {threshold}", share)
    cause = "commands may be squared once too often, or have an offset"
    if share > high:
        cause = "commands may be rotor speeds, sqrt(u), or percent above an idle not taken off"
    elif since := pieces[0].square_since:
        cause = f"u is the square of the throttle, for {since}, and thrust follows the throttle"
    sentence = f"{text}; expected about 1: {cause}. u is thrust as a share of full thrust."
    return CheckResult(name, WARNS, sentence, share, threshold)


def _gentle_share(pieces: Sequence[Flight]) -> float:
    """Measures by which share force changes with throttle in the half with less throttle."""
    signals = [
        np.stack([piece.mean_command.mean(axis=1), np.asarray(piece.accelerometer)[:, 2]], axis=1)
        for piece in pieces
    ]
    blocks = np.concatenate(
        [
            block_mean(signal, max(1, round(_SETTLED_S / piece.period)))
            for signal, piece in zip(signals, pieces, strict=True)
        ]
    )
    throttle, force = blocks[blocks[:, 0] < np.median(blocks[:, 0])].T
    slope = np.polyfit(throttle, force, 1)[0] if len(throttle) > FEWEST else 0.0
    return float(slope * throttle.mean() / max(float(force.mean()), 0.1 * GRAVITY))


def _check_thrust(pieces: Sequence[Flight], curve: CheckResult | None = None) -> CheckResult:
    """Checks full thrust by weight; a thrust curve that was measured tells the likelier cause."""
    name = "thrust to weight"
    loads, commands = [], []
    for piece in pieces:
        load = load_factor(piece)
        if load is not None:
            loads.append(load)
            commands.append(piece.mean_command.mean(axis=1, dtype=np.float64))
    if not loads:
        return unknown(name, "neither accelerometer nor velocity shows the thrust")
    load, command = np.concatenate(loads), np.concatenate(commands)
    is_finite = np.isfinite(load) & np.isfinite(command)
    mean = float(command[is_finite].mean()) if is_finite.any() else 0.0
    if mean <= 1e-3:
        return unknown(name, "the motors are off")
    ratio = float(load[is_finite].mean()) / mean
    low, high = THRUST_TO_WEIGHT
    threshold = f"{low:g} .. {high:g}"
    text = f"hovering takes u = {1 / ratio:.2f}: full thrust is {ratio:.2f} times the weight"
    if low < ratio < high:
        return CheckResult(name, PASSES, f"{text}; compare that with yours", ratio, threshold)
    by_root = float(load[is_finite].mean() / np.sqrt(command[is_finite]).mean())
    scale = "The scale of the commands looks wrong: another full throttle, PWM limits, or percent."
    measured = curve.statistic if curve is not None and curve.name == CURVE_NAME else None
    if ratio > high > by_root and (measured is None or measured < np.sqrt(0.5)):
        # Of no curve, thrust in proportion to the throttle is likelier than a wrong scale.
        since = f", for {pieces[0].square_since}" if pieces[0].square_since else ""
        scale = (
            f"u was taken as the square of the throttle{since}. If thrust follows the throttle "
            f"itself, as through ESCs that linearise it, hovering takes {100 / by_root:.0f} % of "
            f"it, and full thrust is {by_root:.2f} times the weight."
        )
    remedy = (
        "Say which: THR_MDL_FAC of PX4 and the limits of the motors' outputs, or low, high and "
        "thrust in a map."
    )
    cause = f"{text}; expected {threshold} times. {scale}"
    return CheckResult(name, WARNS, cause, ratio, threshold, remedy)
