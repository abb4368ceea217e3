r"""Predicts tracking errors of a real Crazyflie on which a policy of others was flown.

L2F's published policy flew figure-eights and a star on Crazyflies of SimpleFlight (Chen et al.
2024), which logged the way and its error. No package ships its weights, so RAPTOR, of the same
authors, the firmware's controllers and policies of ours fly the same references on drones of the
posterior of such a Crazyflie. Writes the table of paper/notes/rivals.md.

    maidenflight identify cf0/ --start crazyflie_2.0 --mass 32.1 -o cf0.toml
    maidenflight train --drone cf0.toml --task tracking --yaw-penalty 0.1 -o policies/
    python paper/policies/l2f_flights.py cf0.toml policies/ \
        --flights ../shared/data/real/simpleflight
"""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import polars
from identified_drones import drones_of
from jaxtyping import Float

from maidenflight import policy_file
from maidenflight.errors import require_packages
from maidenflight.experiments.transfer import firmware_pilot
from maidenflight.flying.engine import fly_all
from maidenflight.flying.foreign_policy import foreign_policy
from maidenflight.flying.pilots import ForeignPilot, pilots_of
from maidenflight.flying.scenario import Scenario
from maidenflight.names import CONTROLLERS
from maidenflight.simulator.realities.virtual_drone import VirtualDrone
from maidenflight.simulator.tasks import tasks, trajectories, waypoints
from maidenflight.simulator.tasks.failures import APP, LOST, REACHED
from maidenflight.simulator.tasks.tasks import Task

BEGINNING_S, STAR_STEP_S, STAR_HEIGHT_M = 5.0, 0.5, 1.0
"""What is left out of each flight, such as the take-off [s]; time between two rows of the star that
a reference goes through [s], and its height [m]."""
FOREIGN_DRONES = 8
"""Drones that RAPTOR flies, whose flights are simulated one after another."""


class Error(NamedTuple):
    """How far a flight is from its reference, after its beginning."""

    mean: float
    """[cm]."""
    constant: float
    """Length of the mean error, which a trim or a weak integral leaves [cm]."""
    rest: float
    """Mean distance without it [cm]."""


def error_of(vectors: Float[np.ndarray, "n 3"]) -> Error:
    """Splits errors of a flight [m]."""
    mean = vectors.mean(axis=0)
    distance, rest = (np.linalg.norm(part, axis=1).mean() for part in (vectors, vectors - mean))
    return Error(*(100.0 * float(part) for part in (distance, np.linalg.norm(mean), rest)))


class Log(NamedTuple):
    """A real flight of L2F's policy: time [s], set-point and its error [m], about z = 0."""

    time: Float[np.ndarray, "n"]
    setpoint: Float[np.ndarray, "n 3"]
    error: Float[np.ndarray, "n 3"]


def read_log(file: Path) -> Log:
    """Reads columns Timestamp [ms], switch, position x to z and error x to z [m]."""
    table = polars.read_csv(file).to_numpy()
    moments = (table[:, 0] - table[0, 0]) / 1000.0
    return Log(moments, table[:, 2:5] + table[:, 5:8], table[:, 5:8])


def star(log: Log, folder: Path) -> Task:
    """Returns the task of following the way-points that a flight had."""
    places = np.arange(0.0, log.time[-1], STAR_STEP_S)
    rows = np.searchsorted(log.time, places)
    points = log.setpoint[rows] + np.array([0.0, 0.0, STAR_HEIGHT_M])
    file = folder / "star.csv"
    polars.DataFrame(np.c_[log.time[rows] - log.time[0], points], ["t", "x", "y", "z"]).write_csv(
        file
    )
    curve, duration = waypoints.read_reference(file)
    return tasks.tracking(curve, duration)._replace(name="star")


def pilots(policies: Path) -> dict[str, tuple[Sequence[Any], int]]:
    """Returns pilots by what flies, and how many drones each flies."""
    ours = [policy_file.read_policy(file).policy for file in sorted(policies.glob("policy_*.json"))]
    counts = ours[0].interface.full_scale_counts
    every: dict[str, tuple[Sequence[Any], int]] = {"ours": (pilots_of(ours), 1000)}
    every |= {name: ([firmware_pilot(name, counts)], 1000) for name in CONTROLLERS}
    for name in ("raptor", "raptor:500hz"):
        policy = foreign_policy(name)
        assert policy is not None
        every[name] = ([ForeignPilot(policy, counts)], FOREIGN_DRONES)
    return every


def row(
    name: str, pilot: Any, drones: Sequence[VirtualDrone], task: Task, duration: float
) -> dict[str, object]:
    """Flies each drone once; returns what the table says of it."""
    scenario = Scenario(task, duration, drones=[one.parameters for one in drones])
    keys = jax.random.split(jax.random.key(0), len(drones))
    guard = LOST._replace(position_error=APP.position_error)
    flights = fly_all(drones[0], pilot, scenario, keys, guard)
    lasting = [one for one in flights if one.end_reason == REACHED]
    first = round(BEGINNING_S * flights[0].rate)
    errors = [
        error_of(np.asarray(one.rows.true_setpoint - one.rows.true_position)[first:])
        for one in lasting
    ]
    mean, constant, rest = np.median(errors, axis=0) if errors else (float("nan"),) * 3
    low, high = np.quantile([one.mean for one in errors] or [float("nan")], (0.025, 0.975))
    return {
        "reference": task.name,
        "flown by": name,
        "last": f"{len(lasting)} of {len(flights)}",
        "error [cm]": round(float(mean), 1),
        "95 %": f"{low:.1f} to {high:.1f}",
        "constant": round(float(constant), 1),
        "rest": round(float(rest), 1),
    }


def main() -> None:
    """Flies all references with all pilots."""
    require_packages("foundation_policy")
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("drone", type=Path)
    parser.add_argument("policies", type=Path)
    parser.add_argument("--flights", type=Path, default=Path("../shared/data/real/simpleflight"))
    parser.add_argument("-o", "--output", type=Path, default=Path("l2f_flights.csv"))
    arguments = parser.parse_args()
    drones = drones_of(arguments.drone)
    logs = {file.stem: read_log(file) for file in sorted(arguments.flights.glob("l2f_policy_*"))}
    references = {
        "slow": (tasks.figure_eight(trajectories.SLOW), 20.0),
        "normal": (tasks.figure_eight(trajectories.NORMAL), 20.0),
        "star": (star(logs["l2f_policy_star1"], arguments.output.parent), 16.0),
    }
    rows: list[dict[str, object]] = []
    for name, log in logs.items():
        real = error_of(log.error[log.time > BEGINNING_S])
        rows.append({"reference": name, "flown by": "L2F, real", "error [cm]": round(real.mean, 1)})
        rows[-1] |= {"constant": round(real.constant, 1), "rest": round(real.rest, 1)}
    kinds = pilots(arguments.policies)
    for name, (task, duration) in references.items():
        for kind, (several, count) in kinds.items():
            begin = time.monotonic()
            chosen = drones[:: max(1, len(drones) // count)][:count]
            for pilot in several:
                rows.append(row(kind, pilot, chosen, task._replace(name=name), duration))
                print(rows[-1], f"{time.monotonic() - begin:.0f} s", flush=True)
    polars.DataFrame(rows).write_csv(arguments.output)


if __name__ == "__main__":
    main()
