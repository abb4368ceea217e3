"""What to log or fly next so that a parameter's interval becomes narrower, and how narrow."""

from collections.abc import Collection, Mapping

import numpy as np
from jaxtyping import Float

from maidenflight.identification.drone_file import Advice, Estimate
from maidenflight.identification.outcome.plausible import HOVERING, OTHER_DAY
from maidenflight.identification.signals.lag import DELAYS
from maidenflight.identification.signals.motor_response import MotorResponse
from maidenflight.identification.unknowns import UNKNOWNS, is_logarithmic

_WIDE = 1.5
"""Upper end of an interval over the lower one, above which a parameter is hardly known."""
_WORTH = 0.85
"""Share of the present width above which an interval is not worth another flight."""


def advise(
    estimates: Mapping[str, Estimate],
    unidentified: Collection[str],
    samples: Mapping[str, Float[np.ndarray, "N"]],
    motors: MotorResponse | None,
) -> tuple[Advice, ...]:
    """Returns for each parameter that is hardly known what narrows it.

    What follows the motors' lag, as inertia does, narrows with it: the rest of its variance after a
    regression of its samples on those of lag and latency stays.

    Args:
        estimates: the identified parameters.
        unidentified: names of those that flights do not determine.
        samples: of the posterior.
        motors: what the logs show of the motors.
    """
    advice = []
    for name, one in estimates.items():
        low, high = one.interval
        if name == HOVERING:
            reach = 1.96 * OTHER_DAY * one.value
            if 2 * reach < _WORTH * (high - low):
                best = one.value - reach, one.value + reach
                advice.append(Advice(name, UNKNOWNS[name].advice, best))
        elif is_logarithmic(name) and high > _WIDE * low:
            advice.append(_narrowest(name, one, samples, motors) or _general(name))
    advice += [_general(name) for name in unidentified]
    return tuple(one for one in advice if one is not None)


def _general(name: str) -> Advice | None:
    return Advice(name, UNKNOWNS[name].advice, None) if name in UNKNOWNS else None


def _narrowest(
    name: str,
    estimate: Estimate,
    samples: Mapping[str, Float[np.ndarray, "N"]],
    motors: MotorResponse | None,
) -> Advice | None:
    """Returns what narrows a parameter most, if anything does, and by how much."""
    if motors is None or not {*DELAYS, name} <= set(samples):
        return None
    lag, latency = (samples[one] for one in DELAYS)
    own = np.log(np.maximum(samples[name], 1e-12))
    delays = np.column_stack([np.log(lag + latency), latency])
    delays = delays - delays.mean(axis=0)
    slopes = np.linalg.lstsq(delays, own - own.mean(), rcond=None)[0]
    rest = np.var(own - delays @ slopes)
    now = np.std(own)
    best = None
    for action, deviations in motors.expected_deviations.items():
        expected = float(np.sqrt(rest + np.sum((slopes * deviations) ** 2)))
        if expected < _WORTH * now:
            low, high = estimate.value * np.exp(1.96 * expected * np.array([-1.0, 1.0]))
            now, best = expected / _WORTH, Advice(name, action, (float(low), float(high)))
    return best
