"""The paper's zero-shot experiment: policies trained for many motors, flown in an unseen reality.

`python paper/figure_4.py -o zero_shot` trains policies of each control structure, at its own rate,
around drones of each motor lag (40, 80 and 120 ms) and latency (0, 15 and 20 ms), three seeds each,
and flies each of the 81 policies three times in a virtual reality: 243 flights of at most 20 s,
ended by the paper's guards. It is what `maidenflight transfer --matrix paper/zero_shot.toml -o
zero_shot` does, whose table `flights.csv` has a row a flight, and draws `figure_4.svg` from that
table: flight times by lag, a panel a latency. `--authors ../shared/data/authors` draws the
published real flights below. Stopped, it goes on where it was by the same command, and where the
table is there already it only draws; `--small` trains one policy of each cell, for a third as long,
for a look.

Source: Gronauer et al. 2022, sec. Zero-Shot Experiments, fig:experiments:zero-shot.
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import polars

from maidenflight import compiler, results, terminal, workflow
from maidenflight.errors import InputError
from maidenflight.experiments import matrix, matrix_file
from maidenflight.experiments.transfer import MAX_DURATION_S
from maidenflight.reporting import svg
from maidenflight.reporting.flight_figures import COLOURS
from maidenflight.reporting.svg import Panel
from maidenflight.terminal import flight_output

SETTINGS = Path(__file__).with_name("zero_shot.toml")


def published(folder: Path) -> polars.DataFrame:
    """The paper's real flights: control, motor_time_constant, latency, duration.

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
    return own.rename(renamed).with_columns(polars.col("duration").clip(upper_bound=MAX_DURATION_S))


SIDE, HIGH = 280, 190
"""Of a panel [px]."""


def chart(rows: dict[str, polars.DataFrame]) -> str:
    """Box plots of flight times as SVG: a row per table, a panel per latency, colours by structure.

    Boxes reach from the lower to the upper quartile, their line is the median, dots are flights.
    """
    samples = [
        (svg.stroke("M0 6H24", "line", colour), kind.replace("_", " "))
        for kind, colour in COLOURS.items()
    ]
    first = next(iter(rows.values()))
    lags, latencies = (
        first[name].unique().sort().to_list() for name in ("motor_time_constant", "latency")
    )
    wide = max(3, len(latencies)) * SIDE
    legend, tall = svg.legend(svg.TITLE, wide, samples)
    parts, top = [legend], svg.TITLE + tall + 30
    for named, flights in rows.items():
        for column, latency in enumerate(latencies):
            panel = Panel(
                column * SIDE + 48,
                top,
                SIDE - 62,
                HIGH,
                (-0.5, len(lags) - 0.5),
                (0.0, 1.03 * MAX_DURATION_S),
            )
            outside, _ = svg.axes(panel, None, "flight time [s]" if column == 0 else "")
            parts += [
                outside,
                svg.text(
                    panel.left,
                    top - 9,
                    f"{named}: latency {1e3 * latency:g} ms in training",
                    "strong",
                ),
            ]
            for place, lag in enumerate(lags):
                parts.append(
                    svg.text(
                        panel.left + float(panel.across(place)),
                        top + HIGH + 17,
                        f"{1e3 * lag:g}",
                        "",
                        "middle",
                    )
                )
            parts.append(
                svg.text(
                    panel.left + panel.width / 2,
                    top + HIGH + 36,
                    f"{svg.symbol('motor_time_constant')} [ms]",
                    "",
                    "middle",
                )
            )
            parts.append(
                svg.framed(
                    panel, _boxes(panel, flights, lags, latency), f"{named} {1e3 * latency:g}"
                )
            )
        top += HIGH + 82
    return svg.picture(
        wide, top - 30, "Zero-shot flight times by the drone that policies were trained for", parts
    )


def _boxes(
    panel: Panel, flights: polars.DataFrame, lags: Sequence[float], latency: float
) -> Iterator[str]:
    for place, lag in enumerate(lags):
        for shift, (kind, colour) in zip((-0.27, 0.0, 0.27), COLOURS.items(), strict=True):
            near = (polars.col("latency") - latency).abs() + (
                polars.col("motor_time_constant") - lag
            ).abs() < 1e-4
            times = flights.filter(near & (polars.col("control") == kind))["duration"].to_numpy()
            if len(times) == 0:
                continue
            low, middle, high = np.quantile(times, [0.25, 0.5, 0.75])
            (left, top), (right, bottom) = (
                panel.at(place + shift - 0.1, high),
                panel.at(place + shift + 0.1, low),
            )
            yield svg.fill(
                f"M{left:.1f} {top:.1f}H{right:.1f}V{bottom:.1f}H{left:.1f}Z", "faint", colour
            )
            yield svg.stroke(
                f"M{left:.1f} {panel.at(0, middle)[1]:.1f}H{right:.1f}", "line", colour
            )
            scatter = place + shift + 0.08 * np.linspace(-1, 1, len(times))
            yield svg.dots(panel, scatter, np.sort(times), "dots", colour)


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
        help="folder for policies, flights.csv and figure_4.svg",
    )
    parser.add_argument(
        "--settings",
        type=Path,
        default=SETTINGS,
        help="of the matrix, a TOML file (default: paper/zero_shot.toml)",
    )
    parser.add_argument(
        "--small", action="store_true", help="one policy of each cell, trained for a third as long"
    )
    parser.add_argument("--authors", type=Path, help="folder of the authors' data with flights.csv")
    given = parser.parse_args(arguments)
    try:
        run(given.settings, given.small, given.authors, given.output)
    except InputError as error:
        parser.error(str(error))


def run(settings: Path, small: bool, authors: Path | None, output: Path) -> None:
    """All of it, for given arguments."""
    real = None if authors is None else published(authors)
    asked = matrix_file.read(settings)
    asked = asked.sketch() if small else asked
    with terminal.progress("figure 4", len(asked.rows)) as move:
        flights = workflow.transfer_matrix(asked, output, move)
    drawn = {str(name): part for (name,), part in flights.group_by("reality", maintain_order=True)}
    results.write(
        output / "figure_4.svg", chart(drawn if real is None else {**drawn, "real": real})
    )
    flight_output.cells(matrix.by_cell(flights, asked.duration))


if __name__ == "__main__":
    compiler.prepare_jax(fused=True)
    main()
