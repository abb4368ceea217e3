"""The drone file of a match: that which the search began with, with what was found in place."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from maidenflight import parameters
from maidenflight.identification.closed_loop import Match
from maidenflight.identification.drone_file import (
    CLOSED_LOOP,
    DroneFile,
    Estimate,
    Search,
    Source,
)


def merge_match(
    start: DroneFile, result: Match, source: Source, record: Mapping[str, Any]
) -> DroneFile:
    """Puts what was found in place of what the search began with."""
    estimates, posterior = dict(start.estimates), dict(start.posterior)
    for name, (value, error) in result.estimates.items():
        old = estimates.get(name)
        ends = max(value - 1.96 * error, 0.0), value + 1.96 * error
        between = 0.0 if old is None else old.between_sd
        estimates[name] = Estimate(value, ends, (value,), between)
        if name in posterior:
            samples = posterior[name]
            unit = (samples - samples.mean()) / (samples.std() or 1.0)
            posterior[name] = np.maximum(value + error * unit, 0.0)
    changes = {name: np.float32(value) for name, (value, _) in result.estimates.items()}
    return dataclasses.replace(
        start,
        parameters=parameters.replace(start.parameters, **changes),
        estimates=estimates,
        posterior=posterior,
        source=start.source or source,
        search=Search(CLOSED_LOOP, result.cost[1], result.flights, result.evaluations),
        record=record,
    )
