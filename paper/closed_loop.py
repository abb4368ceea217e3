"""Flight times of the authors' policies by drones from the likelihood and from the closed loop.

Identifies the drone from the authors' flights by likelihood, then its closed loop from the flights
and policies of two thirds of the PWM policies, and predicts the flight times of all 72: blind, and
with one flight of the policy whose number is next as a log of the day. The others, a third of each
control structure, took no part in any choice.

    python paper/closed_loop.py --authors ../shared/data/authors -o closed_loop

With logs of other Crazyflies it also says how well both drones predict these: by the likelihood of
a row, and by the rotor speeds where they were measured.

    ... --elsewhere ../shared/data/nanobench --elsewhere ../shared/data/usd/brushed

Source of flights and policies: Gronauer et al. 2022, github SvenGronauer/phoenix-drone-simulation.
"""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import numpy as np
import polars
from agreement import agreement
from jax import tree
from jaxtyping import Float
from predict_flights import one_against_others, published, within_band
from scipy.ndimage import uniform_filter1d

from maidenflight import compiler, policy_file, results
from maidenflight.errors import InputError
from maidenflight.experiments.drones import possible_drones
from maidenflight.experiments.flight_times import predict_flight_times, summary
from maidenflight.flights.log import Flight
from maidenflight.flights.reading import read_flights
from maidenflight.flights.rotors import rotors
from maidenflight.flights.windows import windows
from maidenflight.identification.likelihood import one_step
from maidenflight.identification.outcome.ensembles import BETWEEN_FLIGHTS
from maidenflight.identification.signals.flight_signals import stride
from maidenflight.names import TRIMS
from maidenflight.parameters import Parameters, replace
from maidenflight.policy import Policy
from maidenflight.verbs.identify import Identify
from maidenflight.verbs.match import Match

TODAY = "closed loop, log of the day"
STRUCTURES = ("pwm", "attitude_rate", "attitude", "all")
SEEDS = 2
STEP_S = 0.002
"""Of the simulation by which flights elsewhere are predicted, about [s]."""


def held_out(names: Sequence[str]) -> set[str]:
    """Every third policy of each control structure, by number."""
    found: set[str] = set()
    for structure in STRUCTURES[:-1]:
        own = [name for name in names if name.startswith(f"{structure}/")]
        found |= set(sorted(own, key=lambda name: int(name.split("/")[1]))[2::3])
    return found


def flights_of(authors: Path, name: str) -> Path:
    """Folder of the flights of a policy."""
    structure, number = name.split("/")
    return authors / "flights" / structure / f"policy_{int(number):03d}"


def identified(authors: Path, folder: Path, policies: Mapping[str, Policy]) -> dict[str, Path]:
    """Drone files by how they were found, made unless they are there."""
    flights = authors / "flights"
    dynamics, chosen = folder / "dynamics.toml", folder / "policies"
    if not dynamics.exists():
        Identify(logs=flights / "pwm", commands="zero-order-hold").run(dynamics)
    for name in sorted(set(policies) - held_out(list(policies))):
        structure, number = name.split("/")
        if structure == "pwm":
            made = results.record(seed=0, inputs=[], settings={"published": name})
            policy_file.write_policy(chosen / f"pwm_{int(number):03d}.json", policies[name], made)
    varied, matched = folder / "likelihood.toml", folder / "closed_loop.toml"
    if not varied.exists():
        Identify(logs=flights, start=str(dynamics), over=tuple(BETWEEN_FLIGHTS)).run(varied)
    if not matched.exists():
        matching = Match(logs=flights / "pwm", policies=(str(chosen),), start=str(varied))
        matching.run(matched)
    return {"likelihood": varied, "closed loop": matched}


def todays_log(authors: Path, names: Sequence[str], name: str) -> Path | None:
    """One flight of the policy of the same structure whose number is nearest, of those that tell.

    Of a flight of less than 1.5 s a trim is not known well enough.
    """
    structure, number = name.split("/")
    others = [one for one in names if one.startswith(f"{structure}/") and one != name]
    for other in sorted(others, key=lambda one: abs(int(one.split("/")[1]) - int(number))):
        for file in sorted(flights_of(authors, other).glob("*.csv*")):
            try:
                flights = read_flights(file, lead_in=0)
            except InputError:
                continue
            if sum(flight.duration for flight in flights) >= 1.5:
                return file
    return None


def predicted(
    policies: Mapping[str, Policy], drones: Parameters | Mapping[str, Parameters], trials: int
) -> polars.DataFrame:
    """Mean and band of the flight times of each policy, of all seeds together."""
    parts = []
    for seed in range(SEEDS):
        key = jax.random.key(seed)
        each = (
            [({name: policies[name]}, drones[name]) for name in policies]
            if isinstance(drones, Mapping)
            else [(dict(policies), drones)]
        )
        for some, drone in each:
            parts.append(
                predict_flight_times(
                    list(some.values()), drone, key, trials=trials, names=list(some)
                ).with_columns(polars.col("trial") + seed * trials)
            )
    return summary(polars.concat(parts).sort("policy", "trial"))


def agreements(
    label: str, told: polars.DataFrame, flights: polars.DataFrame
) -> list[dict[str, object]]:
    """Rows of the table: by control structure, of all policies and of those held out."""
    real = flights.group_by("name").agg(polars.col("flight_time_s").mean().alias("measured"))
    joined = told.join(real, left_on="policy", right_on="name")
    out = held_out(joined["policy"].to_list())
    rows: list[dict[str, object]] = []
    for structure in STRUCTURES:
        for which in ("all", "held out"):
            named = [
                name
                for name in joined["policy"]
                if structure in ("all", name.split("/")[0]) and (which == "all" or name in out)
            ]
            own = joined.filter(polars.col("policy").is_in(named))
            found = agreement(own["mean"].to_numpy(), own["measured"].to_numpy())
            real_ones = flights.filter(polars.col("name").is_in(named))
            floor = one_against_others(real_ones)
            rows.append(
                {
                    "drone": label,
                    "control": structure,
                    "policies": f"{len(named)} {which}",
                    "predicted [s]": own["mean"].mean(),
                    "measured [s]": own["measured"].mean(),
                    "Spearman": found.spearman,
                    "error [s]": found.mean_absolute_error,
                    "within 10 to 90 %": within_band(own, real_ones),
                    "one real flight: Spearman": floor.spearman,
                    "one real flight: error [s]": floor.mean_absolute_error,
                }
            )
    return rows


def elsewhere(folder: Path, drones: Mapping[str, Parameters]) -> list[dict[str, object]]:
    """How well drones predict the flights of another one of the same make.

    Each with the thrust that carries that drone: its weight is its own.

    Args:
        folder: its logs.
        drones: by name.
    """
    flights = list(read_flights(folder).flights)
    every, period = stride(flights[0]), flights[0].period
    parts = windows(flights, one_step.LENGTH, one_step.LENGTH, stride=every)
    target = one_step.OneStep(parts, period, max(1, round(period / STEP_S)), every)
    rows: list[dict[str, object]] = []
    for name, drone in drones.items():
        drone = replace(drone, thrust_to_weight=np.float32(target.hovering(drone)[0]))
        told = [shown for flight in flights if (shown := speed_told(flight, drone)) is not None]
        rows.append(
            {
                "flights": folder.name,
                "drone": name,
                "k_F": round(float(drone.thrust_to_weight), 3),
                "nats a row": round(-target(drone), 3),
                "measured rotor speed, explained": np.round(told, 3).tolist(),
            }
        )
    return rows


def speed_told(flight: Flight, drone: Parameters) -> float | None:
    """Share of the measured rotor speed's variance that the drone's motors explain.

    Given the flight's commands, without what changes slower than in a second. None where no speed
    was measured.
    """
    if flight.rotor_speed is None or not np.isfinite(flight.rotor_speed).all():
        return None
    told, measured = _fast(rotors(flight, drone).speed, flight), _fast(flight.rotor_speed, flight)
    left = measured - np.sum(told * measured) / np.sum(told**2) * told
    return float(1.0 - np.sum(left**2) / np.sum(measured**2))


def _fast(values: Float[np.ndarray, "N 4"], flight: Flight) -> Float[np.ndarray, "M 4"]:
    """Values less their mean over a second about each row, without the first and last second."""
    second = round(1.0 / flight.period)
    return (values - uniform_filter1d(values, second, axis=0))[second:-second]


def main(arguments: Sequence[str] | None = None) -> None:
    """Identifies, predicts and prints."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--authors", type=Path, required=True)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--trials", type=int, default=32, help="flights of each policy and seed")
    parser.add_argument(
        "--elsewhere", type=Path, action="append", default=[], help="logs of another Crazyflie"
    )
    given = parser.parse_args(arguments)
    policies, flights = published(given.authors)
    files = identified(given.authors, given.output, policies)
    rows: list[dict[str, object]] = []
    blind = {
        label: possible_drones(files[label], TRIMS, 0) for label in ("likelihood", "closed loop")
    }
    for label, drones in blind.items():
        rows += agreements(label, predicted(policies, drones, given.trials), flights)
    logs = {name: todays_log(given.authors, list(policies), name) for name in policies}
    own = {
        name: possible_drones(files["closed loop"], TRIMS, 0, today=log)
        for name, log in logs.items()
    }
    rows += agreements(TODAY, predicted(policies, own, given.trials), flights)
    table = polars.DataFrame(rows)
    points = {
        label: tree.map(lambda leaf: np.asarray(leaf).mean(axis=0).astype(np.float32), drones)
        for label, drones in blind.items()
    }
    others = [row for folder in given.elsewhere for row in elsewhere(folder, points)]
    with polars.Config(tbl_rows=-1, tbl_cols=-1, tbl_width_chars=220, float_precision=2):
        print(table)
        for row in others:
            print(", ".join(f"{name}: {value}" for name, value in row.items()))
    made = results.record(seed=0, inputs=list(files.values()), settings={"trials": given.trials})
    text = table.write_csv(float_precision=4)
    results.write_table(given.output / "closed_loop.csv", "maidenflight closed loop 1", made, text)


if __name__ == "__main__":
    compiler.prepare_jax()
    main()
