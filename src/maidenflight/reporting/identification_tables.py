"""What the page says of how a drone was identified: from which flights, what each group of
parameters bought, what stayed unknown.
"""

import numpy as np
import polars

from maidenflight.parameters import Parameters, component, crazyflie
from maidenflight.reporting import tables, text
from maidenflight.reporting.identified import source
from maidenflight.reporting.run import Run, true_ends
from maidenflight.reporting.tables import Cell

_COMMANDS = {
    "held": "commands were taken as held from row to row",
    "sampled": "commands were taken as samples of a faster loop",
    "held and sampled": "commands of some logs were taken as held from row to row, of others as "
    "samples of a faster loop",
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
    """How many flights there were, and how they were taken."""
    origin, found = run.origin, source(run.origin, ", ")
    facts = [f"from {found}"] if found else []
    facts += (
        [f"cut into {text.plural(origin.windows, 'window')}"] if origin.windows is not None else []
    )
    told = [f"Identified {', '.join(facts)}"] if facts else []
    told += [_COMMANDS[origin.commands]] if origin.commands else []
    return f"<p>{'; '.join(told)}.</p>" if told else ""


def missed(run: Run) -> str:
    """How many intervals miss the truth, and which effects of the virtual drone were not
    identified.
    """
    if run.reality is None:
        return ""
    outside = 0
    for name, found in run.estimates.items():
        low, high = sorted(true_ends(run, name))
        outside += found.interval[0] > high or found.interval[1] < low
    told = (
        f" The truth lies outside the interval of {outside} of these "
        f"{text.plural(len(run.estimates), 'parameter')}."
    )
    left = _left_out(run, run.reality)
    if outside and left:
        told += (
            " The virtual drone has effects that were not identified, and identified "
            f"parameters make up for them: {', '.join(left)}."
        )
    return told


def _left_out(run: Run, reality: Parameters) -> list[str]:
    """Effects in which the virtual drone differs from the identified one, and that were not sought
    or not found.
    """
    drone = crazyflie() if run.drone is None else run.drone
    return [
        effect
        for effect, names in _EFFECTS.items()
        if not set(names) & set(run.estimates)
        and not all(
            np.isclose(float(component(reality, name)), float(component(drone, name)), rtol=1e-4)
            for name in names
        )
    ]


def bought(run: Run) -> str:
    """What each group of parameters bought, folded away."""
    if not run.origin.bought:
        return ""
    rows = []
    for step in run.origin.bought:
        gain = f"{step.gain:+.4f} <small>± {step.error:.4f}</small>".replace("-", "\N{MINUS SIGN}")
        rows.append(
            (
                "",
                [
                    tables.words(step.group.replace("_", " ")),
                    Cell(gain, step.gain),
                    tables.words("yes" if step.kept else "no"),
                ],
            )
        )
    heads = [
        ("group", "Parameters"),
        ("gain", "Log likelihood gained a row [nats]"),
        ("kept", "Kept"),
    ]
    table = tables.sortable(
        "bought", heads, rows, polars.DataFrame([step._asdict() for step in run.origin.bought])
    )
    note = (
        "<p class=note>Groups were added to the three of the paper one after the other, in this "
        "order, and judged by flights, or stretches"
        " of flight, that were held out. Kept is what gains more than twice its standard error "
        "(±, over stretches of flight) and at"
        " least 0.001 nats a row.</p>"
    )
    return (
        f"<details><summary>What each group of parameters bought</summary>{table}{note}</details>"
    )
