"""Kinds of policies on one curve: two instants, a memory, any reference; in unlike realities.

Flies each folder of policies on the circle and writes a table of paper/notes/training.md, from
which the default kind follows. No choice was made in these realities.

    maidenflight train --drone crazyflie -o two
    maidenflight train --drone crazyflie --memory 16 --randomize any-day -o memory
    maidenflight train --drone crazyflie --task tracking -o tracking
    python paper/policies/kinds.py two memory tracking
"""

import argparse
from pathlib import Path

import jax

import maidenflight as mf
from maidenflight import policy_file
from maidenflight.experiments.drones import find_reality
from maidenflight.simulator.tasks.tasks import find_task

REALITIES = (
    *("near:11", "virtual:31", "far:5"),
    *(f"virtual:31+{change}" for change in ("yaw6000", "10ms", "payload15", "yaw6000+10ms")),
)
TRIALS = 3


def main() -> None:
    """Flies the policies and prints the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folders", type=Path, nargs="+", help="Folders of policies of one kind.")
    parser.add_argument("--task", default="circle")
    arguments = parser.parse_args()
    places = [find_reality(name) for name in REALITIES]
    print("|", " | ".join(["policies", "n", *(f"`{name}`" for name in REALITIES)]), "|")
    print("|---" * (len(REALITIES) + 2) + "|")
    for folder in arguments.folders:
        files = sorted(folder.glob("policy_*.json"))
        policies = [policy_file.read_policy(file).policy for file in files]
        cells = []
        for place in places:
            task, key = find_task(arguments.task), jax.random.key(0)
            table = mf.transfer(policies, place, TRIALS, key, task=task).table
            lasting = int((table["end_reason"] == "time limit").sum())
            error = 100.0 * float(table["position_error"].to_numpy().mean())
            ends = "" if lasting == len(table) else f" ({lasting} of {len(table)})"
            cells.append(f"{error:.2f}{ends}")
        print("|", " | ".join([folder.name, str(len(files)), *cells]), "|", flush=True)


if __name__ == "__main__":
    main()
