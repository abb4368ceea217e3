"""The paper's study of the length of the history, and a study of the size of hidden layers.

`python paper/history_and_hidden.py` trains policies of each history H in {1, 2, 4, 6, 8} and, with
H = 2, of each size of the hidden layers by gradients through the simulator, over drones within 10 %
of a Crazyflie with a motor lag of 80 ms and a latency of 20 ms or of `--drone`. It scores them on
episodes that they have not seen and flies them in a virtual reality that they have not seen. The
paper names the histories and says that H = 2 performed best, without numbers; it had trained by
PPO, as `--method ppo` does here, with other drones.
"""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
import polars

from maidenflight import parameters, results
from maidenflight.errors import InputError
from maidenflight.experiments.transfer import transfer
from maidenflight.names import METHODS
from maidenflight.policy import Policy
from maidenflight.simulator.controllers import control
from maidenflight.simulator.controllers.interface import CONTROLS
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.randomization import RelativeBox, relative_box
from maidenflight.simulator.realities.virtual_drone import virtual_drone
from maidenflight.simulator.tasks import tasks
from maidenflight.training.defaults import choose_settings
from maidenflight.training.evaluation import evaluate
from maidenflight.training.train import train

HISTORY, HIDDEN = 2, (50, 50)
"""Of the paper's policies; what one study does not vary."""
HISTORIES = (1, 2, 4, 6, 8)
"""Gronauer et al. 2022, sec. Simulation Environment."""
SIZES = ("16x16", "32x32", "50x50", "64x64", "128x128")


class Kind(NamedTuple):
    """What is studied of a policy."""

    history: int
    hidden: tuple[int, ...]

    @property
    def size(self) -> str:
        """The hidden layers, as the command line names them."""
        return "x".join(map(str, self.hidden))


class Study(NamedTuple):
    """What came of one kind."""

    policies: polars.DataFrame
    """A row a policy: history, hidden, policy, parameters, episode_return, survival, position_error
    [m], flight_time [s]."""
    seconds: float
    """Of training, compiling included."""


def box(plan: argparse.Namespace) -> RelativeBox:
    """Drones to train over, in steps that fit the control structure."""
    if plan.drone is None:
        centre = parameters.replace(
            parameters.crazyflie(), motor_time_constant=np.float32(0.08), latency=np.float32(0.02)
        )
    else:
        centre = parameters.read_drone(plan.drone)
    return relative_box(control.in_fitting_steps(centre, control.CONTROLLERS[plan.control]()), 0.10)


def study_kind(kind: Kind, plan: argparse.Namespace) -> Study:
    """Trains policies of one kind, scores them and flies them."""
    drones, task, controller = box(plan), tasks.paper_circle(), control.CONTROLLERS[plan.control]()
    spec = PolicySpec(history=kind.history, hidden=kind.hidden)
    settings = choose_settings(plan.control, task.name, plan.method, spec)
    settings = settings if plan.updates is None else replace(settings, updates=plan.updates)
    keys = jax.random.split(jax.random.key(plan.seed), plan.seeds)
    began = time.perf_counter()
    policies = train(task, controller, drones, keys, settings, spec)
    seconds = time.perf_counter() - began
    env = Environment.matching(drones.centre, task, controller, spec=spec)
    scores = [
        evaluate(env, policy, drones, jax.random.key(1234), plan.episodes) for policy in policies
    ]
    flights = transfer(
        policies,
        [virtual_drone(7)],
        plan.trials,
        jax.random.key(plan.seed),
        task=task,
        duration=plan.duration,
    )
    times = flights.table.group_by("policy", maintain_order=True).agg(
        polars.col("duration").mean()
    )["duration"]
    rows = [
        {
            "history": kind.history,
            "hidden": kind.size,
            "policy": number,
            "parameters": count(policy),
            **{name: float(value) for name, value in score._asdict().items()},
            "flight_time": flight_time,
        }
        for number, (policy, score, flight_time) in enumerate(
            zip(policies, scores, times, strict=True), 1
        )
    ]
    result = Study(polars.DataFrame(rows), seconds)
    print(row(f"H = {kind.history}, {kind.size}", result), file=sys.stderr, flush=True)
    return result


def count(policy: Policy) -> int:
    """Weights and biases of a policy's network."""
    return sum(leaf.size for leaf in jax.tree.leaves(policy.network))


def table(first: str, named: dict[str, Study]) -> str:
    """Means over policies, and in brackets the worst, as Markdown.

    `first` heads the column of names.
    """
    lines = [
        f"| {first} | weights | return | survival | distance [cm] | zero-shot flight [s] | "
        "training [s] |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    return "\n".join([*lines, *(row(name, result) for name, result in named.items())])


def row(name: str, result: Study) -> str:
    """Of the table."""
    of = {column: result.policies[column].to_numpy() for column in result.policies.columns}
    cells = [
        name,
        f"{of['parameters'][0]:,}",
        f"{of['episode_return'].mean():.1f} ({of['episode_return'].min():.1f})",
        f"{of['survival'].mean():.1%} ({of['survival'].min():.1%})",
        f"{100 * of['position_error'].mean():.1f} ({100 * of['position_error'].max():.1f})",
        f"{of['flight_time'].mean():.1f} ({of['flight_time'].min():.1f})",
        f"{result.seconds:.0f}",
    ]
    return "| " + " | ".join(cells) + " |"


def parse_arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    """What the command line asks for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--histories",
        type=int,
        nargs="*",
        default=HISTORIES,
        help="H (default: the paper's 1 2 4 6 8)",
    )
    parser.add_argument(
        "--hidden", nargs="*", default=SIZES, help=f"hidden layers (default: {' '.join(SIZES)})"
    )
    parser.add_argument(
        "--control", default="pwm", choices=CONTROLS, help="control structure (default: pwm)"
    )
    parser.add_argument(
        "--method", default="gradient", choices=METHODS, help="of training (default: gradient)"
    )
    parser.add_argument("--drone", help="TOML file of a drone, or its name")
    parser.add_argument(
        "--updates",
        type=int,
        help="gradient steps; as many as the control structure needs unless given",
    )
    parser.add_argument("--seeds", type=int, default=3, help="policies of each kind (default: 3)")
    parser.add_argument(
        "--episodes", type=int, default=1000, help="episodes of a score (default: 1000)"
    )
    parser.add_argument(
        "--trials", type=int, default=10, help="zero-shot flights of each policy (default: 10)"
    )
    parser.add_argument(
        "--duration", type=float, default=20.0, help="longest of them [s] (default: 20)"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("history_and_hidden.csv"),
        help="(default: %(default)s)",
    )
    plan = parser.parse_args(arguments)
    try:
        plan.sizes = [tuple(map(int, size.split("x"))) for size in plan.hidden]
    except ValueError:
        parser.error(f"--hidden {' '.join(plan.hidden)}: expected layers such as 50x50.")
    return plan


def main(arguments: Sequence[str] | None = None) -> None:
    """Trains, scores, flies, prints and writes."""
    plan = parse_arguments(arguments)
    histories = [Kind(history, HIDDEN) for history in plan.histories]
    sizes = [Kind(HISTORY, hidden) for hidden in plan.sizes]
    results_by_kind = {kind: study_kind(kind, plan) for kind in dict.fromkeys([*histories, *sizes])}
    if histories:
        print(
            table("H", {str(kind.history): results_by_kind[kind] for kind in histories}), end="\n\n"
        )
    if sizes:
        print(
            table("hidden layers", {kind.size: results_by_kind[kind] for kind in sizes}), end="\n\n"
        )
    names = ("control", "method", "updates", "seeds", "episodes", "trials", "duration")
    drone = {} if plan.drone is None else {"drone": Path(plan.drone).name}
    settings = (
        {name: getattr(plan, name) for name in names} | {"reality": virtual_drone(7).name} | drone
    )
    inputs = [Path(plan.drone)] if plan.drone is not None and Path(plan.drone).is_file() else []
    record = json.dumps(results.record(seed=plan.seed, inputs=inputs, settings=settings))
    # How long training took is not written: the same seed gives the same bytes.
    everything = polars.concat([each.policies for each in results_by_kind.values()])
    results.write(plan.output, f"# record: {record}\n{everything.write_csv(float_precision=6)}")
    print(f"written to {plan.output}, a row a policy, SI units")


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(f"error: {error}")
