"""Measures what training reaches and how fast, and writes the tables of docs/training.md.

Every policy is scored on 1,000 episodes that it has not seen: noise, drones drawn within +-10 % of a Crazyflie with a motor lag of 80 ms
and a latency of 20 ms, the task's own start, no exploration. The ceiling is the share of these starts from which any sequence of actions
that was found, in full knowledge of the drone and without noise, keeps the drone within the task's bounds.
"""

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import jax

CORES = len(os.sched_getaffinity(0))
if __name__ == "__main__":
    jax.config.update("jax_num_cpu_devices", CORES)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
import optax  # noqa: E402
from page import write  # noqa: E402

from maidenflight.parameters import Parameters, crazyflie, noiseless, replace  # noqa: E402
from maidenflight.policy import Policy  # noqa: E402
from maidenflight.simulator import control, environment, tasks  # noqa: E402
from maidenflight.simulator.environment import Environment, Episode  # noqa: E402
from maidenflight.simulator.randomization import RelativeBox, relative_box  # noqa: E402
from maidenflight.simulator.tasks import Task  # noqa: E402
from maidenflight.training.evaluation import evaluate  # noqa: E402
from maidenflight.training.train import Progress, train  # noqa: E402
from maidenflight.workflow import settings_for  # noqa: E402

SEEDS, EPISODES, STARTS, LOOK_AHEAD, IMPROVEMENTS = 5, 1000, 256, 1.6, 200
DRONES: dict[str, dict[str, Any]] = {"paper's": {}, "authors', 30 g": {"thrust_to_weight": np.float32(1.725 * 28 / 30)}}
"""The authors' published thrust-to-weight ratio is of 28 g, and the drone that they simulate has 30."""


def box(structure: str, **changes: Any) -> RelativeBox:
    """Drones within +-10 %, in steps that fit a control structure."""
    step = np.float32(control.time_step(control.CONTROLLERS[structure]()))
    return relative_box(
        replace(crazyflie(), motor_time_constant=np.float32(0.08), latency=np.float32(0.02), time_step=step, **changes), 0.10
    )


def trained(structure: str, task: Task, drones: RelativeBox) -> tuple[tuple[Policy, ...], list[tuple[float, Progress]]]:
    """Policies of all seeds in one call, and when which score was heard [s]."""
    heard: list[tuple[float, Progress]] = []
    began = time.perf_counter()
    settings = settings_for(structure, task.name.replace("tracking", "figure_eight"))
    keys = jax.random.split(jax.random.key(0), SEEDS)
    policies = train(
        task, control.CONTROLLERS[structure](), drones, keys, settings, lambda p: heard.append((time.perf_counter() - began, p))
    )
    return policies, heard


def survivable(simulated: Environment, drones: RelativeBox, policy: Policy) -> float:
    """The share of starts from which a sequence of actions is found that keeps the drone within the task's bounds.

    The first guess is what a trained policy does; Adam improves it by the gradient through the simulator.
    """
    periods = round(LOOK_AHEAD * simulated.controller.action_rate)
    keys = jax.random.split(jax.random.key(77), STARTS)

    def one(key: jax.Array) -> jax.Array:
        drone_key, reset_key = jax.random.split(key)
        drone: Parameters = noiseless(drones.draw(drone_key))
        first = environment.reset(simulated, drone, reset_key)

        def by_policy(episode: Episode, _: None) -> tuple[Episode, jax.Array]:
            action = policy(environment.observation(episode))
            return environment.step(simulated, episode, action, drone, key)[0], jnp.clip(action, -1.0, 1.0)

        def farthest(actions: jax.Array) -> tuple[jax.Array, jax.Array]:
            def fly(episode: Episode, action: jax.Array) -> tuple[Episode, jax.Array]:
                after, outcome = environment.step(simulated, episode, action, drone, key)
                return after, outcome.position_error

            errors = jax.lax.scan(fly, first, jnp.clip(actions, -1.0, 1.0))[1]
            errors = jnp.where(jnp.isfinite(errors), errors, 10.0)
            # The largest error, rounded so that its neighbours count too, and a little of all.
            return jax.nn.logsumexp(50.0 * errors) / 50.0 + 0.1 * jnp.mean(errors), jnp.max(errors)

        optimiser = optax.adam(0.03)

        def improve(memory: tuple[jax.Array, Any, jax.Array], _: None) -> tuple[tuple[jax.Array, Any, jax.Array], None]:
            actions, state, best = memory
            slope, worst = jax.grad(farthest, has_aux=True)(actions)
            slope = jnp.where(jnp.isfinite(slope), slope, 0.0)
            with jax.numpy_dtype_promotion("standard"):
                change, state = optimiser.update(slope / (jnp.linalg.norm(slope) + 1e-6), state)
            return (jnp.clip(optax.apply_updates(actions, change), -1.0, 1.0), state, jnp.minimum(best, worst)), None  # type: ignore[arg-type]

        _, actions = jax.lax.scan(by_policy, first, None, length=periods)
        start = (actions, optimiser.init(actions), jnp.asarray(jnp.inf))
        return jax.lax.scan(improve, start, None, length=IMPROVEMENTS)[0][2]

    worst = jax.jit(jax.vmap(one))(keys)
    return float(jnp.mean(worst < tasks.FARTHEST))


def scored(simulated: Environment, drones: RelativeBox, policies: tuple[Policy, ...]) -> list[Any]:
    """Scores on episodes that no policy has seen."""
    return [evaluate(simulated, policy, drones, jax.random.key(1234), EPISODES) for policy in policies]


def spread(values: list[float], worst: Callable[..., float], form: str) -> str:
    """Mean and worst."""
    return f"{np.mean(values):{form}} ({worst(values):{form}})"


def measure(structure: str, task: Task, drones: RelativeBox, named: str, ceiling: bool) -> str:
    """A row of the table."""
    simulated = Environment.matching(drones.centre, task, control.CONTROLLERS[structure]())
    policies, heard = trained(structure, task, drones)
    scores = scored(simulated, drones, policies)
    (first, begun), (last, done) = heard[0], heard[-1]
    rate = (done.steps - begun.steps) / (last - first)
    above = f"{survivable(simulated, drones, policies[0]):.1%}" if ceiling else "-"
    cells = [
        f"{structure}, {simulated.controller.action_rate} Hz, {task.name.replace('tracking', 'figure-eight')}, {named} drone",
        spread([float(score.episode_return) for score in scores], min, ".1f"),
        spread([float(score.survival) for score in scores], min, ".1%"),
        above,
        spread([100 * float(score.position_error) for score in scores], max, ".1f"),
        f"{last:.0f}",
        f"{rate / 1e3:.0f} k",
    ]
    row = "| " + " | ".join(cells) + " |"
    click.echo(row)
    return row


HEAD = """| policies | return | survival | ceiling | distance [cm] | 5 policies [s] | steps/s |
|---|---|---|---|---|---|---|"""


@click.command()
@click.option("--output", type=click.Path(path_type=Path, exists=True), default=Path(__file__).parents[1] / "docs" / "training.md")
def main(output: Path) -> None:
    """Trains five policies of each kind and writes their scores into the page OUTPUT."""
    paper, authors = DRONES
    rows = [
        measure("pwm", tasks.circle(), box("pwm"), paper, ceiling=True),
        measure("attitude_rate", tasks.circle(), box("attitude_rate"), paper, ceiling=True),
        measure("attitude", tasks.circle(), box("attitude"), paper, ceiling=True),
        measure("attitude", tasks.circle(), box("attitude", **DRONES[authors]), authors, ceiling=True),
        *(measure("pwm", task(), box("pwm"), paper, ceiling=False) for task in (tasks.figure_eight, tasks.hover, tasks.take_off)),
    ]
    load = os.getloadavg()[0]
    write(output, {"training": "\n".join([HEAD, *rows]), "training-machine": f"{CORES} cores; load at the end {load:.1f}."})


if __name__ == "__main__":
    main()
