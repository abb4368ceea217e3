"""How a drone was identified: from which flights, by which gains, and with what left out."""

import dataclasses
from typing import NamedTuple

import numpy as np
import polars
from markupsafe import Markup

from maidenflight.parameters import Parameters, component, crazyflie
from maidenflight.reporting import identified, tables, text
from maidenflight.reporting.run import Run, true_ends
from maidenflight.reporting.tables import Cell

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
    "flapping rotors": ("flapping_moment",),
    "damped rates": ("rotational_damping",),
    "another thrust curve": ("thrust_offset", "thrust_linear"),
    "late estimates": ("estimator_delay",),
    "a gyro that lags": ("gyro_time_constant",),
}
"""What a virtual drone may have and an identification leave out, by the parameters that stand for
it."""


def flights(run: Run) -> str:
    """How many flights there were, and what their commands were taken as."""
    if run.drone is None or run.drone.source is None or run.drone.search is None:
        return ""
    found = identified.flights(run.drone, run.kinds, ", ")
    windows = text.plural(run.drone.search.windows, "window")
    return f"Identified from {found}, cut into {windows}; {_COMMANDS[run.drone.source.commands]}"


class Missed(NamedTuple):
    """How far the identified drone is from the virtual one."""

    outside: int
    """Intervals that the truth lies outside of."""
    of: str
    """How many there are, in words."""
    effects: list[str]
    """Effects of the virtual drone that were not identified."""


def missed(run: Run) -> Missed | None:
    """How far the identified drone is from the virtual one; `None` where that is not known."""
    if run.reality is None:
        return None
    outside = 0
    for name, found in run.estimates.items():
        low, high = sorted(true_ends(run, name))
        outside += found.interval[0] > high or found.interval[1] < low
    count = text.plural(len(run.estimates), "parameter")
    return Missed(outside, count, _left_out(run, run.reality))


def _left_out(run: Run, reality: Parameters) -> list[str]:
    """Effects in which the virtual drone differs, and that were not sought or not found."""
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


def gains(run: Run) -> Markup | str:
    """Log-likelihood gain of each group of parameters, where the flights chose them."""
    found = () if run.drone is None else run.drone.gains
    if not found:
        return ""
    rows = []
    for group in found:
        gain, error = text.with_error(group.log_likelihood_gain, group.standard_error)
        shown = Markup("{} <small>± {}</small>").format(gain.replace("-", "\N{MINUS SIGN}"), error)
        rows.append(
            [
                tables.plain(group.group.replace("_", " ")),
                Cell(shown, group.log_likelihood_gain),
                tables.plain("yes" if group.kept else "no"),
            ]
        )
    heads = [
        ("group", "Parameters"),
        ("gain", "Log-likelihood gain a row [nats]"),
        ("kept", "Kept"),
    ]
    return tables.sortable(
        "gains", heads, rows, polars.DataFrame([dataclasses.asdict(group) for group in found])
    )
