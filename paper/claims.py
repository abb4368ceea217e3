"""Judge the claims of the paper by the results of its studies, a column a set of results.

`python paper/claims.py --results gradients=FOLDER --results PPO=FOLDER --authors
../shared/data/authors` prints a Markdown table: a row a claim, with the figure that decides it. A
folder holds what the studies write with these names as `-o`; what is absent stays empty:
`zero_shot` (figure_4.py), `ablations` (ablations.py), `history.csv` (history_and_hidden.py) and
`table_2` (table_2.py). The authors' real flights decide the claims on flight times. `--page FILE`
puts the table between the marks of a page, and `--figure FILE` draws the flight times of all
columns below each other. `make paper` runs the studies and this.

Source: Gronauer et al. 2022, sec. Experimental Results and Discussion.
"""

import argparse
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import polars
from ablation_effects import find_effects
from ablation_variants import BASELINE, ITSELF, PARTS
from figure_4 import draw_chart, read_published_flights
from table_2 import PAPER

from maidenflight import results
from maidenflight.errors import InputError
from maidenflight.reporting.figures import picture

NEAR = {"motor_time_constant": 0.08, "latency": 0.02}
"""The cell closest to the identified parameters [s]."""
BEGIN, END = "<!-- claims -->", "<!-- end of claims -->"
"""Marks of a page that hold the table between them."""
REPRODUCED, NOT_SEEN, OPPOSITE = "reproduced", "not seen", "the opposite"


class Finding(NamedTuple):
    """What results say of a claim."""

    figure: str
    verdict: str


class Claim(NamedTuple):
    """A claim, and how the table of a study decides it."""

    words: str
    table: str
    """A name in `TABLES`."""
    judge: Callable[[polars.DataFrame], Finding]


def judge_order(values: Mapping[str, float], expected: str, unit: str, best: bool) -> Finding:
    """Judges whether the expected one has the largest value, or the smallest, or the other end.

    Args:
        values: by name.
        expected: a name.
        unit: of the values, to print.
        best: whether the claim is of the largest value.
    """
    order = sorted(values, key=lambda name: values[name], reverse=best)
    figure = ", ".join(f"{name.replace('_', ' ')} {values[name]:.1f}" for name in order)
    place = order.index(expected)
    verdict = REPRODUCED if place == 0 else OPPOSITE if place == len(order) - 1 else NOT_SEEN
    return Finding(f"{figure} {unit}".rstrip(), verdict)


def average_cells(flights: polars.DataFrame) -> polars.DataFrame:
    """Returns the mean flight time [s] of each cell and control structure."""
    return flights.group_by("control", *NEAR).agg(polars.col("duration").mean())


def mean_times(flights: polars.DataFrame) -> dict[str, float]:
    """Returns mean flight times [s] by control structure, each cell with the same weight."""
    means = average_cells(flights).group_by("control").agg(polars.col("duration").mean())
    return dict(means.sort("control").iter_rows())


def judge_latency_free_order(flights: polars.DataFrame, expected: str, best: bool) -> Finding:
    """Judges the order of control structures whose policies were trained without latency."""
    return judge_order(mean_times(flights.filter(polars.col("latency") == 0)), expected, "s", best)


def judge_nearest_cell(flights: polars.DataFrame) -> Finding:
    """Judges the median flight time of PWM policies of the cell nearest to what was identified."""
    near = flights.filter(
        polars.col("control") == "pwm",
        *((polars.col(name) - value).abs() < 1e-6 for name, value in NEAR.items()),
    )["duration"]
    middle = near.quantile(0.5)
    if middle is None:
        raise InputError("no PWM flight of a motor lag of 80 ms and a latency of 20 ms.")
    return Finding(f"median {middle:.1f} s", REPRODUCED if middle >= 19.95 else NOT_SEEN)


def judge_scatter(flights: polars.DataFrame) -> Finding:
    """Judges whether PWM's mean flight time varies most between cells."""
    scatter = average_cells(flights).group_by("control").agg(polars.col("duration").std())
    order = judge_order(dict(scatter.iter_rows()), "pwm", "s", best=True)
    return Finding(f"standard deviation over cells: {order.figure}", order.verdict)


def judge_latency(flights: polars.DataFrame) -> Finding:
    """Judges whether policies trained with latency fly longer, in every control structure."""
    without, late = (
        mean_times(flights.filter((polars.col("latency") == 0) == is_zero))
        for is_zero in (True, False)
    )
    figure = ", ".join(
        f"{name.replace('_', ' ')} {without[name]:.1f} to {late[name]:.1f} s" for name in late
    )
    gains = [late[name] - without[name] for name in late]
    return Finding(
        figure, REPRODUCED if min(gains) > 0 else OPPOSITE if max(gains) < 0 else NOT_SEEN
    )


def find_change(
    changes: polars.DataFrame, control: str, variant: str, reality: str = ITSELF
) -> tuple[float, float, float, float]:
    """Returns mean flight time, what a change makes of it, and the ends of that interval [s].

    Args:
        changes: what `ablation_effects.find_effects` returns.
        control: a control structure.
        variant: how its policies were trained.
        reality: where they flew.

    Raises:
        InputError: the table lacks these flights.
    """
    row = changes.filter(
        polars.col("control") == control,
        polars.col("variant") == variant,
        polars.col("reality") == reality,
        polars.col("measure") == "duration",
    )
    if row.is_empty():
        raise InputError(f"no flights of {control}, {variant}, {reality}.")
    return row.select("mean", "effect", "low", "high").row(0)


def judge_loss(changes: polars.DataFrame, control: str, variant: str) -> Finding:
    """Judges whether a change shortens flights, by its 95 % interval over policies."""
    mean, effect, low, high = find_change(changes, control, variant)
    verdict = REPRODUCED if high < 0 else OPPOSITE if low > 0 else NOT_SEEN
    ends = "" if math.isnan(low) else f" [{low:.1f}, {high:.1f}]"
    return Finding(f"{mean:.1f} s, {effect:+.1f}{ends}", verdict)


def judge_parts(changes: polars.DataFrame) -> Finding:
    """Judges whether PWM policies fly as long, to a second, with other propellers and motors."""
    gains = {name: find_change(changes, "pwm", BASELINE, name)[1] for name in PARTS}
    passes = [gain > -1.0 for gain in gains.values()]
    figure = ", ".join(f"{name} {gain:+.1f} s" for name, gain in gains.items())
    return Finding(figure, REPRODUCED if all(passes) else "mostly" if any(passes) else NOT_SEEN)


def judge_history(policies: polars.DataFrame) -> Finding:
    """Judges whether policies of two instants have the best return."""
    own = policies.filter(polars.col("hidden") == "50x50")
    means = own.group_by("history").agg(polars.col("episode_return").mean())
    named = {f"H = {history}": value for history, value in means.iter_rows()}
    return judge_order(named, "H = 2", "", best=True)


def judge_lengths(estimates: polars.DataFrame) -> Finding:
    """Judges whether T from 20 on moves the estimates no more than in the paper's table."""
    chosen = estimates.filter(
        polars.col("flights") == "virtual",
        polars.col("method") == "bayesian",
        polars.col("length") > min(PAPER),
    )
    parts, smaller = [], []
    for name in PAPER[min(PAPER)]:
        means = chosen.filter(polars.col("parameter") == name)["trial_mean"].to_list()
        theirs = [values[name][0] for length, values in PAPER.items() if length > min(PAPER)]
        scale, unit = (1.0, "") if name == "thrust_to_weight" else (1e3, " ms")
        parts.append(f"{name} {scale * min(means):.4g} to {scale * max(means):.4g}{unit}")
        smaller.append(max(means) - min(means) <= max(theirs) - min(theirs))
    return Finding(", ".join(parts), REPRODUCED if all(smaller) else NOT_SEEN)


TABLES = {
    "zero_shot": "zero_shot/flights.csv",
    "ablations": "ablations/flights.csv",
    "history": "history.csv",
    "table_2": "table_2/table_2.csv",
}
"""File of a study's table in a folder of results."""
CLAIMS = (
    Claim("The length T has only a minor impact", "table_2", judge_lengths),
    Claim(
        "PWM trained near the identified parameters flies a median of 20 s",
        "zero_shot",
        judge_nearest_cell,
    ),
    Claim(
        "Trained without latency PWM is the worst",
        "zero_shot",
        lambda flights: judge_latency_free_order(flights, "pwm", best=False),
    ),
    Claim(
        "Trained without latency attitude rate is the best",
        "zero_shot",
        lambda flights: judge_latency_free_order(flights, "attitude_rate", best=True),
    ),
    Claim(
        "Attitude rate is the most robust",
        "zero_shot",
        lambda flights: judge_order(mean_times(flights), "attitude_rate", "s", best=True),
    ),
    Claim(
        "Attitude is the worst",
        "zero_shot",
        lambda flights: judge_order(mean_times(flights), "attitude", "s", best=False),
    ),
    Claim("Low-level control needs the higher fidelity", "zero_shot", judge_scatter),
    Claim("Latency in training improves transfer", "zero_shot", judge_latency),
    Claim(
        "Accurate actuators are crucial: PWM without lag and latency in training",
        "ablations",
        lambda changes: judge_loss(changes, "pwm", "neither lag nor latency"),
    ),
    Claim(
        "Without penalties of actions transfer drops: PWM",
        "ablations",
        lambda changes: judge_loss(changes, "pwm", "neither penalty"),
    ),
    Claim(
        "Without penalties of actions transfer drops: attitude rate",
        "ablations",
        lambda changes: judge_loss(changes, "attitude_rate", "neither penalty"),
    ),
    Claim(
        "Attitude rates of +-360 deg/s do not work",
        "ablations",
        lambda changes: judge_loss(changes, "attitude_rate", "+-360 deg/s"),
    ),
    Claim("Policies tolerate changed propellers and motors", "ablations", judge_parts),
    Claim("A history of H = 2 is best", "history", judge_history),
)


def read_tables(folder: Path) -> dict[str, polars.DataFrame]:
    """Reads the studies' tables that a folder holds; of ablations the effects.

    Raises:
        InputError: it holds none.
    """
    paths = {name: folder / file for name, file in TABLES.items()}
    tables = {
        name: polars.read_csv(path, comment_prefix="#")
        for name, path in paths.items()
        if path.is_file()
    }
    if not tables:
        raise InputError(f"{folder}: holds none of {', '.join(TABLES.values())}.")
    if "ablations" in tables:
        tables["ablations"] = find_effects(tables["ablations"])
    return tables


def compare(columns: Mapping[str, Mapping[str, polars.DataFrame]]) -> str:
    """Returns the Markdown table of all claims.

    Args:
        columns: tables of studies, by the name of a set of results.
    """
    lines = [" | ".join(["| claim", *columns]) + " |", "|---" * (1 + len(columns)) + "|"]
    for claim in CLAIMS:
        cells = []
        for tables in columns.values():
            finding = claim.judge(tables[claim.table]) if claim.table in tables else None
            cells.append("-" if finding is None else f"**{finding.verdict}**: {finding.figure}")
        lines.append(" | ".join([f"| {claim.words}", *cells]) + " |")
    return "\n".join(lines)


def replace_table(page: str, table: str) -> str:
    """Returns a page with another table of claims.

    Raises:
        InputError: it does not hold both marks, in their order.
    """
    before, begin, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise InputError(f"the page holds no {BEGIN} and {END}. Add them where the table goes.")
    return f"{before}{BEGIN}\n{table}\n{END}{after}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Reads, judges, prints, and writes what is asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--results",
        action="append",
        required=True,
        metavar="NAME=FOLDER",
        help="a column and the folder of its results; may be repeated",
    )
    parser.add_argument("--authors", type=Path, help="folder of the authors' data with flights.csv")
    parser.add_argument("--page", type=Path, help=f"page with {BEGIN}, for the table")
    parser.add_argument("--figure", type=Path, help="SVG of flight times, for all columns")
    options = parser.parse_args(arguments)
    columns = {}
    for pair in options.results:
        name, mark, folder = pair.partition("=")
        if not mark:
            parser.error(f"--results {pair}: expected NAME=FOLDER, such as PPO=results_ppo.")
        columns[name] = read_tables(Path(folder))
    if options.authors is not None:
        columns["the authors' real flights"] = {
            "zero_shot": read_published_flights(options.authors)
        }
    table = compare(columns)
    print(table)
    if options.page is not None:
        results.write(options.page, replace_table(options.page.read_text("utf-8"), table))
    if options.figure is not None:
        flights = {name: one["zero_shot"] for name, one in columns.items() if "zero_shot" in one}
        results.write(options.figure, picture.svg(draw_chart(flights)))


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(f"error: {error}")
