"""What was identified of a drone, from which flights, and how sure it is."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
import polars
from markupsafe import Markup

from maidenflight.flights.checkup.result import warning_lines
from maidenflight.flights.windows import SEGMENT_SECONDS
from maidenflight.identification.calibration import summarize
from maidenflight.identification.outcome.bounds import bound_reached
from maidenflight.parameters import COMPONENTS, QUANTITIES, Parameters, component, crazyflie
from maidenflight.reporting import identified, tables, text
from maidenflight.reporting import run as runs
from maidenflight.reporting.figures import corner, delays
from maidenflight.reporting.figures import identification as identification_figures
from maidenflight.reporting.figures.calibration import ranks
from maidenflight.reporting.figures.charts import Figure
from maidenflight.reporting.html import render
from maidenflight.reporting.run import Run, true_ends
from maidenflight.reporting.tables import Cell, Column
from maidenflight.simulator.physics.dynamics import equivalent_lag

_RANGES = {
    "motor_time_constant": ("speeding up", "slowing down"),
    "latency": ("command", "command + sensors"),
}


_COMMANDS = {
    "zero-order-hold": "commands were taken as a zero-order hold from row to row",
    "subsampled": "commands were taken as subsampled from a faster loop",
    "mixed": "commands of some logs were taken as a zero-order hold from row to row, "
    "of others as subsampled from a faster loop",
}
_EFFECTS = {
    "a sagging battery": ("battery_resistance", "battery_discharge"),
    "drag along x": ("drag_x",),
    "drag along y": ("drag_y",),
    "drag along z": ("drag_z",),
    "motors that slow down at another rate than they speed up": ("spin_down_ratio",),
    "coasting motors": ("motor_coasting",),
    "rotors whose momentum turns the body": ("rotor_momentum",),
    "a constant torque": ("torque_bias_x", "torque_bias_y", "torque_bias_z"),
    "flapping rotors": ("flapping_moment_x", "flapping_moment_y"),
    "damped rates": ("rotational_damping",),
    "another thrust curve": ("thrust_offset", "thrust_linear"),
    "late estimates": ("estimator_delay",),
    "a gyro that lags": ("gyro_time_constant",),
}
"""What a virtual drone may have and an identification leave out, by the parameters that stand for
it."""


def section(run: Run) -> Markup:
    """Returns what was identified, and how sure it is."""
    best = {name: estimate.value for name, estimate in run.estimates.items()}
    draws = {name: values for name, values in run.posterior.items() if name in best}
    return render(
        "parameters.html",
        source=_source(run),
        doubts=[] if run.drone is None else warning_lines(run.drone.warnings),
        estimates=_estimates(run),
        segment_seconds=f"{SEGMENT_SECONDS:g}",
        missed=_missed(run),
        gains=_gains(run),
        intervals=_intervals(run),
        delays=_delays(run),
        together=_both_ways(run),
        calibration=None if run.calibration is None else ranks(summarize(run.calibration)),
        advice=_advice(run),
        truth=_shape_of_truth(run),
        corner=corner.corner(draws, best) if draws else None,
        constants=_constants(run),
        count=len(QUANTITIES),
    )


def _intervals(run: Run) -> Figure | None:
    """Estimates beside the truth, where it is known, and the paper's values."""
    if run.drone is None or not run.estimates:
        return None
    names = [*run.estimates, *run.unidentified]
    references = {"paper": {name: [float(component(crazyflie(), name))] for name in names}}
    if run.reality is not None:
        true_values = {name: list(dict.fromkeys(true_ends(run, name))) for name in names}
        references = {"truth": true_values, **references}
    return identification_figures.estimates(run.estimates, run.unidentified, references)


def _advice(run: Run) -> Markup | str:
    """Returns what makes intervals narrower, and the intervals to expect."""
    if run.drone is None or not run.drone.advice:
        return ""

    def interval(low: float | None, row: Mapping[str, Any]) -> Cell:
        if low is None:
            return Cell("", "")
        scale, digits, unit = text.rounding(row["parameter"], low, row["high"])
        ends = " .. ".join(text.fixed(scale * end, digits) for end in (low, row["high"]))
        return Cell(f"{ends} {unit}".rstrip(), low)

    rows = []
    for tip in run.drone.advice:
        low, high = tip.interval or (None, None)
        rows.append({"parameter": tip.parameter, "action": tip.action, "low": low, "high": high})
    columns = {
        "parameter": Column("Parameter", lambda name, _: _head(name, "")),
        "action": Column("What narrows it"),
        "low": Column("95 % interval to expect", interval),
    }
    frame = polars.DataFrame(rows, infer_schema_length=None)
    return tables.sortable("advice", frame, columns)


def _shape_of_truth(run: Run) -> str:
    """How the truth is drawn in the picture of the delays: a `line`, a `box`, or not at all."""
    if not runs.truth(run):
        return ""
    return "line" if "spin_down_ratio" in run.estimates else "box"


def _delays(run: Run) -> Figure | None:
    identified = set(run.posterior) & set(run.estimates)
    if run.objective == "replay" or not set(delays.DELAYS) <= identified:
        return None
    return delays.delay_posterior(run.posterior, run.estimates, runs.truth(run))


def _both_ways(run: Run) -> str:
    """Lag of both ways together plus latency [ms], where each way has a lag of its own."""
    ratio = run.estimates.get("spin_down_ratio")
    if ratio is None or not set(delays.DELAYS) <= set(run.estimates):
        return ""
    lag, latency = (run.estimates[name].value for name in delays.DELAYS)
    return f"{1e3 * (float(equivalent_lag(lag, ratio.value)) + latency):.1f}"


def estimate(run: Run, name: str, decimals: int | None = None) -> tuple[str, str, str]:
    """Returns value and interval; by default with as many decimals as the interval justifies."""
    estimate = run.estimates[name]
    scale, digits, _ = text.rounding(name, *estimate.interval)
    digits = digits if decimals is None else decimals
    value, low, high = (
        text.fixed(scale * end, digits) for end in (estimate.value, *estimate.interval)
    )
    return value, low, high


def plausible(run: Run, name: str) -> tuple[str, str]:
    """Returns the plausible range of a parameter that the flights do not identify."""
    ends = run.unidentified[name]
    scale, _, _ = text.rounding(name, *ends)
    low, high = (text.number(end * scale) for end in ends)
    return low, high


def _truth(run: Run, name: str, scale: float) -> Cell:
    """The truth, with what its ends are where it is a range."""
    ends = true_ends(run, name)
    if name not in _RANGES or np.isclose(*ends):
        return Cell(text.number(ends[0] * scale), ends[0])
    parts = [
        Markup("{} <small>({})</small>").format(f"{end * text.factor(name):.1f}", word)
        for end, word in zip(ends, _RANGES[name], strict=True)
    ]
    return Cell(Markup(" ..<br>").join(parts), ends[0])


def _head(name: str, unit: str) -> Cell:
    template, in_unit = Markup("{}{}<small> {}: {}</small>"), f" [{unit}]" if unit else ""
    words = text.label(name), _meaning(name)
    return Cell(template.format(text.symbol(name), in_unit, *words), name)


def _meaning(name: str) -> str:
    """What a parameter is; of a component of a vector, which."""
    meaning = text.quantity(name).meaning
    if COMPONENTS.get(name, (name, None))[1] is None:
        return meaning
    return meaning.replace(": x, y, z", f", {name[-1]}").replace(" x, y, z", f" {name[-1]}")


def _estimates(run: Run) -> Markup | str:
    """The identified parameters beside the truth and the paper."""
    if not run.estimates:
        return ""

    def scale(row: Mapping[str, Any]) -> tuple[float, str]:
        factor, _, unit = text.rounding(row["parameter"], row["low"], row["high"])
        return factor, unit

    def interval(low: float, row: Mapping[str, Any]) -> Cell:
        name = row["parameter"]
        if name in run.unidentified:
            words = Markup("{} <small>plausible</small>").format(" .. ".join(plausible(run, name)))
            return Cell(words, low)
        ends: Markup | str = " .. ".join(estimate(run, name)[1:])
        if bound_reached(name, run.estimates[name]) is not None:
            ends = Markup("{} <small>too narrow: at its search bound</small>").format(ends)
        return Cell(ends, low)

    def between(deviation: float | None, row: Mapping[str, Any]) -> Cell:
        if deviation is None:
            return Cell("", "")
        scaled = deviation * scale(row)[0]
        return Cell(text.fixed(scaled, text.places(scaled) if scaled else 0), deviation)

    def value(number: float | None, row: Mapping[str, Any]) -> Cell:
        if number is None:
            return Cell("not identified", "")
        return Cell(Markup("<b>{}</b>").format(estimate(run, row["parameter"])[0]), number)

    columns = {
        "parameter": Column("Parameter", lambda name, row: _head(name, scale(row)[1])),
        "value": Column("Identified", value),
        "low": Column("95 % interval", interval),
        "between_sd": Column("Between flights", between),
        "truth": Column("Truth", lambda _, row: _truth(run, row["parameter"], scale(row)[0])),
        "paper": Column(
            "Paper", lambda value, row: Cell(text.number(value * scale(row)[0]), value)
        ),
    }
    if run.reality is None:
        del columns["truth"]
    rows = [_in_si(run, name) for name in (*run.estimates, *run.unidentified)]
    return tables.sortable("estimates", polars.DataFrame(rows, infer_schema_length=None), columns)


def _in_si(run: Run, name: str) -> dict[str, str | float | None]:
    """A row of the table."""
    estimate, paper = run.estimates.get(name), float(component(crazyflie(), name))
    low, high = run.unidentified[name] if estimate is None else estimate.interval
    ends = true_ends(run, name) if run.reality is not None else (None, None)
    row: dict[str, str | float | None] = {"parameter": name, "unit": text.quantity(name).unit}
    row |= {"value": estimate and estimate.value, "low": low, "high": high}
    row |= {"between_sd": estimate and estimate.between_sd}
    return row | {"truth": ends[0], "truth_to": ends[1], "paper": paper}


def _source(run: Run) -> str:
    """How many flights there were, and what their commands were taken as."""
    if run.drone is None or run.drone.source is None or run.drone.search is None:
        return ""
    description = identified.flights(run.drone, run.kinds, ", ")
    windows = text.plural(run.drone.search.windows, "window")
    return (
        f"Identified from {description}, cut into {windows}; {_COMMANDS[run.drone.source.commands]}"
    )


def _missed(run: Run) -> dict[str, Any] | None:
    """How many intervals the truth lies outside of, and the effects that were not identified."""
    if run.reality is None:
        return None
    outside = 0
    for name, estimate in run.estimates.items():
        low, high = sorted(true_ends(run, name))
        outside += estimate.interval[0] > high or estimate.interval[1] < low
    count = text.plural(len(run.estimates), "parameter")
    return {"outside": outside, "of": count, "effects": _left_out(run, run.reality)}


def _left_out(run: Run, reality: Parameters) -> list[str]:
    """Effects in which the virtual drone differs, and that were not sought or not identified."""
    drone = crazyflie() if run.drone is None else run.drone.parameters
    return [
        effect
        for effect, names in _EFFECTS.items()
        if not set(names) & set(run.estimates)
        and not all(
            np.isclose(float(component(reality, name)), float(component(drone, name)), rtol=1e-4)
            for name in names
        )
    ]


def _gains(run: Run) -> Markup | str:
    """Log-likelihood gain of each group of parameters, where the flights chose them."""
    gains = () if run.drone is None else run.drone.gains
    if not gains:
        return ""

    def gain(_: float, row: Mapping[str, Any]) -> Cell:
        gain_text, error = text.with_error(row["log_likelihood_gain"], row["standard_error"])
        cell = Markup("{} <small>± {}</small>").format(text.signed(gain_text), error)
        return Cell(cell, row["log_likelihood_gain"])

    columns = {
        "group": Column("Parameters", lambda name, _: tables.plain(text.label(name))),
        "log_likelihood_gain": Column("Log-likelihood gain a row [nats]", gain),
        "is_in_model": Column(
            "In the model", lambda in_model, _: tables.plain("yes" if in_model else "no")
        ),
    }
    rows = polars.DataFrame([dataclasses.asdict(group) for group in gains])
    return tables.sortable("gains", rows, columns)


def _constants(run: Run) -> Markup | str:
    """Every parameter of the identified drone and of the virtual one."""
    own = None if run.drone is None else run.drone.parameters
    drones = {"identified": own, "truth": run.reality}
    drone_columns = {head: drone for head, drone in drones.items() if drone is not None}
    if not drone_columns:
        return ""

    def value(number: float, row: Mapping[str, Any]) -> Cell:
        return Cell(text.number(number * text.factor(row["parameter"])), number)

    columns = {"parameter": Column("Parameter", lambda name, _: _head(name, text.unit(name)))}
    columns |= {head: Column(head.capitalize(), value) for head in drone_columns}
    rows = [
        {"parameter": name, "unit": QUANTITIES[field].unit}
        | {head: float(component(drone, name)) for head, drone in drone_columns.items()}
        for name, (field, _) in COMPONENTS.items()
    ]
    return tables.sortable("all", polars.DataFrame(rows), columns)
