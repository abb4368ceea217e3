"""How flights recover from a change of the drone: `recovery`, and tables of transfer flights."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import polars
from jaxtyping import Float

from maidenflight.flights.log import Flight
from maidenflight.simulator.realities import additions
from maidenflight.simulator.tasks.failures import REACHED

WITHIN_M = 0.05
"""Distance from the set-point [m] within which a flight is back."""
SOON_S = 2.0
"""Time after the change [s] in which a flight is back soon."""


def recovery(errors: Float[np.ndarray, "F T"], rate: float, at: float) -> Float[np.ndarray, "F"]:
    """Returns the time after the change from which a flight stays within `WITHIN_M`, to its end.

    Args:
        errors: distances from the set-point [m], one row a flight.
        rate: distances a second [Hz]; the first is at the flight's start.
        at: when the drone changes [s].

    Returns:
        [s]; infinite where a flight is never back, or ends before the drone changes.
    """
    far = ~(errors[:, round(at * rate) :] <= WITHIN_M)
    if not far.shape[1]:
        return np.full(len(errors), np.inf)
    last = far.shape[1] - np.argmax(far[:, ::-1], axis=1)
    return np.where(far[:, -1], np.inf, np.where(far.any(axis=1), last, 0) / rate)


def distance(flight: Flight) -> Float[np.ndarray, "N"]:
    """Returns distances from the set-point when rows were measured [m], true where known."""
    position = flight.position if flight.true_position is None else flight.true_position
    return np.linalg.norm(np.subtract(position, flight.setpoint, dtype=np.float64), axis=1)


def of_flights(table: polars.DataFrame, flights: Sequence[Flight]) -> polars.DataFrame:
    """Returns the flights whose drone changes, as the names of their realities say.

    Args:
        table: rows of a transfer.
        flights: their logs, in the same order.

    Returns:
        One row a flight: place (in `table`, from 0), policy, reality, at [s], lasts (whether no
        guard ended it) and recovery [s], infinite where a guard ended it. Flights that lasted, but
        not until the change, are left out. No rows where there are none.
    """
    rows: list[dict[str, Any]] = []
    for index, (row, flight) in enumerate(zip(table.iter_rows(named=True), flights, strict=True)):
        at, lasts = additions.jump_of(row["reality"]), row["end_reason"] == REACHED
        if at is None or (lasts and len(flight) <= round(at / flight.period)):
            continue
        (back,) = recovery(distance(flight)[None], 1 / flight.period, at)
        rows.append(
            {"place": index, "policy": row["policy"], "reality": row["reality"], "at": at}
            | {"lasts": lasts, "recovery": float(back) if lasts else float("inf")}
        )
    return polars.DataFrame(rows, _COLUMNS)


_COLUMNS = {
    "place": polars.Int64,
    "policy": polars.String,
    "reality": polars.String,
    "at": polars.Float64,
    "lasts": polars.Boolean,
    "recovery": polars.Float64,
}


def summary(recoveries: polars.DataFrame) -> polars.DataFrame:
    """Returns what `of_flights` gives, one row a reality and policy.

    Returns:
        reality, policy, at [s], flights, lasting, soon (flights that are back within `SOON_S`) and
        median recovery [s]; infinite where half of the flights or more are never back.
    """
    return recoveries.group_by("reality", "policy", maintain_order=True).agg(
        polars.col("at").first(),
        polars.len().alias("flights"),
        polars.col("lasts").sum().alias("lasting"),
        (polars.col("recovery") < SOON_S).sum().alias("soon"),
        polars.col("recovery").median(),
    )
