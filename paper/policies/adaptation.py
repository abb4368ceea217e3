"""What policies find out in flight: jumps of payload and trim, and what their memory knows.

Two studies, of policies that remember and of others beside them.

- Jumps: on virtual drones the payload grows by 15 % of the mass, or the trim in yaw by 4,000
  counts, in the middle of a flight. How many flights are back within 5 cm, for good, in 2 s?
- Memory: drones of any make are flown, and a linear read-out (ridge regression) of the memory is
  fitted to what each drone is. How well does it tell drones that it was not fitted to?

    python paper/policies/adaptation.py policies/policy_1.json others/policy_1.json -o adaptation
"""

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import polars
from jaxtyping import Array, Float

from maidenflight import results
from maidenflight.experiments.recovery import SOON_S, recovery
from maidenflight.flying import engine
from maidenflight.parameters import Parameters, crazyflie, replace
from maidenflight.policy import Policy
from maidenflight.policy_file import read_policy
from maidenflight.simulator.any_drone import GenericQuadrotor
from maidenflight.simulator.controllers import control
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.realities import additions
from maidenflight.simulator.realities.virtual_drone import VARIANTS, virtual_drone
from maidenflight.simulator.stepping import randomized_reset, rollout
from maidenflight.simulator.tasks import tasks

JUMP_S, FLIGHT_S = 5.0, 12.0
"""When the drone changes, and the length of a flight [s]."""
PAYLOAD, TRIM_COUNTS = 0.15, 4000
FLIGHTS, KNOWN_AT_S = 4096, (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)
"""Drones whose memories are read, half of them to fit the read-out; and when [s]."""
RIDGE = 1e-2


def with_trim(drone: Parameters) -> Parameters:
    """With a torque in yaw, as of motors that differ by `TRIM_COUNTS`."""
    thrust = drone.thrust_to_weight * drone.mass * drone.gravity
    torque = TRIM_COUNTS / 65535 * drone.torque_to_thrust * thrust
    return replace(drone, torque_bias=drone.torque_bias + torque * jnp.array([0.0, 0.0, 1.0]))


JUMPS = {"payload": partial(additions.loaded, share=PAYLOAD), "yaw trim": with_trim}


def errors_of(
    policy: Policy, variant: str, jump: str, seeds: Sequence[int], flights: int
) -> Float[np.ndarray, "F T"]:
    """Distances from the set-point [m] of `flights` flights of each virtual drone."""
    drones = [virtual_drone(seed, variant) for seed in seeds]
    controller = control.controller_for(policy.interface)
    env = drones[0].environment(tasks.paper_circle(), controller, spec=policy.spec)
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *(one.parameters for one in drones))
    keys = jax.random.split(jax.random.key(len(jump)), (len(seeds), flights))

    def change(drone: Parameters, elapsed: Float[Array, ""]) -> Parameters:
        return jax.tree.map(
            lambda new, old: jnp.where(elapsed < JUMP_S, old, new), JUMPS[jump](drone), drone
        )

    def one(drone: Parameters, key: Array) -> Float[Array, "T"]:
        steps = round(FLIGHT_S * policy.interface.rate)
        rows = engine.simulate(
            env, lambda observation, _: policy(observation), drone, key, steps, during=change
        )
        return jnp.linalg.norm(rows.true_position - rows.true_setpoint, axis=1)

    rows_by_policy = jax.jit(jax.vmap(jax.vmap(one, (None, 0))))(stacked, keys)
    return np.asarray(rows_by_policy).reshape(len(seeds) * flights, -1)


def jumps(policies: dict[str, Policy], seeds: Sequence[int], flights: int) -> polars.DataFrame:
    """One row a policy, kind of drone and jump."""
    rows: list[dict[str, Any]] = []
    for name, policy in policies.items():
        for variant in VARIANTS:
            for jump in JUMPS:
                errors = errors_of(policy, variant, jump, seeds, flights)
                times = recovery(errors, policy.interface.rate, JUMP_S)
                before, after = np.split(errors, [round(JUMP_S * policy.interface.rate)], axis=1)
                settled = after[:, -round(2.0 * policy.interface.rate) :]
                rows.append(
                    {
                        "policy": name,
                        "drones": variant,
                        "jump": jump,
                        "flights": len(times),
                        "back in 2 s": float(np.mean(times < SOON_S)),
                        "median [s]": float(np.median(times)),
                        "farthest [m]": float(np.median(after.max(axis=1))),
                        "error before [m]": float(before.mean()),
                        "error after [m]": float(settled.mean()),
                    }
                )
                print(rows[-1], flush=True)
    return polars.DataFrame(rows)


def _targets(drones: Parameters) -> dict[str, np.ndarray]:
    """What a read-out is asked for, one number a drone."""
    thrust = np.asarray(drones.thrust_to_weight * drones.mass * drones.gravity)
    bias = np.asarray(drones.torque_bias)
    arm = np.hypot(drones.rotor_x, drones.rotor_y)[:, 0]
    return {
        "thrust-to-weight (log)": np.log(np.asarray(drones.thrust_to_weight)),
        "motor lag (log)": np.log(np.asarray(drones.motor_time_constant)),
        "latency": np.asarray(drones.latency),
        "trim in roll": bias[:, 0] / thrust / arm,
        "trim in yaw": bias[:, 2] / thrust / np.asarray(drones.torque_to_thrust),
        "wind forward": np.asarray(drones.wind)[:, 0],
        "weakest rotor": np.asarray(drones.rotor_thrust).min(axis=1),
    }


def share_explained(inputs: Float[np.ndarray, "N M"], wanted: Float[np.ndarray, "N"]) -> float:
    """Share of the variance (R^2) that a ridge regression, fitted to one half, tells of the other.

    Source: Hoerl and Kennard 1970.
    """
    half = len(wanted) // 2
    scaled = (inputs - inputs[:half].mean(0)) / (inputs[:half].std(0) + 1e-9)
    middle = wanted[:half].mean()
    normal = scaled[:half].T @ scaled[:half] + RIDGE * half * np.eye(scaled.shape[1])
    weights = np.linalg.solve(normal, scaled[:half].T @ (wanted[:half] - middle))
    missed = wanted[half:] - middle - scaled[half:] @ weights
    return float(1.0 - np.var(missed) / np.var(wanted[half:]))


def watch(policy: Policy) -> tuple[Parameters, np.ndarray, np.ndarray]:
    """Drones of any make on which a policy survives, and what it remembers and sees there.

    Returns:
        The drones, stacked; memories (N, times, M) and observed instants (N, times, 20 H) at
        `KNOWN_AT_S`.
    """
    controller = control.controller_for(policy.interface)
    centre = control.in_fitting_steps(crazyflie(), controller)
    env = Environment.matching(centre, tasks.paper_circle(), controller, spec=policy.spec)
    times = np.array([round(time * policy.interface.rate) for time in KNOWN_AT_S])
    steps = int(times.max()) + 1

    def one(key: Array) -> tuple[Parameters, Array, Array, Array]:
        begin_key, key = jax.random.split(key)
        first = randomized_reset(env, GenericQuadrotor(centre), begin_key)
        _, (states, result) = rollout(env, policy, first.env_state, first.parameters, key, steps)
        history = states.history.reshape(steps, -1)
        survives = ~jnp.any(result.terminated)
        return first.parameters, states.memory[times], history[times], survives

    keys = jax.random.split(jax.random.key(1), FLIGHTS)
    *rows_by_policy, survives = jax.tree.map(np.asarray, jax.jit(jax.vmap(one))(keys))
    drones, memories, histories = jax.tree.map(lambda leaf: leaf[survives], rows_by_policy)
    return drones, memories, histories


def read_out(policies: dict[str, Policy]) -> polars.DataFrame:
    """One row a policy and quantity: how much of it memory and observation tell, by time."""
    rows: list[dict[str, Any]] = []
    for name, policy in policies.items():
        drones, *sources = watch(policy)
        for quantity, wanted in _targets(drones).items():
            for source, inputs in zip(("memory", "observation"), sources, strict=True):
                if inputs.shape[-1]:
                    by_time = {
                        f"{time:g} s": share_explained(inputs[:, place], wanted)
                        for place, time in enumerate(KNOWN_AT_S)
                    }
                    rows.append(
                        {"policy": name, "quantity": quantity, "told by": source, **by_time}
                    )
    return polars.DataFrame(rows)


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs both studies and writes their tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("policies", nargs="+", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--drones", type=int, default=10, help="virtual drones of each kind")
    parser.add_argument("--flights", type=int, default=6, help="flights of each")
    options = parser.parse_args(arguments)
    policies = {"/".join(path.parts[-2:]): read_policy(path).policy for path in options.policies}
    seeds = range(1, options.drones + 1)
    record = results.record(seed=0, inputs=options.policies, settings={"drones": options.drones})
    for name, table in (
        ("jumps", partial(jumps, policies, seeds, options.flights)),
        ("read_out", partial(read_out, policies)),
    ):
        tables = table()
        with polars.Config(tbl_rows=-1, tbl_cols=-1, tbl_width_chars=200, float_precision=3):
            print(tables)
        rows = tables.write_csv(float_precision=4)
        text = results.table_text(f"maidenflight {name} 1", record, rows)
        results.write(options.output / f"{name}.csv", text)


if __name__ == "__main__":
    main()
