"""Ablations for the claims of the paper's Discussion: effects on zero-shot flights.

`python paper/ablations.py -o ablations` trains policies around a drone, five seeds each: as the
paper did, and then with one thing changed at a time: penalties of actions, the range of attitude
rates, and what the simulation knows of motor lag and latency. It flies each of them in virtual
realities and on the drone itself, and those trained as the paper's also on drones with other parts,
or drawn from the posterior of an identified drone. `flights.csv` has a row a flight,
`ablations.svg` shows effects with 95 % intervals over policies. Stopped, it goes on where it was by
the same command; what has flown is kept by variant, and only the picture is drawn anew.

Source: Gronauer et al. 2022, sec. Discussion.
"""

import argparse
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import polars
from ablation_effects import NOTE, draw_chart, find_effects, summarize
from ablation_variants import (
    BASELINE,
    ITSELF,
    METHODS,
    POSTERIOR,
    QUICK,
    RANDOMIZATION,
    Variant,
    choose_settings,
    choose_variants,
    number_name,
    other_drones,
    train_variant,
)
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from maidenflight import compiler, parameters, results, terminal
from maidenflight.errors import InputError
from maidenflight.experiments.drones import find_reality
from maidenflight.experiments.transfer import MAX_DURATION_S, transfer
from maidenflight.flights.log import Flight
from maidenflight.parameters import Parameters, replace
from maidenflight.policy import Policy
from maidenflight.reporting.figures import picture
from maidenflight.settings import plain
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.realities.virtual_drone import VirtualDrone
from maidenflight.simulator.tasks import tasks
from maidenflight.training.settings import recorded

LIMIT = 0.01
"""A command within this of 0 or 1 is at its limit; steps of the motors' 8-bit timers are as large
at full thrust."""


def _check_same(content: Any, expected_record: Mapping[str, Any], path: Path) -> None:
    if content != plain(expected_record):
        raise InputError(
            f"{path}: from a run with other settings or of another version. Choose another folder "
            "with -o."
        )


def rebuild_actions(
    policy: Policy, flights: Sequence[Flight], levels: Float[np.ndarray, "F 4"]
) -> list[Float[np.ndarray, "N 4"]]:
    """What a policy did in its flights, from what their logs say that it saw; not clipped.

    Args:
        policy: the one that flew them.
        flights: with a row a control period.
        levels: of each flight the action that stands in the first observation, of level hover.
    """
    longest = max(len(flight) for flight in flights)
    # Flights that have ended stay what they were last, which is cut off again.
    observations = np.stack(
        [
            np.pad(_observe(flight), ((0, longest - len(flight)), (0, 0)), mode="edge")
            for flight in flights
        ]
    )
    layers = [
        (np.asarray(weight), np.asarray(bias))
        for weight, bias in zip(policy.weights, policy.biases, strict=True)
    ]
    mean, deviation = np.asarray(policy.observation_mean), np.asarray(policy.observation_std)
    action, history, done = np.asarray(levels), None, []
    for row in observations.swapaxes(0, 1):
        instant = np.concatenate([row, action], axis=1)
        history = (
            np.tile(instant, policy.spec.history)
            if history is None
            else np.concatenate([history[:, instant.shape[1] :], instant], axis=1)
        )
        values = (history - mean) / deviation
        for weight, bias in layers[:-1]:
            values = np.maximum(values @ weight.T + bias, 0.0)
        action = values @ layers[-1][0].T + layers[-1][1]
        done.append(action)
    return [np.stack(done)[: len(flight), number] for number, flight in enumerate(flights)]


def _observe(flight: Flight) -> Float[np.ndarray, "N 16"]:
    """An observation's instants but for their actions, in the order of `policy_spec.observe`."""
    quaternions = Rotation.from_euler("xyz", flight.attitude).as_quat()
    # Attitudes do not tell a quaternion's sign; the simulator's begins upright and does not jump.
    flips = np.where(np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0, -1.0, 1.0)
    signs = np.cumprod(np.concatenate([[1.0 if quaternions[0, 3] >= 0 else -1.0], flips]))
    error = flight.setpoint - flight.position
    return np.concatenate(
        [flight.position, quaternions * signs[:, None], flight.velocity, flight.body_rates, error],
        axis=1,
    )


class Activity(NamedTuple):
    """How near a flight is to bang-bang control."""

    beyond: float
    """Share of actions with |a| > 1."""
    change: float
    """Mean |u_t - u_(t-1)| of the motor commands, a control period."""
    at_limits: float
    """Share of motor commands at 0 or 1."""


def measure_activity(done: Float[np.ndarray, "N 4"], command: Float[np.ndarray, "N 4"]) -> Activity:
    """Of a flight's actions and motor commands u, a row a control period."""
    limits: Bool[np.ndarray, "N 4"] = (command <= LIMIT) | (command >= 1.0 - LIMIT)
    change = float(np.abs(np.diff(command, axis=0)).mean()) if len(command) > 1 else 0.0
    return Activity(float((np.abs(done) > 1.0).mean()), change, float(limits.mean()))


def fly_variant(
    variant: Variant,
    policies: Sequence[Policy],
    realities: Mapping[str, Sequence[VirtualDrone]],
    trials: int,
    duration: float,
    key: jax.Array,
) -> polars.DataFrame:
    """One row per flight.

    Columns: variant, control, policy, reality, drone (its number in the reality), trial, those of
    `transfer`, and `Activity`.

    All variants start alike and meet the same noise, as far as the key is the same.
    """
    controller = variant.controller()
    places = {
        one.name: (name, number, one)
        for name, drones in realities.items()
        for number, one in enumerate(drones, 1)
    }
    names = [str(number) for number in range(1, len(policies) + 1)]
    record_of_file = transfer(
        policies,
        [one for *_, one in places.values()],
        trials,
        key,
        task=tasks.paper_circle(),
        controller=controller,
        duration=duration,
        names=names,
    )
    levels = {
        name: np.asarray(controller.interface.level(dynamics.hover_command(one.parameters)))
        for name, (*_, one) in places.items()
    }
    done: dict[int, Float[np.ndarray, "N 4"]] = {}
    for name, one in zip(names, policies, strict=True):
        own = [
            number for number, pilot in enumerate(record_of_file.table["policy"]) if pilot == name
        ]
        levels_at_start = np.stack(
            [levels[record_of_file.table["reality"][number]] for number in own]
        )
        done |= dict(
            zip(
                own,
                rebuild_actions(
                    one, [record_of_file.flights[number] for number in own], levels_at_start
                ),
                strict=True,
            )
        )
    rows = []
    for place, (row, flight) in enumerate(
        zip(record_of_file.table.iter_rows(named=True), record_of_file.flights, strict=True)
    ):
        reality, number, _ = places[row["reality"]]
        ended = {name: row[name] for name in ("duration", "end_reason", "position_error")}
        columns = {
            name: round(value, 6)
            for name, value in measure_activity(done[place], flight.command)._asdict().items()
        }
        levels_at_start = {
            "variant": variant.name,
            "control": variant.control,
            "policy": int(row["policy"]),
            "reality": reality,
            "drone": number,
        }
        rows.append({**levels_at_start, "trial": row["trial"], **ended, **columns})
    return polars.DataFrame(rows)


def main(arguments: Sequence[str] | None = None) -> None:
    """Trains, flies, writes, prints and draws."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        help="folder for policies, flights.csv and ablations.svg",
    )
    parser.add_argument(
        "--drone",
        default="crazyflie",
        help="drone to train around: a name or a TOML file (crazyflie)",
    )
    elsewhere = (
        "where to fly beside the drone itself, as `maidenflight transfer` takes it; may "
        "be repeated (virtual:7)"
    )
    parser.add_argument("--reality", action="append", help=elsewhere)
    parser.add_argument(
        "--control",
        action="append",
        choices=list(QUICK),
        help="a control structure; may be repeated (both)",
    )
    parser.add_argument(
        "--method", choices=METHODS, default="gradient", help="of training (gradient)"
    )
    parser.add_argument(
        "--seeds", type=int, default=5, help="policies of each variant (default: 5)"
    )
    parser.add_argument(
        "--trials", type=int, default=3, help="flights of each policy and drone (default: 3)"
    )
    parser.add_argument(
        "--draws", type=int, default=8, help="drones with other parts, of each kind (default: 8)"
    )
    parser.add_argument(
        "--duration",
        type=float,
        default=MAX_DURATION_S,
        help="longest flight, seconds (default: %(default)g)",
    )
    parser.add_argument("--updates", type=int, help="of training, for both control structures")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    if min(options.seeds, options.trials, options.draws) < 1 or options.seeds < 2:
        parser.error("--seeds must be at least 2, --trials and --draws at least 1.")
    try:
        run(options)
    except InputError as error:
        parser.error(str(error))


def run(options: argparse.Namespace) -> None:
    """All of it, for given arguments."""
    nominal = parameters.read_drone(options.drone)
    home = VirtualDrone(ITSELF, replace(nominal, time_step=np.float32(0.001)))
    realities = {
        one.name: [one]
        for one in [home, *(find_reality(name) for name in options.reality or ["virtual:7"])]
    }
    others = other_drones(home.parameters, options.drone, options.draws, options.seed)
    inputs = [options.drone] if Path(options.drone).is_file() else []
    settings_of_run = {
        "drone": Path(options.drone).stem,
        "policies": options.seeds,
        "randomization": RANDOMIZATION,
    }

    def record(settings: Mapping[str, Any]) -> dict[str, Any]:
        return results.record(
            seed=options.seed, inputs=inputs, settings={**settings_of_run, **settings}
        )

    chosen = choose_variants(options.control or tuple(QUICK), options.method)
    settings = {one: choose_settings(one, options.method, options.updates) for one in chosen}
    record_of_file = {one: record({**one._asdict(), **recorded(settings[one])}) for one in chosen}
    flying: dict[str, Any] = {
        name: getattr(options, name) for name in ("trials", "draws", "duration")
    }
    flying |= {"realities": list(realities), "others": list(others)}
    tables = []
    with terminal.Bar("ablations") as bar:
        for number, one in enumerate(chosen):
            bar.move(number, len(chosen), f"{one.control}, {one.name}")
            path, wanted = (
                options.output / "flights" / f"{one.folder}.csv",
                record({**record_of_file[one]["settings"], **flying}),
            )
            if not path.exists():
                policies = train_variant(
                    one,
                    nominal,
                    settings[one],
                    options.seeds,
                    record_of_file[one],
                    options.output / "policies",
                )
                rows = polars.concat(_all_flights(one, policies, realities, others, options))
                results.write(path, results.table_text(_FLIGHTS, wanted, rows.write_csv()))
            tables.append(read_flights(path, wanted))
    flights = polars.concat(tables)
    everything = record({**flying, "variants": [record_of_file[one]["settings"] for one in chosen]})
    text = results.table_text(_FLIGHTS, everything, flights.write_csv())
    results.write(options.output / "flights.csv", text)
    content = find_effects(flights)
    results.write(
        options.output / "ablations.svg",
        picture.svg(draw_chart(content, Path(options.drone).stem), note=NOTE),
    )
    with polars.Config(
        tbl_cols=-1,
        tbl_rows=-1,
        tbl_width_chars=300,
        fmt_str_lengths=60,
        tbl_hide_column_data_types=True,
        tbl_hide_dataframe_shape=True,
    ):
        print(summarize(content))
    if POSTERIOR not in others:
        print(
            f"{options.drone} has no posterior: give the file of an identified drone to fly on "
            "what its logs leave possible."
        )


def _all_flights(
    one: Variant,
    policies: Sequence[Policy],
    realities: Mapping[str, Sequence[VirtualDrone]],
    others: Mapping[str, Sequence[Parameters]],
    options: argparse.Namespace,
) -> Iterator[polars.DataFrame]:
    key = jax.random.key(options.seed)
    yield fly_variant(
        one,
        policies,
        realities,
        options.trials,
        options.duration,
        jax.random.fold_in(key, number_name("realities")),
    )
    if one.name == BASELINE:
        for name, drones in others.items():
            group = {
                name: [
                    VirtualDrone(f"{name}, {number}", drone)
                    for number, drone in enumerate(drones, 1)
                ]
            }
            yield fly_variant(
                one,
                policies,
                group,
                options.trials,
                options.duration,
                jax.random.fold_in(key, number_name(name)),
            )


def read_flights(path: Path, expected_record: Mapping[str, Any]) -> polars.DataFrame:
    """The table that a run with these settings wrote.

    Raises:
        InputError: it is of other settings, or no such table.
    """
    text = path.read_text(encoding="utf-8")
    head = [line.removeprefix("# record: ") for line in text.splitlines()[:2]]
    try:
        content = json.loads(head[-1]) if head else None
    except ValueError as error:
        raise InputError(
            f"{path}: not a table of this script ({error}). Choose another folder with -o."
        ) from error
    _check_same(content, expected_record, path)
    return polars.read_csv(io.StringIO(text), comment_prefix="#")


_FLIGHTS = (
    "# maidenflight ablations 1: simulated, a row a flight; duration s, position_error m, beyond "
    "= share of actions with |a| > 1,"
    " change = mean |u_t - u_(t-1)| a control period, at_limits = share of motor commands at 0 or 1"
)

if __name__ == "__main__":
    compiler.prepare_jax()
    main()
