"""Measures how far a drone sinks when the firmware's PID takes it over from a policy.

Writes a table of paper/notes/export.md.

The PID starts anew, so the integrals of its height loops are zero, which hold up what weighs more
than the firmware's base thrust lifts. The simulated PID of firmware 2026.08 begins with the drone
at its set-point, at rest with the motors at hover thrust, level or tilted; nothing is noisy.
"""

from pathlib import Path

import click
import jax
import jax.numpy as jnp
import numpy as np
from page import write

from maidenflight import parameters
from maidenflight.parameters import Parameters, noiseless
from maidenflight.parameters.named import with_mass
from maidenflight.simulator import environment
from maidenflight.simulator.controllers import control
from maidenflight.simulator.controllers.pid import ATTITUDE_RATE
from maidenflight.simulator.controllers.position_pid import position_pid
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics import dynamics, rotations
from maidenflight.simulator.physics.battery import COUNTS
from maidenflight.simulator.stepping import rollout
from maidenflight.simulator.tasks import tasks

DRONE, MASSES_G, TILTS_DEG = "crazyflie_2.1+", (27.0, 29.0, 31.0, 33.0, 35.0), (0.0, 33.0)
HEIGHT, SECONDS = 1.0, 4.0
"""[m], [s]."""


def sinking(drone: Parameters, tilt: float) -> float:
    """Greatest distance below the set-point after the hand-back [m].

    Args:
        drone: what flies.
        tilt: pitch at the hand-back [deg].
    """
    structure = position_pid("2026.08")
    drone = control.in_fitting_steps(noiseless(drone), structure)
    env = Environment.matching(drone, tasks.hover(HEIGHT), structure)
    attitude = rotations.from_attitude(jnp.radians(jnp.array([0.0, tilt, 0.0])))
    state = dynamics.at_hover(jnp.array([0.0, 0.0, HEIGHT]), drone)._replace(quaternion=attitude)
    key, still, steps = jax.random.key(0), jnp.zeros(4), round(SECONDS * ATTITUDE_RATE)
    start = environment.begin(env, state, jnp.zeros(()), drone, key)
    fly = jax.jit(lambda start: rollout(env, lambda _: still, start, drone, key, steps))
    _, (before, _) = fly(start)
    return HEIGHT - float(np.min(np.asarray(before.state.position)[:, 2]))


@click.command()
def main() -> None:
    """Measures and writes the table."""
    rows = [
        "| mass | hover thrust | from level | from a tilt of 33 deg |",
        "|---|---|---|---|",
    ]
    for mass in MASSES_G:
        drone = with_mass(parameters.read_drone(DRONE), mass / 1000, DRONE)
        sunk = [f"{100 * sinking(drone, tilt):.0f} cm" for tilt in TILTS_DEG]
        counts = COUNTS / float(drone.thrust_to_weight)
        rows.append(f"| {mass:.0f} g | {counts:,.0f} counts | {' | '.join(sunk)} |")
        click.echo(rows[-1])
    write(
        Path(__file__).parents[1] / "paper" / "notes" / "export.md", {"hand-back": "\n".join(rows)}
    )


if __name__ == "__main__":
    main()
