"""Whether a drone is known well enough to fly: a verdict on flights of drones of its posterior."""

from collections.abc import Mapping

import polars
import scipy
from jaxtyping import Float
from numpy import ndarray

from maidenflight.identification.drone_file import DroneFile
from maidenflight.simulator.tasks.failures import REACHED

WITHIN_M = 0.05
"""Mean distance from the set-point within which a flight is good [m]."""
_SURE = 0.01
"""Probability of such a rank correlation by chance, above which no parameter decides."""


def verdicts(flights: polars.DataFrame, file: DroneFile, seconds: float) -> list[str]:
    """Returns a line for each control structure: how many drones fly well, and what decides.

    Args:
        flights: of drones of the posterior, with the column `drone`; see `predict_flight_times`.
        file: the drone's file.
        seconds: longest flight [s].
    """
    lasts = polars.col("end_reason") == REACHED
    is_good = lasts & (polars.col("position_error") < WITHIN_M)
    lines = []
    for (control,), part in flights.group_by("control", maintain_order=True):
        shares = part.group_by("policy", maintain_order=True).agg(is_good.mean().alias("share"))
        best, share = shares.sort("share", descending=True, maintain_order=True).row(0)
        own = part.filter(polars.col("policy") == best)
        line = (
            f"{control}: {share:.0%} of {own.height} drones of the posterior fly {seconds:g} s "
            f"within {100 * WITHIN_M:g} cm ({best})"
        )
        if share < 1.0:
            name = _decides(own, file.posterior)
            advice = [f"next: {one.action}" for one in file.advice if one.parameter == name]
            line = "; ".join([line, f"{name or 'no parameter'} decides", *advice])
        lines.append(line)
    return lines


def _decides(flights: polars.DataFrame, samples: Mapping[str, Float[ndarray, "N"]]) -> str | None:
    """Returns the parameter whose rank goes most with that of the error, if any surely does.

    Flights that a guard ended have the largest errors, the shortest the largest of all. Of several
    parameters the threshold is divided by their number (Bonferroni).
    """
    drone = flights["drone"].to_numpy() - 1
    error = flights["position_error"].to_numpy().copy()
    ended = (flights["end_reason"] != REACHED).to_numpy()
    error[ended] = 1e6 - flights["duration"].to_numpy()[ended]
    if len(set(error)) < 2:
        return None
    chances = {
        name: float(scipy.stats.spearmanr(values[drone], error).pvalue)
        for name, values in samples.items()
        if len(set(values[drone])) > 1
    }
    name = min(chances, key=lambda one: chances[one], default=None)
    return name if name and chances[name] * len(chances) < _SURE else None
