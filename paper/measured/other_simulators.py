r"""Predicted against flown tracking errors in simulators by others, whose physics are not ours.

In each reality `record` flies, and `identify` makes a drone of the logs. Forty policies are trained
for the first one's drone: two tasks, two control structures, five seeds, two numbers of updates so
small that errors differ. `predict` says their mean distance from the set-point on each identified
drone, and they fly there. Prints the ratio of predicted and flown and their rank correlation. What
a folder of an earlier run holds is not made again.

    python paper/measured/other_simulators.py -o other --reality l2f:crazyflie+sensors \
      --reality crazyflow:cf2x_L250+sensors
"""

import argparse
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import jax
import numpy as np
import polars
from agreement import agreement

import maidenflight as mf
from maidenflight import compiler, policy_file, results
from maidenflight.errors import require_simulators
from maidenflight.experiments.conditions import Conditions
from maidenflight.experiments.drones import choose_prediction, find_reality, possible_drones
from maidenflight.experiments.flight_times import predict_flight_times
from maidenflight.flying.scenario import start_of
from maidenflight.simulator.realities.reality import AnyReality
from maidenflight.simulator.tasks.failures import ZERO_SHOT
from maidenflight.simulator.tasks.tasks import find_task
from maidenflight.verbs.identify import Identify
from maidenflight.verbs.record import Record
from maidenflight.verbs.train import Train

TASKS, CONTROLS, UPDATES, SEEDS = ("circle", "figure_eight"), ("pwm", "attitude_rate"), (40, 120), 5
DURATION_S, PREDICTED, ACTUAL, WITHIN = 10.0, 8, 1, 0.25
"""Longest flight [s]; flights of a policy, predicted and flown; the error of a ratio to count."""
STILL = (0.0, 0.0, 0.0)
# A t distribution of four degrees has twice the variance of its scale.
START = start_of((0.02 / np.sqrt(6.0),) * 3, STILL, STILL, STILL, 0.0, 0.0)
"""As `transfer` begins: at rest, within 2 cm of the reference's start along each axis."""


def identify_drone(reality: str, folder: Path) -> Path:
    """Returns the drone identified from flights recorded in a reality."""
    logs, drone = folder / "flights", folder / "drone.toml"
    if not logs.is_dir():
        Record(reality=reality).run(logs)
    if not drone.is_file():
        Identify(logs=logs, start=str(logs / "reality.toml")).run(drone)
    return drone


def train_policies(drone: Path, folder: Path) -> list[tuple[str, str, list[Path]]]:
    """Returns task, control structure and policy files of each training."""
    every = []
    for task, structure, updates in product(TASKS, CONTROLS, UPDATES):
        place = folder / f"{task}_{structure}_{updates}"
        how = {"policies": SEEDS, "updates": updates, "randomize": 0.1, "accept_bounds": True}
        if not (place / f"policy_{SEEDS}.json").is_file():
            Train(drone=str(drone), task=task, control=structure, **how).run(place)
        every.append((task, structure, sorted(place.glob("policy_*.json"))))
    return every


def compare_errors(
    drone: Path, reality: AnyReality, trainings: Sequence[tuple[str, str, list[Path]]]
) -> polars.DataFrame:
    """Returns a row a policy: how long and how far from the set-point [m], predicted and flown.

    Args:
        drone: the identified one.
        reality: where the policies fly.
        trainings: what `train_policies` returns.
    """
    drones, rows = possible_drones(drone, choose_prediction(drone), 0), []
    for name, structure, files in trainings:
        policies = [policy_file.read_policy(file).policy for file in files]
        labels, task = [f"{file.parent.name}/{file.stem}" for file in files], find_task(name)
        how = {"duration": DURATION_S, "names": labels}
        predicted = predict_flight_times(
            policies,
            drones,
            jax.random.key(0),
            trials=PREDICTED,
            conditions=Conditions(start=START, guard=ZERO_SHOT),
            policy_tasks=[task] * len(policies),
            **how,
        )
        flights = mf.transfer(policies, reality, ACTUAL, jax.random.key(1), task=task, **how).table
        rows.append(means(predicted, "predicted").join(means(flights, "flown"), on="policy"))
        print(f"{name}, {structure}: {len(policies)} policies", flush=True)
    return polars.concat(rows).with_columns(
        ratio=polars.col("predicted_error") / polars.col("flown_error")
    )


def means(flights: polars.DataFrame, label: str) -> polars.DataFrame:
    """Returns mean error [m] and duration [s] of each policy, in columns of a label."""
    return flights.group_by("policy", maintain_order=True).agg(
        polars.col("position_error").mean().alias(f"{label}_error"),
        polars.col("duration").mean().alias(f"{label}_duration"),
    )


def describe(table: polars.DataFrame) -> str:
    """Returns a line on ratio and rank of the errors of all policies, and of those that last."""
    lines = []
    lasting = table.filter(polars.min_horizontal("^.*_duration$") >= DURATION_S)
    for label, part in (("all", table), ("lasting", lasting)):
        if part.height < 2:
            lines.append(f"{label}: {part.height} policies")
            continue
        predicted, actual, ratio = (
            part[name].to_numpy() for name in ("predicted_error", "flown_error", "ratio")
        )
        low, middle, high = np.quantile(ratio, [0.1, 0.5, 0.9])
        within = int(np.sum(np.abs(ratio - 1.0) <= WITHIN))
        lines.append(
            f"{label}: {within} of {part.height} policies within {WITHIN:.0%}, ratio {middle:.2f} "
            f"({low:.2f} to {high:.2f}), rank {agreement(predicted, actual).spearman:.2f}"
        )
    return "; ".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Records, identifies, trains, predicts, flies and prints."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--reality", action="append", required=True, help="may be repeated")
    parser.add_argument("-o", "--output", type=Path, default=Path("other_simulators"))
    options = parser.parse_args(arguments)
    require_simulators(options.reality)
    folders = {name: options.output / name.replace(":", "_") for name in options.reality}
    drones = {name: identify_drone(name, folder) for name, folder in folders.items()}
    trainings = train_policies(drones[options.reality[0]], options.output / "policies")
    for name, folder in folders.items():
        table = compare_errors(drones[name], find_reality(name), trainings)
        record = results.record(seed=0, inputs=[], settings={"reality": name})
        text = results.table_text("maidenflight other simulator 1", record, table.write_csv())
        results.write(folder / "compared.csv", text)
        print(f"{name}: {describe(table)}", flush=True)


if __name__ == "__main__":
    compiler.prepare_jax()
    main()
