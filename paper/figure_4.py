"""The paper's zero-shot experiment: policies trained for many motors, flown in unseen realities.

`python paper/figure_4.py -o zero_shot` trains policies of each control structure, at its own rate,
around drones of each motor lag (40, 80 and 120 ms) and latency (0, 15 and 20 ms), three seeds each,
and flies each of the 81 policies three times in each reality for at most 20 s, until the paper's
guards end it. It computes the study `paper/settings/zero_shot.toml`, as `maidenflight sweep
paper/settings/zero_shot.toml -o zero_shot` does, gathers all flights into `flights.csv` with a row
a flight, and draws `figure_4.svg`: flight times by lag, a panel a latency. `--authors
../shared/data/authors` draws the published real flights below. Interrupted, it goes on by the same
command; what is there already is not computed again. `--small` trains one policy of each cell, a
third as long, for a look.

Source: Gronauer et al. 2022, sec. Zero-Shot Experiments, fig:experiments:zero-shot.
"""

import argparse
import dataclasses
from collections.abc import Mapping, Sequence
from contextlib import chdir
from pathlib import Path
from typing import Any

import polars

import maidenflight as mf
from maidenflight import manifest, results, run_folder, terminal
from maidenflight.errors import InputError
from maidenflight.experiments.transfer import MAX_DURATION_S
from maidenflight.reporting.figures import picture
from maidenflight.reporting.figures.charts import Figure
from maidenflight.reporting.figures.flight_times import COLOURS, flight_times
from maidenflight.simulator.controllers.interface import INTERFACES
from maidenflight.simulator.tasks.failures import REACHED
from maidenflight.studies import study as studies
from maidenflight.studies.store import Folder
from maidenflight.studies.study import Study, Task

STUDY = Path(__file__).parent / "settings" / "zero_shot.toml"
CELL = ("motor_time_constant", "latency")
"""Parameters of the drone that differ between cells [s]."""
FLIGHTS = dataclasses.replace(
    run_folder.FLIGHTS,
    columns={
        **{"control": str, "training_rate": int, **dict.fromkeys(CELL, float), "number": int},
        **run_folder.FLIGHTS.columns,
    },
    heading="maidenflight zero-shot flights 1: simulated, a row a flight; training_rate Hz, "
    "motor_time_constant s and latency s of the policy's training, number of the policy in its "
    "cell, duration s, position_error m",
)
"""Flights of all policies, with what each policy was trained for."""


def read_published_flights(folder: Path) -> polars.DataFrame:
    """Reads the paper's real flights: control, motor_time_constant, latency, duration, end_reason.

    Raises:
        InputError: the folder lacks `flights.csv`.
    """
    try:
        flights = polars.read_csv(folder / "flights.csv")
    except OSError as error:
        raise InputError(
            f"{folder}: not the authors' data ({error}). Give the folder with flights.csv."
        ) from error
    own = flights.filter(polars.col("in_paper").cast(polars.Int64) == 1)
    renamed = {
        "trained_motor_time_constant_s": "motor_time_constant",
        "trained_latency_s": "latency",
        "flight_time_s": "duration",
    }
    duration = polars.col("duration").clip(upper_bound=MAX_DURATION_S)
    reached = polars.when(duration >= MAX_DURATION_S).then(polars.lit(REACHED))
    return own.rename(renamed).with_columns(
        duration, end_reason=reached.otherwise(polars.lit("a guard"))
    )


def read_study(path: Path, small: bool = False) -> Study:
    """Reads a study whose policies are trained for a motor lag and a latency, and flown.

    Args:
        path: of its TOML file.
        small: train one policy of each cell, with a third of the updates.

    Raises:
        InputError: see `studies.read_study`; or it flies no policies that it trains for both.
    """
    study = studies.read_study(path)
    if small:
        entries = [shorten_training(entry) for entry in study.entries]
        study = studies.of(entries, study.home, str(path))
    if not find_flown_tasks(study):
        raise InputError(
            f"{path}: no task flies policies that another one trains with set.motor_time_constant "
            "and set.latency. Give a study such as paper/settings/zero_shot.toml."
        )
    return study


def shorten_training(entry: Mapping[str, Any]) -> dict[str, Any]:
    """Returns an entry of a study that trains one policy, with a third of the updates."""
    if entry["kind"] != "train":
        return dict(entry)
    settings = {**entry.get("settings", {}), "policies": 1}
    if "updates" in settings:
        settings["updates"] = max(1, settings["updates"] // 3)
    return {**entry, "settings": settings}


def find_flown_tasks(study: Study) -> list[tuple[Task, Task]]:
    """Returns tasks that train policies of a cell, each with a task that flies them."""
    by_key = {task.key: task for task in study.tasks}
    pairs = [
        (by_key[task.inputs["policies"]], task)
        for task in study.tasks
        if task.kind == "transfer" and "policies" in task.inputs
    ]
    return [pair for pair in pairs if set(CELL) <= pair[0].settings["set"].keys()]


def gather_flights(study: Study, folder: Path) -> polars.DataFrame:
    """Gathers the flights of a study's results; writes `flights.csv` too.

    Returns:
        A row a flight, with the columns of `FLIGHTS`; its policy is called after its cell.
    """
    store, parts = Folder(folder), []
    tasks = find_flown_tasks(study)
    for trained, flight_rows in tasks:
        place = store.folder(flight_rows.key) / run_folder.TRANSFER / run_folder.FLIGHTS.name
        rows, _ = run_folder.FLIGHTS.read(place)
        control, drone = trained.settings["control"], trained.settings["set"]
        rate = trained.settings["rate"] or INTERFACES[control]().rate
        number = polars.col("policy").str.extract(r"(\d+)$").cast(polars.Int64)
        number += trained.settings["seed"] * trained.settings["policies"]
        delays = "_".join(f"{1e3 * drone[name]:g}ms" for name in CELL)
        cell = [
            polars.lit(control).alias("control"),
            polars.lit(rate, polars.Int64).alias("training_rate"),
            *(polars.lit(float(drone[name])).alias(name) for name in CELL),
            number.alias("number"),
        ]
        policy = polars.lit(f"{control}_{delays}/") + number.cast(polars.String)
        parts.append(rows.select(*cell, polars.all()).with_columns(policy.alias("policy")))
    flights = polars.concat(parts).with_columns(
        polars.int_range(1, polars.len() + 1).alias("flight")
    )
    drones = sorted({Path(trained.settings["drone"]).name for trained, _ in tasks})
    settings = {
        "drone": ", ".join(drones),
        "duration": min(flight_rows.settings["duration"] for _, flight_rows in tasks),
        "study": list(study.entries),
    }
    record = results.record(seed=None, inputs=[], settings=settings)
    table = FLIGHTS.write(folder / FLIGHTS.name, flights, record)
    manifest.append(folder, "transfer", {"flights": [table]}, record)
    return flights


def summarize_cells(flights: polars.DataFrame) -> polars.DataFrame:
    """Summarizes flight times by reality and cell.

    Returns:
        Policies, flights, mean and median flight time [s], and the share of flights that reach the
        time limit.
    """
    duration = polars.col("duration")
    return flights.group_by("reality", "control", *CELL, maintain_order=True).agg(
        polars.col("number").n_unique().alias("policies"),
        polars.len().alias("flights"),
        duration.mean().alias("mean"),
        duration.median().alias("median"),
        (polars.col("end_reason") == REACHED).mean().alias("share"),
    )


def print_cells(cells: polars.DataFrame) -> None:
    """Prints flight times: a row a reality, control structure and latency, a column a lag."""
    lags = cells["motor_time_constant"].unique().sort().to_list()
    rows = []
    order = {name: place for place, name in enumerate(cells["reality"].unique(maintain_order=True))}
    cells = cells.sort(polars.col("reality").replace_strict(order), maintain_order=True)
    for names, part in cells.group_by("reality", "control", "latency", maintain_order=True):
        reality, control, latency = names
        tables = {
            row["motor_time_constant"]: f"{row['mean']:.1f} s  {row['share']:4.0%}"
            for row in part.iter_rows(named=True)
        }
        times = (tables.get(lag, "") for lag in lags)
        rows.append([str(reality), str(control), f"{1e3 * float(str(latency)):g} ms", *times])
    title = (
        "Mean flight time and share of flights that reach the time limit, by what was trained for; "
        "simulated"
    )
    columns = ["reality", "control", "latency", *(f"T_m {1e3 * lag:g} ms" for lag in lags)]
    terminal.print_table(title, columns, rows)


def draw_chart(rows: dict[str, polars.DataFrame]) -> Figure:
    """Draws box plots of flight times: a panel a table and latency, a row a lag and structure.

    Args:
        rows: flights by what the table is called.
    """
    kinds = {kind: kind.replace("_", " ") for kind in COLOURS}
    lag, latency = (
        (1e3 * polars.col(name)).round(1).cast(polars.String).str.strip_suffix(".0")
        for name in ("motor_time_constant", "latency")
    )
    late = latency + " ms in training"
    names = polars.col("control").replace(kinds) + ", " + lag + " ms"
    order = polars.col("control").replace_strict({kind: n for n, kind in enumerate(COLOURS)})
    drawn = [
        flights.sort("latency", "motor_time_constant", order, maintain_order=True).select(
            names.alias("row"),
            polars.col("control").replace(COLOURS).alias("colour"),
            (polars.lit(f"{name}: latency ") + late).alias("panel"),
            *("duration", "end_reason"),
        )
        for name, flights in rows.items()
    ]
    title = "Zero-shot flight times by the motor time constant that policies were trained for"
    labels = {colour: kinds[kind] for kind, colour in COLOURS.items()}
    flight_rows = polars.concat(drawn)
    figure = flight_times(flight_rows, title, labels)
    panels_by_name = dict(
        zip(flight_rows["panel"].unique(maintain_order=True), figure.panels, strict=True)
    )
    every = polars.concat([flights.select("latency") for flights in rows.values()])
    columns = every.unique().sort("latency").select(late.alias("latency"))["latency"].to_list()
    # A table without flights of a latency has an empty panel in its place.
    empty = {**figure.panels[0], "data": {"values": []}}
    heads = [f"{name}: latency {each}" for name in rows for each in columns]
    panels = [{**panels_by_name.get(head, empty), "title": head} for head in heads]
    return dataclasses.replace(figure, panels=panels, columns=len(columns))


def main(arguments: Sequence[str] | None = None) -> None:
    """Trains, flies, writes and draws."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        help="folder of the study, for flights.csv and figure_4.svg too",
    )
    parser.add_argument(
        "--settings",
        type=Path,
        default=STUDY,
        help="a study, a TOML file (default: paper/settings/zero_shot.toml)",
    )
    parser.add_argument(
        "--small", action="store_true", help="one policy of each cell, trained for a third as long"
    )
    parser.add_argument("--authors", type=Path, help="folder of the authors' data with flights.csv")
    options = parser.parse_args(arguments)
    try:
        run(options.settings, options.small, options.authors, options.output)
    except InputError as error:
        parser.error(str(error))


def run(settings: Path, small: bool, authors: Path | None, output: Path) -> None:
    """Does all of it, for given arguments."""
    real = None if authors is None else read_published_flights(authors)
    study, output = read_study(settings, small), output.resolve()
    with terminal.Bar("figure 4") as bar, chdir(study.home):
        mf.sweep(
            study.entries,
            output,
            on_progress=lambda now: bar.move(
                now.done, now.tasks, f"{now.done} of {now.tasks} tasks"
            ),
        )
    flights = gather_flights(study, output)
    rows = {str(name): part for (name,), part in flights.group_by("reality", maintain_order=True)}
    results.write(
        output / "figure_4.svg",
        picture.svg(draw_chart(rows if real is None else {**rows, "real": real})),
    )
    print_cells(summarize_cells(flights))


if __name__ == "__main__":
    main()
