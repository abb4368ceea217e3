"""Measures what training reaches, how fast and in how much memory.

Writes its table, recipes and learning curves into paper/notes/training.md.

Every policy is scored on 1,000 episodes that it has not seen: noise, drones drawn within +-10 % of
a Crazyflie with a motor lag of 80 ms and a latency of 20 ms, the task's own start, no exploration.
The ceiling is the share of these very episodes, noise and all, in which any sequence of actions
that was found, in full knowledge of the drone and of the noise to come, keeps the drone within the
task's bounds; the other ceiling is that of the same starts without noise.

A look at less than all leaves the page alone: `python benchmarks/training.py --only pwm_hover
--updates 30 --picture look.svg`.
"""

import dataclasses
import multiprocessing
import os
import resource
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import click
import jax
import jax.numpy as jnp
import numpy as np
import optax
import polars
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from page import write

from maidenflight.parameters import crazyflie, noiseless, replace
from maidenflight.policy import Policy
from maidenflight.reporting.figures import picture, training
from maidenflight.reporting.figures.charts import Figure
from maidenflight.simulator import environment, stepping
from maidenflight.simulator.controllers import control
from maidenflight.simulator.environment import Environment, EnvState
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.randomization import RelativeBox, relative_box
from maidenflight.simulator.stepping import randomized_reset
from maidenflight.simulator.tasks import failures, tasks
from maidenflight.training import defaults
from maidenflight.training.evaluation import evaluate
from maidenflight.training.train import Progress, train

CORES = len(os.sched_getaffinity(0))
SEEDS, EPISODES, UNSEEN, LOOK_AHEAD, IMPROVEMENTS = 5, 1000, 1234, 1.6, 200
DRONES: dict[str, dict[str, Any]] = {
    "paper's": {},
    "authors', 30 g": {"thrust_to_weight": np.float32(1.725 * 28 / 30)},
}
"""The authors' published thrust-to-weight ratio is of 28 g, and the drone that they simulate has
30."""


class Recipe(NamedTuple):
    """What is trained, all by the names of the command line."""

    control: str
    task: str = "circle"
    drone: str = "paper's"
    """A name in `DRONES`."""
    history: int = 2
    """Instants that a policy sees."""

    @property
    def spec(self) -> PolicySpec:
        """Returns what its policies see, and their layers."""
        hidden = defaults.choose_hidden(self.control, "gradient")
        return PolicySpec(self.history, hidden=hidden)

    @property
    def title(self) -> str:
        """What it is called in pictures."""
        return ", ".join([self.control, self.task, *(["30 g"] if self.drone != "paper's" else [])])

    @property
    def name(self) -> str:
        """What `--only` and the folder of its policies are called."""
        return self.title.replace(", ", "_").replace(" ", "")

    @property
    def command(self) -> str:
        """What trains the same policies from a drone's file."""
        drone = "drone.toml" if self.drone == "paper's" else "drone_30g.toml"
        command = (
            f"maidenflight train --drone {drone} --policies {SEEDS} -o {self.name} "
            f"--control {self.control} --task {self.task} --randomize 0.1"
        )
        if self.history != 2:
            command += f" --history {self.history}"
        if self.control == "attitude_rate":
            command += " --yaw-penalty 0"
        if self.control == "attitude":
            command += " --paper-scales"
        return command


RECIPES = {
    recipe.name: recipe
    for recipe in (
        Recipe("pwm"),
        Recipe("attitude_rate", history=4),
        Recipe("attitude"),
        Recipe("attitude", drone="authors', 30 g"),
        *(Recipe("pwm", task) for task in ("figure_eight", "hover", "take_off")),
    )
}


class Measurement(NamedTuple):
    """What came of a recipe."""

    row: str
    """Of the table."""
    curves: polars.DataFrame
    """A row a score of a policy in training; see `training.panel`."""


def box(recipe: Recipe) -> RelativeBox:
    """Drones within +-10 %, in steps that fit the control structure."""
    centre = replace(
        crazyflie(),
        motor_time_constant=np.float32(0.08),
        latency=np.float32(0.02),
        **DRONES[recipe.drone],
    )
    return relative_box(
        control.in_fitting_steps(centre, control.CONTROLLERS[recipe.control]()), 0.10
    )


def train_recipe(
    recipe: Recipe, drones: RelativeBox, updates: int | None
) -> tuple[tuple[Policy, ...], list[tuple[float, Progress]]]:
    """Policies of all seeds in one call, and when which score was heard [s]."""
    evaluations: list[tuple[float, Progress]] = []
    began = time.perf_counter()
    settings: Any = defaults.choose_settings(recipe.control, recipe.task, "gradient", recipe.spec)
    settings = settings if updates is None else dataclasses.replace(settings, updates=updates)
    task, controller = tasks.TASKS[recipe.task](), control.CONTROLLERS[recipe.control]()
    keys = jax.random.split(jax.random.key(0), SEEDS)

    def hear(progress: Progress) -> None:
        evaluations.append((time.perf_counter() - began, progress))

    return train(
        task, controller, drones, keys, settings, recipe.spec, on_progress=hear
    ), evaluations


def curves(evaluations: list[tuple[float, Progress]]) -> polars.DataFrame:
    """A row a score of a policy in training."""
    rows = []
    for seconds, progress in evaluations:
        for number in range(SEEDS):
            scores = {
                name: float(values[number]) for name, values in progress.score._asdict().items()
            }
            rows.append(
                {
                    "seconds": seconds,
                    "update": progress.update,
                    "steps": progress.steps,
                    "policy": number + 1,
                    **scores,
                }
            )
    return polars.DataFrame(rows)


def survivable(env: Environment, drones: RelativeBox, policy: Policy) -> float:
    """Share of episodes for which a sequence of actions is found that keeps the drone in bounds.

    The first guess is what a trained policy does; Adam improves it by the gradient through the
    simulator. Drones, starts and the noise of each period are those of `scored`, so that a policy
    and its ceiling differ by what it does, not by luck; over noiseless drones the noise is gone,
    and the drones and starts are the same.
    """
    rate = env.controller.interface.rate
    periods, all_periods = round(LOOK_AHEAD * rate), round(env.task.duration * rate)
    cores = NamedSharding(Mesh(np.array(jax.devices()), ("starts",)), PartitionSpec("starts"))
    keys = jax.device_put(jax.random.split(jax.random.key(UNSEEN), EPISODES), cores)

    def one(key: jax.Array) -> jax.Array:
        launch_key, key = jax.random.split(key)  # as `evaluate` and `rollout` split it
        first, drone = randomized_reset(env, drones, launch_key)
        noise = jax.random.split(key, all_periods)[:periods]

        def by_policy(env_state: EnvState, key: jax.Array) -> tuple[EnvState, jax.Array]:
            action = policy(environment.observation(env, env_state))
            return stepping.step(env, env_state, action, drone, key)[0], jnp.clip(action, -1.0, 1.0)

        def farthest(actions: jax.Array) -> tuple[jax.Array, jax.Array]:
            def fly(
                env_state: EnvState, now: tuple[jax.Array, jax.Array]
            ) -> tuple[EnvState, jax.Array]:
                action, key = now
                after, step_result = stepping.step(env, env_state, action, drone, key)
                return after, step_result.position_error

            errors = jax.lax.scan(fly, first, (jnp.clip(actions, -1.0, 1.0), noise))[1]
            errors = jnp.where(jnp.isfinite(errors), errors, 10.0)
            # The largest error, rounded so that its neighbours count too, and a little of all.
            return jax.nn.logsumexp(50.0 * errors) / 50.0 + 0.1 * jnp.mean(errors), jnp.max(errors)

        optimiser = optax.adam(0.03)

        def improve(
            memory: tuple[jax.Array, Any, jax.Array], _: None
        ) -> tuple[tuple[jax.Array, Any, jax.Array], None]:
            actions, state, best = memory
            slope, worst = jax.grad(farthest, has_aux=True)(actions)
            slope = jnp.where(jnp.isfinite(slope), slope, 0.0)
            with jax.numpy_dtype_promotion("standard"):
                change, state = optimiser.update(slope / (jnp.linalg.norm(slope) + 1e-6), state)
            moved: Any = optax.apply_updates(actions, change)
            return (jnp.clip(moved, -1.0, 1.0), state, jnp.minimum(best, worst)), None

        _, actions = jax.lax.scan(by_policy, first, noise)
        start = (actions, optimiser.init(actions), jnp.asarray(jnp.inf))
        return jax.lax.scan(improve, start, None, length=IMPROVEMENTS)[0][2]

    worst = jax.jit(jax.vmap(one))(keys)
    return float(jnp.mean(worst < failures.MAX_POSITION_ERROR_M))


def score_policies(
    env: Environment, drones: RelativeBox, policies: tuple[Policy, ...]
) -> list[Any]:
    """Scores on episodes that no policy has seen."""
    return [evaluate(env, policy, drones, jax.random.key(UNSEEN), EPISODES) for policy in policies]


def spread(values: list[float], worst: Callable[..., float], form: str) -> str:
    """Mean and worst."""
    return f"{np.mean(values):{form}} ({worst(values):{form}})"


def measure(recipe: Recipe, updates: int | None) -> Measurement:
    """Trains and scores.

    To be called in a process of its own, for memory counts from the process's start.
    """
    jax.config.update("jax_num_cpu_devices", CORES)
    drones = box(recipe)
    task, controller = tasks.TASKS[recipe.task](), control.CONTROLLERS[recipe.control]()
    env = Environment.matching(drones.centre, task, controller, spec=recipe.spec)
    policies, evaluations = train_recipe(recipe, drones, updates)
    memory = (
        resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    )  # GiB, before the scores add theirs
    scores = score_policies(env, drones, policies)
    (first, first_time), (last, final) = evaluations[0], evaluations[-1]
    rate = (
        f"{(final.steps - first_time.steps) / (last - first) / 1e3:.0f} k"
        if len(evaluations) > 1
        else "-"
    )
    quiet = dataclasses.replace(drones, nominal=noiseless(drones.nominal))
    ceilings = (
        [survivable(env, each, policies[0]) for each in (drones, quiet)]
        if recipe.task == "circle"
        else []
    )
    cells = [
        f"{recipe.control}, {env.controller.interface.rate} Hz, {recipe.task}, "
        f"{recipe.drone} drone",
        spread([float(score.episode_return) for score in scores], min, ".1f"),
        spread([float(score.survival) for score in scores], min, ".1%"),
        " / ".join(f"{ceiling:.1%}" for ceiling in ceilings) or "-",
        spread([100 * float(score.position_error) for score in scores], max, ".1f"),
        f"{last:.0f}",
        rate,
        f"{memory:.1f}",
    ]
    return Measurement("| " + " | ".join(cells) + " |", curves(evaluations))


COLUMNS = (
    *("policies", "return", "survival", "ceiling / without noise", "distance [cm]"),
    *("5 policies [s]", "steps/s", "memory [GiB]"),
)
HEAD = f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}"


def draw_curves(measured: dict[str, Measurement]) -> str:
    """The picture of the recipes' learning curves."""
    title = (
        f"Return of {SEEDS} policies each over the time of training on {CORES} cores, "
        "compiling included"
    )
    panels = [
        training.panel(each.curves, "episode_return", RECIPES[name].title, "seconds")
        for name, each in measured.items()
    ]
    legend = training.legend(next(iter(measured.values())).curves)
    return picture.svg(Figure(title, panels, legend, least=250), 840)


@click.command()
@click.option(
    "--output",
    type=click.Path(path_type=Path, exists=True),
    default=Path(__file__).parents[1] / "paper" / "notes" / "training.md",
)
@click.option(
    "--only",
    "chosen",
    multiple=True,
    type=click.Choice(list(RECIPES)),
    help="This recipe, for a look; may be repeated.",
)
@click.option("--updates", type=click.IntRange(1), help="Train with so few updates, for a look.")
@click.option(
    "--picture",
    type=click.Path(path_type=Path),
    help="Of a look: SVG file for the learning curves; none unless given.",
)
def main(output: Path, chosen: tuple[str, ...], updates: int | None, picture: Path | None) -> None:
    """Trains five policies of each kind and writes the results.

    Table, commands and curves go into the page OUTPUT.

    A look at less leaves the page alone.
    """
    measured: dict[str, Measurement] = {}
    click.echo(HEAD)
    for name in chosen or RECIPES:
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as process:
            measured[name] = process.submit(measure, RECIPES[name], updates).result()
        click.echo(measured[name].row)
    if chosen or updates is not None:
        if picture is not None:
            picture.write_text(draw_curves(measured))
        return
    picture = output.with_name("training_curves.svg")
    picture.write_text(draw_curves(measured))
    write(
        output,
        {
            "training": "\n".join([HEAD, *(each.row for each in measured.values())]),
            "training-machine": f"{CORES} cores; load at the end {os.getloadavg()[0]:.1f}.",
            "training-recipes": recipes(),
            "training-curves": "![Return over the time of training, a panel a "
            f"recipe]({picture.name})",
        },
    )


def recipes() -> str:
    """The recipes' commands, as the page shows them."""
    return "\n".join(["```sh", *(recipe.command for recipe in RECIPES.values()), "```"])


if __name__ == "__main__":
    main()
