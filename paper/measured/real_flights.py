"""Judges drones by held-out real flights: by their likelihood and by flight times of policies.

Seven of ten policies' flights make the drones, the others' judge them. No flight time is used for
anything but judging.

    python paper/measured/real_flights.py --authors ../shared/data/authors -o real_flights

Source of flights and policies: Gronauer et al. 2022, github SvenGronauer/phoenix-drone-simulation.
"""

import argparse
import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
import polars
from agreement import GRONAUER_2021, agreement
from predict_flights import one_against_others, read_published
from rich.console import Console
from rich.table import Table

import maidenflight as mf
from maidenflight import results
from maidenflight.experiments.flight_times import predict_flight_times, summary
from maidenflight.flights.log import Flight
from maidenflight.flights.reading import read_flights
from maidenflight.flights.windows import windows
from maidenflight.identification.identify import identify
from maidenflight.identification.likelihood import one_step
from maidenflight.identification.likelihood.flight_differences import trim_ensemble
from maidenflight.identification.likelihood.observation import BY_MOMENT
from maidenflight.identification.likelihood.one_step import OneStep
from maidenflight.identification.likelihood.selection import FIRST
from maidenflight.identification.methods import Likelihood, Replay
from maidenflight.identification.outcome.estimates import Identification
from maidenflight.identification.replay.prediction import predict
from maidenflight.parameters import Parameters
from maidenflight.policy import Policy

STRUCTURES = ("pwm", "attitude_rate", "attitude")
PERIOD, STEPS = 0.01, 5
HELD_OUT = 0.3
ONCE = Likelihood(trials=1)
"""Settings of every identification by likelihood here."""
TRAP = (
    *FIRST,
    "inertia_x",
    "inertia_y",
    "rotational_damping",
    "drag_x",
    "drag_y",
    "drag_z",
    "spin_down_ratio",
)
"""Parameters that a replay inflates, because whatever damps hides what it cannot foresee."""


def policy_of(flight: Flight) -> int:
    """The authors' number of the policy that flew."""
    return int(flight.name.split("/")[0].removeprefix("policy_"))


def split(flights: Sequence[Flight], seed: int) -> tuple[list[Flight], list[Flight]]:
    """Flights of seven of ten policies, and of the others."""
    numbers = sorted({policy_of(flight) for flight in flights})
    chosen = np.random.default_rng(seed).permutation(numbers)[: round(HELD_OUT * len(numbers))]
    return [flight for flight in flights if policy_of(flight) not in chosen], [
        flight for flight in flights if policy_of(flight) in chosen
    ]


def one_step_likelihood(
    drones: Mapping[str, Parameters], training: Sequence[Flight], held_out: Sequence[Flight]
) -> dict[str, float]:
    """Log-likelihood per row of held-out flights [nats], noise fitted to training flights."""
    inside, others = (
        OneStep(windows(part, one_step.LENGTH, every=one_step.LENGTH), PERIOD, STEPS)
        for part in (training, held_out)
    )
    return {
        name: -others.per_segment(drone, inside.noise_model(drone)).sum() / others.rows
        for name, drone in drones.items()
    }


def multi_step_likelihood(
    drones: Mapping[str, Parameters],
    training: Sequence[Flight],
    held_out: Sequence[Flight],
    rows: int,
) -> dict[str, float]:
    """Log density of velocity, attitude and body rates some rows ahead.

    Mean and covariance are those of the training flights' errors.
    """
    inside, others = (windows(part, rows) for part in (training, held_out))
    likelihoods = {}
    for name, drone in drones.items():
        wrong = []
        for cut in (inside, others):
            ahead = cut.measured[:, -1] - predict(cut, drone, PERIOD)[:, -1]
            ahead[:, 6:9] = (ahead[:, 6:9] + np.pi) % (2 * np.pi) - np.pi
            wrong.append(ahead[:, 3:].astype(np.float64))
        mean, covariance = wrong[0].mean(axis=0), np.cov(wrong[0].T)
        left = wrong[1] - mean
        square = np.einsum("wi,ij,wj->w", left, np.linalg.inv(covariance), left)
        likelihoods[name] = float(
            -0.5 * (square.mean() + np.linalg.slogdet(2 * np.pi * covariance)[1])
        )
    return likelihoods


def real_controller(identification: Identification) -> Parameters:
    """The drones that `maidenflight predict` flies, with other trims in each flight."""
    if not set(BY_MOMENT) & set(identification.estimates):
        return identification.parameters
    return trim_ensemble(identification.parameters, identification.estimates, "flights").drones


def flight_times(
    drones: Mapping[str, Parameters],
    policies: Mapping[str, Policy],
    flights: polars.DataFrame,
    seed: int,
) -> list[dict]:
    """Agreement of predicted and real mean flight times, by control structure and together.

    Last, that of one real flight.
    """
    names = list(policies)
    real = dict(flights.group_by("name").agg(polars.col("flight_time_s").mean()).iter_rows())
    measured = np.array([real[name] for name in names])
    durations = {
        drone: summary(
            predict_flight_times(
                *(list(policies.values()), parameters, jax.random.key(seed)),
                names=names,
                conditions=GRONAUER_2021,
            )
        )["mean"].to_numpy()
        for drone, parameters in drones.items()
    }
    rows = []
    for kind in (*STRUCTURES, "all"):
        chosen = np.array([kind == "all" or name.startswith(f"{kind}/") for name in names])
        own = flights.filter(
            polars.col("name").is_in([name for name, one in zip(names, chosen, strict=True) if one])
        )
        agreements = {
            drone: agreement(mean[chosen], measured[chosen]) for drone, mean in durations.items()
        }
        means = {drone: float(mean[chosen].mean()) for drone, mean in durations.items()}
        (
            agreements["one real flight against the others"],
            means["one real flight against the others"],
        ) = (
            one_against_others(own),
            float("nan"),
        )
        for drone, one in agreements.items():
            labels = {
                "spearman": one.spearman,
                "pearson": one.pearson,
                "mean absolute error": one.mean_absolute_error,
            }
            rows.append(
                {
                    "control": kind,
                    "policies": int(chosen.sum()),
                    "drone": drone,
                    **labels,
                    "predicted mean": means[drone],
                }
            )
        rows[-1]["predicted mean"] = float(measured[chosen].mean())
    return rows


def show(title: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """Prints a table; returns it as Markdown."""
    heads = list(rows[0])
    cells = [
        [f"{value:.3g}" if isinstance(value, float) else str(value) for value in row.values()]
        for row in rows
    ]
    table = Table(*heads, title=title, title_justify="left")
    for row in cells:
        table.add_row(*row)
    Console(width=200).print(table)
    lines = [
        f"**{title}**",
        "",
        "| " + " | ".join(heads) + " |",
        "|" + "---|" * len(heads),
        *("| " + " | ".join(row) + " |" for row in cells),
    ]
    return "\n".join(lines)


def parameter_rows(identifications: Mapping[str, Identification]) -> list[dict[str, str]]:
    """A row a parameter: value and 95 % interval in each identification."""
    names = dict.fromkeys(name for one in identifications.values() for name in one.estimates)
    rows = []
    for name in names:
        row = {"parameter": name}
        for title, one in identifications.items():
            estimate = one.estimates.get(name)
            row[title] = (
                ""
                if estimate is None
                else f"{estimate.value:.4g} [{estimate.interval[0]:.4g}, "
                f"{estimate.interval[1]:.4g}]"
            )
        rows.append(row)
    return rows


def compare_likelihoods(
    drones: Mapping[str, Parameters], training: Sequence[Flight], held_out: Sequence[Flight]
) -> list[dict[str, Any]]:
    """Returns a row a drone: log-likelihood of held-out flights, a row and a window."""
    ones = one_step_likelihood(drones, training, held_out)
    many = {rows: multi_step_likelihood(drones, training, held_out, rows) for rows in (10, 25, 50)}
    return [
        {
            "drone": name,
            "one step": ones[name],
            **{f"{rows * 10} ms": many[rows][name] for rows in many},
        }
        for name in drones
    ]


def nanobench(folder: Path, seed: int) -> list[str]:
    """The same tables, without flight times, of NanoBench's PID flights.

    Two of three files identify the drones, the third judges.
    """
    flights = list(read_flights(folder))
    files = sorted({flight.name.split(" ")[0] for flight in flights})
    judging = set(files[2::3])
    training, held_out = (
        [flight for flight in flights if (flight.name.split(" ")[0] in judging) == others]
        for others in (False, True)
    )
    key = jax.random.key(seed)
    wide = {
        "thrust_to_weight": (1.01, 2.5),
        "motor_time_constant": (0.01, 0.5),
        "latency": (0.0, 0.05),
    }
    identifications = {
        "chosen by likelihood": identify(training, ONCE, key=key),
        "three by replay": identify(training, Replay(), key=key, bounds=wide),
    }
    drones = {
        **{name: one.parameters for name, one in identifications.items()},
        "paper": mf.crazyflie(),
    }
    return [
        show("NanoBench: drones", parameter_rows(identifications)),
        show(
            f"NanoBench: log likelihood of {len(held_out)} held-out pieces of flight [nats a row "
            "or window]",
            compare_likelihoods(drones, training, held_out),
        ),
        show("NanoBench: open loop, held out [m, m/s, deg, rad/s]", open_loop(held_out, drones)),
    ]


def open_loop(flights: Sequence[Flight], drones: Mapping[str, Parameters]) -> list[dict[str, Any]]:
    """Errors of open-loop predictions, by horizon."""
    errors = mf.prediction_error(flights, drones)
    return errors.select(
        "model", "horizon", "position", "velocity", polars.col("attitude").degrees(), "body_rates"
    ).to_dicts()


def main() -> None:
    """Runs the whole comparison."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--authors",
        type=Path,
        default=Path("../shared/data/authors"),
        help="the authors' flights and policies",
    )
    parser.add_argument(
        "--nanobench", type=Path, help="NanoBench's flights, for tables of them alone"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("real_flights"),
        help="folder for tables and drones",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the split")
    options = parser.parse_args()
    if options.nanobench is not None:
        results.write(
            options.output / "nanobench.md",
            "\n\n".join(nanobench(options.nanobench, options.seed)) + "\n",
        )
        return
    everything = {
        structure: list(read_flights(options.authors / "flights" / structure))
        for structure in STRUCTURES
    }
    parts = {structure: split(flights, options.seed) for structure, flights in everything.items()}
    training, held_out = parts["pwm"]
    others = {
        f"{structure}/{policy_of(flight)}"
        for structure, (_, flights) in parts.items()
        for flight in flights
    }
    policies, flight_table = read_published(options.authors)
    policies = {name: policy for name, policy in policies.items() if name in others}

    key = jax.random.key(options.seed)
    identifications = {
        "chosen by likelihood": identify(training, ONCE, key=key),
        "three by replay": identify(training, Replay(), key=key),
        "ten by replay (the trap)": identify(
            training, Replay(trials=1), over=TRAP, key=key, bounds={
                "spin_down_ratio": (0.5, 4.0), "inertia_x": (6e-6, 1e-4),
                "inertia_y": (6e-6, 1e-4), "rotational_damping": (0.0, 1e-3),
                "drag_x": (0.0, 3.0), "drag_y": (0.0, 3.0), "drag_z": (0.0, 3.0),
            },
        ),
    }  # fmt: skip
    drones = {name: one.parameters for name, one in identifications.items()}
    drones["paper"] = mf.crazyflie()
    texts = [
        show(
            "Drones identified from seven of ten PWM policies' flights",
            parameter_rows(identifications),
        )
    ]
    gains = [dataclasses.asdict(gain) for gain in identifications["chosen by likelihood"].gains]
    texts.append(show("Gain of each group [nats a row, held-out flights]", gains))
    texts.append(
        show(
            f"First judge: log likelihood of {len(held_out)} held-out PWM flights [nats a row or "
            "window]",
            compare_likelihoods(drones, training, held_out),
        )
    )
    flying = {**drones, **{name: real_controller(one) for name, one in identifications.items()}}
    texts.append(
        show(
            "Second judge: flight times of held-out policies [s]",
            flight_times(flying, policies, flight_table, options.seed),
        )
    )
    texts.append(
        show("Open loop, held-out PWM flights [m, m/s, deg, rad/s]", open_loop(held_out, drones))
    )
    by_structure = {
        structure: identify(flights, ONCE, key=key) for structure, flights in everything.items()
    }
    by_structure["together"] = identify(
        [flight for flights in everything.values() for flight in flights], ONCE, key=key
    )
    texts.append(show("By control structure, all flights", parameter_rows(by_structure)))
    for name, one in {**identifications, **by_structure}.items():
        one.write(options.output / f"{name.replace(' ', '_')}.toml")
    results.write(options.output / "real_flights.md", "\n\n".join(texts) + "\n")


if __name__ == "__main__":
    main()
