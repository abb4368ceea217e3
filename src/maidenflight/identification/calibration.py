"""Calibration of an identification: its intervals, tested on simulated drones of known truth.

Drones are drawn from the posterior and fly the paths of the logs, with the noise that these logs
showed. Each is identified as the drone itself was. If intervals are
right, 95 % of them hold the drawn truth, and its ranks among the posterior samples are uniform.

Source: Talts et al. 2018, Validating Bayesian inference algorithms with simulation-based
    calibration.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import jax
import numpy as np
import polars
import scipy
from jaxtyping import Array

from maidenflight.errors import InputError
from maidenflight.flights.log import Flight
from maidenflight.identification.drone_file import DroneFile
from maidenflight.identification.outcome.estimates import Identification
from maidenflight.identification.path_flights import fly_paths, require_path
from maidenflight.identification.signals.lag import DELAYS
from maidenflight.identification.uncertainty import LEVEL, interval
from maidenflight.parameters import check, replace

TOTAL = "lag + latency"
"""Both delays together, which flights tell better than either."""
BINS = 5
"""Of a rank histogram. Source: R's package SBC, `guess_rank_hist_bins`, for fewer than 60 ranks."""
BAND = 0.99
"""Share of uniform ranks' counts of a bin that lie in the band (Talts et al. 2018)."""
Identify = Callable[[Sequence[Flight], Array], Identification]
"""(flights, random key) to what is identified from them."""


def draw_calibrations(
    flights: Sequence[Flight],
    file: DroneFile,
    identify: Identify,
    key: Array,
) -> Iterator[list[dict[str, Any]]]:
    """Identifies one drone of the posterior after another.

    Args:
        flights: the logs, of which drones fly the paths.
        file: the identified drone.
        identify: how the drone was identified.
        key: random key.

    Yields:
        A row for each parameter: parameter, truth, low and high of the interval, rank of the truth
        among the posterior samples in [0, 1] and width over that of the drone's file; truth alone
        where the parameter was not in the model. No rows where a drone is not held on the path.

    Raises:
        InputError: there is no posterior, or no path in the logs.
    """
    if not file.posterior:
        raise InputError(f"{file.name}: no [posterior] to draw drones from. Identify it again.")
    for flight in flights:
        require_path(flight)
    count = len(next(iter(file.posterior.values())))
    order_key, key = jax.random.split(key)
    for number in np.asarray(jax.random.permutation(order_key, count)):
        fly_key, identify_key = jax.random.split(jax.random.fold_in(key, int(number)))
        values = {name: float(samples[number]) for name, samples in file.posterior.items()}
        drone = replace(file.parameters, **{name: np.float32(v) for name, v in values.items()})
        drone = check(drone, f"{file.name} [posterior]")
        logs = fly_paths(drone, file.parameters, flights, fly_key)
        yield [] if logs is None else _compare(values, file, identify(logs, identify_key))


def _compare(
    truth: Mapping[str, float], file: DroneFile, result: Identification
) -> list[dict[str, Any]]:
    """Returns a row for each parameter; see `draw_calibrations`."""
    before, after = with_total(file.posterior), with_total(result.posterior)
    ends = {name: estimate.interval for name, estimate in file.estimates.items()}
    own = {name: estimate.interval for name, estimate in result.estimates.items()}
    rows: list[dict[str, Any]] = []
    for name, value in with_total(truth).items():
        row: dict[str, Any] = {"parameter": name, "truth": value}
        row |= dict.fromkeys(("low", "high", "rank", "width_ratio"))
        if name in after:
            low, high = own.get(name) or interval(after[name])
            first, last = ends.get(name) or interval(before[name])
            row |= {"low": float(low), "high": float(high)}
            row["rank"] = float(np.mean(after[name] < value))
            row["width_ratio"] = float((high - low) / (last - first))
        rows.append(row)
    return rows


def with_total(values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns values by parameter, and of lag and latency together where both are there."""
    total = {TOTAL: sum(values[name] for name in DELAYS)} if set(DELAYS) <= set(values) else {}
    return {**values, **total}


def uniform_band(count: int) -> tuple[int, int]:
    """Returns the least and most of so many uniform ranks that a bin holds, by `BAND`."""
    ends = scipy.stats.binom.ppf([(1 - BAND) / 2, (1 + BAND) / 2], count, 1 / BINS)
    return int(ends[0]), int(ends[1])


def summarize(rows: polars.DataFrame) -> list[dict[str, Any]]:
    """Returns how each parameter's intervals hold the truth.

    Args:
        rows: of all draws; see `draw_calibrations`.

    Returns:
        For each parameter: draws, in_model (how many had it), held (of these), width_ratio
        (median), ranks (counts of `BINS` bins), enough (whether so few held intervals are no rarer
        than one in forty where 95 % are to hold) and uniform (whether every bin is in the band).
    """
    summary = []
    for (name,), part in rows.group_by("parameter", maintain_order=True):
        tested = part.filter(polars.col("rank").is_finite())
        count = tested.height
        held = int(tested["truth"].is_between(tested["low"], tested["high"]).sum())
        ranks = np.histogram(tested["rank"], BINS, (0.0, 1.0))[0].tolist()
        low, high = uniform_band(count)
        enough = bool(scipy.stats.binom.cdf(held, count, LEVEL) > 0.025)
        summary.append(
            {"parameter": name, "draws": part.height, "in_model": count, "held": held}
            | {"width_ratio": tested["width_ratio"].median(), "ranks": ranks}
            | {"enough": enough, "uniform": all(low <= rank <= high for rank in ranks)}
        )
    return summary
