"""Policies of the documented path for real drones: identify, train, fly what the logs leave open.

Each drone is identified from its logs (quickstart, step 3) and policies are trained for it (step
4). They, the firmware's PID and Mellinger's controller fly drones of its posterior for 20 s. Writes
a table of paper/notes/training.md. What a folder of an earlier run holds is not made again.

    python paper/policies/identified_drones.py --data ../shared/data -o identified
"""

import argparse
import dataclasses
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
import polars

import maidenflight as mf
from maidenflight import policy_file, results
from maidenflight.experiments.drones import possible_drones
from maidenflight.experiments.transfer import Transfer, firmware_pilot
from maidenflight.identification import drone_file
from maidenflight.names import CONTROLLERS, POSTERIOR
from maidenflight.simulator.physics.battery import law_for
from maidenflight.simulator.realities.virtual_drone import VirtualDrone
from maidenflight.verbs.identify import Identify
from maidenflight.verbs.train import Train

DRAWN, FLIGHT_S, WITHIN_M, START_S, GUARD_DEG = 20, 20.0, 0.03, 0.5, 30.0
"""Drones drawn from a posterior; a flight's length [s], and the mean error [m] that it may have;
the start, in which tilt is looked at [s], and the guard of tilt [deg]."""


class Source(NamedTuple):
    """Logs of a real drone."""

    pattern: str
    """Of the logs or their folder, below the data's folder."""
    start: str
    """Named drone to begin with."""
    mass: float | None
    """[g]; None for the named drone's."""


SOURCES = {
    "authors": Source("authors/flights/pwm", "crazyflie", None),
    "brushed": Source("usd/brushed/jana*", "crazyflie_2.0", 34.7),
    "brushless": Source("usd/brushless/eckart*", "crazyflie_brushless", 37.0),
    "payload": Source("usd/payload/eckart*", "crazyflie_brushless", 44.4),
    "NanoBench": Source("nanobench/*_rep1.csv.gz", "crazyflie_2.0", None),
}


def identify_drone(source: Source, data: Path, folder: Path) -> Path:
    """Returns a drone's file in a folder, identified from its logs unless it is there."""
    logs, drone = folder / "logs", folder / "drone.toml"
    if not drone.is_file():
        logs.mkdir(parents=True, exist_ok=True)
        for file in sorted(data.glob(source.pattern)):
            (logs / file.name).unlink(missing_ok=True)
            (logs / file.name).symlink_to(file.resolve())
        logs = data / source.pattern if (data / source.pattern).is_dir() else logs
        Identify(logs=logs, start=source.start, mass=source.mass).run(drone)
    return drone


def make(name: str, data: Path, output: Path) -> tuple[Path, Path]:
    """Identifies a drone and trains policies for it; returns its file and their folder."""
    folder = output / name
    drone, policies = identify_drone(SOURCES[name], data, folder), folder / "policies"
    if not (policies / "policy_1.json").is_file():
        Train(drone=str(drone), yaw_penalty=0.1, accept_bounds=True).run(policies)
    return drone, policies


def drones_of(drone: Path) -> list[VirtualDrone]:
    """Returns drones of the posterior."""
    file = drone_file.read(drone)
    every, law = possible_drones(file, POSTERIOR, seed=0), law_for(file.full_scale_counts)
    # Which divides the 2 ms between two commands of the firmware.
    every = dataclasses.replace(every, time_step=np.full_like(every.time_step, 0.002))
    count = len(np.asarray(every.mass))
    chosen = np.linspace(0, count - 1, min(DRAWN, count)).astype(int)
    return [
        VirtualDrone(
            f"posterior-{index}", jax.tree.map(lambda part, i=index: part[i], every), thrust_law=law
        )
        for index in chosen
    ]


def tilt_at_start(flights: Transfer) -> float:
    """Largest roll or pitch in the first half second of any flight [deg]."""
    return max(
        float(np.degrees(np.abs(one.attitude[: round(START_S / one.period), :2]).max()))
        for one in flights.flights
    )


def row(name: str, pilot: str, flights: Transfer) -> dict[str, object]:
    """Returns what a table says of flights of one kind of pilot."""
    table = flights.table
    lasting = (table["end_reason"] == "time limit") & (table["position_error"] <= WITHIN_M)
    return {
        "drone": name,
        "flown by": pilot,
        "20 s within 3 cm": f"{int(lasting.sum())} of {len(table)}",
        "last 20 s": int((table["end_reason"] == "time limit").sum()),
        "error [cm]": round(100.0 * float(np.mean(table["position_error"].to_numpy())), 2),
        "worst [cm]": round(100.0 * float(np.max(table["position_error"].to_numpy())), 2),
        "tilt margin at the start [deg]": round(GUARD_DEG - tilt_at_start(flights), 1),
    }


def main() -> None:
    """Makes the drones and policies, and flies them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--drone", action="append", choices=SOURCES, help="All by default.")
    parser.add_argument("-o", "--output", type=Path, default=Path("identified"))
    arguments = parser.parse_args()
    rows = []
    for name in arguments.drone or SOURCES:
        drone, folder = make(name, arguments.data, arguments.output)
        places = drones_of(drone)
        files = sorted(folder.glob("policy_*.json"))
        policies = [policy_file.read_policy(file).policy for file in files]
        key = jax.random.key(0)
        rows.append(row(name, f"{len(policies)} policies", mf.transfer(policies, places, 1, key)))
        for controller in CONTROLLERS:
            pilot = firmware_pilot(controller, policies[0].interface.full_scale_counts)
            rows.append(row(name, controller, mf.transfer([pilot], places, 1, key)))
        results.write(arguments.output / "table.csv", polars.DataFrame(rows).write_csv())
        print(*rows[-3:], sep="\n", flush=True)


if __name__ == "__main__":
    main()
