"""The paper's hypothesis as a statistic: whether low-level control needs higher fidelity.

`python paper/hypothesis.py zero_shot/flights.csv zero_shot_100hz/flights.csv --authors
../shared/data/authors -o hypothesis` reads tables of zero-shot flights, as `figure_4.py` writes
them, and the published real ones. It asks how flight time falls with the distance between the drone
that a policy was trained for and the one that it flies, and whether it falls more steeply for PWM
than for attitude-rate and attitude policies: with policies that fly at the rate of their training,
and with those trained at one rate and flown at another, as the authors' were. It prints tables and
verdicts, and writes `statistics.csv` and `hypothesis.svg`.

Distance is told by one number, the total lag from command to thrust as a policy sees it
(`total_lag`), because flights determine the sum of motor lag and latency well and its parts badly
(docs/identification.md). It is used twice: `lag` is that of training less that of the reality, with
its sign, and `distance` is its size. Both mislead somewhere. `distance` takes too much lag in
training for as bad as too little, and `lag` takes it for good: on the real drone policies trained
for 140 ms, 50 ms too much, are among the best. Neither tells latency from motor lag, which is why
slopes with each of the two stand beside them.

The unit is the policy, with its mean flight time. Intervals are 95 % by bootstrap over the policies
of each control structure (percentiles: unlike BCa they exist where a whole structure falls at once
or never falls; on 300 synthetic data sets of 9, 18 and 27 policies, cut at 20 s, they held the
slope in 93, 90 and 91 %). Policies are not redrawn cell by cell: with three in a cell variances
would come out a third too small, and it would not count that the means of cells need not lie on a
line. For that the cells themselves are redrawn beside it.

Flights are cut at 20 s, and none is shorter than a fall takes. So mean flight times saturate at
both ends: where most policies of a structure reach 20 s, or fall at once, its slope comes out too
flat. The share of flights that reach 20 s does not depend on how long those would have lasted, and
rank correlations depend on order alone; both stand beside the slopes.

Source: Gronauer et al. 2022, sec. Methods, sec. Zero-Shot Experiments and sec. Discussion
(Control-level Hypothesis).
"""

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars
from hypothesis_data import (
    IDENTIFIED,
    REAL,
    Data,
    average_policies,
    group_policies,
    join_tables,
    read_real_flights,
    read_simulated_flights,
    total_lag,
)
from hypothesis_statistics import (
    DISTANCES,
    FEWEST,
    PAIRS,
    SHARE,
    TIME,
    TITLES,
    WORST,
    Line,
    Measure,
    compute_statistics,
    describe_ranking,
    format_estimate,
    has_enough,
    judge_attitude,
    judge_slopes,
    look_up,
    rate_pairs,
    slope,
    tabulate,
    take_sample,
)

from maidenflight import parameters, results, terminal
from maidenflight.errors import InputError
from maidenflight.experiments.drones import find_reality
from maidenflight.experiments.transfer import MAX_DURATION_S
from maidenflight.parameters import replace
from maidenflight.reporting.figures import charts, picture
from maidenflight.reporting.figures.charts import Entry, Figure, Spec
from maidenflight.reporting.figures.flight_times import COLOURS
from maidenflight.simulator.controllers.interface import CONTROLS
from maidenflight.simulator.realities.virtual_drone import VirtualDrone

COLUMNS = 3
NOTE = (
    "A dot is a policy, a ring one that was trained without latency; lines are those of least "
    "squares."
)


def draw_chart(groups: Sequence[Data]) -> Figure:
    """Flight times over the difference of lag between training and reality.

    A panel per data set, a colour per structure, a dot per policy.
    """
    legend = [Entry(kind.replace("_", " "), colour, "line") for kind, colour in COLOURS.items()]
    excess = [1e3 * (data.policies["trained"].to_numpy() - data.total_lag) for data in groups]
    across = charts.margin([0.0, *np.concatenate(excess)])
    return Figure(
        "Flight time by the lag that policies were trained for",
        [_panel(data, across) for data in groups],
        legend,
        columns=min(COLUMNS, len(groups)),
    )


def _panel(data: Data, across: tuple[float, float]) -> Spec:
    rows: list[Spec] = []
    for shift, (kind, colour) in zip((-1.2, 0.0, 1.2), COLOURS.items(), strict=True):
        x, y = take_sample(data, kind, Measure("slope", TIME, "lag"))
        if len(x) == 0:
            continue
        common = {"series": kind, "colour": charts.paint(colour)}
        rows += [
            {
                **common,
                "kind": "line",
                "x": 10.0 * end,
                "y": y.mean() + slope(x, y) * (end - x.mean()),
            }
            for end in (x.min(), x.max())
        ]
        none = data.policies.filter(control=kind)["latency"].to_numpy() == 0.0
        rows += [
            {**common, "kind": "policy", "x": 10.0 * lag + shift, "y": time}
            | {"fill": charts.paint("paper") if hollow else common["colour"]}
            for lag, time, hollow in zip(x, y, none, strict=True)
        ]
    x = charts.number("x", "excess of lag in training [ms]", **charts.within(*across))
    ends = charts.within(-0.03 * MAX_DURATION_S, 1.03 * MAX_DURATION_S)
    colour, fill = (
        {"field": name, "type": "nominal", "scale": None} for name in ("colour", "fill")
    )
    place = {"x": x, "y": charts.number("y", "flight time [s]", **ends), "stroke": colour}
    zero = {"type": "rule", "strokeDash": [7, 4]}
    line = {"type": "line", "clip": True, "strokeWidth": 2}
    dot = {"type": "point", "size": 30, "opacity": 1, "strokeWidth": 1.4}
    layers: list[Spec] = [
        {"data": {"values": [{"x": 0}]}, "mark": zero, "encoding": {"x": x}},
        charts.layer("line", line, **place),
        charts.layer("policy", dot, **place, fill=fill),
    ]
    title = [data.name, f"its total lag: {1e3 * data.total_lag:.0f} ms"]
    return charts.panel(charts.rows(rows), layers, title=title, height=210, zooms=())


def print_results(groups: Sequence[Data], lines: Sequence[Line]) -> None:
    """Prints tables and verdicts."""
    for data in groups:
        rows = []
        for measure, title in TITLES.items():
            shares = (
                look_up(lines, data.name, kind, less, measure)
                for kind, less in (*((kind, "") for kind in CONTROLS), *PAIRS)
            )
            rows.append(
                [
                    title,
                    *("" if line is None else format_estimate(line.estimate) for line in shares),
                ]
            )
        counts = [data.policies.filter(polars.col("control") == kind) for kind in CONTROLS]
        rows.append(
            [
                "policies, flights",
                *(f"{part.height}, {part['flights'].sum()}" for part in counts),
                *("" for _ in PAIRS),
            ]
        )
        title = (
            f"{data.name}; total lag of the drone flown {1e3 * data.total_lag:.1f} ms; 95 % "
            "intervals"
        )
        terminal.print_table(
            title, ["", *CONTROLS, *(f"{kind} - {other}" for kind, other in PAIRS)], rows
        )
    print(
        "Low-level control needs higher fidelity: flight time falls more steeply for pwm than for "
        "attitude_rate and attitude."
    )
    for data in groups:
        for against in DISTANCES:
            print(
                f"  {data.name}, by {against}: "
                f"{judge_slopes(lines, data.name, Measure('slope', TIME, against))}"
            )
            checks = {
                SHARE: Measure("slope", SHARE, against),
                "cells redrawn": Measure("slope", TIME, against, "cell"),
            }
            print(
                "    "
                + "; ".join(
                    f"{name}: {judge_slopes(lines, data.name, one).split(' (')[0]}"
                    for name, one in checks.items()
                )
            )
    print("Attitude control is the worst, in mean flight time.")
    for data in groups:
        print(f"  {data.name}: attitude is {WORST[judge_attitude(lines, data.name)]}.")
    if rate_pairs(groups):
        print("What of it is due to training at another rate than that of flight.")
    for matching, other in rate_pairs(groups):
        print(f"  {describe_ranking(lines, matching, other)}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Reads, prints, writes and draws."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "tables",
        nargs="*",
        type=Path,
        help="flights.csv of figure_4.py",
    )
    parser.add_argument("--authors", type=Path, help="folder of the authors' data with flights.csv")
    parser.add_argument(
        "--drone",
        help="the real drone, identified, a TOML file (default: its values in "
        "docs/identification.md)",
    )
    parser.add_argument(
        "--nominal",
        default="crazyflie",
        help="drone of the training: a name or a TOML file (default: %(default)s)",
    )
    parser.add_argument(
        "--reality",
        action="append",
        default=[],
        metavar="NAME=WHAT",
        help="what a table's reality is: virtual:7, a TOML file",
    )
    parser.add_argument(
        "--lag",
        action="append",
        default=[],
        metavar="NAME=S",
        help="total lag of a reality (real: the authors'), seconds",
    )
    parser.add_argument(
        "--least-latency",
        type=float,
        default=0.0,
        metavar="S",
        help="leave out policies trained for less, seconds",
    )
    parser.add_argument(
        "--resamples", type=int, default=9999, help="of the bootstrap (default: %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        help="folder for statistics.csv and hypothesis.svg",
    )
    options = parser.parse_args(arguments)
    try:
        run(options)
    except InputError as error:
        parser.error(str(error))


def read_pairs(texts: Sequence[str], option: str) -> dict[str, str]:
    """What options of the form NAME=VALUE say.

    Raises:
        InputError: one is of another form.
    """
    parts = [entry.partition("=") for entry in texts]
    wrong = [
        entry for entry, (name, _, value) in zip(texts, parts, strict=True) if not name or not value
    ]
    if wrong:
        raise InputError(
            f"{option} {wrong[0]}: expected NAME=VALUE, with the name that the table gives the "
            "reality."
        )
    return {name: value for name, _, value in parts}


def find_lags(realities: Sequence[str], options: argparse.Namespace) -> dict[str, float]:
    """Total lag [s] of each reality that is flown in: as given, or of its parameters.

    Raises:
        InputError: a lag is not a positive number, or nothing is known of a reality.
    """
    lags, places = read_pairs(options.lag, "--lag"), read_pairs(options.reality, "--reality")
    unused = [name for name in (*lags, *places) if name not in realities]
    if unused:
        raise InputError(f"no flight in {unused[0]}; there are flights in {', '.join(realities)}.")
    lag_by_reality = {}
    for name in realities:
        if name in lags:
            try:
                lag_by_reality[name] = float(lags[name])
            except ValueError:
                lag_by_reality[name] = math.nan
            if not 0.0 < lag_by_reality[name] < 1.0:
                raise InputError(
                    f"--lag {name}={lags[name]}: expected seconds, such as {name}=0.09."
                )
        elif name == REAL:
            lag_by_reality[name] = total_lag(
                parameters.read_drone(options.drone)
                if options.drone
                else replace(parameters.crazyflie(), **IDENTIFIED)
            )
        else:
            kind, _, seed = name.rpartition(":")
            try:
                # PyBullet is another engine for the same constants, and need not be installed to
                # ask for them.
                what = places.get(name, f"{'virtual' if kind == 'pybullet' else kind}:{seed}")
                place = find_reality(what)
                if not isinstance(place, VirtualDrone):
                    raise InputError(f"{what} has no parameters.")
                lag_by_reality[name] = total_lag(place.parameters)
            except InputError as error:
                raise InputError(
                    f"reality {name} is unknown ({error}) Give --reality {name}=FILE.toml or "
                    f"--lag {name}=SECONDS."
                ) from error
    return lag_by_reality


def run(options: argparse.Namespace) -> None:
    """All of it, for given arguments."""
    if not options.tables and options.authors is None:
        raise InputError("nothing to read. Give tables of flights, --authors, or both.")
    if options.resamples < 100:
        raise InputError(f"--resamples {options.resamples}: an interval of 95 % takes 100 or more.")
    nominal, parts = parameters.read_drone(options.nominal), []
    if options.tables:
        flights = join_tables(
            [read_simulated_flights(path, options.nominal) for path in options.tables]
        )
        if REAL in flights["reality"]:
            raise InputError(
                f"a table's reality is called {REAL}, as the authors' flights are. Give it "
                "another name."
            )
        parts.append(average_policies(flights, nominal))
    if options.authors is not None:
        parts.append(average_policies(read_real_flights(options.authors), parameters.crazyflie()))
    policies = polars.concat(
        [part.select(sorted(part.columns)) for part in parts], how="vertical_relaxed"
    )
    lags = find_lags(policies["reality"].unique(maintain_order=True).to_list(), options)
    groups = group_policies(
        policies.filter(polars.col("latency") > options.least_latency - 1e-6), lags
    )
    if not any(has_enough(data, kind) for data in groups for kind in CONTROLS):
        raise InputError(
            f"no control structure has {FEWEST} policies of at least 3 lags. Give more flights."
        )
    lines = compute_statistics(groups, options.resamples, options.seed)
    inputs = [
        *options.tables,
        *([options.authors / "flights.csv"] if options.authors else []),
        *([options.drone] if options.drone else []),
    ]
    settings: dict[str, Any] = {
        "total_lag": {name: round(lag, 6) for name, lag in lags.items()},
        "resamples": options.resamples,
    }
    settings |= {"nominal": Path(options.nominal).name, "least_latency": options.least_latency}
    record = results.record(seed=options.seed, inputs=inputs, settings=settings)
    text = results.table_text(_STATISTICS, record, tabulate(lines).write_csv())
    results.write(options.output / "statistics.csv", text)
    results.write(options.output / "hypothesis.svg", picture.svg(draw_chart(groups), note=NOTE))
    print_results(groups, lines)


_STATISTICS = (
    "# maidenflight hypothesis 1: slopes of flight time with the lag that policies were trained "
    "for; low and high are 95 % by bootstrap;"
    " less: a control structure or data set whose value is taken off"
)

if __name__ == "__main__":
    main()
