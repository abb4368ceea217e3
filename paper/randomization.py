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
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import polars
from randomization_policies import CELLS, QUICK, Cell, choose_settings, train_cell
from randomization_shares import (
    BAR,
    COLOURS,
    OLD,
    compare_randomizations,
    draw_chart,
    find_best_policies,
    summarize,
)

from maidenflight import compiler, results, terminal
from maidenflight.errors import InputError
from maidenflight.experiments.conditions import read_conditions
from maidenflight.experiments.drones import find_reality, possible_drones
from maidenflight.experiments.flight_times import predict_flight_times
from maidenflight.experiments.transfer import MAX_DURATION_S, transfer
from maidenflight.names import POSTERIOR, TRIMS
from maidenflight.policy import Policy
from maidenflight.reporting.figures import picture
from maidenflight.settings import plain
from maidenflight.simulator.controllers import control
from maidenflight.simulator.tasks import tasks

REALITIES = ["virtual:1", "virtual:2", "virtual:3", "pybullet:7"]
"""That nobody has trained for."""
GRONAUER_2021 = Path(__file__).parent / "settings" / "gronauer_2021.toml"
"""How the published flights were flown."""
DRONES = {"posterior": POSTERIOR, "trim": TRIMS}
"""Places that `predict_flight_times` flies: drones about the identified one, by name."""


def list_places(kind: str, realities: Sequence[str]) -> list[str]:
    """Where policies of a control structure are flown. PWM goes past the firmware."""
    return [*DRONES, *([] if kind == "pwm" else [name + OLD for name in DRONES]), *realities]


def fly(
    place: str, policies: Mapping[str, Policy], options: argparse.Namespace
) -> polars.DataFrame:
    """Flights of policies of one control structure in one place.

    Columns: policy, trial, duration [s], end_reason.

    Args:
        place: a key of `DRONES`, with or without `OLD`; or a reality, as `find_reality` takes it.
        policies: by name.
        options: of the command line.

    Raises:
        InputError: the drone's file does not tell of such drones, or there is no such reality.
    """
    # Random numbers depend neither on the other places nor on their order.
    key = jax.random.fold_in(
        jax.random.key(options.seed),
        int.from_bytes(hashlib.sha256(place.removesuffix(OLD).encode()).digest()[:4]),
    )
    many, names = list(policies.values()), list(policies)
    if place.removesuffix(OLD) in DRONES:
        drones = possible_drones(options.drone, DRONES[place.removesuffix(OLD)], options.seed)
        conditions = read_conditions(GRONAUER_2021)
        if not place.endswith(OLD):
            conditions = conditions._replace(controller_for=control.controller_for)
        table = predict_flight_times(
            many,
            drones,
            key,
            trials=options.flights,
            duration=options.duration,
            names=names,
            conditions=conditions,
        )
    else:
        table = transfer(
            *(many, [find_reality(place)], options.trials, key),
            task=tasks.paper_circle(),
            duration=options.duration,
            names=names,
        ).table
    return table.select("policy", "trial", "duration", "end_reason")


def read_or_fly(
    place: str, kind: str, policies: Mapping[str, Policy], options: argparse.Namespace
) -> polars.DataFrame:
    """The result of `fly`, from its file if that is of the same policies and settings.

    Raises:
        InputError: the file is of other policies or settings; and see `fly`.
    """
    path = (
        options.output / "flights" / f"{kind}_{re.sub('[^a-z0-9.-]+', '_', Path(place).name)}.csv"
    )
    files = [options.output / "policies" / f"{name}.json" for name in policies]
    trials = options.flights if place.removesuffix(OLD) in DRONES else options.trials
    reality = [place] if Path(place).is_file() else []
    settings = {
        "place": Path(place).name,
        "trials": trials,
        "duration": options.duration,
        "policies": list(policies),
    }
    record = plain(
        results.record(
            seed=options.seed, inputs=[options.drone, *files, *reality], settings=settings
        )
    )
    if path.exists() and results.read_record(path) != record:
        raise InputError(
            f"{path}: flights of other policies or settings. Choose another folder with -o."
        )
    if not path.exists():
        table = fly(place, policies, options)
        results.write(
            path, results.table_text(_FLIGHTS, record, table.write_csv(float_precision=2))
        )
    return polars.read_csv(path, comment_prefix="#")


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
    options = parser.parse_args(arguments)
    try:
        run(options)
    except InputError as error:
        parser.error(str(error))


def run(options: argparse.Namespace) -> None:
    """All of it, for given arguments.

    Raises:
        InputError: the drone is no file that `maidenflight identify` wrote, or what earlier runs
            left is of other settings.
    """
    if not Path(options.drone).is_file():
        raise InputError(
            f"{options.drone}: no such file. Give a drone.toml that `maidenflight identify` wrote."
        )
    if min(options.seeds, options.flights, options.trials) < 1 or options.duration <= 0:
        raise InputError(
            "at least one policy, flight and trial, and a duration above 0 s, are needed."
        )
    for place in options.realities:
        find_reality(place)
    kinds = [kind for kind in QUICK if kind in (options.control or QUICK)]
    cells = [
        cell
        for cell in CELLS
        if cell.control in kinds and cell.randomization in (options.randomization or COLOURS)
    ]
    total = len(cells) + sum(len(list_places(kind, options.realities)) for kind in kinds)
    done, tables = 0, []
    with terminal.Bar("randomization") as bar:
        for kind in kinds:
            own: list[tuple[Cell, int, Policy]] = []
            for cell in [cell for cell in cells if cell.control == kind]:
                bar.move(done, total, f"training {cell.name}")
                settings = choose_settings(cell, options.updates)
                several = train_cell(
                    cell,
                    options.drone,
                    settings,
                    options.seeds,
                    options.seed,
                    options.output / "policies",
                )
                own += [(cell, number, one) for number, one in enumerate(several, 1)]
                done += 1
            policies = {f"{cell.name}/policy_{number}": one for cell, number, one in own}
            labels = [
                {"policy": name, **cell._asdict(), "number": number}
                for name, (cell, number, _) in zip(policies, own, strict=True)
            ]
            for place in list_places(kind, options.realities):
                bar.move(done, total, f"flying {kind} in {place}")
                table = polars.DataFrame(labels).with_columns(place=polars.lit(place))
                tables.append(
                    table.join(
                        read_or_fly(place, kind, policies, options),
                        on="policy",
                        maintain_order="left",
                    ).drop("policy")
                )
                done += 1
    flights = polars.concat(tables)
    run_settings = {
        "realities": [Path(place).name for place in options.realities],
        "flights": options.flights,
        "trials": options.trials,
        "duration": options.duration,
        "policies": {cell.name: options.seeds for cell in cells},
    }
    record = results.record(seed=options.seed, inputs=[options.drone], settings=run_settings)
    text = results.table_text(_FLIGHTS, record, flights.write_csv(float_precision=2))
    results.write(options.output / "flights.csv", text)
    results.write(
        options.output / "randomization.svg", picture.svg(draw_chart(flights, options.duration))
    )
    with polars.Config(
        tbl_cols=-1,
        tbl_rows=-1,
        tbl_width_chars=200,
        fmt_str_lengths=80,
        float_precision=2,
        tbl_hide_column_data_types=True,
    ):
        print("Means over policies, 95 % intervals over policies")
        print(summarize(flights, options.duration))
        print("Differences of shares, 95 % intervals over policies (Welch)")
        print(compare_randomizations(flights, options.duration))
        print(
            f"The best policy of each control structure: does it reach {options.duration:g} s in "
            f"{BAR:.0%} of its flights everywhere?"
        )
        print(find_best_policies(flights, options.duration))


_FLIGHTS = (
    "# maidenflight randomization flights 1: simulated, a row a flight; control structure, "
    "randomization and number of the policy,"
    " place where it flew, duration s"
)

if __name__ == "__main__":
    compiler.prepare_jax()
    main()
