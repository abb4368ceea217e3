"""Measures how close the hot paths come to what the machine can do.

Writes the tables of paper/notes/roofline.md.

The work of a path is counted in its traced program, before the compiler fuses or duplicates
anything: elementary operations by kind, and bytes that loops store for later or read back. What
the machine can do of each kind is measured in the same run by programs that do nothing else. The
least time of a path is the sum of its work over these rates; the share that is reached is this over
the time it takes. That is measured twice, as XLA compiles by itself and with fused loops
(`compiler.FUSED`), which `maidenflight train` has.

    python benchmarks/roofline.py
"""

import json
import os
import statistics
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax

from maidenflight import compiler

if __name__ == "__main__":
    compiler.prepare_jax()

import click
import jax.numpy as jnp
import maidenflight_speed as speed
import numpy as np
from jax import lax
from jax.extend import core
from page import write

import maidenflight as mf
from maidenflight.flights.windows import LEAD_IN, Windows
from maidenflight.identification.likelihood import one_step_errors
from maidenflight.parameters import crazyflie, replace
from maidenflight.policy import untrained_policy
from maidenflight.simulator.controllers import control
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.randomization import relative_box, stacked
from maidenflight.simulator.tasks import tasks
from maidenflight.training import analytic_gradient
from maidenflight.training.defaults import SETTINGS, choose_hidden
from maidenflight.training.evaluation import evaluate_together, starts_of

PAGE = Path(__file__).parents[1] / "paper" / "notes" / "roofline.md"
KINDS = {
    "arithmetic": "add neg sub mul max min abs eq ne lt le gt ge select_n sign floor ceil round "
    "and or not xor shift_left shift_right_logical shift_right_arithmetic clamp is_finite square "
    "integer_pow cumsum reduce_sum reduce_max reduce_min reduce_and reduce_or argmin argmax "
    "dot_general add_any population_count rem nextafter stop_gradient convert_element_type",
    "division and root": "div sqrt rsqrt",
    "transcendental": "exp exp2 expm1 log log1p sin cos tan asin acos atan atan2 sinh cosh tanh "
    "logistic erf erf_inv erfc pow cbrt sinc",
    "random": "random_bits threefry2x32 random_fold_in random_split random_seed",
}
"""Primitives of JAX by the rate at which a machine does them."""
KIND = {name: kind for kind, names in KINDS.items() for name in names.split()}
MOVED = "stored bytes"
"""What loops write for later, or read back."""
ELEMENTS = 4096
"""Of the arrays of the machine's own measurement: 16 KiB, within the first cache."""
TURNS = 2000
CORES = compiler.count_cores()


class HotPath(NamedTuple):
    """A hot path."""

    name: str
    unit: str
    """What is counted."""
    units: int
    """Of them in a call."""
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    parts: int = 1
    """Calls of the program in a call: devices that each run it."""


def work(program: Any) -> Counter[str]:
    """Elementary operations by kind, and bytes that loops store, of a traced program.

    A loop whose number of turns is an argument counts once. Of branches that depend on data the
    costlier counts; over a batch they are both computed and are no branches.
    """
    costs: Counter[str] = Counter()
    for equation in program.eqns:
        name, parameters = equation.primitive.name, equation.params
        if name == "scan":
            inner, length = parameters["jaxpr"].jaxpr, parameters["length"]
            for kind, amount in work(inner).items():
                costs[kind] += amount * length
            carried = parameters["num_carry"]
            stacked = equation.outvars[carried:]
            read = equation.invars[parameters["num_consts"] + carried :]
            costs[MOVED] += sum(_bytes(one) for one in (*stacked, *read))
        elif name == "cond":
            costs += max((work(branch.jaxpr) for branch in parameters["branches"]), key=_total)
        elif name == "dot_general":
            (contracted, _), _ = parameters["dimension_numbers"]
            shape = equation.invars[0].aval.shape
            length = int(np.prod([shape[axis] for axis in contracted]))
            costs["arithmetic"] += 2 * _size(equation.outvars[0]) * length
        elif name == "shard_map":
            # What one device does of its share.
            for kind, amount in work(parameters["jaxpr"]).items():
                costs[kind] += amount * parameters["mesh"].size
        elif name == "while":
            costs += work(parameters["body_jaxpr"].jaxpr)
        elif subs := [
            getattr(value, "jaxpr", value)
            for value in parameters.values()
            if isinstance(value, core.Jaxpr | core.ClosedJaxpr)
        ]:
            # Of a function with a derivative of its own, the function.
            costs += work(subs[0])
        elif name in KIND:
            sizes = [_size(one) for one in equation.outvars]
            reduces = name.startswith(("reduce", "arg"))
            amount = _size(equation.invars[0]) if reduces else max(sizes)
            if name == "integer_pow":
                amount *= max(1, int(abs(parameters["y"])).bit_length() - 1)
            costs[KIND[name]] += amount
    return costs


def _size(variable: Any) -> int:
    return int(np.prod(variable.aval.shape)) if hasattr(variable.aval, "shape") else 0


def _bytes(variable: Any) -> int:
    kind = getattr(variable.aval, "dtype", None)
    width = kind.itemsize if kind is not None and hasattr(kind, "itemsize") else 4
    return _size(variable) * width


def _total(costs: Counter[str]) -> int:
    return sum(costs.values())


def machine(seconds: float) -> dict[str, float]:
    """What all cores do a second of each kind, in programs that do nothing else."""
    values = jnp.linspace(0.1, 0.9, CORES * ELEMENTS, dtype=jnp.float32).reshape(CORES, ELEMENTS)
    keys = jax.random.split(jax.random.key(0), CORES)

    def loop(step: Callable[[Any], Any], turns: int = TURNS) -> Callable[[Any], Any]:
        return lambda inputs: lax.fori_loop(0, turns, lambda _, now: step(now), inputs)

    def chains(now: Any) -> Any:
        # Independent products and sums in one pass over the array, which stay in registers.
        one, two, three, four = now, now, now, now
        for _ in range(8):
            one, two = one * 0.999 + 0.001, two * 0.998 + 0.002
            three, four = three * 0.997 + 0.003, four * 0.996 + 0.004
        return 0.25 * (one + two + three + four)

    def draw(key: Any) -> Any:
        return jax.random.wrap_key_data(jax.random.bits(key, (ELEMENTS,)).reshape(-1, 2)[0])

    programs: dict[str, tuple[Callable[[Any], Any], Any, float]] = {
        "arithmetic": (loop(chains), values, 68.0 * ELEMENTS * TURNS),
        "division and root": (
            loop(lambda now: jnp.sqrt(1.0 / (1.0 + now))),
            values,
            2.0 * ELEMENTS * TURNS,
        ),
        "transcendental": (
            loop(lambda now: 0.5 * jnp.sin(now) + 0.1 * jnp.exp(now)),
            values,
            2.0 * ELEMENTS * TURNS,
        ),
        "random": (loop(draw, TURNS // 4), keys, ELEMENTS * TURNS / 4),
    }
    rates = {
        kind: CORES * amount / median_time(jax.pmap(program), (inputs,), seconds)
        for kind, (program, inputs, amount) in programs.items()
    }
    # Beyond every cache, and in place, so that no time goes to the system for new pages.
    large, passes = jnp.zeros((CORES, 2**25), jnp.float32), 16
    turned = loop(lambda now: jnp.flip(now) + 1.0, passes)
    copied = median_time(jax.pmap(turned), (large,), seconds)
    return rates | {MOVED: 2 * passes * large.nbytes / copied}


def median_time(function: Callable[..., Any], inputs: tuple[Any, ...], seconds: float) -> float:
    """Median seconds of a call after two for warming up."""
    for _ in range(2):
        jax.block_until_ready(function(*inputs))
    times: list[float] = []
    while sum(times) < seconds or len(times) < 5:
        start = time.perf_counter()
        jax.block_until_ready(function(*inputs))
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def simulation_path(name: str, series: str, batch: int) -> HotPath:
    """The simulator as `simulator.py` measures it, on one device of all."""
    one, counted = speed.SERIES[series]
    turns = 64
    length = {"steps" if series == "training" else "commands": turns}
    shared, own = speed.drones(series, batch)
    run = jax.vmap(partial(one, **length), in_axes=(None, 0))
    unit = "environment step" if series == "training" else "physics step"
    return HotPath(name, unit, batch * turns * counted, run, (shared, own), CORES)


def training_path(name: str, structure: str) -> HotPath:
    """One update of training by gradients with its default settings."""
    settings = SETTINGS[structure]
    controller = control.CONTROLLERS[structure]()
    drone = control.in_fitting_steps(crazyflie(), controller)
    spec = mf.PolicySpec(hidden=choose_hidden(structure, "gradient"))
    env = Environment.matching(drone, mf.simulator.circle(), controller, spec=spec)
    boxes, keys = stacked([relative_box(drone)]), jax.random.split(jax.random.key(0), 1)
    learners = analytic_gradient.init(env, settings, boxes, keys)

    def update(learners: Any) -> Any:
        return analytic_gradient.update(env, settings, boxes, learners, keys, 0, 1)

    steps = settings.num_envs * settings.horizon
    return HotPath(name, "environment step", steps, update, (learners,))


def evaluation_path(name: str, policies: int = 2) -> HotPath:
    """Episodes with which training scores policies."""
    env, boxes = Environment(task=tasks.circle()), stacked([relative_box(crazyflie())] * policies)
    episodes = 128
    policy_batch = jax.vmap(untrained_policy)(jax.random.split(jax.random.key(0), policies))
    starts = starts_of(env, episodes, boxes)

    def score(policy_batch: Any) -> Any:
        return evaluate_together(env, episodes, policy_batch, starts)

    steps = round(env.task.duration * env.controller.interface.rate)
    return HotPath(name, "environment step", policies * episodes * steps, score, (policy_batch,))


def identification_path(name: str, rows: int = 200) -> HotPath:
    """Prediction errors of a chunk of windows, as the likelihood sums them."""
    # One physics step a row: of a loop whose number of turns is an argument `work` counts one.
    drone, generator = replace(crazyflie(), time_step=0.01), np.random.default_rng(0)

    def about(shape: tuple[int, ...], centre: Any = 0.0) -> np.ndarray:
        return (centre + generator.normal(0.0, 0.05, shape)).astype(np.float32)

    count, level = 64, np.array([1.0, 0.0, 0.0, 0.0])
    windows = Windows(
        about((count, 3)),
        about((count, 3)),
        np.broadcast_to(level, (count, 4)).astype(np.float32),
        about((count, 3)),
        np.clip(about((count, LEAD_IN + rows, 4), 0.55), 0.0, 1.0),
        about((count, rows, 12)),
        np.zeros(count, np.int32),
    )

    def chunk(windows: Any) -> Any:
        return one_step_errors.errors_of_chunk(windows, drone, 1, 1)

    return HotPath(name, "row", count * rows, chunk, (jax.tree.map(jnp.asarray, windows),), CORES)


def time_path(path: HotPath, seconds: float) -> float:
    """Time of a unit [ns]."""
    if path.parts > 1:
        copies = jax.tree.map(lambda leaf: jnp.stack([leaf] * path.parts), path.arguments)
        took = median_time(jax.pmap(path.function), copies, seconds)
    else:
        took = median_time(jax.jit(path.function), path.arguments, seconds)
    return 1e9 * took / (path.units * path.parts)


def measure_path(path: HotPath, rates: dict[str, float], seconds: float) -> dict[str, Any]:
    """Work, least time and time of a path; per unit, in ns."""
    program = jax.make_jaxpr(path.function)(*path.arguments)
    done = work(program.jaxpr)
    least = {kind: done[kind] / path.units / rates[kind] for kind in rates}
    return {
        "path": path.name,
        "unit": path.unit,
        **{kind: done[kind] / path.units for kind in rates},
        "least": 1e9 * sum(least.values()),
        "largest": max(least, key=lambda kind: least[kind]),
        "took": time_path(path, seconds),
    }


PATHS: tuple[Callable[[], HotPath], ...] = (
    partial(simulation_path, "physics", "motor", 2048),
    partial(simulation_path, "physics and rate PID", "rate", 2048),
    partial(simulation_path, "environment, with noise and resets", "training", 1024),
    partial(evaluation_path, "evaluation"),
    *(partial(training_path, f"training update, {name}", name) for name in SETTINGS),
    partial(identification_path, "likelihood of one row ahead"),
)


def time_fused(seconds: float) -> dict[str, float]:
    """Times of the paths [ns] in a process that compiles with fused loops."""
    text = subprocess.run(
        [sys.executable, __file__, "--seconds", str(seconds), "--times"],
        env={**os.environ, "XLA_FLAGS": compiler.FUSED},
        stdout=subprocess.PIPE,
        check=True,
    ).stdout
    return json.loads(text)


@click.command(help=__doc__)
@click.option("--times", is_flag=True, help="Print times alone, as JSON.")
@click.option("--seconds", default=3.0, show_default=True, help="Time for each measurement.")
@click.option("--output", default=str(PAGE), show_default=True, help="Page to write into.")
def main(times: bool, seconds: float, output: str) -> None:
    """Measures and writes."""
    if times:
        paths = [path() for path in PATHS]
        print(json.dumps({path.name: time_path(path, seconds) for path in paths}))
        return
    rates, quicker = machine(seconds), time_fused(seconds)
    lines = ["| kind | all cores do |", "|---|---|"]
    lines += [
        f"| {kind} | {rate / 1e9:.3g} {'GB/s' if kind == MOVED else 'G/s'} |"
        for kind, rate in rates.items()
    ]
    rows = [measure_path(path(), rates, seconds) for path in PATHS]
    head = ["path", "unit", *rates, "least time [ns]", "time [ns]", "fused [ns]", "reached"]
    head += ["most of it"]
    table = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for row in rows:
        cells = [row["path"], row["unit"], *(f"{row[kind]:,.0f}" for kind in rates)]
        best = min(row["took"], quicker[row["path"]])
        cells += [f"{row['least']:.3g}", f"{row['took']:.3g}", f"{quicker[row['path']]:.3g}"]
        cells += [f"{row['least'] / best:.0%}", row["largest"]]
        table.append("| " + " | ".join(cells) + " |")
    print("\n".join([*lines, *table]))
    write(Path(output), {"machine": "\n".join(lines), "roofline": "\n".join(table)})


if __name__ == "__main__":
    main()
