"""How slow a log may be: motor lag and latency from simulated flights of which rows are left out.

Virtual drones are flown by the firmware's PID and identified by likelihood from every row at 100
Hz, every second, and so on, with and without the accelerometer. The search for a rate at which
nothing is found goes below the one that `identify` accepts. With `--speeds` logs hold the rotors'
speeds, from every command at 500 Hz on, of drones whose lags are scaled as well.

    python paper/identification/log_rates.py -o log_rates
    python paper/identification/log_rates.py --speeds
"""

import argparse
import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import polars

import maidenflight as mf
from maidenflight import results
from maidenflight.errors import InputError
from maidenflight.flights.log import Flight, thinned
from maidenflight.flying.engine import fly_all
from maidenflight.flying.firmware_pilot import FirmwarePilot
from maidenflight.flying.scenario import Scenario
from maidenflight.identification.likelihood.speed_errors import motors_of_speeds
from maidenflight.identification.outcome import problem as accepted
from maidenflight.identification.outcome.problem import generator_of
from maidenflight.parameters import Parameters, component
from maidenflight.parameters import replace as changed
from maidenflight.simulator.physics.dynamics import equivalent_lag
from maidenflight.simulator.tasks.tasks import paper_circle

OVER = ("thrust_to_weight", "motor_time_constant", "latency", "inertia_x")
FULL_SPEED = 2500.0
"""Of rotors at full thrust [rad/s]."""
SCALES = (1.0, 0.35)
"""Of the lag, some 80 ms, where speeds are measured."""
EVERY = (1, 2, 3, 4, 5)
"""Rows at 100 Hz to one that is kept."""


def row(seed: int, truth: Parameters, flights: Sequence[Flight]) -> dict[str, Any]:
    """What is found of a drone; times in ms. The true lag is the equivalent of up and down."""
    lag = float(equivalent_lag(truth.motor_time_constant, truth.spin_down_ratio))
    true = 1e3 * (lag + float(truth.latency))
    what = {
        "drone": seed,
        "rate": round(1 / flights[0].period, 1),
        "accelerometer": flights[0].accelerometer is not None,
        "true": round(true, 1),
    }
    try:
        identification = mf.identify(flights, mf.Likelihood(trials=1), over=OVER)
    except InputError:  # the flights tell nothing that is asked for
        return what
    samples = identification.posterior["motor_time_constant"] + identification.posterior["latency"]
    low, middle, high = 1e3 * np.quantile(samples, [0.025, 0.5, 0.975])
    inertia = float(component(identification.parameters, "inertia_x")) / float(truth.inertia[0])
    return what | {
        "found": round(float(middle), 1),
        "low": round(float(low), 1),
        "high": round(float(high), 1),
        "holds": bool(low <= true <= high),
        "lag told": "motor_time_constant" in identification.estimates,
        "inertia over true": round(inertia, 2),
        "inertia told": "inertia_x" in identification.estimates,
    }


def table(seeds: Sequence[int], every: Sequence[int], duration: float) -> polars.DataFrame:
    """A row for each drone and rate, with and without the accelerometer."""
    accepted.LONGEST_PERIOD = 1.0
    rows = []
    for seed in seeds:
        drone = mf.virtual_drone(seed)
        whole = mf.record(drone, jax.random.key(seed), flights=4, duration=duration, rate=100)
        for step in every:
            flights = [thinned(flight, step) for flight in whole]
            bare = [replace(flight, accelerometer=None) for flight in flights]
            rows += [row(seed, drone.parameters, options) for options in (flights, bare)]
    return polars.DataFrame(rows)


def summary(rows: polars.DataFrame) -> polars.DataFrame:
    """Means over the drones, by rate."""
    by = rows.group_by("accelerometer", "rate", maintain_order=True)
    counted = ("holds", "lag told", "inertia told")
    return by.agg(polars.exclude("drone", *counted).mean().round(2), polars.col(counted).sum())


def speed_errors(seeds: Sequence[int], every: Sequence[int], duration: float) -> polars.DataFrame:
    """Errors by measured speeds, RMS over drones: shares of lag and ratio; rows of the latency."""
    errors = []
    for seed, scale in itertools.product(seeds, SCALES):
        drone, keys = mf.virtual_drone(seed), jax.random.split(jax.random.key(seed), 4)
        truth = drone.parameters
        truth = changed(truth, motor_time_constant=scale * truth.motor_time_constant)
        drone = replace(drone, parameters=truth)
        lag = float(equivalent_lag(truth.motor_time_constant, truth.spin_down_ratio))
        scenario = Scenario(paper_circle(), duration)
        simulated = fly_all(drone, FirmwarePilot(np.float32(0.06)), scenario, keys)
        whole = [
            replace(
                one.to_flight(f"flight_{number}"), rotor_speed=FULL_SPEED * one.rows.rotor_speed
            )
            for number, one in enumerate(simulated)
        ]
        for step in every:
            flights = [thinned(flight, step) for flight in whole]
            motors = motors_of_speeds(flights, mf.crazyflie(), generator_of(0))
            period = flights[0].period
            if motors is not None and motors.spin_down_ratio is not None:
                longer = float(np.median(motors.lag)) / lag - 1
                later = float(np.median(motors.latency) - truth.latency) / period
                ratio = float(np.median(motors.spin_down_ratio) / truth.spin_down_ratio) - 1
                row = {"ms a row": 1e3 * period, "lag scaled by": scale, "lag": longer}
                errors.append(row | {"ratio": ratio, "latency": later})
    rms = (polars.col("lag", "ratio", "latency") ** 2).mean().sqrt().round(2)
    return (
        polars.DataFrame(errors).group_by("lag scaled by", "ms a row", maintain_order=True).agg(rms)
    )


def main() -> None:
    """Writes the table and prints it with its summary."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="*", default=range(1, 7), help="of the drones")
    parser.add_argument("--every", type=int, nargs="*", default=EVERY, help="rows to one kept")
    parser.add_argument("--duration", type=float, default=30.0, help="of a flight [s]")
    parser.add_argument("-o", "--output", type=Path, default=Path("log_rates"))
    parser.add_argument("--speeds", action="store_true", help="logs with the rotors' speeds")
    options = parser.parse_args()
    if options.speeds:
        print(speed_errors(options.seeds, (1, 2, 5, 10), options.duration))
        return
    rows = table(options.seeds, options.every, options.duration)
    results.write(options.output / "log_rates.csv", rows.write_csv())
    with polars.Config(tbl_rows=200, tbl_cols=20, tbl_hide_dataframe_shape=True):
        print(rows)
        print(summary(rows))


if __name__ == "__main__":
    main()
