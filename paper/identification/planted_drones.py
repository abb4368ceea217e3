"""Whether intervals hold the truth: drones of the training model itself, identified from flights.

Thrust-to-weight ratio, motor time constant and latency are drawn at random. A PWM policy, trained
over the same ranges, flies each drone with sensor and actuator noise; nothing but the three is
unknown. (A policy in a limit cycle throws commands between 0 and 1, where the simulator cuts the
motors' noise off and the lag comes out up to 2.4 ms too long.) Prints the coverage of 90 and 95 %
intervals and the largest errors.

    python paper/identification/planted_drones.py --drones 240 -o planted_drones

Source of the method: Cook, Gelman and Rubin 2006, Validation of software for Bayesian models.
"""

import argparse
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
import polars
from rich.progress import track

import maidenflight as mf
from maidenflight import results
from maidenflight.flights.log import Flight
from maidenflight.flying import engine
from maidenflight.flying.rows import Rows, SimulatedFlight
from maidenflight.parameters import Parameters, crazyflie, replace
from maidenflight.policy import Policy
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics.battery import Supply
from maidenflight.simulator.randomization import UniformBox

DRAWN = {
    "thrust_to_weight": (1.5, 1.95),
    "motor_time_constant": (0.050, 0.090),
    "latency": (0.004, 0.012),
}
"""Ranges of the unknown parameters, SI units."""
FLIGHTS, DURATION = 4, 30.0
"""Flights of a drone and how long each is [s]."""
STEP = 0.001
"""Physics step of these flights [s]: at the 5 ms of training a command that arrives within a step
moves the lag by 1.7 ms."""
TOTAL = "T_m + latency"


def fly(policy: Policy, drone: Parameters, seed: int) -> list[Flight]:
    """The flights of one drone, from starts of their own."""
    world = Environment.matching(drone, mf.simulator.paper_circle(), mf.simulator.pwm())
    keys = jax.random.split(jax.random.key(seed), FLIGHTS)
    rows = jax.tree.map(np.asarray, _fly(world, policy, drone, keys))
    return [
        SimulatedFlight(
            jax.tree.map(lambda values, number=number: values[number], rows),
            world.controller.interface.rate,
            zero_order_hold=True,
            supply=Supply(),
            reality=f"drone {seed}",
        ).to_flight(f"drone {seed} flight {number + 1}")
        for number in range(FLIGHTS)
    ]


@partial(jax.jit, static_argnums=0)
def _fly(world: Environment, policy: Policy, drone: Parameters, keys: jax.Array) -> Rows:
    def one(key: jax.Array) -> Rows:
        return engine.simulate(
            world, lambda observation, _: policy(observation), drone, key, round(DURATION / 0.01)
        )

    return jax.vmap(one)(keys)


def judge(seeds: range, policy: Policy) -> Iterator[dict[str, Any]]:
    """A row for each drone and quantity; times in ms."""
    for seed in track(seeds, description="drones"):
        generator = np.random.default_rng(seed)
        truth: dict[str, Any] = {
            name: float(generator.uniform(*ends)) for name, ends in DRAWN.items()
        }
        flights = fly(policy, replace(crazyflie(), **truth, time_step=STEP), seed)
        identification = mf.identify(flights, over=tuple(DRAWN), key=jax.random.key(seed))
        draws: dict[str, Any] = dict(identification.posterior)
        values: dict[str, Any] = {name: identification.estimates[name].value for name in draws}
        for of in (draws, values, truth):
            of[TOTAL] = of["motor_time_constant"] + of["latency"]
        for name, samples in draws.items():
            scale = 1.0 if name == "thrust_to_weight" else 1e3
            low, lower, upper, high = np.quantile(samples, [0.025, 0.05, 0.95, 0.975])
            yield {
                "drone": seed,
                "parameter": name,
                "truth": scale * truth[name],
                "found": scale * values[name],
                "error": scale * (values[name] - truth[name]),
                "standard deviation": scale * float(np.std(samples)),
                "in 90 %": bool(lower <= truth[name] <= upper),
                "in 95 %": bool(low <= truth[name] <= high),
            }


def summary(rows: polars.DataFrame) -> polars.DataFrame:
    """Coverage and errors of each quantity."""
    error = polars.col("error")
    return rows.group_by("parameter", maintain_order=True).agg(
        polars.len().alias("drones"),
        polars.col("in 90 %", "in 95 %").sum(),
        error.mean().alias("mean error"),
        error.abs().median().alias("median error"),
        error.abs().max().alias("largest"),
        polars.col("standard deviation").median(),
    )


def _with_ends(side: int) -> Parameters:
    """The paper's drone with the least or the largest of what is drawn."""
    ends = {name: np.float32(ends[side]) for name, ends in DRAWN.items()}
    return replace(crazyflie(), **ends)


def main() -> None:
    """Writes the table and prints its summary."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drones", type=int, default=240)
    parser.add_argument("--updates", type=int, default=1500, help="of the policy's training")
    parser.add_argument("-o", "--output", type=Path, default=Path("planted_drones"))
    options = parser.parse_args()
    policy = mf.train(
        mf.simulator.paper_circle(),
        mf.simulator.pwm(),
        UniformBox(*(_with_ends(side) for side in (0, 1))),
        jax.random.split(jax.random.key(0), 1),
        mf.AnalyticGradient(updates=options.updates),
    )[0]
    rows = polars.DataFrame(judge(range(options.drones), policy))
    results.write(options.output / "planted_drones.csv", rows.write_csv())
    with polars.Config(tbl_cols=20, tbl_hide_dataframe_shape=True):
        print(summary(rows))


if __name__ == "__main__":
    main()
