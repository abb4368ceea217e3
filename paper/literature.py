"""Identified parameters beside what others measured, identified or assumed for a Crazyflie 2.

    python paper/literature.py run/drone.toml --truth run/reality.toml -o literature.svg

prints what the sources give and draws it. They differ with batteries, propellers, payloads and
methods, by more than any source says, and so show what is plausible, not what is true.
"""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

from maidenflight import results, terminal
from maidenflight.errors import InputError
from maidenflight.identification import drone_file
from maidenflight.identification.drone_file import Estimate
from maidenflight.parameters import component, crazyflie
from maidenflight.reporting import text
from maidenflight.reporting.figures import charts, intervals, picture
from maidenflight.reporting.figures.charts import Entry, Figure, Spec
from maidenflight.reporting.run import Run, true_ends

PAPER = "Gronauer et al. 2022"
_FOERSTER = "Förster 2015"
_LANDRY = "Landry 2015, as in gym-pybullet-drones"
_SECONDS = "Learning to Fly in Seconds 2024"
_DELAYS = "Eschmann et al. 2024, from flights"
_RL_TOOLS = "rl_tools"
_CRAZYFLOW = "crazyflow, load cell, with markers"
_SIMPLE = "SimpleFlight 2025"
_ROTORPY = "RotorPy 3.0"
_QUADSWARM = "QuadSwarm 2023"


_OTHERS: dict[str, dict[str, float]] = {
    "thrust_to_weight": {
        _LANDRY: 2.25,
        _SECONDS: 2.25,
        _DELAYS: 1.97,
        _ROTORPY: 1.95,
        _SIMPLE: 1.60,
        _CRAZYFLOW: 1.49,
        _RL_TOOLS: 1.47,
    },
    "motor_time_constant": {
        _SECONDS: 0.150,
        _CRAZYFLOW: 0.136,
        _DELAYS: 0.072,
        _ROTORPY: 0.072,
        _RL_TOOLS: 0.055,
        _QUADSWARM: 0.037,
        _SIMPLE: 0.025,
    },
    "spin_down_ratio": {_RL_TOOLS: 249 / 55, _CRAZYFLOW: 106 / 136},
    "inertia_x": {
        _CRAZYFLOW: 1.68e-5,
        _FOERSTER: 1.66e-5,
        _ROTORPY: 1.43e-5,
        _LANDRY: 1.4e-5,
        _SIMPLE: 1.4e-5,
        _DELAYS: 1.03e-5,
        _RL_TOOLS: 9.4e-6,
        _SECONDS: 3.85e-6,
    },
    "inertia_y": {_CRAZYFLOW: 1.68e-5, _FOERSTER: 1.67e-5, _ROTORPY: 1.43e-5, _LANDRY: 1.4e-5},
    "inertia_z": {_CRAZYFLOW: 2.98e-5, _FOERSTER: 2.93e-5, _ROTORPY: 2.89e-5, _LANDRY: 2.17e-5},
    "torque_to_thrust": {
        _FOERSTER: 5.96e-3,
        _CRAZYFLOW: 7.35e-3,
        _LANDRY: 2.51e-2,
        _ROTORPY: 3.39e-2,
    },
    "mass": {_CRAZYFLOW: 0.0328, _SIMPLE: 0.0321, _ROTORPY: 0.030, _LANDRY: 0.027},
}
"""By parameter and source [SI]. Where a source gives two motor lags, the first is that of speeding
up and their ratio the slowdown."""


def list_published(parameter: str) -> dict[str, float]:
    """Returns what others give for a parameter [SI] by source, from the largest to the smallest.

    The paper's value is not among them.

    Args:
        parameter: name in `parameters.COMPONENTS`.
    """
    return dict(sorted(_OTHERS.get(parameter, {}).items(), key=lambda entry: -entry[1]))


def beside_literature(
    estimates: Mapping[str, Estimate], truth: Mapping[str, tuple[float, float]] | None = None
) -> Figure:
    """Draws parameters as multiples of the paper's values, on one logarithmic axis.

    Args:
        estimates: by parameter; those that the paper's model lacks are left out.
        truth: from and to, by parameter, of a virtual drone [SI].

    Raises:
        InputError: none of the parameters has a value above zero in the paper.
    """
    papers = {name: float(component(crazyflie(), name)) for name in estimates}
    chosen_names = [name for name in estimates if papers[name] > 0 and estimates[name].value > 0]
    if not chosen_names:
        raise InputError(
            "no parameter to draw beside the literature: the paper gives none of them a value "
            "above zero."
        )
    marks: list[Spec] = []
    for row, name in enumerate(chosen_names):
        ends = (truth or {}).get(name)
        marks += [
            {**mark, "row": row, "name": name.replace("_", " ")}
            for mark in _marks(name, estimates[name], papers[name], ends)
        ]
    values = [mark[end] for mark in marks for end in ("x", "x2") if end in mark]
    # An interval from zero would squeeze all others.
    domain = [max(1 / 8, min([0.85, *(0.94 * value for value in values)])), 1.06 * max(values)]
    marks = [mark | {"x": max(mark["x"], domain[0])} for mark in marks]
    multiple = "datum.value < 1 ? '1/' + round(1 / datum.value) : datum.value"
    x = charts.number(
        "x",
        f"multiple of the value of {PAPER}",
        scale={"type": "log", "base": 2, "domain": domain, "nice": False},
        axis={
            "values": [2.0**power for power in range(-6, 7)],
            "labelExpr": f"({multiple}) + '\N{MULTIPLICATION SIGN}'",
        },
    )
    names = [(text.plain_symbol(name), _numbers(name, estimates[name])) for name in chosen_names]
    labels = {"name": "", "value": "value", "source": "source"}
    legend = [Entry("identified, 95 % interval", "orange", "bar", "identified")]
    legend += [Entry("truth", "green", "tick", "truth")] if truth else []
    legend += [Entry("paper", "purple", "tick", "paper"), Entry("others", "soft", "dot", "others")]
    return Figure("Beside the literature", [intervals.rows(names, marks, x, labels)], legend)


def _marks(
    name: str, estimate: Estimate, paper: float, truth: tuple[float, float] | None
) -> list[Spec]:
    """What is drawn of a parameter; each value as a multiple of the paper's."""

    def mark(kind: str, series: str, colour: str, value: float, source: str) -> Spec:
        place = {"kind": kind, "series": series, "colour": charts.paint(colour), "x": value / paper}
        return {**place, "value": _write(name, value), "source": source}

    marks = [mark("line", "paper", "purple", paper, PAPER)]
    marks += [
        mark("dot", "others", "soft", value, source)
        for source, value in list_published(name).items()
    ]
    if truth is not None and min(truth) > 0:
        bar = mark("whisker", "truth", "green", truth[0], "the virtual drone")
        marks += [{**bar, "x2": truth[1] / paper}]
        marks += [
            mark("end", "truth", "green", end, "the virtual drone") for end in dict.fromkeys(truth)
        ]
    low, high = (max(end, 1e-3 * estimate.value) for end in estimate.interval)
    bar = mark("bar", "identified", "orange", low, "these flights")
    return [
        *marks,
        {**bar, "x2": high / paper},
        mark("value", "identified", "orange", estimate.value, "these flights"),
    ]


def _write(name: str, value: float) -> str:
    scale, unit = text.scale(name, [value])
    return f"{text.number(value * scale, 3)} {unit}".rstrip()


def _numbers(name: str, estimate: Estimate) -> str:
    scale, digits, unit = text.rounding(name, *estimate.interval)
    value, low, high = (
        text.fixed(scale * each, digits) for each in (estimate.value, *estimate.interval)
    )
    return f"{value} [{low}, {high}] {unit}".rstrip()


def main(arguments: Sequence[str] | None = None) -> None:
    """Reads, prints and draws."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drone", type=Path, help="the identified drone's file")
    parser.add_argument("--truth", type=Path, help="file of the virtual drone that was flown")
    parser.add_argument("-o", "--output", type=Path, required=True, help="the SVG file")
    options = parser.parse_args(arguments)
    drone = drone_file.read(options.drone)
    truth = None
    if options.truth is not None:
        run = Run(reality=drone_file.read(options.truth).parameters, drone=drone)
        truth = {name: true_ends(run, name) for name in drone.estimates}
    results.write(options.output, picture.svg(beside_literature(drone.estimates, truth)))
    rows = [
        [name, _write(name, value), source]
        for name in drone.estimates
        for source, value in list_published(name).items()
    ]
    terminal.print_table("What others give for a Crazyflie", ["", "value", "source"], rows)


if __name__ == "__main__":
    main()
