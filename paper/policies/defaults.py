"""Policies by default for ten drones: what they cost, and how far each flies where.

Five drones are identified from real logs, five are named or drawn. For each, `maidenflight train`
makes three policies of each control structure, nothing set. They fly the drone itself, others about
it, and itself with more latency, a weak motor and a payload, three flights of 20 s each. Prints a
table of paper/notes/training.md; a cell in which a flight ends says what the drone there has left:
the phase margin of the firmware's rate loop, unless policies command the motors, and thrust. What
the folder holds is not made again.

    python paper/policies/defaults.py --data ../shared/data -o defaults

`--train` gives training other settings than the default, to compare.
"""

import argparse
import resource
import shlex
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import jax
import numpy as np
import polars
from identified_drones import SOURCES, Source, identify_drone

import maidenflight as mf
from maidenflight import compiler, parameters, policy_file, results
from maidenflight.errors import InputError
from maidenflight.experiments.drones import find_reality
from maidenflight.policy import Policy
from maidenflight.simulator.controllers.phase_margin import rate_margin
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.realities.virtual_drone import VirtualDrone, must_be_virtual

IDENTIFIED = {name: SOURCES[name] for name in ("brushed", "brushless", "payload", "NanoBench")} | {
    "SimpleFlight": Source("real/simpleflight/cf0*", "crazyflie_2.0", 32.1)
}
OTHERS = (
    *("racer_5_inch", "x500", "crazyflie_2.1+"),
    *("virtual:5@crazyflie_brushless", "far:9@x500"),
)
"""Named drones, and virtual ones whose parameters are known."""
PLACES = {
    "itself": "{drone}",
    **{kind: f"{kind}:11@{{drone}}" for kind in ("near", "virtual", "far")},
    **{f"+{change}": f"{{drone}}+{change}" for change in ("10ms", "weak10", "payload15")},
}
TRIALS = 3


def make_drone(name: str, data: Path, folder: Path) -> str:
    """Returns what a drone is called in commands: its name, or a file that the folder holds."""
    if name in parameters.DRONES:
        return name
    path = folder / "drone.toml"
    if name in IDENTIFIED:
        return str(identify_drone(IDENTIFIED[name], data, folder))
    if not path.is_file():
        drone = must_be_virtual(find_reality(name), "Name a virtual one.").parameters
        parameters.write_drone(path, drone)
    return str(path)


def train_policies(drone: str, control: str, further: str, folder: Path) -> list[Policy]:
    """Returns policies by the command, which end `seconds.txt` with what processors took [s]."""
    cost = folder / "seconds.txt"
    if not cost.is_file():
        words = ["train", "--drone", drone, "--control", control, "-o", str(folder)]
        words += ["--accept-bounds", "--overwrite", *shlex.split(further)]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(
            [sys.executable, "-m", "maidenflight", *words], check=True, stdout=sys.stderr
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
        results.write(cost, f"{seconds:.0f}\n")
    files = sorted(folder.glob("policy_*.json"))
    return [policy_file.read_policy(file).policy for file in files]


def fly(drone: str, policies: list[Policy], folder: Path) -> polars.DataFrame:
    """Returns a row a flight of each policy in each place, from the folder if they are there."""
    path = folder / "flights.csv"
    if not path.is_file():
        places = {}
        for place, name in PLACES.items():
            # A drone may lift no more than itself.
            with suppress(InputError):
                places[place] = find_reality(name.format(drone=drone), True)
        table = mf.transfer(policies, list(places.values()), TRIALS, jax.random.key(0)).table
        where = {reality.name: place for place, reality in places.items()}
        table = table.with_columns(place=polars.col("reality").replace(where))
        results.write(path, table.write_csv(float_precision=5))
    return polars.read_csv(path)


def lacks(reality: VirtualDrone, policy: Policy) -> str:
    """Returns what a drone has left where flights end: phase of the rate loop, and thrust."""
    interface, drone = policy.interface, reality.parameters
    share = float(dynamics.hover_command(drone))
    left = [f"hovers at {share:.2f}"] if share > 0.95 else []
    if interface.name != "pwm":
        margin = rate_margin(drone, interface.full_scale_counts).phase
        left.append(f"{np.degrees(margin):.0f} deg")
    return f" [{', '.join(left)}]" if left else ""


def describe(place: str, drone: str, flights: polars.DataFrame, policy: Policy) -> str:
    """Returns a cell: error [cm], and where flights end how many do not."""
    here = flights.filter(polars.col("place") == place)
    if here.is_empty():
        return "cannot fly"
    error = 100.0 * float(here["position_error"].to_numpy().mean())
    lasting = int((here["end_reason"] == "time limit").sum())
    if lasting == len(here):
        return f"{error:.1f}"
    reality = must_be_virtual(find_reality(PLACES[place].format(drone=drone), True), "")
    return f"{error:.1f}, {lasting} of {len(here)}{lacks(reality, policy)}"


def count_sound(flights: polars.DataFrame) -> str:
    """Returns how many policies last in all of near, virtual and far, within 2 cm in the mean."""
    table = flights.filter(polars.col("place").is_in(["near", "virtual", "far"]))
    sound = table.group_by("policy", "place").agg(
        ((polars.col("end_reason") == "time limit").all())
        & (polars.col("position_error").mean() < 0.02)
    )
    each = sound.group_by("policy").agg(polars.col("end_reason").all())["end_reason"]
    return f"{int(each.sum())} of {len(each)}"


def survival_of(folder: Path) -> str:
    """Returns the least and greatest best survival of policies in training, in percent."""
    scores = polars.read_csv(folder / "training.csv", comment_prefix="#")
    best = 100.0 * scores.group_by("policy").agg(polars.col("survival").max())["survival"]
    return f"{best.min():.0f} to {best.max():.0f} %"


def main() -> None:
    """Makes drones and policies, flies them, and prints the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--drone", action="append", choices=[*IDENTIFIED, *OTHERS])
    parser.add_argument("--control", action="append", help="attitude_rate and pwm by default")
    parser.add_argument("--train", default="", help="further words for `maidenflight train`")
    parser.add_argument("-o", "--output", type=Path, default=Path("defaults"))
    options = parser.parse_args()
    heads = ["drone", "control", "processor [s]", "survival in training", *PLACES, "sound"]
    print("|", " | ".join(heads), "|")
    print("|---" * len(heads) + "|")
    for control in options.control or ("attitude_rate", "pwm"):
        for name in options.drone or (*IDENTIFIED, *OTHERS):
            home = options.output / name.replace(":", "_").replace("@", "_")
            folder = home / control
            drone = make_drone(name, options.data, home)
            policies = train_policies(drone, control, options.train, folder)
            flights = fly(drone, policies, folder)
            cells = [describe(place, drone, flights, policies[0]) for place in PLACES]
            cost, survival = (folder / "seconds.txt").read_text().strip(), survival_of(folder)
            row = [name, control, cost, survival, *cells, count_sound(flights)]
            print("|", " | ".join(row), "|", flush=True)


if __name__ == "__main__":
    compiler.prepare_jax()
    main()
