"""Policies trained in moving air beside those that are not, where it moves and where it does not.

For each drone file `maidenflight train` makes PWM policies, nothing set, for the drone as it is and
for DRONE_disturbed.toml beside it, as `validate --disturbances` writes it; without that file the
air is that of `+air`. Both fly the drone itself, others about it, and itself changed, calm and
disturbed, three flights of 20 s each. Prints error and commands at limits of each: a table of
paper/notes/nanodrone.md.

    python paper/policies/disturbed.py brushed.toml brushless.toml crazyflie.toml -o disturbed
"""

import argparse
import subprocess
import sys
from pathlib import Path

import jax
import polars

import maidenflight as mf
from maidenflight import parameters, policy_file
from maidenflight.errors import InputError
from maidenflight.experiments.drones import find_reality
from maidenflight.simulator.realities.additions import in_air
from maidenflight.simulator.tasks.failures import END_REASONS, TIME_LIMIT
from maidenflight.simulator.tasks.tasks import find_task

PLACES = (
    *("{drone}", "near:1@{drone}", "virtual:2@{drone}", "far:3@{drone}"),
    *("{drone}+10ms", "virtual:2@{drone}+weak10", "virtual:2@{drone}+payload15"),
)
TRIALS = 3


def disturbed_file(drone: Path, folder: Path) -> Path:
    """Returns the file of a drone in moving air."""
    path = drone.with_name(f"{drone.stem}_disturbed.toml")
    if path.is_file():
        return path
    return parameters.write_drone(folder / path.name, in_air(parameters.read_drone(drone)))


def train_policies(drone: Path, folder: Path) -> list[mf.Policy]:
    """Returns policies by default; those that the folder holds are not made again."""
    if not sorted(folder.glob("policy_*.json")):
        words = ["train", "--drone", str(drone), "--accept-bounds", "-o", str(folder)]
        subprocess.run([sys.executable, "-m", "maidenflight", *words], check=True)
    return [policy_file.read_policy(one).policy for one in sorted(folder.glob("policy_*.json"))]


def fly(policies: list[mf.Policy], drone: Path) -> polars.DataFrame:
    """Returns a row a flight in each place about a drone."""
    realities = []
    for place in PLACES:
        try:
            realities.append(find_reality(place.format(drone=drone), accept_bounds=True))
        except InputError as error:
            print(f"left out: {error}")
    how = {"task": find_task("circle"), "duration": 20.0}
    return mf.transfer(policies, realities, trials=TRIALS, key=jax.random.key(5), **how).table


def main() -> None:
    """Trains, flies, prints and writes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("drones", nargs="+", type=Path, help="drone files")
    parser.add_argument("-o", "--output", type=Path, default=Path("disturbed"), help="folder")
    arguments = parser.parse_args()
    arguments.output.mkdir(exist_ok=True)
    mf.prepare_jax()
    tables = []
    for drone in arguments.drones:
        files = {"calm": drone, "disturbed": disturbed_file(drone, arguments.output)}
        for trained, file in files.items():
            policies = train_policies(file, arguments.output / f"{drone.stem}_{trained}")
            for air, place in files.items():
                labels = {"drone": drone.stem, "trained": trained, "air": air}
                table = fly(policies, place).with_columns(
                    **{name: polars.lit(value) for name, value in labels.items()}
                )
                tables.append(table)
                lasting = (table["end_reason"] == END_REASONS[TIME_LIMIT]).sum()
                means = table.select("position_error", "estimated_error", "at_limits").mean().row(0)
                true, estimated, limits = (100 * value for value in means)
                shown = f"{true:.2f} cm, {estimated:.2f} by its estimate, {limits:.2f} % at limits"
                print(*labels.values(), f"{lasting} of {len(table)}, {shown}", flush=True)
        polars.concat(tables).write_csv(arguments.output / "flights.csv")


if __name__ == "__main__":
    main()
