"""What identification buys: how hard a flight may be for policies that know the drone, and others.

Each virtual drone is recorded (four flights of 30 s by its PID), identified from these logs, and
flown by

- policies that were trained for the identified drone, with several kinds of randomization,
- policies that were trained for the unidentified Crazyflie, and one kind, with a memory, for drones
  of any make,
- the authors' best published PWM policies (`--authors`) and RAPTOR (`--raptor`),
- the firmware's position PID and its Mellinger controller.

What is there already is not made again, so an interrupted run goes on.

    python paper/policies/rivals.py -o rivals --drones 1 2 --authors ../shared/data/authors --raptor
"""

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import polars

from maidenflight import results
from maidenflight.errors import require_packages
from maidenflight.experiments import envelope, transfer
from maidenflight.flights.log import thinned
from maidenflight.flying import engine
from maidenflight.flying.foreign_policy import foreign_policy
from maidenflight.flying.pilots import AnyPolicy
from maidenflight.flying.rows import Rows, SimulatedFlight
from maidenflight.integrations.exporters.authors_json import EPSILON
from maidenflight.names import ANY, POSTERIOR, WIDE
from maidenflight.parameters import Parameters
from maidenflight.policy import Policy
from maidenflight.policy_file import read_policy
from maidenflight.simulator.controllers import control, mellinger
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.controllers.position_pid import position_pid
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.realities.virtual_drone import VirtualDrone, virtual_drone
from maidenflight.simulator.tasks import tasks, trajectories
from maidenflight.simulator.tasks.trajectories import Trajectory
from maidenflight.verbs.identify import Identify
from maidenflight.verbs.record import Record
from maidenflight.verbs.train import Train

TASK = "fast_circle"
RANDOMIZATIONS: dict[str, float | str] = {"10 %": 0.10, "wide": WIDE}
OF_IDENTIFIED: dict[str, float | str] = {**RANDOMIZATIONS, "posterior": POSTERIOR}
UNKNOWN = "crazyflie"
"""The drone of policies without identification."""
MEMORY = 16
"""Numbers that the adaptive policies remember."""
PUBLISHED = (33, 34, 36, 38)
"""The authors' PWM policies of the two settings of which all real flights lasted 20 s, as far as
they are there: trained with a motor lag of 100 and a latency of 20 ms (33, 34), or 120 and 10."""
OTHERS = ("the authors' best", "raptor", "raptor:500hz")
"""Policies of others. All but the circle is spared them: the authors' know one circle only."""
RATE = 500
"""Commands of a controller a second [Hz]."""
SECONDS = 20.0
"""Of a circle that comes to 1.7 m/s by then, whose error and calm are measured."""
_RESAMPLINGS = 2000

Makes = Callable[[Trajectory], Controller]
"""A controller for a reference."""
CONTROLLERS: dict[str, Makes] = {
    "firmware PID": lambda _: position_pid(),
    "Mellinger, positions alone": lambda _: mellinger.mellinger(),
    "Mellinger, full state": mellinger.mellinger,
}
"""Controllers of the firmware, as they are."""


class Sources(NamedTuple):
    """What is flown beside our own."""

    authors: Path | None
    raptor: bool


def train_policies(
    folder: Path, drone: str | Path, kind: float | str, policies: int, memory: int = 0
) -> list[Policy]:
    """Policies of one training, made unless they are there."""
    files = [folder / f"policy_{number}.json" for number in range(1, policies + 1)]
    if not all(file.exists() for file in files):
        training = Train(
            drone=str(drone),
            randomize=kind,
            accept_bounds=True,
            task=TASK,
            memory=memory,
            policies=policies,
        )
        training.run(folder)
    return [read_policy(file).policy for file in files]


def identify_drone(folder: Path, seed: int) -> Path:
    """The drone file identified from recorded flights, made unless it is there."""
    file = folder / "drone.toml"
    if not file.exists():
        logs = folder / "logs"
        recording = Record(
            reality=f"virtual:{seed}", flights=4, duration=30.0, excitation=0.06, seed=seed
        )
        recording.run(logs)
        Identify(logs=logs, seed=seed).run(file)
    return file


def read_published(folder: Path) -> list[Policy]:
    """The authors' policies of `PUBLISHED`."""
    archive = np.load(folder / "policies.npz")
    policies = []
    for number in PUBLISHED:
        (place,) = np.flatnonzero((archive["control"] == "pwm") & (archive["policy"] == number))

        def layers(kind: str, place: Any = place) -> tuple[jax.Array, ...]:
            return tuple(
                jnp.asarray(archive[f"{kind}{layer}"][place], jnp.float32) for layer in range(3)
            )

        mean, deviation = archive["observation_mean"][place], archive["observation_std"][place]
        policies.append(
            Policy(
                weights=layers("W"),
                biases=layers("b"),
                observation_mean=jnp.asarray(mean, jnp.float32),
                observation_std=jnp.asarray(deviation + EPSILON, jnp.float32),
            )
        )
    return policies


def rivals_of(
    folder: Path, drone: VirtualDrone, seed: int, policies: int, sources: Sources
) -> dict[str, Sequence[AnyPolicy]]:
    """All policies that fly a drone, by their training."""
    train = partial(train_policies, policies=policies)
    known = identify_drone(folder / drone.name, seed)
    rivals: dict[str, Sequence[AnyPolicy]] = {
        f"unidentified, {name}": train(folder / UNKNOWN / name, UNKNOWN, kind)
        for name, kind in RANDOMIZATIONS.items()
    }
    rivals["unidentified, any, memory"] = train(
        folder / UNKNOWN / "any, memory", UNKNOWN, ANY, memory=MEMORY
    )
    rivals |= {
        f"identified, {name}": train(folder / drone.name / name, known, kind)
        for name, kind in OF_IDENTIFIED.items()
    }
    if sources.authors is not None:
        rivals[OTHERS[0]] = read_published(sources.authors)
    if sources.raptor:
        for name in OTHERS[1:]:
            raptor = foreign_policy(name)
            assert raptor is not None
            rivals[name] = [raptor]
    return rivals


def fly_controller(
    makes: Makes, drone: VirtualDrone, axis: str, flights: int, name: str
) -> polars.DataFrame:
    """A controller's flights along an axis of speed, in rows as `envelope.envelope` gives."""
    pace = envelope.AXES[axis]
    assert isinstance(pace, envelope.SpeedRamp)
    assert pace.of is not None
    task = tasks.tracking(pace.of(pace.fastest), trajectories.RAMP_DURATION_S)
    env = drone.environment(task, makes(task.reference))
    keys = jax.random.split(jax.random.key(0), flights)
    rows = jax.tree.map(
        np.asarray, _fly(env, drone.parameters, keys, None, trajectories.RAMP_DURATION_S)
    )
    steps = round(trajectories.RAMP_DURATION_S * RATE)
    lasted = [
        envelope.steps_done(Rows(*(column[number] for column in rows)), RATE)
        for number in range(flights)
    ]
    reached = [round(pace.fastest * count / steps, 6) if count else np.nan for count in lasted]
    return polars.DataFrame(
        {
            "policy": f"{name}: 1",
            "reality": drone.name,
            "axis": axis,
            "flight": list(range(1, flights + 1)),
            "reached": reached,
            "unit": pace.unit,
            "hardest": pace.fastest,
            "limit": round(envelope.limit(axis, drone), 6),
        }
    )


@partial(jax.jit, static_argnums=(0, 4))
def _fly(
    env: Environment, drone: Parameters, keys: jax.Array, policy: Policy | None, seconds: float
) -> Rows:
    steps = round(seconds * env.controller.interface.rate)

    def one(key: jax.Array) -> Rows:
        act = lambda observation, _: jnp.zeros(4) if policy is None else policy(observation)  # noqa: E731
        return engine.simulate(env, act, drone, key, steps)

    return jax.vmap(one)(keys)


def precision(
    rivals: dict[str, Sequence[AnyPolicy]], drone: VirtualDrone, flights: int
) -> polars.DataFrame:
    """How close and how calmly a drone flies the first `SECONDS` of a circle that gets faster.

    A row a flight: training, policy, reality, flight, mean distance `error` [m] and
    `command_change`, the mean |du| between commands 10 ms apart [-]. No guard ends a flight.
    """
    task, rows = tasks.TASKS[TASK](), []
    keys = jax.random.split(jax.random.key(1), flights)
    makers = {name: makes(task.reference) for name, makes in CONTROLLERS.items()}
    several = [
        (name, policy) for name, own in rivals.items() if name not in OTHERS for policy in own
    ]
    for place, (name, policy) in enumerate([*several, *((name, None) for name in makers)]):
        assert policy is None or isinstance(policy, Policy)
        controller = makers[name] if policy is None else control.controller_for(policy.interface)
        spec = PolicySpec() if policy is None else policy.spec
        env = drone.environment(task, controller, spec=spec)
        columns = jax.tree.map(np.asarray, _fly(env, drone.parameters, keys, policy, SECONDS))
        for number in range(flights):
            one = Rows(*(column[number] for column in columns))
            log = SimulatedFlight(
                one,
                controller.interface.rate,
                zero_order_hold=True,
                supply=env.supply,
                reality=drone.name,
            ).to_flight(name)
            slow = thinned(log, controller.interface.rate // 100)
            away = np.linalg.norm(one.true_position - one.true_setpoint, axis=1)
            rows.append(
                {
                    "training": name,
                    "policy": place,
                    "reality": drone.name,
                    "flight": number + 1,
                    "error": round(float(away.mean()), 6),
                    "command_change": transfer.activity(slow)["command_change"],
                }
            )
    return polars.DataFrame(rows)


def table(
    folder: Path,
    seeds: Sequence[int],
    axes: Sequence[str],
    policies: int,
    flights: int,
    sources: Sources,
) -> polars.DataFrame:
    """A row a flight, as `envelope.envelope` gives; policies are called by their training.

    Controllers fly axes of speed, RAPTOR and the authors' policies the circle alone.
    """
    parts = []
    drones = [virtual_drone(seed) for seed in seeds]
    for axis in axes:
        for drone, seed in zip(drones, seeds, strict=True):
            rivals = rivals_of(folder, drone, seed, policies, sources)
            makers = CONTROLLERS if isinstance(envelope.AXES[axis], envelope.SpeedRamp) else {}
            for name in [*rivals, *makers]:
                if name in OTHERS and axis != "circle":
                    continue
                file = folder / drone.name / axis / f"{name}.csv"
                if not file.exists():
                    print(f"{drone.name} along {axis}: {name}", flush=True)
                    flights_of_name = (
                        envelope.envelope(
                            rivals[name],
                            drone,
                            axis,
                            flights=flights,
                            task=tasks.TASKS[TASK](),
                            names=[f"{name}: {place + 1}" for place in range(len(rivals[name]))],
                        )
                        if name in rivals
                        else fly_controller(makers[name], drone, axis, flights, name)
                    )
                    results.write(file, flights_of_name.write_csv())
                parts.append(polars.read_csv(file, schema_overrides=_NUMBERS))
    return polars.concat(parts)


_NUMBERS: Any = dict.fromkeys(("reached", "hardest", "limit"), polars.Float64)


def by_training(flights: polars.DataFrame) -> polars.DataFrame:
    """Mean envelope over policies of a training and over drones, and the worst of them.

    A policy that flies nothing counts as 0. `low` and `high` are a 95 % interval of the mean: a
    bootstrap over policies and drones, of whose few it tells little more than their range.

    Source: Efron and Tibshirani 1993, An introduction to the bootstrap, sec. 13.3.
    """
    training = polars.col("policy").str.split(": ").list.first().alias("training")
    each = envelope.summary(flights).with_columns(
        training, value=polars.col("envelope").fill_nan(0.0)
    )
    rows = []
    for (axis, name), part in each.group_by("axis", "training", maintain_order=True):
        values = part["value"].to_numpy()
        drawn = np.random.default_rng(0).choice(values, (_RESAMPLINGS, len(values))).mean(axis=1)
        low, high = np.quantile(drawn, [0.025, 0.975])
        rows.append(
            {
                "axis": axis,
                "training": name,
                "policies x drones": len(values),
                "mean": values.mean(),
                "low": low,
                "high": high,
                "worst": values.min(),
                "of physics": (values / part["limit"].to_numpy()).mean(),
                "unit": part["unit"][0],
            }
        )
    return polars.DataFrame(rows)


def main() -> None:
    """Writes the table and prints it by training."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drones", type=int, nargs="*", default=(1, 2, 3), help="seeds")
    parser.add_argument("--along", nargs="*", default=tuple(envelope.AXES)[1:], help="axes")
    parser.add_argument("--policies", type=int, default=2, help="of each training")
    parser.add_argument("--flights", type=int, default=20, help="of each policy and axis")
    parser.add_argument("--authors", type=Path, help="folder of the authors' policies.npz")
    parser.add_argument("--raptor", action="store_true", help="needs foundation-policy")
    parser.add_argument("-o", "--output", type=Path, default=Path("rivals"))
    options = parser.parse_args()
    require_packages(*(["foundation_policy"] if options.raptor else []))
    extra = Sources(options.authors, options.raptor)
    flights = table(
        options.output,
        options.drones,
        options.along,
        options.policies,
        options.flights,
        extra,
    )
    results.write(options.output / "rivals.csv", flights.write_csv())
    of_drones = [
        precision(
            rivals_of(options.output, drone, seed, options.policies, extra), drone, options.flights
        )
        for seed, drone in ((seed, virtual_drone(seed)) for seed in options.drones)
    ]
    close = polars.concat(of_drones)
    results.write(options.output / "precision.csv", close.write_csv())
    with polars.Config(
        tbl_rows=200, tbl_cols=20, tbl_hide_dataframe_shape=True, fmt_str_lengths=40
    ):
        print(envelope.summary(flights))
        print(by_training(flights))
        print(
            close.group_by("training", maintain_order=True).agg(
                polars.len().alias("flights"),
                polars.col("error", "command_change").mean(),
                polars.col("error").max().alias("largest error"),
            )
        )


if __name__ == "__main__":
    main()
