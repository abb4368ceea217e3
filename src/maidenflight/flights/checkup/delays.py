"""When the drone answers its commands: no sooner than they are given, and soon after.

No motion begins before its command. Motors, the gyro's filter and a feedback all make the answer
later: measured, by 1 to 28 ms in 116 sound logs, with standard errors below 7 ms.
"""

from collections.abc import Sequence

import numpy as np

from maidenflight.flights.checkup.response import (
    DELAYS_S,
    FEWEST,
    FORCE,
    LAGS_S,
    Delay,
    Fit,
    Responses,
    measure_delay,
    place_of_largest,
)
from maidenflight.flights.checkup.result import FAILS, PASSES, WARNS, CheckResult, unknown
from maidenflight.flights.log import Flight

DELAY = "command delay"
EARLIEST_S, LATEST_S = -0.015, 0.045
"""Delays of the drone's answer behind its commands beyond which other orders of the motors are not
looked for [s]."""
CAUSAL_S = -0.002
"""Delay below which, with two standard errors, motion begins before its command [s]; measured, 3
ms and more in sound logs (benchmarks/checkup.py)."""
LONGEST_S = 0.1
"""A longer one is no way to the motors but another clock, and refused [s]."""
USUAL_S = 0.012
"""The usual one [s]."""
LATE_GYRO_S = 0.04
"""By which the gyro may follow commands later than the accelerometer does [s]."""


def check_delay(
    pieces: Sequence[Flight], logged: Fit, answer: Responses, is_driven: bool
) -> CheckResult:
    """Checks when motion follows the commands.

    Args:
        pieces: of one flight.
        logged: how roll and pitch follow the motors in the order of the log.
        answer: what each lag and delay explain.
        is_driven: whether commands surely drive the motion.
    """
    late = 1e3 * logged.delay
    threshold = f"{1e3 * EARLIEST_S:.0f} .. {1e3 * LATEST_S:.0f} ms"
    if not is_driven:
        return unknown(DELAY, "too little shows when commands act", late)
    text = f"motion follows commands by {late:.0f} ms and a lag of {1e3 * logged.lag:.0f} ms"
    force = answer.correlation(FORCE, np.ones(4))
    lag, delay = place_of_largest(force)
    force_is_clear = float(force[lag, delay]) > 0.8 and answer.segments >= FEWEST
    difference = logged.lag + logged.delay - float(LAGS_S[lag] + DELAYS_S[delay])
    if force_is_clear and difference > LATE_GYRO_S:
        sentence = (
            f"{text}, the accelerometer {1e3 * difference:.0f} ms before the gyro: body rates are "
            f"late by about {1e3 * difference:.0f} ms."
        )
        remedy = "Shift them, or log them with less filtering."
        return CheckResult(DELAY, FAILS, sentence, late, threshold, remedy)
    if EARLIEST_S < logged.delay < LATEST_S:
        return _check_cause(pieces) or CheckResult(DELAY, PASSES, text, late, threshold)
    off = 1e3 * (logged.delay - USUAL_S)
    side = "early" if off > 0 else "late"
    sentence = (
        f"commands are {side} by about {abs(off):.0f} ms: {text}; expected {threshold}. They have "
        "another clock than gyro and accelerometer, or a long way to the motors."
    )
    # The force follows the same commands: it has to be off on the same side.
    felt = float(DELAYS_S[delay])
    alone = force_is_clear and (felt < LATEST_S / 2 if off > 0 else felt > 0.0)
    if alone:
        return unknown(DELAY, f"{text}, but the force along z by {1e3 * felt:.0f} ms", late)
    possible = EARLIEST_S < logged.delay < LONGEST_S
    verdict = WARNS if possible else FAILS
    return CheckResult(DELAY, verdict, sentence, late, threshold, "Shift them.")


def is_before(delay: Delay | None) -> bool:
    """Returns whether motion surely begins before its command."""
    return delay is not None and delay.value + 2 * delay.error < CAUSAL_S


def _check_cause(pieces: Sequence[Flight]) -> CheckResult | None:
    """Checks whether motion begins before its command; None where it does not, surely."""
    delay = measure_delay(pieces)
    if delay is None or not is_before(delay):
        return None
    late, error = 1e3 * delay.value, 1e3 * delay.error
    cause = (
        f"motion begins {-late:.1f} +- {error:.1f} ms before its commands, which none does: they "
        f"were logged late, as motion usually follows {1e3 * USUAL_S:.0f} ms after, by about "
        f"{1e3 * USUAL_S - late:.0f} ms."
    )
    remedy = "Log them with the gyro's clock, or shift them."
    return CheckResult(DELAY, WARNS, cause, late, f"{1e3 * CAUSAL_S:.0f} ms or more", remedy)
