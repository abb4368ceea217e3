"""What the yaw trim of the day does to the flight times of the authors' policies.

`python paper/yaw_trim.py --authors ../shared/data/authors --drone drone.toml` measures in the
published logs the mean yaw command of each policy of a control structure, turns it into the
constant torque that it balances on the given drone, and flies every policy in simulation twice: on
the drone as it is, and on the drone with the policy's own yaw trim. It prints a row a policy and
how both predictions agree with the measured mean flight times, beside how one real flight agrees
with the others of its policy. `--json` prints one object instead.

A policy's trim comes from the flights whose times it shall explain, so this is an explanation, not
a prediction: no drone is judged by it.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import numpy as np
import polars
from agreement import GRONAUER_2021, agreement
from jaxtyping import Float
from predict_flights import one_against_others, read_published

from maidenflight import compiler, parameters
from maidenflight.errors import InputError
from maidenflight.experiments.flight_times import predict_flight_times, summary
from maidenflight.flights import tables
from maidenflight.integrations.logs import authors
from maidenflight.parameters import Parameters
from maidenflight.policy import Policy
from maidenflight.simulator.controllers.interface import CONTROLS
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.physics.battery import COUNTS
from maidenflight.simulator.physics.geometry import TORQUES

BEGIN = 0.5
"""Time after which a flight counts [s]: before it the PID hands over and the yaw rate settles."""
YAW = TORQUES[:, 2] / 4
"""The yaw part of the commands of rotors 1 to 4."""


def mean_command(files: Sequence[Path]) -> Float[np.ndarray, "4"] | None:
    """Mean command u of the four motors over a policy's flights, without their first 0.5 s.

    All rows count: motors that a policy turns off for a moment make no torque then. `read_flights`
    would leave those rows out.

    Args:
        files: the authors' logs, a flight each.

    Returns:
        Nothing if no flight lasts longer.

    Raises:
        InputError: a file is damaged or not one of the authors' logs.
    """
    all_commands = [np.zeros((0, 4))]
    for file in files:
        parts, _ = authors.flights(tables.read(file, f"{file.parent.name}/{file.name}"))
        commands = np.concatenate([flight.command for flight, _ in parts])[
            round(BEGIN / authors.PERIOD) :
        ]
        all_commands.append(commands[np.isfinite(commands).all(axis=1)])
    rows = np.concatenate(all_commands)
    return rows.mean(axis=0, dtype=np.float64) if len(rows) else None


def mean_commands(folder: Path, names: Sequence[str]) -> dict[str, Float[np.ndarray, "4"]]:
    """Mean command of each policy by its name "control/number".

    Policies whose flights all end within 0.5 s are left out.

    Args:
        folder: has the logs of policy attitude_rate/7 in `flights/attitude_rate/policy_007`.
        names: of policies.

    Raises:
        InputError: see `mean_command`; or no logs at all.
    """
    commands = {}
    for name in names:
        control, number = name.split("/")
        files = sorted((folder / "flights" / control / f"policy_{int(number):03d}").glob("*.csv*"))
        command = mean_command(files)
        if command is not None:
            commands[name] = command
    if not commands:
        raise InputError(
            f"{folder / 'flights'}: no logs of {BEGIN} s of these {len(names)} policies. Give the "
            "folder of the authors' data."
        )
    return commands


def balanced_torque(command: Float[np.ndarray, "4"], drone: Parameters) -> float:
    """Constant yaw torque [N m] that a held command balances: minus what the motors make at it.

    Where the thrust curve is quadratic, as in the paper's model, that is -k_M1 k_F m g times the
    yaw command (-u1 + u2 - u3 + u4) / 4.

    Source: `dynamics.rotor_forces` and `dynamics.torque` (Gronauer et al. 2022, eq:motor-force and
    eq:motor-torque), nu = sqrt(u).
    """
    forces = dynamics.rotor_forces(np.sqrt(command), drone)  # type: ignore[arg-type]
    return -float(dynamics.torque(forces, drone)[2])


def fly(
    policies: Mapping[str, Policy],
    drone: Parameters,
    trims: Mapping[str, float],
    seed: int,
    trials: int,
) -> polars.DataFrame:
    """Predicted mean flight times [s]: policy, as_it_is, own_trim."""
    key, names = jax.random.key(seed), list(policies)
    how = {"trials": trials, "conditions": GRONAUER_2021}
    as_it_is = predict_flight_times(list(policies.values()), drone, key, names=names, **how)
    # The program is compiled once: another drone is another number to it.
    own = [
        predict_flight_times(
            [policy],
            parameters.replace(drone, torque_bias_z=np.float32(trims[name])),
            key,
            names=[name],
            **how,
        )
        for name, policy in policies.items()
    ]
    columns = (("as_it_is", as_it_is), ("own_trim", polars.concat(own)))
    first, second = (
        summary(prediction).select("policy", polars.col("mean").alias(column))
        for column, prediction in columns
    )
    return first.join(second, on="policy", maintain_order="left")


def agreements(compared: polars.DataFrame, flights: polars.DataFrame) -> polars.DataFrame:
    """How well both predictions, and one real flight, tell the measured mean flight times."""
    measured = compared["measured"].to_numpy()
    values = {
        name: agreement(compared[name].to_numpy(), measured) for name in ("as_it_is", "own_trim")
    }
    values["one real flight against the others"] = one_against_others(flights)
    rows = [
        {
            "prediction": name,
            "Spearman": one.spearman,
            "Pearson": one.pearson,
            "error [s]": one.mean_absolute_error,
        }
        for name, one in values.items()
    ]
    return polars.DataFrame(rows)


def main(arguments: Sequence[str] | None = None) -> None:
    """Reads, flies and prints."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--authors",
        type=Path,
        required=True,
        help="folder with policies.npz, flights.csv and flights/",
    )
    parser.add_argument(
        "--drone",
        default="crazyflie",
        help="TOML file of a drone, or its name (default: crazyflie)",
    )
    parser.add_argument(
        "--control",
        choices=[*CONTROLS, "all"],
        default="attitude_rate",
        help="whose policies (default: attitude_rate)",
    )
    parser.add_argument(
        "--trials", type=int, default=16, help="flights of each policy (default: 16)"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--json",
        action="store_true",
        help="print one JSON object: a row a policy, and the agreement",
    )
    options = parser.parse_args(arguments)
    try:
        policies, flights = read_published(options.authors)
        drone = parameters.read_drone(options.drone)
        chosen_policies = {
            name: policy
            for name, policy in policies.items()
            if options.control in (policy.interface.name, "all")
        }
        commands = mean_commands(options.authors, list(chosen_policies))
        flights = flights.filter(polars.col("name").is_in(list(chosen_policies)))
        # Flights too short to tell a trim are flown on the drone as it is.
        own = float(parameters.component(drone, "torque_bias_z"))
        trims = {
            name: balanced_torque(commands[name], drone) if name in commands else own
            for name in chosen_policies
        }
        measured = (
            flights.group_by("name")
            .agg(polars.col("flight_time_s").mean().alias("measured"))
            .rename({"name": "policy"})
        )
        counts = [
            COUNTS * float(YAW @ commands[name]) if name in commands else None
            for name in chosen_policies
        ]
        table = polars.DataFrame(
            {"policy": list(chosen_policies), "yaw_counts": counts, "trim": list(trims.values())}
        )
        predictions = fly(chosen_policies, drone, trims, options.seed, options.trials)
        compared = table.join(measured, on="policy", maintain_order="left").join(
            predictions, on="policy", maintain_order="left"
        )
        agreed = agreements(compared, flights)
    except InputError as error:
        parser.error(str(error))
    if options.json:
        print(json.dumps({"agreement": agreed.to_dicts(), "policies": compared.to_dicts()}))
        return
    display = compared.select(
        "policy",
        polars.col("measured").alias("measured [s]"),
        polars.col("yaw_counts").round(0).cast(polars.Int32).alias("yaw command [counts]"),
        (1e5 * polars.col("trim")).alias("trim [1e-5 N m]"),
        polars.col("as_it_is").alias("as it is [s]"),
        polars.col("own_trim").alias("own trim [s]"),
    )
    with polars.Config(
        tbl_cols=-1,
        tbl_rows=-1,
        tbl_width_chars=200,
        fmt_str_lengths=50,
        float_precision=2,
        tbl_hide_column_data_types=True,
    ):
        print(
            "The drone's own yaw trim: "
            f"{1e5 * float(parameters.component(drone, 'torque_bias_z')):.2f}e-5 N m"
        )
        print(display)
        print(agreed)


if __name__ == "__main__":
    compiler.prepare_jax()
    main()
