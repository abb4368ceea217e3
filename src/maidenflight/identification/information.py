"""What flights can tell of a drone before anything is fitted: expected intervals of its parameters.

The information of the one-step likelihood, with the noise model that fits best at the start's
parameters, is joined with the range that is plausible for each parameter beforehand. A parameter
of which the flights say less than that range does is not identifiable from them.

This presumes the model: what a real drone does beyond it is not foreseen.

Source: Ljung 1999, System identification: theory for the user, sec. 9.2-9.3 (covariance of
prediction error estimates) and 13.3 (informative experiments).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from maidenflight.identification.one_step import OneStep
from maidenflight.parameters import Parameters, arm_length, component

HOVERING = "thrust_to_weight"
"""The parameter that is found by its moment: mean thrust carries the weight and what accelerates
the drone. A likelihood of one row ahead hardly weighs what lasts."""
LAG = "motor_time_constant"
"""The parameter that accelerometer or rotor speed show by themselves: the mean of motors that speed
up and slow down."""
DELAYS = (LAG, "latency")
"""The parameters that delay what commands do."""
NEXT_FLIGHT = 6
"""Segments of the flight that intervals are to hold: 30 s."""
OTHER_DAY = 0.015
"""Standard deviation of thrust from day to day, a share: that of the air's density over 4.5 K or 15
hPa, without battery and propellers. Three sets of flights of one Crazyflie differ by 3 % in what
hovering takes (docs/studies/identification.md)."""
TOLD = 0.5
"""Share of its variance beforehand below which a parameter's variance must lie for flights to tell
it: they then say more than is known without them."""
UNIFORM = 12.0
"""Squared width of a uniform distribution over its variance."""

Ranges = Mapping[str, tuple[float, float]]
"""Lowest and highest value by parameter, SI units."""


@dataclass(frozen=True)
class Expected:
    """What flights can tell of one parameter, in its SI unit."""

    prior: tuple[float, float]
    """Range that is plausible beforehand."""
    interval: tuple[float, float]
    """95 % interval to expect about the start's value, within the prior."""
    identifiable: bool
    """Whether flights say more of it than the prior does."""


def prior_ranges(start: Parameters, bounds: Ranges) -> dict[str, tuple[float, float]]:
    """Plausible ranges about a drone, by parameter; its search bounds for others than these.

    They hold what was identified from real Crazyflies and what the virtual drones have
    (docs/studies/identification.md); torques grow with weight times arm, as do the bounds.

    Args:
        start: the drone.
        bounds: search bounds, which no range exceeds.
    """
    torque = float(start.mass * start.gravity) * arm_length(start)
    factors = {
        HOVERING: (0.8, 1.25),
        "motor_time_constant": (0.5, 1.6),
        "torque_to_thrust": (0.5, 1.5),
        **{f"inertia_{axis}": (0.7, 1.5) for axis in "xyz"},
    }
    values = {
        "latency": (0.0, 0.03),
        "spin_down_ratio": (0.7, 2.5),
        "motor_coasting": (0.0, 0.16),
        "rotor_momentum": (0.0, 0.013 * torque),
        "flapping_moment": (0.0, 0.037 * torque),
        "rotational_damping": (0.0, 0.01 * torque),
        "torque_bias_x": (-0.05 * torque, 0.05 * torque),
        "torque_bias_y": (-0.05 * torque, 0.05 * torque),
        "torque_bias_z": (-0.014 * torque, 0.014 * torque),
        **{f"drag_{axis}": (0.0, 0.5) for axis in "xyz"},
    }
    found = {}
    for name, (lowest, highest) in bounds.items():
        here = float(component(start, name))
        low, high = values.get(name, (lowest, highest))
        if name in factors:
            low, high = (factor * here for factor in factors[name])
        found[name] = (max(min(low, here), lowest), min(max(high, here), highest))
    return found


def is_told(deviation: float, prior: tuple[float, float]) -> bool:
    """Whether flights say more of a parameter than the range that is plausible without them."""
    return bool(deviation**2 < TOLD * (prior[1] - prior[0]) ** 2 / UNIFORM)


def other_days(
    drone: Parameters, count: int, generator: np.random.Generator
) -> Float[np.ndarray, "N"]:
    """By how much the thrust-to-weight ratio differs on other days.

    Args:
        drone: on the day of the flights.
        count: of samples.
        generator: random numbers.
    """
    return generator.normal(0.0, OTHER_DAY * float(drone.thrust_to_weight), count)


def expected(
    objective: OneStep,
    start: Parameters,
    names: Sequence[str],
    priors: Ranges,
    seen: Mapping[str, Float[np.ndarray, "N"]] | None = None,
) -> dict[str, Expected]:
    """What the windows of an objective can tell of some parameters together.

    Args:
        objective: all windows of the flights.
        start: the drone about which intervals are expected.
        names: of `parameters.COMPONENTS`.
        priors: plausible range of each.
        seen: samples of parameters that are not found by the likelihood but seen by other signals.
    """
    _, _, curvatures = objective.derivatives(start, names)
    apart = {}
    for name, samples in (seen or {}).items():
        row = np.eye(len(names))[names.index(name)]
        ratio = float(start.spin_down_ratio)
        share = 2 / (1 + ratio) if name == LAG else 1.0
        if name == LAG and "spin_down_ratio" in names:
            row[names.index("spin_down_ratio")] = float(start.motor_time_constant) / (1 + ratio)
        apart[name] = row, float(np.var(share * samples))
    if HOVERING in names:
        climbs = objective.climbs(start, names)
        spread = float(np.std(objective.hovering(start)[1]))
        variance = spread**2 * (1 / objective.segments + 1 / NEXT_FLIGHT)
        apart[HOVERING] = climbs / climbs[names.index(HOVERING)], variance
    matrix = information(curvatures.sum(axis=0) * objective.rows, names, apart)
    widths = np.array([priors[name][1] - priors[name][0] for name in names])
    deviations = np.sqrt(np.diag(covariance(matrix, widths)))
    found = {}
    for name, deviation in zip(names, deviations, strict=True):
        low, high = priors[name]
        here = float(np.clip(component(start, name), low, high))
        other_day = OTHER_DAY * here if name == HOVERING else 0.0
        reach = 1.96 * float(np.hypot(deviation, other_day))
        found[name] = Expected(
            (low, high),
            (max(low, here - reach), min(high, here + reach)),
            is_told(float(deviation), (low, high)),
        )
    return found


def information(
    curvature: Float[np.ndarray, "d d"],
    names: Sequence[str],
    apart: Mapping[str, tuple[Float[np.ndarray, "d"], float]],
) -> Float[np.ndarray, "d d"]:
    """Information of flights on some parameters, as identification uses it.

    Args:
        curvature: of minus the log likelihood of all rows.
        names: of the parameters.
        apart: of each parameter that is not found by the likelihood, the combination of all
            parameters that something else shows, with a weight of 1 of this one, and the
            combination's variance.
    """
    towards, place = np.eye(len(names)), [names.index(name) for name in apart]
    for number, (row, _) in zip(place, apart.values(), strict=True):
        towards[number] = row
    back = np.linalg.inv(towards)
    found = back.T @ curvature @ back
    rest = [number for number in range(len(names)) if number not in place]
    scale = np.sqrt(np.maximum(np.diag(found)[rest], 1e-30))
    likely = found[np.ix_(rest, rest)] / np.outer(scale, scale) + 1e-9 * np.eye(len(rest))
    pull = found[np.ix_(rest, place)] / scale[:, None]
    # So that, the likelihood's parameters eliminated, only the other signals' information is left.
    found[np.ix_(place, place)] = pull.T @ np.linalg.solve(likely, pull) + np.diag(
        [1 / max(variance, 1e-30) for _, variance in apart.values()]
    )
    return towards.T @ found @ towards


def covariance(
    matrix: Float[np.ndarray, "d d"], widths: Float[np.ndarray, "d"]
) -> Float[np.ndarray, "d d"]:
    """Covariance of parameters that are uniform over some widths before the flights.

    Args:
        matrix: information of the flights.
        widths: of the parameters' ranges.
    """
    scale = np.outer(widths, widths)
    return np.linalg.inv(matrix * scale + UNIFORM * np.eye(len(widths))) * scale
