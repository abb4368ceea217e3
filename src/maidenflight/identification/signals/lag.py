"""Independent estimates of the motors' lag and latency together, and their disagreement."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from maidenflight.identification.signals.motor_response import MotorResponse
from maidenflight.identification.uncertainty import DELAY, Evidence, of_samples
from maidenflight.parameters import Parameters
from maidenflight.simulator.physics.dynamics import equivalent_lag

LAG = "motor_time_constant"
"""The parameter that gyro or rotor speed show by themselves: the equivalent lag of motors that
speed up and slow down."""
DELAYS = (LAG, "latency")
"""The parameters that delay what commands do."""
SLOWING_DOWN = "spin_down_ratio"
"""Lag slowing down over that speeding up."""


def speeding_up(equivalent: Any, ratio: Any) -> Any:
    """Returns the lag speeding up [s] of motors of an equivalent lag."""
    return equivalent / equivalent_lag(1.0, ratio)


def slope_by_ratio(drone: Parameters) -> float:
    """Returns the change of the lag speeding up by the ratio [s], the equivalent lag fixed."""
    lag, ratio = float(drone.motor_time_constant), float(drone.spin_down_ratio)
    less, more = equivalent_lag(1.0, ratio * np.array([0.999, 1.001]))
    return -lag * float(np.log(more / less)) / (0.002 * ratio)


def delay_evidence(
    motors: MotorResponse | None,
    draws: Mapping[str, np.ndarray],
    unidentifiable: Collection[str],
    drone: Parameters,
) -> tuple[Evidence, ...]:
    """Returns what each signal shows, and last what is taken.

    Nothing where neither delay is identified.

    Signals show the equivalent lag of speeding up and slowing down, and so is that which is taken.

    Args:
        motors: what logs show of the motors.
        draws: posterior samples by parameter.
        unidentifiable: parameters that the flights cannot tell.
        drone: what was identified.
    """
    if not set(DELAYS) <= set(draws):
        return ()
    ratio = draws.get(SLOWING_DOWN, float(drone.spin_down_ratio))
    total = equivalent_lag(draws[LAG], ratio) + draws["latency"]
    origin = "plausible" if LAG in unidentifiable else "all together" if motors else "likelihood"
    return (
        *(motors.evidence if motors else ()),
        *(estimate._replace(is_taken=True) for estimate in of_samples(origin, {DELAY: total})),
    )


def notes(estimates: Sequence[Evidence], motors: MotorResponse | None) -> list[str]:
    """Returns which estimates disagree, and what the logs show of the motors."""
    if not estimates:
        return []
    outliers = [
        f"{estimate.signal} and {other.signal}"
        for number, estimate in enumerate(estimates)
        for other in estimates[number + 1 :]
        if estimate.interval[1] < other.interval[0] or other.interval[1] < estimate.interval[0]
    ]
    lines = [f"these disagree about the motors' lag: {'; '.join(outliers)}"]
    return [*(lines if outliers else []), *(motors.notes if motors else ())]
