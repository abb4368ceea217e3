"""What a log can and cannot tell at the rates of its signals, said before anything is fitted.

Identification follows the motors' lag from row to row. Between two logged commands their mean is
taken, and where that is not what the motors were told, latency is off by up to half the step.
"""

import math
from collections.abc import Mapping

from maidenflight.errors import InputError

LEAST_HZ = 40.0
"""Rate of body rates and motors below which identification refuses a flight [Hz]."""
PLENTY_HZ = 200.0
"""Rate of motors from which nothing is said [Hz]: half a step is a tenth of the shortest lags."""
NEEDED = {
    "body rates": "inertia and latency",
    "motors": "the motors' lag and latency",
    "specific force": "thrust without a position",
}
"""Signals that identification needs, and what they tell."""


def filter_delay(cutoff: float) -> float:
    """Returns the delay of a Butterworth filter of second order, at low frequencies [s].

    1 / (s^2 + sqrt(2) s + 1) of s = i f / cutoff: its phase falls by sqrt(2) f / cutoff.

    Args:
        cutoff: where it passes 0.71 [Hz]; 0 is no filter.
    """
    return 2**0.5 / (2 * math.pi * cutoff) if cutoff > 0 else 0.0


def refuse_too_slow(
    name: str, rates: Mapping[str, float], remedy: str, logged: Mapping[str, float] | None = None
) -> None:
    """Refuses a log of which a needed signal is logged too rarely, or not at all.

    Args:
        name: of the file.
        rates: of the signals that are needed, keys of `NEEDED` [Hz]; 0 where one is missing.
        remedy: a sentence that says what to set.
        logged: rates of all that the log holds [Hz], to be told.

    Raises:
        InputError: the signals, their rates and the remedy.
    """
    slow = {signal: rate for signal, rate in rates.items() if rate < 0.97 * LEAST_HZ}
    if slow:
        slow_signals = "; ".join(
            f"{signal} {'not logged' if not rate else f'logged at {rate:.3g} Hz'}, so "
            f"{NEEDED[signal]} cannot be identified"
            for signal, rate in slow.items()
        )
        held = ", ".join(f"{signal} {rate:.3g} Hz" for signal, rate in (logged or {}).items())
        held = f" It holds {held}." if held else ""
        raise InputError(f"{name}: {slow_signals}; {LEAST_HZ:g} Hz are needed. {remedy}{held}")


def notes(name: str, rates: Mapping[str, float], remedy: str) -> list[str]:
    """Returns what is known less well than a faster log would tell.

    Args:
        name: of the file.
        rates: as of `refuse_too_slow`.
        remedy: a sentence that says what to set.
    """
    motors = rates["motors"]
    if motors >= PLENTY_HZ:
        return []
    return [
        f"{name}: motors logged at {motors:.3g} Hz: the latency found may be off by "
        f"{500 / motors:.2g} ms, half of their step. {remedy}"
    ]
