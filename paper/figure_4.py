"""The paper's zero-shot experiment: policies trained for many motors, flown in a reality that none of them has seen.

`python paper/figure_4.py -o zero_shot` trains policies of each control structure, at its own rate, around drones of each motor lag (40, 80
and 120 ms) and latency (0, 15 and 20 ms), three seeds each, and flies each of the 81 policies three times in a virtual reality: 243 flights
of at most 20 s, ended by the paper's guards. It writes `flights.csv` with a row a flight and `figure_4.svg`, flight times by lag, a panel a
latency. `--authors ../shared/data/authors` draws the published real flights below. Stopped, it goes on where it was by the same command;
`--small` trains one seed of each for a look.

Source: Gronauer et al. 2022, sec. Zero-Shot Experiments, fig:experiments:zero-shot.
"""

import argparse
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace as replaced
from pathlib import Path
from typing import NamedTuple

import jax

if __name__ == "__main__":  # a core is a device
    jax.config.update("jax_num_cpu_devices", len(os.sched_getaffinity(0)))

import numpy as np
import polars

from maidenflight import parameters, policy, results, terminal, workflow
from maidenflight.errors import InputError
from maidenflight.experiments.transfer import LONGEST, transfer
from maidenflight.parameters import Parameters, replace
from maidenflight.policy import Policy
from maidenflight.reporting import svg
from maidenflight.reporting.svg import Panel
from maidenflight.simulator import control, tasks
from maidenflight.simulator.randomization import relative_box
from maidenflight.simulator.virtual_drone import VirtualDrone
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.train import recorded, train

LAGS, LATENCIES = (0.040, 0.080, 0.120), (0.0, 0.015, 0.020)
"""T_m and latency of the drones that policies are trained for [s]."""
RANDOMIZATION = 0.10
"""Half width of the box about each of them."""
QUICK = {
    "pwm": AnalyticGradient(updates=800),
    "attitude_rate": AnalyticGradient(updates=600, horizon=32),
    "attitude": AnalyticGradient(updates=600, horizon=32),
}
"""Settings of training, by control structure: half as long as the command line's, or less."""
COLOURS = {"pwm": "blue", "attitude_rate": "orange", "attitude": "green"}


class Cell(NamedTuple):
    """What some policies are trained for."""

    control: str
    motor_time_constant: float
    latency: float

    @property
    def name(self) -> str:
        """Of the folder of its policies."""
        return f"{self.control}_{1e3 * self.motor_time_constant:g}ms_{1e3 * self.latency:g}ms"

    def drone(self, nominal: Parameters) -> Parameters:
        """The drone in the middle of the training box, in steps that fit the control structure."""
        drone = replace(nominal, motor_time_constant=np.float32(self.motor_time_constant), latency=np.float32(self.latency))
        return control.in_fitting_steps(drone, control.CONTROLLERS[self.control]())


MATRIX = [Cell(kind, lag, latency) for kind in QUICK for lag in LAGS for latency in LATENCIES]


def trained(cell: Cell, nominal: Parameters, settings: AnalyticGradient, seeds: int, seed: int, folder: Path) -> list[Policy]:
    """Policies of a cell: those that the folder holds, or new ones that it holds then.

    Raises:
        InputError: the folder holds policies of other settings.
    """
    files = [folder / cell.name / f"policy_{number}.json" for number in range(1, seeds + 1)]
    said = {**cell._asdict(), "randomization": RANDOMIZATION, "policies": seeds, **recorded(settings)}
    made = results.record(seed=seed, inputs=[], settings=said)
    if not all(path.exists() for path in files):
        # What a cell's policies are depends neither on the other cells nor on what an interrupted run left.
        keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), MATRIX.index(cell)), seeds)
        box = relative_box(cell.drone(nominal), RANDOMIZATION)
        learned = train(tasks.circle(), control.CONTROLLERS[cell.control](), box, keys, settings)
        for path, one in zip(files, learned, strict=True):
            policy.write(path, one, made)
    for path in files:
        if json.loads(path.read_text(encoding="utf-8"))["record"] != json.loads(json.dumps(made)):
            raise InputError(f"{path}: from a run with other settings or of another version. Choose another folder with -o.")
    return [policy.read(path) for path in files]


def flown(
    policies: dict[Cell, list[Policy]], realities: Sequence[VirtualDrone], trials: int, duration: float, seed: int
) -> polars.DataFrame:
    """A row a flight: the policy's control structure, lag and latency in training [s], its number, and what `transfer` tells."""
    tables = []
    for number, kind in enumerate(dict.fromkeys(cell.control for cell in policies)):
        own = [(cell, place, one) for cell, several in policies.items() if cell.control == kind for place, one in enumerate(several, 1)]
        names = [f"{cell.name}/policy_{place}" for cell, place, _ in own]
        key = jax.random.fold_in(jax.random.key(seed), number)
        table = transfer([one for *_, one in own], realities, trials, key, duration=duration, names=names).table.drop("flight")
        told = polars.DataFrame(
            [{"policy": name, **cell._asdict(), "number": place} for name, (cell, place, _) in zip(names, own, strict=True)]
        )
        tables.append(told.join(table, on="policy", maintain_order="left").drop("policy"))
    return polars.concat(tables)


def published(folder: Path) -> polars.DataFrame:
    """The paper's real flights as far as they are given: control, motor_time_constant, latency, duration.

    Raises:
        InputError: the folder lacks `flights.csv`.
    """
    try:
        flights = polars.read_csv(folder / "flights.csv")
    except OSError as error:
        raise InputError(f"{folder}: not the authors' data ({error}). Give the folder with flights.csv.") from error
    own = flights.filter(polars.col("in_paper").cast(polars.Int64) == 1)
    renamed = {"trained_motor_time_constant_s": "motor_time_constant", "trained_latency_s": "latency", "flight_time_s": "duration"}
    return own.rename(renamed).with_columns(polars.col("duration").clip(upper_bound=LONGEST))


SIDE, HIGH = 280, 190
"""Of a panel [px]."""


def chart(rows: dict[str, polars.DataFrame]) -> str:
    """Box plots of flight times as SVG: a row of panels for each table, a panel a latency, a colour a control structure.

    Boxes reach from the lower to the upper quartile, their line is the median, dots are flights.
    """
    samples = [(svg.stroke("M0 6H24", "line", colour), kind.replace("_", " ")) for kind, colour in COLOURS.items()]
    legend, tall = svg.legend(svg.TITLE, 3 * SIDE, samples)
    parts, top = [legend], svg.TITLE + tall + 30
    for named, flights in rows.items():
        for column, latency in enumerate(LATENCIES):
            panel = Panel(column * SIDE + 48, top, SIDE - 62, HIGH, (-0.5, len(LAGS) - 0.5), (0.0, 1.03 * LONGEST))
            outside, _ = svg.axes(panel, None, "flight time [s]" if column == 0 else "")
            parts += [outside, svg.text(panel.left, top - 9, f"{named}: trained for {1e3 * latency:g} ms", "strong")]
            for place, lag in enumerate(LAGS):
                parts.append(svg.text(panel.left + float(panel.across(place)), top + HIGH + 17, f"{1e3 * lag:g}", "", "middle"))
            parts.append(svg.text(panel.left + panel.width / 2, top + HIGH + 36, f"{svg.symbol('motor_time_constant')} [ms]", "", "middle"))
            parts.append(svg.framed(panel, _boxes(panel, flights, latency), f"{named} {1e3 * latency:g}"))
        top += HIGH + 82
    return svg.picture(3 * SIDE, top - 30, "Zero-shot flight times by the drone that policies were trained for", parts)


def _boxes(panel: Panel, flights: polars.DataFrame, latency: float) -> Iterator[str]:
    for place, lag in enumerate(LAGS):
        for shift, (kind, colour) in zip((-0.27, 0.0, 0.27), COLOURS.items(), strict=True):
            near = (polars.col("latency") - latency).abs() + (polars.col("motor_time_constant") - lag).abs() < 1e-4
            times = flights.filter(near & (polars.col("control") == kind))["duration"].to_numpy()
            if len(times) == 0:
                continue
            low, middle, high = np.quantile(times, [0.25, 0.5, 0.75])
            (left, top), (right, bottom) = panel.at(place + shift - 0.1, high), panel.at(place + shift + 0.1, low)
            yield svg.fill(f"M{left:.1f} {top:.1f}H{right:.1f}V{bottom:.1f}H{left:.1f}Z", "faint", colour)
            yield svg.stroke(f"M{left:.1f} {panel.at(0, middle)[1]:.1f}H{right:.1f}", "line", colour)
            scatter = place + shift + 0.08 * np.linspace(-1, 1, len(times))
            yield svg.dots(panel, scatter, np.sort(times), "dots", colour)


_SHORT = {"motor_time_constant": "T_m", "latency": "latency"}


def cell_table(flights: polars.DataFrame) -> polars.DataFrame:
    """Mean and median flight time and the share that reaches the time limit, a row a cell."""
    duration = polars.col("duration")
    told = [duration.mean().alias("mean [s]"), duration.median().alias("median [s]"), (duration >= LONGEST).mean().alias("share of 20 s")]
    cell = ["control", *((1e3 * polars.col(name)).round(1).alias(f"{short} [ms]") for name, short in _SHORT.items())]
    return flights.group_by(cell, maintain_order=True).agg(*told)


def main(arguments: Sequence[str] | None = None) -> None:
    """Trains, flies, writes and draws."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for policies, flights.csv and figure_4.svg")
    parser.add_argument("--drone", default="crazyflie", help="drone whose other parameters are kept: a name or a TOML file")
    parser.add_argument("--reality", action="append", help="where to fly, as `maidenflight transfer` takes it; may be repeated (virtual:7)")
    parser.add_argument("--control", action="append", choices=list(QUICK), help="a control structure; may be repeated (all three)")
    parser.add_argument("--seeds", type=int, default=3, help="policies of each cell (default: 3)")
    parser.add_argument("--trials", type=int, default=3, help="flights of each policy (default: 3)")
    parser.add_argument("--duration", type=float, default=LONGEST, help="longest flight, seconds (default: %(default)g)")
    parser.add_argument("--updates", type=int, help="of training, for all control structures")
    parser.add_argument("--small", action="store_true", help="one policy of each cell, trained for a third as long")
    parser.add_argument("--authors", type=Path, help="folder of the authors' data with flights.csv")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(arguments)
    try:
        run(given)
    except InputError as error:
        parser.error(str(error))


def settings_of(given: argparse.Namespace, kind: str) -> AnalyticGradient:
    """Settings of training for a control structure."""
    settings = QUICK[kind]
    updates = given.updates or (settings.updates // 3 if given.small else settings.updates)
    return replaced(settings, updates=updates)


def run(given: argparse.Namespace) -> None:
    """All of it, for given arguments."""
    nominal = parameters.read(given.drone)
    realities = [workflow.reality(name) for name in given.reality or ["virtual:7"]]
    real = published(given.authors) if given.authors else None
    chosen = [cell for cell in MATRIX if cell.control in (given.control or QUICK)]
    policies: dict[Cell, list[Policy]] = {}
    with terminal.progress("figure 4", len(chosen)) as move:
        for number, cell in enumerate(chosen):
            move(number, len(chosen), f"training {cell.name}")
            seeds = 1 if given.small else given.seeds
            policies[cell] = trained(cell, nominal, settings_of(given, cell.control), seeds, given.seed, given.output / "policies")
        move(len(chosen), len(chosen), "flying")
        flights = flown(policies, realities, given.trials, given.duration, given.seed)
    made = results.record(
        seed=given.seed,
        inputs=[],
        settings={"drone": given.drone, "realities": [one.name for one in realities], "trials": given.trials, "duration": given.duration},
    )
    results.write(given.output / "flights.csv", f"{_FLIGHTS}\n# record: {json.dumps(made)}\n{flights.write_csv()}")
    drawn = {one.name: flights.filter(polars.col("reality") == one.name) for one in realities}
    results.write(given.output / "figure_4.svg", chart(drawn if real is None else {**drawn, "real": real}))
    with polars.Config(tbl_cols=-1, tbl_rows=-1, tbl_width_chars=200, float_precision=2, tbl_hide_column_data_types=True):
        print(cell_table(flights))


_FLIGHTS = (
    "# maidenflight zero-shot flights 1: simulated, a row a flight; motor_time_constant and latency of the drone trained for, duration s,"
)
_FLIGHTS += " position_error m"

if __name__ == "__main__":
    main()
