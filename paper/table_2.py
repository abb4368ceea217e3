"""The paper's table of identified parameters, beside ours.

`python paper/table_2.py` runs the paper's Bayesian optimisation (250 evaluations, three trials, T =
10 to 50) on virtual flights of a drone that has the paper's own values, so that the truth is known;
`--logs ../shared/data/authors/flights` does so on real flights as well, folder by folder. Our
gradient method and the bootstrap's interval stand beside, for the paper's +- is the spread of an
optimiser that is run three times on the same data, and tells nothing of how well the data fix the
parameter.
"""

import argparse
import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np
import polars

from maidenflight import results, terminal
from maidenflight.errors import InputError
from maidenflight.flights.log import Flight
from maidenflight.flights.reading import read_flights
from maidenflight.flights.windows import windows
from maidenflight.flying import recording
from maidenflight.identification.identify import identify
from maidenflight.identification.methods import METHODS, Replay
from maidenflight.identification.outcome.estimates import Identification
from maidenflight.identification.replay.objective import Objective
from maidenflight.identification.unknowns import PAPER_BOUNDS
from maidenflight.parameters import crazyflie, replace
from maidenflight.simulator.controllers.control import CONTROLLERS
from maidenflight.simulator.realities.virtual_drone import VirtualDrone

PAPER: dict[int, dict[str, tuple[float, float]]] = {
    10: {
        "thrust_to_weight": (1.746, 0.0050),
        "motor_time_constant": (0.102, 0.0110),
        "latency": (0.006, 0.0039),
    },
    20: {
        "thrust_to_weight": (1.733, 0.0093),
        "motor_time_constant": (0.087, 0.0087),
        "latency": (0.014, 0.0038),
    },
    30: {
        "thrust_to_weight": (1.725, 0.0018),
        "motor_time_constant": (0.088, 0.0006),
        "latency": (0.018, 0.0003),
    },
    40: {
        "thrust_to_weight": (1.725, 0.0081),
        "motor_time_constant": (0.096, 0.0035),
        "latency": (0.018, 0.0007),
    },
    50: {
        "thrust_to_weight": (1.722, 0.0027),
        "motor_time_constant": (0.104, 0.0012),
        "latency": (0.018, 0.0004),
    },
}
"""Mean and standard deviation over three trials by T; SI units (Gronauer et al. 2022,
table:results-sim-opt)."""
TRUTH = {name: mean for name, (mean, _) in PAPER[30].items()}
"""xi of the virtual drone: the paper's, T = 30."""
PARAMETERS = {
    "thrust_to_weight": ("k_F", 1.0, 3),
    "motor_time_constant": ("T_m, ms", 1e3, 1),
    "latency": ("latency, ms", 1e3, 1),
}
"""Words, scale and decimals of a parameter."""
NOTES = (
    "The paper's +- and that of our trials are standard deviations over runs of the optimiser on "
    "the same data: they tell of the optimiser."
    " The interval in brackets is the 95 % bootstrap interval over segments of flight: it tells "
    "of the parameter.",
    "k_F is full thrust over the weight of the paper's 28 g. The authors' code scales thrust by "
    "28 g as well but lifts a body of 30 g, so"
    " that its k_F of 1.725 lifts like 1.61 here, while it turns like 1.725.",
    "The paper's flights are not published. Those that are were flown by its policies, not by the "
    "PID that the paper identified from.",
)


@dataclass(frozen=True)
class Entry:
    """What one method found in one set of flights with one T."""

    flights: str
    method: str
    length: int
    identification: Identification
    at_paper: float
    """Objective at the paper's values of this T."""
    truth: dict[str, float] | None

    @property
    def objectives(self) -> list[float]:
        """Lowest objective of each trial."""
        trials = self.identification.search.filter(polars.col("trial") > 0).group_by(
            "trial", maintain_order=True
        )
        return trials.agg(polars.col("objective").min())["objective"].to_list()


def virtual_flights(seed: int, count: int, duration: float) -> Sequence[Flight]:
    """Flights of the paper's PID on the drone `TRUTH`, at a fifth of identification's time step."""
    drone = VirtualDrone("the paper's drone", replace(crazyflie(), time_step=0.001, **TRUTH))
    return recording.record(drone, jax.random.key(seed), count, duration, rate=100)


def sets_of_flights(folder: Path) -> Iterator[tuple[str, Sequence[Flight]]]:
    """All flights of a folder, or of each of its folders that is named as a control structure."""
    parts = [folder / name for name in CONTROLLERS if (folder / name).is_dir()]
    for part in parts or [folder]:
        yield part.name, read_flights(part).flights


def entries(
    name: str, flights: Sequence[Flight], plan: argparse.Namespace, truth: dict[str, float] | None
) -> Iterator[Entry]:
    """What both methods find, for each T."""
    for length in plan.lengths:
        paper = {parameter: np.float32(mean) for parameter, (mean, _) in PAPER[length].items()}
        at_paper = Objective(windows(flights, length), flights[0].period)(
            replace(crazyflie(), **paper)
        )
        for method in reversed(METHODS):
            evaluations = plan.evaluations if method == "bayesian" else 60
            key = jax.random.key(plan.seed)
            identification = identify(
                flights,
                Replay(method, length, trials=plan.trials, evaluations=evaluations),
                key=key,
            )
            print(
                f"{name}, T = {length}, {method}: {identification.windows} windows, "
                f"{identification.seconds:.1f} s",
                file=sys.stderr,
            )
            yield Entry(name, method, length, identification, at_paper, truth)


def spread(mean: float, deviation: float, scale: float, decimals: int) -> str:
    """Mean and standard deviation; of the second a digit more, as in the paper."""
    return f"{scale * mean:.{decimals}f} +- {scale * deviation:.{decimals + 1}f}"


def where(value: float, low: float, high: float) -> str:
    """Where a value lies, seen from an interval."""
    return "below" if value < low else "above" if value > high else "inside"


def table(name: str, results: Sequence[Entry], lengths: Sequence[int]) -> list[list[str]]:
    """Rows of the table of one set of flights, in the paper's layout."""
    by = {(entry.method, entry.length): entry for entry in results}
    rows = []
    for parameter, (words, scale, decimals) in PARAMETERS.items():
        bayesian, gradient = (
            [by[method, length] for length in lengths] for method in ("bayesian", "gradient")
        )
        estimates = [entry.identification.estimates[parameter] for entry in gradient]
        rows.append(
            [
                words,
                "paper",
                *(spread(*PAPER[length][parameter], scale, decimals) for length in lengths),
            ]
        )
        theirs = [entry.identification.estimates[parameter] for entry in bayesian]
        rows.append(
            [
                "",
                "Bayesian",
                *(spread(each.trial_mean, each.trial_sd, scale, decimals) for each in theirs),
            ]
        )
        rows.append(
            [
                "",
                "gradient",
                *(spread(each.trial_mean, each.trial_sd, scale, decimals) for each in estimates),
            ]
        )
        ends = [[f"{scale * end:.{decimals}f}" for end in each.interval] for each in estimates]
        rows.append(["", "interval", *(f"[{low}, {high}]" for low, high in ends)])
        if gradient[0].truth is not None:
            rows.append(
                [
                    "",
                    "truth",
                    *[f"{scale * gradient[0].truth[parameter]:.{decimals}f}"] * len(lengths),
                ]
            )
        lies = [
            where(PAPER[length][parameter][0], *each.interval)
            for length, each in zip(lengths, estimates, strict=True)
        ]
        rows.append(["", "paper's lies", *lies])
    for method in ("bayesian", "gradient"):
        reached = [by[method, length].objectives for length in lengths]
        words = "objective" if method == "bayesian" else ""
        rows.append(
            [
                words,
                method.replace("bay", "Bay"),
                *(spread(float(np.mean(each)), float(np.std(each)), 1.0, 3) for each in reached),
            ]
        )
    excess = [
        by["gradient", length].at_paper / by["gradient", length].identification.value - 1
        for length in lengths
    ]
    rows.append(["", "at paper's", *(f"{100 * share:+.1f} %" for share in excess)])
    return rows


def as_data(results: Iterable[Entry]) -> polars.DataFrame:
    """A row for each parameter of each entry, SI units."""
    rows = []
    for entry in results:
        for parameter, estimate in entry.identification.estimates.items():
            low, high = estimate.interval
            mean, deviation = PAPER[entry.length][parameter]
            rows.append(
                {
                    "flights": entry.flights,
                    "length": entry.length,
                    "method": entry.method,
                    "windows": entry.identification.windows,
                    "parameter": parameter,
                    "trial_mean": estimate.trial_mean,
                    "trial_sd": estimate.trial_sd,
                    "value": estimate.value,
                    "low": low,
                    "high": high,
                    "truth": entry.truth and entry.truth[parameter],
                    "paper_mean": mean,
                    "paper_deviation": deviation,
                    "objective_mean": float(np.mean(entry.objectives)),
                    "objective_deviation": float(np.std(entry.objectives)),
                    "objective_at_paper": entry.at_paper,
                }
            )
    return polars.DataFrame(rows, infer_schema_length=None)


def markdown(tables: dict[str, list[list[str]]], columns: list[str], record: str) -> str:
    """The page."""
    parts = ["# Simulation optimization: the paper's table beside ours"]
    for title, rows in tables.items():
        head = ["| " + " | ".join(columns) + " |", "|---" * 2 + "|---:" * (len(columns) - 2) + "|"]
        parts.append(
            "\n".join([f"## {title}\n", *head, *("| " + " | ".join(row) + " |" for row in rows)])
        )
    return (
        "\n\n".join(
            [*parts, "\n".join(f"- {note}" for note in NOTES), f"<!-- record: {record} -->"]
        )
        + "\n"
    )


def parse_arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    """What the command line asks for; `--small` sets what is not given."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--logs",
        type=Path,
        help="folder of real flights, or of folders pwm, attitude_rate, attitude of them",
    )
    parser.add_argument(
        "--small", action="store_true", help="a quick run that shows how it works and nothing else"
    )
    parser.add_argument(
        "--lengths", type=int, nargs="+", choices=PAPER, help="T; all of the paper's unless given"
    )
    parser.add_argument("--evaluations", type=int, help="of Bayesian optimisation, a trial (250)")
    parser.add_argument("--trials", type=int, help="(3)")
    parser.add_argument("--flights", type=int, help="virtual flights (20)")
    parser.add_argument("--duration", type=float, help="of each [s] (30)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("table_2"),
        help="folder for table_2.md and table_2.csv (table_2)",
    )
    plan = parser.parse_args(arguments)
    full = {
        "lengths": list(PAPER),
        "evaluations": 250,
        "trials": 3,
        "flights": 20,
        "duration": 30.0,
    }
    small = {"lengths": [10, 30], "evaluations": 15, "trials": 2, "flights": 2, "duration": 6.0}
    for name, value in (small if plan.small else full).items():
        if getattr(plan, name) is None:
            setattr(plan, name, value)
    return plan


def main(arguments: Sequence[str] | None = None) -> None:
    """Identifies, prints and writes."""
    plan = parse_arguments(arguments)
    recordings = virtual_flights(plan.seed, plan.flights, plan.duration)
    by_title = {
        "Virtual flights, truth known": list(entries("virtual", recordings, plan, dict(TRUTH)))
    }
    if plan.logs is not None:
        for name, flights in sets_of_flights(plan.logs):
            by_title[f"Real flights: {name}"] = list(entries(name, flights, plan, None))
    names = ("lengths", "evaluations", "trials", "flights", "duration")
    settings = {name: getattr(plan, name) for name in names}
    record = json.dumps(results.record(seed=plan.seed, inputs=[], settings=settings))
    columns = ["", "", *(f"T = {length}" for length in plan.lengths)]
    tables = {title: table(title, some, plan.lengths) for title, some in by_title.items()}
    for title, rows in tables.items():
        terminal.print_table(title, columns, rows)
    print("\n".join(NOTES))
    everything = as_data(entry for some in by_title.values() for entry in some)
    results.write(plan.output / "table_2.md", markdown(tables, columns, record))
    results.write(
        plan.output / "table_2.csv",
        f"# record: {record}\n{everything.write_csv(float_precision=9)}",
    )
    print(f"written to {plan.output}/table_2.md and table_2.csv; search bounds {PAPER_BOUNDS}")


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(f"error: {error}")
