"""Half a second ahead on public logs, in the measure of the NanoDrone benchmark.

Each fold is predicted by what the others tell: inertia by measured rotor speeds, disturbances by
likelihood. From every row of a checked flight but its first 30, the logged inputs alone carry the
prediction on. NanoDrone leaves each of its four training flights out, NanoBench a manoeuvre, the
micro-SD logs a third of the logs.

    python paper/identification/nanodrone.py --data ../shared/data -o nanodrone.csv

Source: Busetto et al. 2025, Nonlinear system identification nano-drone benchmark; Ullah and Baca
2026 (NanoBench); IMRCLab's micro-SD logs.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars
from truth_board import DRONES, Drone, read_drone_flights

import maidenflight as mf
from maidenflight.disturbances.fitting import filter_flights, fit_disturbances
from maidenflight.disturbances.horizons import SUMS, predict_windows, tabulate_horizons
from maidenflight.disturbances.kalman import with_disturbances
from maidenflight.flights.log import Flight
from maidenflight.identification.signals.speed_inertia import inertia_of_speeds
from maidenflight.parameters import Parameters, arm_length, replace

SHOWN_S = (0.02, 0.05, 0.1, 0.25, 0.5)
"""Times ahead that are printed [s]."""


@dataclass(frozen=True)
class Logs:
    """Logs of a drone, and the fold of each."""

    drone: Drone
    fold: Callable[[str], str]
    """Of a log's name."""
    every: int
    """Rows from a window to the next."""


def third(name: str) -> str:
    """Returns the third of the micro-SD logs that one belongs to, by its last digit."""
    return f"third {min(int(name[-1]) // 3, 2) + 1}"


NANOBENCH = tuple(
    f"nanobench/{flights}.csv.gz"
    for flights in ("B2*", "B3*", "B7*fast*", "B7*medium*", "B7*slow_rep[23]")
)
"""All flights but one, of which too few rows are higher than 0.1 m."""
SETS = {
    "NanoDrone": Logs(DRONES["NanoDrone"], lambda name: Path(name).name.split("_")[0], 1),
    "NanoBench": Logs(
        Drone(NANOBENCH, "crazyflie", None, {}, ""),
        lambda name: Path(name).name.split("_")[1],
        4,
    ),
    "brushless": Logs(DRONES["brushless"], third, 1),
    "brushed": Logs(DRONES["brushed"], third, 2),
}


def with_inertia(start: Parameters, flights: Sequence[Flight]) -> Parameters:
    """Returns a drone with the inertia that measured speeds tell; about z in proportion."""
    samples = inertia_of_speeds(flights, start, 400, np.random.default_rng(0))
    inertia, told = np.asarray(start.inertia, float), []
    for axis, name in enumerate(("inertia_x", "inertia_y")):
        if name in samples:
            value = float(np.exp(np.log(samples[name]).mean()))
            told.append(value / inertia[axis])
            inertia[axis] = value
    inertia[2] *= np.mean(told) if told else 1.0
    return replace(start, inertia=inertia.astype(np.float32))


def describe_air(drone: Parameters) -> str:
    """Returns how large and slow disturbances of a drone are, over its weight and its arm."""
    weight = float(drone.mass * drone.gravity)
    torque = drone.disturbance_torque / (weight * arm_length(drone))
    force = drone.disturbance_force / weight
    return (
        f"disturbances: torque {np.round(torque, 4)} of weight times arm, for "
        f"{drone.disturbance_torque_time:.2f} s; force {np.round(force, 4)} of weight, for "
        f"{drone.disturbance_force_time:.2f} s"
    )


def predict_fold(logs: Logs, flights: Sequence[Flight], fold: str) -> polars.DataFrame:
    """Returns errors on the flights of a fold, by what the others tell."""
    training = [one for one in flights if logs.fold(one.name) != fold]
    judged = [one for one in flights if logs.fold(one.name) == fold]
    drone = with_inertia(logs.drone.parameters, training)
    model = fit_disturbances(training, drone)
    print(describe_air(with_disturbances(drone, filter_flights(judged, model))))
    return tabulate_horizons([predict_windows(judged, model, drone, every=logs.every)])


def main() -> None:
    """Predicts, prints and writes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder of the logs")
    parser.add_argument("--sets", nargs="+", choices=SETS, default=list(SETS))
    parser.add_argument("-o", "--output", type=Path, default=Path("nanodrone.csv"))
    arguments = parser.parse_args()
    mf.prepare_jax()
    tables = []
    for name in arguments.sets:
        logs = SETS[name]
        flights = read_drone_flights(logs.drone, arguments.data)
        for fold in sorted({logs.fold(one.name) for one in flights}):
            table = predict_fold(logs, flights, fold)
            tables.append(
                table.with_columns(set=polars.lit(name), fold=polars.lit(fold)).select(
                    "set", "fold", *table.columns
                )
            )
            shown = table.filter(polars.col("horizon").is_in([SUMS, *SHOWN_S]))
            with polars.Config(tbl_rows=-1, tbl_cols=-1, tbl_width_chars=200, float_precision=4):
                print(name, fold, shown, flush=True)
            polars.concat(tables).write_csv(arguments.output)


if __name__ == "__main__":
    main()
