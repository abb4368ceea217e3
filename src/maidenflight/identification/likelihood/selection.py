"""Choice of the parameters to identify, by the likelihood of held-out flights."""

from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from maidenflight.flights.log import Flight
from maidenflight.flights.windows import SHORTEST_LEAD_IN
from maidenflight.identification.drone_file import GroupGain
from maidenflight.identification.likelihood import one_step
from maidenflight.identification.likelihood.observation import BY_MOMENT, ObservationModel
from maidenflight.identification.signals.flight_signals import is_zero_order_hold, stride
from maidenflight.identification.unknowns import INERTIA, PAPER_BOUNDS
from maidenflight.parameters import Parameters

FIRST = tuple(PAPER_BOUNDS)
"""The paper's three, which every model has."""
ALWAYS = (*FIRST, *BY_MOMENT)
"""What every model of logs with a state has. Mean errors tell the trims, and the likelihood cannot
judge them: it takes what lasts for noise."""
GROUPS: dict[str, tuple[str, ...]] = {
    "motor_coasting": ("motor_coasting",),
    "spin_down_ratio": ("spin_down_ratio",),
    "inertia": INERTIA,
    "torque_to_thrust": ("torque_to_thrust",),
    "rotor_momentum": ("rotor_momentum",),
    "flapping_moment": ("flapping_moment_x", "flapping_moment_y"),
    "drag": ("drag_x", "drag_y"),
}
"""What may be added, a group at a time: its name, and the parameters in it.

Not among them is damping of the rates: a little misfit of the sensors' lag passes for it one step
ahead, and policies that crashed within a second are then predicted to fly (docs/identification.md).
Name it to identify it."""
OF_HELD_COMMANDS: dict[str, tuple[str, ...]] = {
    "thrust_linear": ("thrust_linear",),
    "inertia_z": ("inertia_z",),
}
"""Groups besides, where each command acts until the next row and no signal shows the lag: a curved
thrust and gyroscopic coupling pass for inertia otherwise. They have no plausible range, and an
inertia about z found so is taken as yaw's share (`about_z`)."""
WITH_KNOWN_LAG: dict[str, tuple[str, ...]] = {
    **{name: parts for name, parts in GROUPS.items() if name not in ("motor_coasting", "drag")},
    "drag": ("drag_x", "drag_y", "drag_z"),
    "rotational_damping": ("rotational_damping",),
}
"""Groups where a log shows the motors' lag by itself, so that no damping can pass for it."""
MOVING = 0.1
"""Root mean square of the velocity [m/s] below which drag and flapping are not looked for: the
estimate's noise, some 0.015 m/s, returns to its mean and passes for drag. Harmless within a factor
of 1.4 (paper/identification/constants.py)."""
HELD_OUT = 3
"""Every third flight is held out; if there are fewer flights, every third segment; chosen, the
least number that leaves more to fit than to judge by."""
SIGNIFICANT = 2.0
"""Gain over its standard error above which a group is added."""
CERTAIN = ("flapping_moment",)
"""Groups that every drone has, so that a gain need not be significant: of few held-out flights it
rarely is, and without it attitudes of a payload's drone were off by twice as much
(paper/notes/identification.md#parameter-groups)."""
SMALLEST_GAIN = 1e-3
"""Log-likelihood gain of a row [nats] above which a group is added; harmless within a factor of 1.4
(paper/identification/constants.py)."""
ROUGH = SMALLEST_GAIN / 50
"""Log-likelihood gain of a row [nats] below which a fit need not be improved for the choice;
harmless within a factor of 1.4 (paper/identification/constants.py)."""


def groups(flights: Sequence[Flight], has_measured_lag: bool) -> dict[str, tuple[str, ...]]:
    """Returns the groups that may be added for some flights.

    Args:
        flights: checked flights.
        has_measured_lag: whether they show the motors' lag by themselves.
    """
    square = np.mean(np.concatenate([flight.velocity for flight in flights]) ** 2, axis=0)
    level = {*GROUPS["drag"], *GROUPS["flapping_moment"]}
    still = level if square[0] + square[1] < MOVING**2 else set()
    still |= {"drag_z"} if square[2] < MOVING**2 else set()
    parameter_groups = WITH_KNOWN_LAG if has_measured_lag else GROUPS
    if not has_measured_lag:
        parameter_groups = dict(parameter_groups)
        if is_zero_order_hold(flights):
            parameter_groups |= OF_HELD_COMMANDS
        else:
            # Noise of a faster loop, which samples fold, passes for inertia: NanoDrone's is then
            # 2.5 times as large.
            del parameter_groups["inertia"]
    return leave_out(parameter_groups, still)


def leave_out(
    groups: Mapping[str, Sequence[str]], names: Collection[str]
) -> dict[str, tuple[str, ...]]:
    """Returns groups without some parameters, and without those that lose all."""
    left = {
        group: tuple(name for name in parts if name not in names) for group, parts in groups.items()
    }
    return {group: parts for group, parts in left.items() if parts}


class Parts(NamedTuple):
    """Flights by which groups of parameters are chosen."""

    training: ObservationModel
    """Flights to fit."""
    held_out: ObservationModel
    """Flights that the gains are measured on."""
    sample: ObservationModel
    """Some of the training flights' windows, by which the groups are put in order."""


def choose(
    parts: Parts,
    fit: Callable[[Sequence[str], Parameters], Parameters],
    start: Parameters,
    first: Sequence[str] = FIRST,
    offered: Mapping[str, Sequence[str]] = GROUPS,
    on_group: Callable[[GroupGain], None] | None = None,
    at_bounds: Callable[[Parameters, Sequence[str]], Sequence[str]] = lambda drone, names: (),
) -> tuple[tuple[str, ...], Parameters, list[GroupGain]]:
    """Adds one group after another, each staying if the likelihood of held-out flights gains.

    The group with the largest promised gain is next.

    What a group promises is the gain of the quadratic model of the likelihood around the fit
    without it, so that adding a group costs one fit.

    Args:
        parts: flights to fit and to judge by.
        fit: names and where to begin, to the training flights' best drone.
        start: where the first fit begins.
        first: what every model has, at least one parameter.
        offered: groups that may be added.
        on_group: called with the gain of each group.
        at_bounds: those of a drone's parameters that ended where their search does. Their group is
            not added: it stands for something that the model lacks.

    Returns:
        Names of the parameters chosen, the training flights' best drone, and the gain of each
        group, in the order of trying.

    Source: Rao 1948 (score test); forward selection judged by held-out likelihood.
    """
    training, held_out, sample = parts
    names, remaining, gains = tuple(first), dict(offered), []
    drone = fit(names, start)
    value = held_out.per_segment(drone, training.noise_model(drone))
    while remaining:
        likely = [name for name in names if name not in BY_MOMENT]
        everything = (*likely, *(name for group in remaining.values() for name in group))
        equations = sample.normal_equations(drone, everything)
        promised = {
            group: _promise(
                equations.gradient, equations.curvature, everything, (*likely, *remaining[group])
            )
            for group in remaining
        }
        group = max(promised, key=lambda group: promised[group])
        wider = (*names, *remaining.pop(group))
        ahead = fit(wider, drone)
        value_ahead = held_out.per_segment(ahead, training.noise_model(ahead))
        gain, error = _mean_gain(value - value_ahead, held_out.rows_per_segment)
        least = 0.0 if group in CERTAIN else SIGNIFICANT
        reason = _reason(gain, least, error, at_bounds(ahead, offered[group]))
        keep = reason is None
        gains.append(GroupGain(group, gain, error, keep, reason))
        if on_group is not None:
            on_group(gains[-1])
        if keep:
            names, drone, value = wider, ahead, value_ahead
    return names, drone, gains


def _reason(gain: float, least: float, error: float | None, at_bounds: Sequence[str]) -> str | None:
    """Returns why a group is not added, if it is not."""
    if gain <= 0.0:
        return "no gain"
    if gain <= SMALLEST_GAIN:
        return f"below {SMALLEST_GAIN:g}"
    if gain <= least * (error or 0.0):
        return f"below {least:g} standard errors"
    return f"{', '.join(at_bounds)} at a search bound" if at_bounds else None


def _promise(
    gradient: Float[np.ndarray, "d"],
    curvature: Float[np.ndarray, "d d"],
    all_names: Sequence[str],
    names: Sequence[str],
) -> float:
    """Gain of the quadratic model when these parameters may move."""
    indices = [all_names.index(name) for name in names]
    slope, matrix = gradient[indices], curvature[np.ix_(indices, indices)]
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-30))
    scaled = matrix / np.outer(scale, scale) + 1e-9 * np.eye(len(indices))
    return 0.5 * float(slope / scale @ np.linalg.solve(scaled, slope / scale))


def _mean_gain(
    gain: Float[np.ndarray, "S"], rows: Float[np.ndarray, "S"]
) -> tuple[float, float | None]:
    """Gain of a row and its standard error, where segments are independent; `None` of one segment.

    Segments without a window have no rows and do not count.
    """
    gain, rows = gain[rows > 0], rows[rows > 0]
    mean, count = float(gain.sum() / rows.sum()), len(rows)
    if count < 2:
        return mean, None
    residual = gain - mean * rows
    return mean, float(np.sqrt(np.sum(residual**2) * count / (count - 1)) / rows.sum())


def split(flights: Sequence[Flight]) -> tuple[list[Flight], list[Flight]]:
    """Returns flights to fit and, every third of them, to judge by.

    The longest is cut in three where there are fewer than three.

    Segments of one flight stay together, unless there are fewer than three flights.
    """
    long_enough = [
        flight
        for flight in flights
        if len(flight)
        > one_step.LENGTH * stride(flight)
        + max((SHORTEST_LEAD_IN + 1) * stride(flight), flight.lead)
    ]
    whole: list[list[Flight]] = []
    for flight in long_enough:
        before = whole[-1][-1] if whole else None
        if before and flight.lead and before.lead and before.name == flight.name:
            whole[-1].append(flight)
        else:
            whole.append([flight])
    if len(whole) < HELD_OUT:
        whole = [[flight] for flight in long_enough]
    if len(whole) < HELD_OUT:
        whole = []
        for flight in flights:
            ends = [len(flight) * part // 3 for part in range(4)]
            for first, end in zip(ends[:-1], ends[1:], strict=True):
                whole.append([flight.part(first, end)])
    held_out = whole[HELD_OUT - 1 :: HELD_OUT]
    fitted = [parts for number, parts in enumerate(whole) if number % HELD_OUT != HELD_OUT - 1]
    return [*chain(*fitted)], [*chain(*held_out)]
