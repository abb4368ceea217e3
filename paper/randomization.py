"""Compares randomizations of training by how well their policies transfer.

`python paper/randomization.py --drone drone.toml -o randomization` trains policies of each control
structure for an identified drone: on the drone itself (`none`), on a box of +-10 % about it (`box`,
the paper's fields) and on samples of its posterior (`posterior`), each as `maidenflight train` does
but half as long; and by a `recipe` for transfer: over a box that also covers trims and other drones
(`wide_box`), for longer, and with a yaw penalty. Each policy flies 200 times on posterior samples,
200 times with trims that differ from flight to flight, as in real flights, and 16 times in each of
some realities that training has not seen. The script writes `flights.csv` with one row per flight
and `randomization.svg`, and prints shares of flights that reach 20 s, differences between
randomizations with their intervals, and whether a policy of each structure reaches 20 s in 95 % of
its flights everywhere. After an interruption the same command resumes it.

Policies fly with the firmware that they were trained for, and, in rows whose place ends in
`2021.10`, as the authors' drone flew.

Source of the task, the guards and the box: Gronauer et al. 2022, sec. Simulation Environment and
sec. Zero-Shot Experiments.
"""

import argparse
import hashlib
import math
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace as replaced
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
import polars
from jaxtyping import Float
from kept_policies import kept_policies
from scipy import stats

from maidenflight import compiler, results, terminal
from maidenflight.errors import InputError
from maidenflight.experiments.drones import distribution_of, find_reality, possible_drones
from maidenflight.experiments.flight_times import predict_flight_times
from maidenflight.experiments.real_controller import real_controller
from maidenflight.experiments.transfer import MAX_DURATION_S, transfer
from maidenflight.names import POSTERIOR, TRIMS, WIDE
from maidenflight.policy import Policy
from maidenflight.reporting.figures import charts, picture
from maidenflight.reporting.figures.charts import Entry, Figure, Spec
from maidenflight.simulator.controllers import control
from maidenflight.simulator.tasks import tasks
from maidenflight.simulator.tasks.tasks import Task
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.settings import recorded
from maidenflight.training.train import train

BOX = 0.10
"""Half width of the paper's box."""
REALITIES = ["virtual:1", "virtual:2", "virtual:3", "pybullet:7"]
"""That nobody has trained for."""
BAR = 0.95
"""Share of flights that shall reach the time limit."""
COLOURS = {"none": "purple", "box": "blue", "posterior": "green", "recipe": "orange"}
"""Randomizations, in the order of the table."""


class Cell(NamedTuple):
    """What some policies are trained for."""

    control: str
    randomization: str

    @property
    def name(self) -> str:
        """Of the folder of its policies."""
        return f"{self.control}_{self.randomization}"


QUICK = {
    "pwm": AnalyticGradient(updates=800, hidden_learning_rate=0.0, action_change_penalty=0.0),
    "attitude_rate": AnalyticGradient(
        updates=600, horizon=32, hidden_learning_rate=0.0, action_change_penalty=0.0
    ),
    "attitude": AnalyticGradient(
        updates=600, horizon=32, hidden_learning_rate=0.0, action_change_penalty=0.0
    ),
}
"""Settings of training, by control structure: half as long as the command line's, or less, and by
Adam alone, as paper/notes/randomization.md was measured."""
RECIPE = {
    kind: replaced(settings, updates=settings.updates * 2) for kind, settings in QUICK.items()
}
"""Those of the recipe: drones that differ more take longer to learn."""
CELLS = [Cell(kind, randomization) for kind in QUICK for randomization in COLOURS]

YAW_PENALTY = 0.1
"""What the recipe's task takes for a radian of heading, a control period."""


def task_of(randomization: str) -> Task:
    """The paper's circle; for the recipe with a price on turning away."""
    return (
        tasks.with_yaw_penalty(tasks.paper_circle(), YAW_PENALTY)
        if randomization == "recipe"
        else tasks.paper_circle()
    )


def settings_of(cell: Cell, updates: int | None) -> AnalyticGradient:
    """Settings of training, with other updates if given."""
    settings = (RECIPE if cell.randomization == "recipe" else QUICK)[cell.control]
    return replaced(settings, updates=updates or settings.updates)


RANDOMIZATIONS = {"none": 0.0, "box": BOX, "posterior": POSTERIOR, "recipe": WIDE}
"""As `maidenflight train --randomize` takes them."""


def trained(
    cell: Cell, drone: str, settings: AnalyticGradient, seeds: int, seed: int, folder: Path
) -> list[Policy]:
    """Policies of a cell: those that the folder holds, or new ones that it holds then.

    Raises:
        InputError: the folder holds policies of other settings, or the drone's file does not tell
            what the cell asks for.
    """
    controller = control.CONTROLLERS[cell.control]()
    drones = distribution_of(drone, RANDOMIZATIONS[cell.randomization], controller)
    priced = {"yaw_penalty": YAW_PENALTY} if cell.randomization == "recipe" else {}
    said = {
        **cell._asdict(),
        "drones": str(drones),
        **priced,
        "policies": seeds,
        **recorded(settings),
    }
    made = results.record(seed=seed, inputs=[drone], settings=said)
    # What a cell's policies are depends neither on the other cells nor on what an interrupted run
    # left.
    keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), CELLS.index(cell)), seeds)
    return kept_policies(
        folder / cell.name,
        seeds,
        made,
        lambda: train(task_of(cell.randomization), controller, drones, keys, settings),
    )


FLOWN = {"posterior": POSTERIOR, "trim": TRIMS}
"""Places that `predict_flight_times` flies: drones about the identified one, by name."""
OLD = " 2021.10"
"""What the names of places end in where policies fly as the authors' drone ran them, not as they
were trained."""


def places_of(kind: str, realities: Sequence[str]) -> list[str]:
    """Where policies of a control structure are flown. PWM goes past the firmware."""
    return [*FLOWN, *([] if kind == "pwm" else [name + OLD for name in FLOWN]), *realities]


def fly(place: str, policies: Mapping[str, Policy], given: argparse.Namespace) -> polars.DataFrame:
    """Flights of policies of one control structure in one place.

    Columns: policy, trial, duration [s], end_reason.

    Args:
        place: a key of `FLOWN`, with or without `OLD`; or a reality, as `find_reality` takes it.
        policies: by name.
        given: the command line's arguments.

    Raises:
        InputError: the drone's file does not tell of such drones, or there is no such reality.
    """
    # Random numbers depend neither on the other places nor on their order.
    key = jax.random.fold_in(
        jax.random.key(given.seed),
        int.from_bytes(hashlib.sha256(place.removesuffix(OLD).encode()).digest()[:4]),
    )
    many, names = list(policies.values()), list(policies)
    if place.removesuffix(OLD) in FLOWN:
        drones = possible_drones(given.drone, FLOWN[place.removesuffix(OLD)], given.seed)
        controller_for = real_controller if place.endswith(OLD) else control.controller_for
        table = predict_flight_times(
            many,
            drones,
            key,
            trials=given.flights,
            duration=given.duration,
            names=names,
            controller_for=controller_for,
        )
    else:
        table = transfer(
            *(many, [find_reality(place)], given.trials, key),
            task=tasks.paper_circle(),
            duration=given.duration,
            names=names,
        ).table
    return table.select("policy", "trial", "duration", "end_reason")


def flown(
    place: str, kind: str, policies: Mapping[str, Policy], given: argparse.Namespace
) -> polars.DataFrame:
    """The result of `fly`, from its file if that is of the same policies and settings.

    Raises:
        InputError: the file is of other policies or settings; and see `fly`.
    """
    path = given.output / "flights" / f"{kind}_{re.sub('[^a-z0-9.-]+', '_', Path(place).name)}.csv"
    files = [given.output / "policies" / f"{name}.json" for name in policies]
    trials = given.flights if place.removesuffix(OLD) in FLOWN else given.trials
    reality = [place] if Path(place).is_file() else []
    settings = {
        "place": Path(place).name,
        "trials": trials,
        "duration": given.duration,
        "policies": list(policies),
    }
    made = results.plain(
        results.record(seed=given.seed, inputs=[given.drone, *files, *reality], settings=settings)
    )
    if path.exists() and results.read_record(path) != made:
        raise InputError(
            f"{path}: flights of other policies or settings. Choose another folder with -o."
        )
    if not path.exists():
        table = fly(place, policies, given)
        results.write(path, results.table_text(_FLIGHTS, made, table.write_csv(float_precision=2)))
    return polars.read_csv(path, comment_prefix="#")


class Interval(NamedTuple):
    """A number and the ends of its 95 % interval.

    They are not numbers where there is one policy.
    """

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return (
            f"{self.value:.2f}"
            if math.isnan(self.low)
            else f"{self.value:.2f} [{self.low:.2f}, {self.high:.2f}]"
        )


def mean_of(values: Float[np.ndarray, "n"]) -> Interval:
    """Mean over policies, with Student's interval.

    Policies that are all equal say nothing of how others differ: it has no width.
    """
    if len(values) < 2 or np.ptp(values) == 0:
        end = math.nan if len(values) < 2 else float(values[0])
        return Interval(float(values[0]), end, end)
    low, high = stats.t.interval(0.95, len(values) - 1, np.mean(values), stats.sem(values))
    return Interval(float(np.mean(values)), float(low), float(high))


def difference(first: Float[np.ndarray, "n"], second: Float[np.ndarray, "m"]) -> Interval:
    """How much larger the mean of the second policies is, with Welch's interval.

    None where no policy differs from its like.
    """
    value = float(np.mean(second) - np.mean(first))
    if min(len(first), len(second)) < 2 or np.ptp(first) == np.ptp(second) == 0:
        return Interval(value, math.nan, math.nan)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Precision loss")  # one side's policies may all be equal
        low, high = stats.ttest_ind(second, first, equal_var=False).confidence_interval()
    return Interval(value, float(low), float(high))


def by_policy(flights: polars.DataFrame, longest: float) -> polars.DataFrame:
    """One row per policy and place.

    Columns: control, randomization, place, number, flights, share that reached the longest time,
    mean duration [s].
    """
    duration = polars.col("duration")
    told = [
        polars.len().alias("flights"),
        (duration >= longest - 1e-6).mean().alias("share"),
        duration.mean().alias("mean"),
    ]
    return flights.group_by("control", "randomization", "place", "number", maintain_order=True).agg(
        *told
    )


def summary(flights: polars.DataFrame, longest: float) -> polars.DataFrame:
    """One row per control structure, place and randomization.

    Shares of flights that reached the longest time, times, and why others ended.
    """
    rows = []
    for (kind, place, randomization), part in flights.group_by(
        "control", "place", "randomization", maintain_order=True
    ):
        policies = by_policy(part, longest)
        short = part.filter(polars.col("duration") < longest - 1e-6)["end_reason"].value_counts(
            sort=True
        )
        share, mean = (mean_of(policies[name].to_numpy()) for name in ("share", "mean"))
        rows.append(
            {
                "control": kind,
                "place": place,
                "randomization": randomization,
                "policies": policies.height,
                "flights": part.height,
                "share of 20 s": str(
                    Interval(share.value, max(share.low, 0.0), min(share.high, 1.0))
                ),
                "worst policy": policies["share"].min(),
                "mean [s]": mean.value,
                "most end by": f"{short['end_reason'][0]} ({short['count'][0]})"
                if short.height
                else "",
            }
        )
    return polars.DataFrame(rows)


def differences(flights: polars.DataFrame, longest: float) -> polars.DataFrame:
    """One row per structure and place: the gain of each randomization over the one before."""
    rows = []
    for (kind, place), part in by_policy(flights, longest).group_by(
        "control", "place", maintain_order=True
    ):
        shares = {
            name: group["share"].to_numpy()
            for (name,), group in part.group_by("randomization", maintain_order=True)
        }
        pairs = {
            f"{second} - {first}": str(difference(shares[first], shares[second]))
            for first, second in pairwise(shares)
        }
        rows.append(
            {"control": kind, "place": place, "policies": min(map(len, shares.values())), **pairs}
        )
    return polars.DataFrame(rows)


def best_policies(flights: polars.DataFrame, longest: float) -> polars.DataFrame:
    """The policy of each control structure with the best worst share over all places.

    Its shares, and where it misses the requirement.

    Places of the authors' drone (`OLD`) do not count: policies are not trained for it.
    """
    policies = by_policy(flights.filter(~polars.col("place").str.ends_with(OLD)), longest)
    rows = []
    for (kind,), part in policies.group_by("control", maintain_order=True):
        least = part.group_by("randomization", "number", maintain_order=True).agg(
            polars.col("share").min().alias("least"), polars.col("share").mean().alias("all")
        )
        best = least.sort("least", "all", descending=True, maintain_order=True).row(0, named=True)
        own = part.filter(
            (polars.col("randomization") == best["randomization"])
            & (polars.col("number") == best["number"])
        )
        missed = [
            f"{row['place']} {row['share']:.2f}"
            for row in own.iter_rows(named=True)
            if row["share"] < BAR
        ]
        told = "yes" if not missed else f"no: {', '.join(missed)}"
        rows.append(
            {
                "control": kind,
                "policy": f"{best['randomization']} {best['number']}",
                "least share": best["least"],
                "meets it": told,
            }
        )
    return polars.DataFrame(rows)


STEP, HIGH = 84, 170
"""Of a place's column and of a panel [px]."""


def chart(flights: polars.DataFrame, longest: float) -> Figure:
    """Share of flights that reached the longest time: a dot a policy, a line the mean.

    A panel per control structure, a column per place, a colour per randomization.
    """
    policies = by_policy(flights, longest)
    kinds, places = (
        policies[name].unique(maintain_order=True).to_list() for name in ("control", "place")
    )
    places.sort(key=lambda place: place.endswith(OLD))
    chosen = [name for name in COLOURS if name in policies["randomization"]]
    legend = [Entry(name, COLOURS[name], "bar") for name in chosen]
    panels = [
        _panel(policies.filter(control=kind), kind, places, chosen, f"{longest:g} s reached [%]")
        for kind in kinds
    ]
    title = f"Share of flights that reach {longest:g} s"
    return Figure(title, panels, legend, columns=1)


def _panel(
    policies: polars.DataFrame, kind: str, places: list[str], chosen: list[str], label: str
) -> Spec:
    apart, rows = 0.8 / len(chosen), []
    for (place, name), part in policies.group_by("place", "randomization", maintain_order=True):
        shares = 100 * part["share"].sort().to_numpy()
        middle = apart * (chosen.index(str(name)) - (len(chosen) - 1) / 2)
        common = {"place": place, "colour": charts.paint(COLOURS[str(name)])}
        rows.append({**common, "kind": "mean", "shift": middle, "y": float(shares.mean())})
        across = middle + 0.22 * apart * np.linspace(-1, 1, len(shares))
        rows += [
            {**common, "kind": "policy", "shift": shift, "y": share}
            for shift, share in zip(across, shares, strict=True)
        ]
    # The firmware stands below the place.
    lines = f"split(replace(datum.label, '{OLD}', '|{OLD.strip()}'), '|')"
    x = {"field": "place", "type": "nominal", "sort": places, "title": None}
    x |= {
        "scale": {"domain": places, "padding": 0},
        "axis": {"labelExpr": lines, "labelAngle": 0, "labelFlush": False},
    }
    y = charts.number("y", label, **charts.within(-4.0, 104.0))
    shared = {"x": x, "y": y, "color": {"field": "colour", "type": "nominal", "scale": None}}
    shared["xOffset"] = charts.number("shift", scale={"domain": [-0.5, 0.5]})
    bar = {"type": "rule", "strokeDash": [7, 4], "color": charts.paint("line")}
    mean = {"type": "tick", "orient": "horizontal", "size": 0.72 * apart * STEP, "thickness": 2}
    layers: list[Spec] = [
        {"data": {"values": [{"y": 100 * BAR}]}, "mark": bar, "encoding": {"y": y}},
        charts.layer("mean", {**mean, "opacity": 0.6}, **shared),
        charts.layer("policy", {"type": "point", "filled": True, "opacity": 1}, **shared),
    ]
    panel = charts.panel(
        charts.rows(rows), layers, title=kind.replace("_", " "), height=HIGH, zooms=()
    )
    return {**panel, "width": STEP * len(places)}


def main(arguments: Sequence[str] | None = None) -> None:
    """Trains, flies, writes, draws and prints."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--drone", required=True, help="the identified drone's TOML file")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        help="folder for policies, flights.csv and randomization.svg",
    )
    parser.add_argument(
        "--realities",
        nargs="+",
        default=REALITIES,
        help="as `maidenflight transfer` takes them (default: %(default)s)",
    )
    parser.add_argument(
        "--control",
        action="append",
        choices=list(QUICK),
        help="a control structure; may be repeated (all three)",
    )
    parser.add_argument(
        "--randomization",
        action="append",
        choices=list(COLOURS),
        help="a randomization; may be repeated (all four)",
    )
    parser.add_argument(
        "--seeds", type=int, default=3, help="policies of each cell (default: %(default)s)"
    )
    parser.add_argument(
        "--flights",
        type=int,
        default=200,
        help="of each policy on drones about the identified one (default: %(default)s)",
    )
    parser.add_argument(
        "--trials",
        type=int,
        default=16,
        help="flights of each policy in each reality (default: %(default)s)",
    )
    parser.add_argument(
        "--duration",
        type=float,
        default=MAX_DURATION_S,
        help="longest flight, seconds (default: %(default)g)",
    )
    parser.add_argument("--updates", type=int, help="of training, for all control structures")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(arguments)
    try:
        run(given)
    except InputError as error:
        parser.error(str(error))


def run(given: argparse.Namespace) -> None:
    """All of it, for given arguments.

    Raises:
        InputError: the drone is no file that `maidenflight identify` wrote, or what earlier runs
            left is of other settings.
    """
    if not Path(given.drone).is_file():
        raise InputError(
            f"{given.drone}: no such file. Give a drone.toml that `maidenflight identify` wrote."
        )
    if min(given.seeds, given.flights, given.trials) < 1 or given.duration <= 0:
        raise InputError(
            "at least one policy, flight and trial, and a duration above 0 s, are needed."
        )
    for place in given.realities:
        find_reality(place)
    kinds = [kind for kind in QUICK if kind in (given.control or QUICK)]
    cells = [
        cell
        for cell in CELLS
        if cell.control in kinds and cell.randomization in (given.randomization or COLOURS)
    ]
    total = len(cells) + sum(len(places_of(kind, given.realities)) for kind in kinds)
    done, tables = 0, []
    with terminal.Bar("randomization") as bar:
        for kind in kinds:
            own: list[tuple[Cell, int, Policy]] = []
            for cell in [cell for cell in cells if cell.control == kind]:
                bar.move(done, total, f"training {cell.name}")
                settings = settings_of(cell, given.updates)
                several = trained(
                    cell, given.drone, settings, given.seeds, given.seed, given.output / "policies"
                )
                own += [(cell, number, one) for number, one in enumerate(several, 1)]
                done += 1
            policies = {f"{cell.name}/policy_{number}": one for cell, number, one in own}
            told = [
                {"policy": name, **cell._asdict(), "number": number}
                for name, (cell, number, _) in zip(policies, own, strict=True)
            ]
            for place in places_of(kind, given.realities):
                bar.move(done, total, f"flying {kind} in {place}")
                table = polars.DataFrame(told).with_columns(place=polars.lit(place))
                tables.append(
                    table.join(
                        flown(place, kind, policies, given), on="policy", maintain_order="left"
                    ).drop("policy")
                )
                done += 1
    flights = polars.concat(tables)
    said = {
        "realities": [Path(place).name for place in given.realities],
        "flights": given.flights,
        "trials": given.trials,
        "duration": given.duration,
        "policies": {cell.name: given.seeds for cell in cells},
    }
    made = results.record(seed=given.seed, inputs=[given.drone], settings=said)
    text = results.table_text(_FLIGHTS, made, flights.write_csv(float_precision=2))
    results.write(given.output / "flights.csv", text)
    results.write(given.output / "randomization.svg", picture.svg(chart(flights, given.duration)))
    with polars.Config(
        tbl_cols=-1,
        tbl_rows=-1,
        tbl_width_chars=200,
        fmt_str_lengths=80,
        float_precision=2,
        tbl_hide_column_data_types=True,
    ):
        print("Means over policies, 95 % intervals over policies")
        print(summary(flights, given.duration))
        print("Differences of shares, 95 % intervals over policies (Welch)")
        print(differences(flights, given.duration))
        print(
            f"The best policy of each control structure: does it reach {given.duration:g} s in "
            f"{BAR:.0%} of its flights everywhere?"
        )
        print(best_policies(flights, given.duration))


_FLIGHTS = (
    "# maidenflight randomization flights 1: simulated, a row a flight; control structure, "
    "randomization and number of the policy,"
    " place where it flew, duration s"
)

if __name__ == "__main__":
    compiler.prepare_jax()
    main()
