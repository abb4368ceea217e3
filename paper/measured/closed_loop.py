r"""Flight times of the authors' policies by drones that their own flights had no part in.

Policies are dealt into five outer folds (`fold_of`). For each, the whole recipe runs with the
flights and policies of the other four: the likelihood of the dynamics, trims and how they differ,
the closed loop. Its drone then predicts the policies of the fold: the outer score, by which choices
count. The inner score is that of the drone of all flights, which predicts all policies; both also
with one flight of the policy whose number is next as a log of the day. Drones lie in the output
folder, those of a fold in one of their own, and are not made again.

    python paper/measured/closed_loop.py --authors ../shared/data/authors -o closed_loop \
        --folds 0 1 2 3 4

Without `--folds` only the inner score. With logs of other Crazyflies it says how well the drones of
all flights predict these: by the likelihood of a row, and by the rotor speeds where they were
measured.

    ... --elsewhere ../shared/data/nanobench --elsewhere ../shared/data/usd/brushed

Source of flights and policies: Gronauer et al. 2022, github SvenGronauer/phoenix-drone-simulation.
"""

import argparse
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import numpy as np
import polars
from agreement import CONDITIONS, GRONAUER_2021, agreement
from jax import tree
from jaxtyping import Float
from predict_flights import one_against_others, read_published, within_band
from scipy.ndimage import uniform_filter1d

from maidenflight import compiler, policy_file, results
from maidenflight.errors import InputError
from maidenflight.experiments.drones import possible_drones
from maidenflight.experiments.flight_times import (
    UNSURE,
    outlives,
    predict_flight_times,
    summary,
)
from maidenflight.flights.log import Flight
from maidenflight.flights.reading import read_flights
from maidenflight.flights.trims import rotors
from maidenflight.flights.windows import windows
from maidenflight.identification.likelihood import one_step
from maidenflight.identification.likelihood.observation import BY_MOMENT
from maidenflight.identification.outcome.plausible import HOVERING
from maidenflight.identification.signals.flight_signals import stride
from maidenflight.names import TRIMS
from maidenflight.parameters import Parameters, replace
from maidenflight.policy import Policy
from maidenflight.verbs.identify import Identify
from maidenflight.verbs.match import Match

TODAY = "closed loop, log of the day"
STRUCTURES = ("pwm", "attitude_rate", "attitude", "all")
FOLDS = 5
WHOLE = -1
"""The fold of no policy: its drone is made of all flights."""
STEP_S = 0.002
"""Of the simulation by which flights elsewhere are predicted, about [s]."""


def fold_of(names: Sequence[str]) -> dict[str, int]:
    """The outer fold of each policy "control/number", dealt once and for all.

    Blocks are of two neighbours by number, which were trained alike; blocks of a control structure
    go to the folds in turn, those of attitude control from the third on.
    """
    fold = {}
    for structure, first in zip(STRUCTURES[:-1], (0, 0, 2), strict=True):
        own = [name for name in names if name.startswith(f"{structure}/")]
        own.sort(key=lambda name: int(name.split("/")[1]))
        fold |= {name: (place // 2 + first) % FOLDS for place, name in enumerate(own)}
    return fold


def flights_of(authors: Path, name: str) -> Path:
    """Folder of the flights of a policy."""
    structure, number = name.split("/")
    return authors / "flights" / structure / f"policy_{int(number):03d}"


def identify_drones(authors: Path, folder: Path, policies: Mapping[str, Policy]) -> dict[str, Path]:
    """Drone files by how they were made, of the flights of these policies alone.

    Args:
        authors: folder of all flights.
        folder: for the files; those that are there are not made again.
        policies: by name.
    """
    flights, chosen = folder / "flights", folder / "policies"
    for name in policies:
        copy = flights_of(folder, name)
        if not copy.exists():
            shutil.copytree(flights_of(authors, name), copy)
        structure, number = name.split("/")
        if structure == "pwm":
            record = results.record(seed=0, inputs=[], settings={"published": name})
            policy_file.write_policy(chosen / f"pwm_{int(number):03d}.json", policies[name], record)
    dynamics, varied, matched = (
        folder / f"{name}.toml" for name in ("dynamics", "likelihood", "closed_loop")
    )
    if not dynamics.exists():
        Identify(logs=flights / "pwm", commands="zero-order-hold").run(dynamics)
    if not varied.exists():
        Identify(logs=flights, start=str(dynamics), over=(*BY_MOMENT, HOVERING)).run(varied)
    if not matched.exists():
        how = {"start": str(varied), "conditions": CONDITIONS}
        Match(logs=flights, policies=(str(chosen),), **how).run(matched)
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


def predict(
    policies: Mapping[str, Policy], drones: Mapping[str, Parameters], trials: int, seed: int
) -> polars.DataFrame:
    """Predicted flights of each policy on its drone."""
    parts = []
    for drone in {id(one): one for one in drones.values()}.values():
        own = {name: policy for name, policy in policies.items() if drones[name] is drone}
        key = jax.random.key(seed)
        parts.append(
            predict_flight_times(
                *(list(own.values()), drone, key),
                trials=trials,
                names=list(own),
                conditions=GRONAUER_2021,
            )
        )
    return polars.concat(parts).with_columns(seed=seed)


def agreements(
    labels: Mapping[str, object], predictions: polars.DataFrame, flights: polars.DataFrame
) -> list[dict[str, object]]:
    """Rows of the table, by control structure, with standard errors over seeds.

    Args:
        labels: further columns.
        predictions: of `predict`, of one seed or several; their bands are of all together.
        flights: the real ones.
    """
    real = flights.group_by("name").agg(polars.col("flight_time_s").mean().alias("measured"))
    rows: list[dict[str, object]] = []
    for structure in [one for one in STRUCTURES if one in ("all", *predictions["control"])]:
        own = predictions if structure == "all" else predictions.filter(control=structure)
        seeds = [
            agreement(joined["mean"].to_numpy(), joined["measured"].to_numpy())
            for one in own.partition_by("seed")
            for joined in [summary(one).join(real, left_on="policy", right_on="name")]
        ]
        errors = [one.mean_absolute_error for one in seeds]
        together = summary(own.sort("policy", "seed", "trial"))
        real_ones = flights.filter(polars.col("name").is_in(together["policy"].to_list()))
        floor = one_against_others(real_ones)
        sure = np.std(errors, ddof=1) / np.sqrt(len(errors)) if len(errors) > 1 else np.nan
        rows.append(
            {
                **labels,
                "control": structure,
                "policies": together.height,
                "predicted [s]": together["mean"].mean(),
                "measured [s]": real_ones["flight_time_s"].mean(),
                "Spearman": np.mean([one.spearman for one in seeds]),
                "error [s]": np.mean(errors),
                "+- [s]": sure,
                "within 10 to 90 %": within_band(together, real_ones),
                "pairs: said, right": pairs(own, real_ones),
                "one real flight: Spearman": floor.spearman,
                "one real flight: error [s]": floor.mean_absolute_error,
            }
        )
    return rows


def pairs(predictions: polars.DataFrame, flights: polars.DataFrame) -> str:
    """Of two policies: which share `outlives` tells apart, and how often the real flights agree."""
    chances, names = (
        outlives(predictions),
        predictions["policy"].unique(maintain_order=True).to_list(),
    )
    durations = flights.select("name", duration="flight_time_s").rename({"name": "policy"})
    real = outlives(polars.concat([durations.filter(policy=name) for name in names]))
    sure = chances > 1.0 - UNSURE
    count = len(names) * (len(names) - 1) / 2
    return f"{sure.sum() / count:.0%}, {real[sure].mean():.0%}"


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
        predictions = [
            slope for flight in flights if (slope := speed_told(flight, drone)) is not None
        ]
        rows.append(
            {
                "flights": folder.name,
                "drone": name,
                "k_F": round(float(drone.thrust_to_weight), 3),
                "nats a row": round(-target(drone), 3),
                "measured rotor speed, explained": np.round(predictions, 3).tolist(),
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
    simulated_speed, measured = (
        _fast(rotors(flight, drone).speed, flight),
        _fast(flight.rotor_speed, flight),
    )
    left = (
        measured - np.sum(simulated_speed * measured) / np.sum(simulated_speed**2) * simulated_speed
    )
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
    parser.add_argument("--seeds", type=int, default=4, help="of the predictions")
    parser.add_argument("--folds", type=int, nargs="*", default=(), help="outer folds to run")
    parser.add_argument(
        "--elsewhere", type=Path, action="append", default=[], help="logs of another Crazyflie"
    )
    options = parser.parse_args(arguments)
    policies, flights = read_published(options.authors)
    fold = fold_of(list(policies))
    rows: list[dict[str, object]] = []
    files: dict[int, dict[str, Path]] = {}
    possible: dict[tuple[str, int], Parameters] = {}
    for number in [*options.folds, WHOLE]:
        inner = {name: policy for name, policy in policies.items() if fold[name] != number}
        place = options.output if number == WHOLE else options.output / f"fold_{number}"
        files[number] = identify_drones(options.authors, place, inner)
        for label, file in files[number].items():
            possible[label, number] = possible_drones(file, TRIMS, 0)

    def add(label: str, part: str, drones: Mapping[str, Parameters]) -> None:
        some = {name: policies[name] for name in drones}
        predictions = [predict(some, drones, options.trials, seed) for seed in range(options.seeds)]
        rows.extend(agreements({"drone": label, "of": part}, polars.concat(predictions), flights))

    for label in ("likelihood", "closed loop"):
        outer = {name: possible[label, one] for name, one in fold.items() if one in options.folds}
        if outer:
            add(label, "outer", outer)
        add(label, "inner", dict.fromkeys(policies, possible[label, WHOLE]))
    logs = {name: todays_log(options.authors, list(policies), name) for name in policies}
    for part in ("outer", "inner"):
        use = {name: one if part == "outer" else WHOLE for name, one in fold.items()}
        own = {
            name: possible_drones(files[use[name]]["closed loop"], TRIMS, 0, today=log)
            for name, log in logs.items()
            if use[name] in files
        }
        if own:
            add(TODAY, part, own)
    points = {
        label: tree.map(
            lambda leaf: np.asarray(leaf).mean(axis=0).astype(np.float32), possible[label, WHOLE]
        )
        for label in files[WHOLE]
    }
    for folder in options.elsewhere:
        for row in elsewhere(folder, points):
            print(", ".join(f"{name}: {value}" for name, value in row.items()))
    table = polars.DataFrame(rows)
    with polars.Config(tbl_rows=-1, tbl_cols=-1, tbl_width_chars=220, float_precision=2):
        print(table)
    record = results.record(
        seed=0,
        inputs=[file for own in files.values() for file in own.values()],
        settings={"trials": options.trials, "seeds": options.seeds},
    )
    text = table.write_csv(float_precision=4)
    text = results.table_text("maidenflight closed loop 2", record, text)
    results.write(options.output / "closed_loop.csv", text)


if __name__ == "__main__":
    compiler.prepare_jax()
    main()
