"""What identification buys: envelopes of policies that know the drone, and of those that do not.

Each virtual drone is recorded (four flights of 30 s by its PID), identified from these logs, and
flown by policies for fast circles that were trained for the identified drone, and by policies for
the unidentified Crazyflie, each with several kinds of randomization. The firmware's position PID
flies the same. What is there already is not made again.

    python paper/rivals.py -o rivals --drones 1 2 3
"""

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import polars

from maidenflight import results, workflow
from maidenflight.experiments import envelope
from maidenflight.flights import flying
from maidenflight.flights.flying import Rows
from maidenflight.parameters import Parameters
from maidenflight.policy import read
from maidenflight.simulator import control, tasks, trajectories
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.virtual_drone import VirtualDrone, virtual_drone

TASK = "fast_circle"
RANDOMIZATIONS: dict[str, float | str] = {"10 %": 0.10, "wide": workflow.WIDE}
OF_IDENTIFIED: dict[str, float | str] = {**RANDOMIZATIONS, "posterior": workflow.POSTERIOR}
UNKNOWN = "crazyflie"
"""The drone of policies without identification."""
PID_RATE = 500


def trained(folder: Path, drone: str | Path, kind: float | str, policies: int) -> list[Path]:
    """Policy files of one training, made unless they are there."""
    files = [folder / f"policy_{number}.json" for number in range(1, policies + 1)]
    if not all(file.exists() for file in files):
        settings = workflow.settings_for("pwm", TASK)
        workflow.train_for(
            drone, 0, folder, policies, settings, kind, task=TASK, accept_bounds=True
        )
    return files


def identified(folder: Path, drone: VirtualDrone, seed: int) -> Path:
    """The drone file identified from recorded flights, made unless it is there."""
    file = folder / "drone.toml"
    if not file.exists():
        logs = folder / "logs"
        workflow.record(drone, seed, logs, folder / "reality.toml", 4, 30.0, 0.06)
        workflow.identify_from(logs, seed, file)
    return file


def pid_speed(drone: VirtualDrone, flights: int) -> list[float]:
    """The speed on the circle that each flight of the firmware's position PID reaches [m/s]."""
    pace = envelope.AXES["circle"]
    assert isinstance(pace, envelope.Pace)
    task = tasks.tracking(pace.of(pace.fastest), trajectories.QUICKENING)
    env = drone.environment(task, control.position_pid())
    keys = jax.random.split(jax.random.key(0), flights)
    rows = jax.tree.map(np.asarray, _fly_pid(env, drone.parameters, keys))
    steps = round(trajectories.QUICKENING * PID_RATE)
    found = []
    for number in range(flights):
        one = jax.tree.map(lambda values, number=number: values[number], rows)
        found.append(pace.fastest * envelope.rows_flown(one, PID_RATE) / steps)
    return found


@partial(jax.jit, static_argnums=0)
def _fly_pid(env: Environment, drone: Parameters, keys: jax.Array) -> Rows:
    steps = round(trajectories.QUICKENING * PID_RATE)

    def one(key: jax.Array) -> Rows:
        return flying.fly(env, lambda *_: jnp.zeros(4), drone, key, steps)

    return jax.vmap(one)(keys)


def table(
    folder: Path, seeds: Sequence[int], axes: Sequence[str], policies: int, flights: int
) -> polars.DataFrame:
    """A row a flight, as `envelope.envelope` gives; policies are called by their training."""
    parts = []
    for seed in seeds:
        file = folder / f"virtual-{seed}" / "envelopes.csv"
        if not file.exists():
            found = of_drone(folder, seed, axes, policies, flights)
            results.write(file, found.write_csv())
        parts.append(polars.read_csv(file))
    return polars.concat(parts)


def of_drone(
    folder: Path, seed: int, axes: Sequence[str], policies: int, flights: int
) -> polars.DataFrame:
    """The same of one drone."""
    drone, parts = virtual_drone(seed), []
    known = identified(folder / drone.name, drone, seed)
    files = {
        f"unidentified, {name}": trained(folder / UNKNOWN / name, UNKNOWN, kind, policies)
        for name, kind in RANDOMIZATIONS.items()
    } | {
        f"identified, {name}": trained(folder / drone.name / name, known, kind, policies)
        for name, kind in OF_IDENTIFIED.items()
    }
    names = [f"{name}: {number}" for name in files for number in range(1, policies + 1)]
    flown = [read(file) for several in files.values() for file in several]
    for axis in axes:
        print(f"{drone.name} along {axis}", flush=True)
        found = envelope.envelope(
            flown, drone, axis, flights=flights, task=tasks.TASKS[TASK](), names=names
        )
        parts.append(found)
        if axis == "circle":
            speeds = pid_speed(drone, flights)
            pid = found[:flights].with_columns(
                polars.lit("firmware PID: 1").alias("policy"),
                polars.Series("reached", speeds),
            )
            parts.append(pid)
    return polars.concat(parts)


def by_training(found: polars.DataFrame) -> polars.DataFrame:
    """Mean envelope over policies of a training and over drones, and the worst of them.

    A policy that flies nothing counts as 0.
    """
    training = polars.col("policy").str.split(":").list.first().alias("training")
    value = polars.col("envelope").fill_nan(0.0)
    return (
        envelope.summary(found)
        .with_columns(training)
        .group_by("axis", "training", maintain_order=True)
        .agg(
            polars.len().alias("policies x drones"),
            value.mean().alias("mean"),
            value.min().alias("worst"),
            (value / polars.col("limit")).mean().alias("of physics"),
            polars.col("unit").first(),
        )
    )


def main() -> None:
    """Writes the table and prints it by training."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drones", type=int, nargs="*", default=(1, 2, 3), help="seeds")
    parser.add_argument("--along", nargs="*", default=tuple(envelope.AXES), help="axes")
    parser.add_argument("--policies", type=int, default=2, help="of each training")
    parser.add_argument("--flights", type=int, default=20, help="of each policy and axis")
    parser.add_argument("-o", "--output", type=Path, default=Path("rivals"))
    given = parser.parse_args()
    found = table(given.output, given.drones, given.along, given.policies, given.flights)
    results.write(given.output / "rivals.csv", found.write_csv())
    with polars.Config(
        tbl_rows=100, tbl_cols=20, tbl_hide_dataframe_shape=True, fmt_str_lengths=40
    ):
        print(envelope.summary(found))
        print(by_training(found))


if __name__ == "__main__":
    main()
