"""Motor lag and latency of drones whose rotor speeds were measured, found with these speeds hidden.

Every log alone and every folder together, at the logs' own 500 Hz, at 250 and at 100 Hz, by what
the accelerometer and the gyro show of the motors; beside it what the measured speeds say of the
same log. Slower rates keep every second or fifth row, as a log at that rate would have.

    python paper/measured_truth.py --usd ../shared/data/usd -o measured_truth

Source of the logs: IMRCLab, crazyflie-data-collection (2026).
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars

from maidenflight import results
from maidenflight.flights.log import Flight, thinned
from maidenflight.flights.reading import read_flights
from maidenflight.identification.signals.motor_response import (
    MotorResponse,
    estimate_motor_response,
)
from maidenflight.parameters import crazyflie

FOLDERS = ("brushed", "brushless", "payload")
EVERY = (1, 2, 5)
"""Rows of a log to one that is kept."""


def ends(found: MotorResponse) -> tuple[float, float, float]:
    """Median and 95 % interval of lag and latency together [ms]."""
    low, middle, high = 1e3 * np.quantile(found.lag + found.latency, [0.025, 0.5, 0.975])
    return float(middle), float(low), float(high)


def judged(name: str, flights: Sequence[Flight], every: int) -> dict[str, object] | None:
    """A row of the table, or none where the flights are too short."""
    truth = estimate_motor_response(flights, np.random.default_rng(0), crazyflie())
    hidden = [thinned(replace(flight, rotor_speed=None), every) for flight in flights]
    found = estimate_motor_response(hidden, np.random.default_rng(0), crazyflie())
    if truth is None or found is None:
        return None
    measured, value, (low, high) = ends(truth)[0], ends(found)[0], ends(found)[1:]
    return {
        "flights": name,
        "rate": round(1 / (flights[0].period * every)),
        "every": every,
        "measured": round(measured, 1),
        "found": round(value, 1),
        "low": round(low, 1),
        "high": round(high, 1),
        "error": round(value - measured, 1),
        "holds": low <= measured <= high,
    }


def table(usd: Path, every: Sequence[int]) -> polars.DataFrame:
    """A row for each log and each folder at each rate; times in ms."""
    rows = []
    for folder in FOLDERS:
        flights = read_flights(usd / folder).flights
        logs = sorted({flight.name for flight in flights})
        for step in every:
            for log in logs:
                alone = [flight for flight in flights if flight.name == log]
                rows.append(judged(log, alone, step))
            rows.append(judged(f"{folder} together", list(flights), step))
    return polars.DataFrame([row for row in rows if row])


def summary(found: polars.DataFrame) -> polars.DataFrame:
    """Median error and share of intervals that hold the measured value, by rate and kind."""
    together = polars.col("flights").str.ends_with("together")
    return (
        found.with_columns(
            polars.when(together)
            .then(polars.lit("folder"))
            .otherwise(polars.lit("log"))
            .alias("of")
        )
        .group_by("of", "every", maintain_order=True)
        .agg(
            polars.len().alias("count"),
            polars.col("error").abs().median().alias("median error"),
            polars.col("error").abs().max().alias("largest"),
            polars.col("holds").mean().alias("holds"),
            (polars.col("high") / polars.col("low")).median().alias("high over low"),
        )
    )


def main() -> None:
    """Writes the table and prints it with its summary."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--usd", type=Path, required=True, help="folder with the three folders")
    parser.add_argument("--every", type=int, nargs="*", default=EVERY, help="rows to one kept")
    parser.add_argument("-o", "--output", type=Path, default=Path("measured_truth"))
    given = parser.parse_args()
    found = table(given.usd, given.every)
    results.write(given.output / "measured_truth.csv", found.write_csv())
    with polars.Config(tbl_rows=200, tbl_cols=20, tbl_hide_dataframe_shape=True):
        print(found)
        print(summary(found))


if __name__ == "__main__":
    main()
