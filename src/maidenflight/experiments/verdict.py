"""Whether a policy may fly: a verdict on its simulated flights on the identified drone."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import polars
import scipy
from jaxtyping import Float

from maidenflight.simulator.tasks.failures import REACHED

WITHIN_M = 0.05
"""Mean distance of the estimate from the set-point within which a flight is good [m]."""
_SURE = 0.01
"""Probability of such a rank correlation by chance, above which no parameter decides."""


@dataclass(frozen=True)
class Verdict:
    """Whether a policy may fly, and why not."""

    is_good: bool
    """Whether all flights last and stay within `WITHIN_M`, as far as the drone knows."""
    sentence: str
    parameter: str | None = None
    """What decides between good and bad flights, if anything surely does."""


def judge(
    flights: polars.DataFrame,
    samples: Mapping[str, Float[np.ndarray, "N"]],
    seconds: float,
    actions: Mapping[str, str],
) -> Verdict:
    """Judges a policy by its flights.

    Args:
        flights: of one policy; see `predict_flight_times`.
        samples: parameters of the drones that their column `drone` counts, by name.
        seconds: longest flight [s].
        actions: what makes a parameter better known, by its name.
    """
    name, count = flights["policy"][0], flights.height
    lasts = flights["end_reason"] == REACHED
    far = int((lasts & ~(flights["estimated_error"] < WITHIN_M)).sum())
    reach = f"{100 * WITHIN_M:g} cm"
    if lasts.all() and not far:
        largest = 100 * float(flights["position_error"].to_numpy().max())
        drift = f", by its estimate, which drifts: up to {largest:.0f} cm in truth"
        return Verdict(
            True,
            f"Fly: {count} of {count} flights of {name} last {seconds:g} s within {reach} of the "
            f"set-point{drift if largest >= 100 * WITHIN_M else ''}.",
        )
    reasons = Counter(flights.filter(~lasts)["end_reason"].to_list()).most_common()
    faults = [f"{number} of {count} end by {reason}" for reason, number in reasons]
    if reasons:
        faults[-1] += f" ({flights.filter(~lasts)['duration'].mean():.1f} s in the mean)"
    faults += [f"{far} of {count} stay farther than {reach} from the set-point"] if far else []
    parameter = _decides(flights, samples)
    if parameter is not None:
        faults.append(f"{parameter} decides which")
        faults += [actions[parameter]] if parameter in actions else []
    return Verdict(False, f"Do not fly: of {name}, {'; '.join(faults)}.", parameter)


def _decides(
    flights: polars.DataFrame, samples: Mapping[str, Float[np.ndarray, "N"]]
) -> str | None:
    """Returns the parameter whose rank goes most with that of the error, if any surely does.

    Flights that a guard ended have the largest errors, the shortest the largest of all. Of several
    parameters the threshold is divided by their number (Bonferroni).
    """
    drone = flights["drone"].to_numpy() - 1
    error = flights["estimated_error"].to_numpy().copy()
    ended = (flights["end_reason"] != REACHED).to_numpy()
    error[ended] = 1e6 - flights["duration"].to_numpy()[ended]
    if len(set(error)) < 2:
        return None
    chances = {
        name: float(scipy.stats.spearmanr(values[drone], error).pvalue)
        for name, values in samples.items()
        if len(set(values[drone])) > 1
    }
    name = min(chances, key=lambda name: chances[name], default=None)
    return name if name and chances[name] * len(chances) < _SURE else None
