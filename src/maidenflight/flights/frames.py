"""A flight of a pandas or polars table in memory, whose columns a map names."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars

from maidenflight.errors import InputError
from maidenflight.flights.checked_log import check_log
from maidenflight.flights.formats import Logged
from maidenflight.flights.log import Flight
from maidenflight.flights.maps import column_map
from maidenflight.flights.tables import Table


def flight_of_frame(
    frame: Any, columns: Mapping[str, Any], name: str, zero_order_hold: bool | None
) -> Flight:
    """Returns the flight in a table; see `Flight.from_frame`."""
    if not isinstance(frame, polars.DataFrame):
        frame = polars.DataFrame({str(key): np.asarray(frame[key]) for key in frame.columns})
    entries = {
        signal: entry if isinstance(entry, Mapping) else {"columns": entry}
        for signal, entry in columns.items()
    }
    entries = {
        signal: {
            **entry,
            "columns": [names] if isinstance(names := entry.get("columns"), str) else names,
        }
        for signal, entry in entries.items()
    }
    flight, time, notes = column_map.flight(
        Table(name, frame), column_map.of_entries(Path(f"columns of {name}"), entries)
    )
    if zero_order_hold is not None:
        flight = replace(flight, zero_order_hold=zero_order_hold, assumed=False)
    log = check_log([Logged(name, [(flight, time)], notes)])
    if log.faults:
        raise InputError(" ".join(map(str, log.faults)))
    if len(log.pieces) != 1:
        raise InputError(
            f"{name}: {len(log.pieces)} usable pieces of flight, expected one. Cut the table where "
            f"rows are missing. {' '.join(map(str, log.notes))}"
        )
    return log.pieces[0]
