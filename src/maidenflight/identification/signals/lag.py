"""Independent looks at the motors' lag and the latency together, and where they disagree."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from maidenflight.identification.signals.motor_response import Look, MotorResponse
from maidenflight.parameters import Parameters

LAG = "motor_time_constant"
"""The parameter that accelerometer or rotor speed show by themselves: the mean of motors that speed
up and slow down."""
DELAYS = (LAG, "latency")
"""The parameters that delay what commands do."""


def looks(
    motors: MotorResponse | None,
    draws: Mapping[str, np.ndarray],
    untold: Collection[str],
    drone: Parameters,
) -> tuple[Look, ...]:
    """What each signal shows, and last what is taken; nothing where neither delay is identified.

    Signals show the mean lag of speeding up and slowing down, and so is that which is taken.

    Args:
        motors: what logs show of the motors.
        draws: posterior samples by parameter.
        untold: parameters that the flights cannot tell.
        drone: what was identified.
    """
    if not set(DELAYS) <= set(draws):
        return ()
    ratio = draws.get("spin_down_ratio", float(drone.spin_down_ratio))
    total = draws[LAG] * (1 + ratio) / 2 + draws["latency"]
    low, value, high = np.quantile(total, [0.025, 0.5, 0.975])
    taken = "plausible" if LAG in untold else "taken" if motors else "likelihood"
    return (
        *(motors.looks if motors else ()),
        Look(taken, float(value), (float(low), float(high))),
    )


def notes(found: Sequence[Look], motors: MotorResponse | None) -> list[str]:
    """The looks in words, and those that disagree."""
    if not found:
        return []
    shown = ", ".join(
        f"{look.signal} {1e3 * look.value:.0f} [{1e3 * look.interval[0]:.0f},"
        f" {1e3 * look.interval[1]:.0f}]"
        for look in found
    )
    apart = [
        f"{one.signal} and {other.signal}"
        for number, one in enumerate(found)
        for other in found[number + 1 :]
        if one.interval[1] < other.interval[0] or other.interval[1] < one.interval[0]
    ]
    told = [f"motor lag and latency together, in ms with 95 % interval: {shown}"]
    if apart:
        told.append(f"these disagree about the motors' lag: {'; '.join(apart)}")
    return [*told, *(motors.notes if motors else ())]
