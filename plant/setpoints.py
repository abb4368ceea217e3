"""Flies a tracking policy by the exported app in the plant, along set-points of the commander.

Writes a table of paper/notes/training.md: what the app makes of velocity and acceleration in the
set-points, in place of the reference's future. Plant, estimator and PID as in `guards.py`.

    maidenflight train --drone crazyflie --task tracking -o tracking
    python plant/setpoints.py tracking/policy_1.json --reference places.csv
"""

from pathlib import Path
from typing import Any

import click
import jax
import jax.numpy as jnp
import numpy as np
from guards import Flights, write

from maidenflight.simulator.tasks.tasks import find_task

HOVER, CIRCLE, COMMANDER = 0, 1, 2
BUILT_IN, CURVES = {"hover": HOVER, "circle": CIRCLE}, ("circle", "figure_eight")
SEEDS, SECONDS = 1, 12.0


def motion(reference: str) -> tuple[np.ndarray, float]:
    """Position, velocity and acceleration of a reference each millisecond, from its start."""
    task = find_task(reference)
    path, seconds = task.reference, min(task.duration, SECONDS)
    seconds = seconds if reference.endswith(".csv") else SECONDS

    def slope(of: Any) -> Any:
        return lambda time: jax.jvp(of, (time,), (jnp.ones_like(time),))[1]

    times = jnp.arange(0.0, seconds, 0.001, dtype=jnp.float32)
    parts = [np.asarray(jax.vmap(of)(times)) for of in (path, slope(path), slope(slope(path)))]
    parts[0] = parts[0] - parts[0][0] + [0.0, 0.0, 1.0]
    return np.stack(parts, axis=1), seconds


def fly(flights: Flights, reference: str, task: int, seed: int) -> tuple[float, float, str]:
    """Mean distance of the true state in a flight [cm], the share of it flown, and why no more."""
    places, seconds = motion(reference)
    errors: list[float] = []
    start = np.zeros(3)

    def lead(loop: Any, time: float) -> None:
        if time == 0.0:
            start[:2] = loop.position[:2]
        place, velocity, acceleration = places[min(round(time * 1000), len(places) - 1)]
        loop.wanted[:] = place + start
        loop.row["wanted_velocity"], loop.row["wanted_acceleration"] = velocity, acceleration
        goal = np.array([loop.app.log(f"goal{axis}") for axis in "XYZ"])
        if time > 0.0:
            errors.append(float(np.linalg.norm(loop.plant.state.position - goal)))

    lasted, why, _ = flights.fly(seed, task, seconds, lead)
    return 100.0 * float(np.mean(errors)), lasted / seconds, why


@click.command()
@click.argument("policy", type=Path)
@click.option("--reference", multiple=True, help="CSV file of a reference, beside the curves.")
@click.option("--drone", default="virtual:7", help="Virtual drone, or a drone's file.")
def main(policy: Path, reference: tuple[str, ...], drone: str) -> None:
    """Measures and writes the table."""
    flights = Flights(policy, drone)
    rows = ["| reference | `mf.task` | error [cm] | ends |", "|---|---|---|---|"]
    courses = [*BUILT_IN.items(), *((name, COMMANDER) for name in (*CURVES, *reference))]
    for name, task in courses:
        outcomes = [fly(flights, name, task, seed) for seed in range(SEEDS)]
        error = f"{np.mean([one[0] for one in outcomes]):.2f}"
        ends = sum(one[1] == 1.0 for one in outcomes)
        rows.append(f"| {Path(name).stem} | {task} | {error} | {ends} of {SEEDS} |")
        click.echo(rows[-1])
    page = Path(__file__).parents[1] / "paper" / "notes" / "training.md"
    write(page, {"setpoints": "\n".join(rows)})


if __name__ == "__main__":
    main()
