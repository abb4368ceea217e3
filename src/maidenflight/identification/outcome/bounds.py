"""Parameters that lie at a bound of their search.

The best value is then somewhere beyond, and the interval, cut off at the bound, is too narrow.
Where nature ends, as at a latency or a drag of zero, a bound says nothing of the kind.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from maidenflight.errors import InputError
from maidenflight.identification.drone_file import DroneFile, Estimate
from maidenflight.identification.signals.lag import SLOWING_DOWN, speeding_up
from maidenflight.identification.signals.motor_response import LAG_BOUNDS
from maidenflight.identification.unknowns import UNKNOWNS, is_logarithmic
from maidenflight.parameters import COMPONENTS, QUANTITIES, Parameters, Quantity, component

AT_BOUND = 0.01
"""Share of the search range within which a value is at its bound; harmless within a factor of 1.4
(paper/identification/constants.py)."""
_OF_BOUND = 0.02
"""Share of the bound itself within which it is: thrust-to-weight ratio is searched from 1.01 to 8,
of which a hundredth is much; harmless within a factor of 1.4
(paper/identification/constants.py)."""
_WIDER = 3.0
"""Factor by which a search range is to be widened: changes advice alone
(paper/identification/constants.py)."""


def bound_reached(name: str, estimate: Estimate) -> float | None:
    """Returns the search bound at which an estimate lies.

    `None` if at none, or where nature ends there.

    Args:
        name: of the parameter, of `parameters.COMPONENTS`.
        estimate: with its search bounds, or at none without them.
    """
    return None if estimate.bounds is None else reached(name, estimate.value, estimate.bounds)


def reached(name: str, value: float, bounds: tuple[float, float]) -> float | None:
    """Returns the search bound at which a value lies.

    `None` if at none, or where nature ends there.

    Args:
        name: of the parameter, of `parameters.COMPONENTS`.
        value: of it.
        bounds: of the search.
    """
    low, high = bounds
    span = np.log(high / low) if is_logarithmic(name) else high - low
    for bound, inward in ((low, 1.0), (high, -1.0)):
        if bound == 0.0 == _quantity(name).lower:
            continue
        reach = AT_BOUND * span * (bound if is_logarithmic(name) else 1.0)
        reach = reach if bound == 0.0 else min(reach, _OF_BOUND * abs(bound))
        if inward * (value - bound) <= reach:
            return bound
    return None


def all_reached(drone: Parameters, limits: Mapping[str, tuple[float, float]]) -> list[str]:
    """Returns the names of a drone's parameters that lie at their search bounds."""
    return [
        name
        for name, ends in limits.items()
        if reached(name, float(component(drone, name)), ends) is not None
    ]


def at_bounds(estimates: Mapping[str, Estimate], by_law: bool = False) -> dict[str, str]:
    """Returns what to say and do of each estimate at a search bound, by the parameter's name.

    Args:
        estimates: by name.
        by_law: whether a battery law is known to have given the flights' thrust.
    """
    return {
        name: f"{name} = {estimate.value:.4g} lies at its search bound "
        f"{_format_bound(name, bound)}, and its interval is too narrow; "
        f"{_cure(name, bound, estimates, by_law)}"
        for name, estimate in estimates.items()
        if (bound := bound_reached(name, estimate)) is not None
    }


def cut_off(estimates: Mapping[str, Estimate], by_law: bool = False) -> dict[str, str]:
    """Returns the same of estimates of which only the interval reaches a search bound."""
    names_at = {}
    for name, estimate in estimates.items():
        if estimate.bounds is None or bound_reached(name, estimate) is not None:
            continue
        for end in estimate.interval:
            if (bound := reached(name, end, estimate.bounds)) is not None:
                names_at.setdefault(
                    name,
                    f"the interval of {name} is cut off at its search bound "
                    f"{_format_bound(name, bound)}; {_cure(name, bound, estimates, by_law)}",
                )
    return names_at


def _format_bound(name: str, bound: float) -> str:
    return f"{bound:.4g} {_quantity(name).unit}".removesuffix(" -")


def _cure(name: str, bound: float, estimates: Mapping[str, Estimate], by_law: bool) -> str:
    bounds = estimates[name].bounds or (bound, bound)
    if name == "thrust_to_weight" and bound <= UNKNOWNS[name].searched.low:
        return (
            "a drone that hardly flies explains the flights best: the accelerometer is wrong, "
            + ("or the battery law (--battery-law)" if by_law else "or the scale of the commands")
            + "; maidenflight log shows both"
        )
    if (
        name == "motor_time_constant"
        and np.isclose(bound, _measured_lags(estimates), rtol=1e-4).any()
    ):
        return (
            "gyro and rotor speeds show no lag beyond: check the logs' clocks and the order of "
            "their motors (maidenflight log)"
        )
    wider = widened(name, bound, bounds)
    if wider == bounds:
        return (
            "the model ends there; check units and --commands of the logs, or leave it out of "
            "--over"
        )
    return f"widen it: --bounds {name}={wider[0]:.6g},{wider[1]:.6g}"


def widened(name: str, bound: float, bounds: tuple[float, float]) -> tuple[float, float]:
    """Returns search bounds beyond the one that was reached, within the physical range.

    Args:
        name: of the parameter.
        bound: the one that was reached.
        bounds: both.
    """
    low, high = bounds
    quantity = _quantity(name)
    if bound == low:
        away = low / _WIDER if low > 0 else low - (_WIDER - 1) * (-low or high)
        return max(quantity.lower, away), high
    return low, min(quantity.upper, high * _WIDER if high > 0 else high / _WIDER)


def must_lie_within_bounds(drone: DroneFile) -> None:
    """Refuses a drone with a parameter at a search bound.

    Raises:
        InputError: names the parameters, their bounds, and what to do.
    """
    names_at = at_bounds(drone.estimates)
    if names_at:
        raise InputError(
            f"{drone.name}: {'; '.join(names_at.values())}. Identify again, or accept it with "
            "--accept-bounds."
        )


def equivalent_lag_estimates(estimates: Mapping[str, Estimate]) -> dict[str, Estimate]:
    """Estimates whose lag was not searched for but seen, with the bounds within which it is."""
    lag = estimates["motor_time_constant"]
    lags = _measured_lags(estimates)
    low, high = np.clip(lags if lag.bounds is None else lag.bounds, *lags)
    return {**estimates, "motor_time_constant": replace(lag, bounds=(float(low), float(high)))}


def _measured_lags(estimates: Mapping[str, Estimate]) -> tuple[float, float]:
    """Lags of speeding up that are told where the equivalent lag of both ways is seen."""
    ratio = estimates.get(SLOWING_DOWN)
    value = 1.0 if ratio is None else ratio.value
    return speeding_up(LAG_BOUNDS[0], value), speeding_up(LAG_BOUNDS[1], value)


def _quantity(name: str) -> Quantity:
    return QUANTITIES[COMPONENTS[name][0]]
