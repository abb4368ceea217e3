"""What to log or fly next so that a parameter's interval becomes narrower, and how narrow."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from maidenflight.flights.log import Flight
from maidenflight.identification.drone_file import Advice, Estimate
from maidenflight.identification.outcome.plausible import HOVERING, OTHER_DAY
from maidenflight.identification.outcome.problem import calm_thrust
from maidenflight.identification.signals.lag import DELAYS
from maidenflight.identification.signals.motor_response import MotorResponse
from maidenflight.identification.unknowns import UNKNOWNS, is_logarithmic

_WIDE = 1.5
"""Upper end of an interval over the lower one, above which a parameter is hardly known: changes
advice alone (paper/identification/constants.py)."""
_WORTH = 0.85
"""Share of the present width above which an interval is not worth another flight: changes advice
alone (paper/identification/constants.py)."""
_CURVE = ("thrust_linear", "thrust_offset", "drag_z")
"""What thrust near a hover leaves open, besides its ratio to weight."""
_INSEPARABLE = 0.5
"""Share of the variance of 1 / thrust_to_weight that goes with `_CURVE`, from which on they cannot
be told apart: notes alone (paper/identification/constants.py). Calm PX4 logs have 0.70 to
0.91, a thrown quadrotor 0.41."""
_VARIED = 0.35
"""Standard deviation over mean of a throttle that is anywhere from a fifth to four fifths."""


def advise(
    estimates: Mapping[str, Estimate],
    unidentified: Collection[str],
    samples: Mapping[str, Float[np.ndarray, "N"]],
    motors: MotorResponse | None,
    inseparable: Collection[str] = (),
) -> tuple[Advice, ...]:
    """Returns for each parameter that is hardly known what narrows it.

    What follows the motors' lag, as inertia does, narrows with it: the rest of its variance after a
    regression of its samples on those of lag and latency stays.

    Args:
        estimates: the identified parameters.
        unidentified: names of those that flights do not determine.
        samples: of the posterior.
        motors: what the logs show of the motors.
        inseparable: what `inseparable_from_thrust` returns.
    """
    advice = []
    for name, estimate in estimates.items():
        low, high = estimate.interval
        if name in inseparable:
            advice.append(Advice(name, UNKNOWNS[_CURVE[0]].advice, None))
        elif name == HOVERING:
            if _may_narrow(estimate):
                reach = 1.96 * OTHER_DAY * estimate.value
                best = estimate.value - reach, estimate.value + reach
                advice.append(Advice(name, UNKNOWNS[name].advice, best))
        elif is_logarithmic(name) and high > _WIDE * low:
            advice.append(_narrowest(name, estimate, samples, motors) or _general(name, name))
    for name in unidentified:
        # Any hover shows the trim about z as a share of this.
        needed = "torque_to_thrust" if name == "torque_bias_z" else name
        advice.append(_general(name, needed if needed in unidentified else name))
    return tuple(tip for tip in advice if tip is not None)


def _may_narrow(ratio: Estimate) -> bool:
    """Tests whether a ratio of thrust to weight is known worse than another day would change it."""
    low, high = ratio.interval
    return 2 * 1.96 * OTHER_DAY * ratio.value < _WORTH * (high - low)


def inseparable_from_thrust(
    estimates: Mapping[str, Estimate],
    samples: Mapping[str, Float[np.ndarray, "N"]],
    flights: Sequence[Flight],
) -> tuple[str, ...]:
    """Returns the parameters that cannot be told apart from thrust-to-weight, and that; or none.

    About one throttle u only thrust_to_weight (linear sqrt(u) + (1 - linear) u) shows, so that the
    inverse of the ratio is a straight line in the others.

    Args:
        estimates: the identified parameters.
        samples: of the posterior.
        flights: that they are of; they tell more where the throttle varies.
    """
    names = [name for name in _CURVE if name in estimates and np.std(samples.get(name, 0.0)) > 0]
    if not names or HOVERING not in estimates or not _may_narrow(estimates[HOVERING]):
        return ()
    throttle = _throttle(flights)
    inverse = 1 / np.asarray(samples[HOVERING], float)
    others = np.column_stack([np.ones(len(inverse)), *(samples[name] for name in names)])
    rest = inverse - others @ np.linalg.lstsq(others, inverse, rcond=None)[0]
    is_line = np.var(rest) < (1 - _INSEPARABLE) * np.var(inverse)
    return (HOVERING, *names) if is_line and throttle.std() < _VARIED * throttle.mean() else ()


def _throttle(flights: Sequence[Flight]) -> Float[np.ndarray, "N"]:
    return np.concatenate([np.mean(flight.command, axis=1, dtype=float) for flight in flights])


def note_inseparable(names: Sequence[str], flights: Sequence[Flight]) -> list[str]:
    """Returns what flights of one throttle tell of thrust, if `names` cannot be told apart."""
    if len(names) < 2:
        return []
    throttle = _throttle(flights)
    ratio = float(np.median([calm_thrust(flight) for flight in flights]))
    known = f", where it is {ratio:.2f} times the weight per u, as maidenflight log has it"
    return [
        f"{', '.join(names[:-1])} and {names[-1]} cannot be told apart in these flights: throttle "
        f"varies by {throttle.std():.3f} of full thrust only (standard deviation). They tell "
        f"thrust near u = {throttle.mean():.2f}{known if ratio else ''}; that at full throttle "
        "lies anywhere in the interval"
    ]


def _general(name: str, needed: str) -> Advice | None:
    return Advice(name, UNKNOWNS[needed].advice, None) if name in UNKNOWNS else None


def _narrowest(
    name: str,
    estimate: Estimate,
    samples: Mapping[str, Float[np.ndarray, "N"]],
    motors: MotorResponse | None,
) -> Advice | None:
    """Returns what narrows a parameter most, if anything does, and by how much."""
    if motors is None or not {*DELAYS, name} <= set(samples):
        return None
    lag, latency = (samples[name] for name in DELAYS)
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
