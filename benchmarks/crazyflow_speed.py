"""Crazyflow's side of `simulator.py`, for a Python that has crazyflow.

Same requests and answers as `maidenflight_speed.py`.
"""

# pyright: reportMissingImports=false
import os
import resource
import sys
from typing import Any

import jax
from serving import Prepared, rate, serve

CORES = len(os.sched_getaffinity(0))
if len(sys.argv) == 1:
    jax.config.update("jax_num_cpu_devices", CORES)

import numpy as np  # noqa: E402
from crazyflow.control import Control  # noqa: E402
from crazyflow.dynamics import Dynamics  # noqa: E402
from crazyflow.sim import Sim  # noqa: E402
from crazyflow.sim.integration import Integrator  # noqa: E402
from crazyflow.sim.sharding import world_mesh  # noqa: E402

LAYOUTS = {"one core": 1, "all cores": CORES}
"""CPU devices that the worlds are laid on by crazyflow's own mesh."""


def simulation(series: str, batch: int, devices: int = 1) -> Any:
    """Rotor velocities or body rates commanded, first principles, Euler, 500 Hz, float32."""
    control = {"motor": Control.rotor_vel, "rate": Control.body_rate}[series]
    mesh = world_mesh(jax.devices()[:devices]) if devices > 1 else None
    sim = Sim(
        n_worlds=batch,
        control=control,
        dynamics=Dynamics.first_principles,
        integrator=Integrator.euler,
        freq=500,
        mesh=mesh,
        device=jax.default_backend(),
    )
    if series == "motor":
        sim.rotor_vel_control(np.full((batch, 1, 4), 15000.0, np.float32))
    else:
        sim.body_rate_control(
            np.broadcast_to(np.array([0.0, 0.0, 0.0, 0.3], np.float32), (batch, 1, 4))
        )
    return sim


def prepare(series: str, batch: int, layout: str) -> Prepared | None:
    """A call that simulates, and the physics steps that it counts for.

    Nothing where the layout does not fit the batch.
    """
    if batch % LAYOUTS[layout]:
        return None
    sim, turns = simulation(series, batch, LAYOUTS[layout]), max(min(2**20 // batch, 1024), 64)

    def call() -> None:
        sim.step(turns)
        jax.block_until_ready(sim.data.states.pos)

    return call, batch * turns


def first() -> None:
    """The first physics step of a fresh process."""
    sim = simulation("motor", 1)
    sim.step()
    print(float(sim.data.states.pos[0, 0, 2]))


def memory() -> None:
    """Peak memory [MB] of a process that steps 1,000 worlds.

    Crazyflow has no noise, reward or randomization here.
    """
    sim = simulation("rate", 1000)
    sim.step(64)
    jax.block_until_ready(sim.data.states.pos)
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6)


def single() -> None:
    """Steps per second of one drone in crazyflow's self-resetting figure-eight environment."""
    import crazyflow.envs  # noqa: F401  registers
    import gymnasium

    world = gymnasium.make_vec("DroneFigureEightTrajectory-v0", num_envs=1, freq=100)
    world.reset(seed=0)
    action = np.array([[0.0, 0.0, 0.0, 0.3]], np.float32)

    def fly() -> None:
        for _ in range(100):
            jax.block_until_ready(world.step(action)[:4])

    fly()
    print(rate(fly, 100, seconds=2.0))


if __name__ == "__main__":
    {"first": first, "memory": memory, "single": single}[sys.argv[1]]() if len(
        sys.argv
    ) > 1 else serve(prepare)
