"""Flights for the page's viewer: decimated columns of 16-bit numbers in base64."""

import base64
from typing import Any

import numpy as np

from maidenflight.flights.log import Flight
from maidenflight.parameters import arm_length, crazyflie, rotors
from maidenflight.reporting import run as runs
from maidenflight.reporting.run import Run

RATES = ((60, 50.0), (10**9, 25.0))
"""Up to so many flights, rows a second of each [Hz]."""
_LEVELS = 65534
"""Steps of a column from its smallest to its largest value."""


def viewer_data(run: Run) -> dict[str, Any]:
    """Returns the flights to look at, for the page's scripts; nothing where there are none."""
    places, flights = runs.viewable(run), runs.flights_to_show(run)
    rate = rate_of(len(places))
    references: list[dict[str, Any] | None] = []
    packed = []
    for index in places:
        flight = flights[index]
        every, usable_rows = max(1, round(1 / (rate * flight.period))), runs.usable(flight)
        has_setpoint = np.isfinite(flight.setpoint[usable_rows]).all()
        reference = _packed(flight.setpoint[usable_rows][::every]) if has_setpoint else None
        if reference not in references:
            references.append(reference)
        columns = [flight.position, flight.attitude, flight.command]
        true = flight.true_position
        if true is not None and np.isfinite(true[usable_rows]).all():
            columns.append(true)
        rows = np.concatenate(columns, axis=1)[usable_rows][::every]
        about = {
            "row": index,
            "label": _label(run, index, flight),
            "simulated": flight.simulated,
            "period": round(flight.period * every, 6),
        }
        packed.append({**about, **_packed(rows), "reference": references.index(reference)})
    drone = crazyflie() if run.drone is None else run.drone.parameters
    arm = arm_length(drone)
    shape = {"arm": round(arm, 5), "rotors": (rotors(drone)[:, :2] / arm).round(7).tolist()}
    return {**shape, "references": references, "flights": packed} if packed else {}


def rate_of(flights: int) -> float:
    """Returns rows a second of so many flights [Hz]."""
    return next(rate for most, rate in RATES if flights <= most)


def _label(run: Run, index: int, flight: Flight) -> str:
    if run.table is None:
        return f"{flight.name}, {flight.duration:.1f} s"
    row = run.table.row(index, named=True)
    label = "Flight {flight}: {policy} in {reality}, trial {trial}, {duration:.1f} s, {end_reason}"
    return label.format(**row)


def _packed(rows: np.ndarray) -> dict[str, Any]:
    """Columns of 16-bit numbers, one after the other, with each one's middle value and step."""
    columns = np.asarray(rows, np.float64).T
    low, high = columns.min(axis=1), columns.max(axis=1)
    middle, step = (low + high) / 2, np.maximum((high - low) / _LEVELS, 1e-9)
    levels = np.rint((columns - middle[:, None]) / step[:, None]).astype("<i2")
    # Seven digits of a step are more than 16 bits need.
    return {
        "middle": [round(float(value), 7) for value in middle],
        "step": [float(f"{value:.7g}") for value in step],
        "rows": base64.b64encode(levels.tobytes()).decode(),
    }
