"""Independent estimates of the motors' lag and latency together, and their disagreement."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from maidenflight.identification.signals.motor_response import DelayEstimate, MotorResponse
from maidenflight.parameters import Parameters

LAG = "motor_time_constant"
"""The parameter that accelerometer or rotor speed show by themselves: the mean of motors that speed
up and slow down."""
DELAYS = (LAG, "latency")
"""The parameters that delay what commands do."""


def delay_estimates(
    motors: MotorResponse | None,
    draws: Mapping[str, np.ndarray],
    unidentifiable: Collection[str],
    drone: Parameters,
) -> tuple[DelayEstimate, ...]:
    """Returns what each signal shows, and last what is taken.

    Nothing where neither delay is identified.

    Signals show the mean lag of speeding up and slowing down, and so is that which is taken.

    Args:
        motors: what logs show of the motors.
        draws: posterior samples by parameter.
        unidentifiable: parameters that the flights cannot tell.
        drone: what was identified.
    """
    if not set(DELAYS) <= set(draws):
        return ()
    ratio = draws.get("spin_down_ratio", float(drone.spin_down_ratio))
    total = draws[LAG] * (1 + ratio) / 2 + draws["latency"]
    low, value, high = np.quantile(total, [0.025, 0.5, 0.975])
    origin = "plausible" if LAG in unidentifiable else "all together" if motors else "likelihood"
    return (
        *(motors.delay_estimates if motors else ()),
        DelayEstimate(origin, float(value), (float(low), float(high))),
    )


def notes(estimates: Sequence[DelayEstimate], motors: MotorResponse | None) -> list[str]:
    """Returns which estimates disagree, and what the logs show of the motors."""
    if not estimates:
        return []
    outliers = [
        f"{one.signal} and {other.signal}"
        for number, one in enumerate(estimates)
        for other in estimates[number + 1 :]
        if one.interval[1] < other.interval[0] or other.interval[1] < one.interval[0]
    ]
    lines = [f"these disagree about the motors' lag: {'; '.join(outliers)}"]
    return [*(lines if outliers else []), *(motors.notes if motors else ())]
