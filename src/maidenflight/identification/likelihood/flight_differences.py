"""How flights differ: drones to randomize over, and whether estimates of each are one drone's."""

from collections.abc import Mapping, Sequence
from dataclasses import replace as replace_
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from maidenflight.errors import InputError
from maidenflight.flights import trims
from maidenflight.flights.log import Flight, by_log
from maidenflight.flights.trims import ENOUGH_FLIGHTS, SEGMENT_S, between_flights, trim
from maidenflight.flights.windows import segment_names
from maidenflight.identification.drone_file import Estimate
from maidenflight.identification.likelihood import one_step
from maidenflight.identification.likelihood.observation import BALANCED, BY_MOMENT
from maidenflight.identification.likelihood.one_step import OneStep
from maidenflight.identification.outcome.plausible import HOVERING
from maidenflight.identification.signals.flight_signals import stride
from maidenflight.identification.signals.motor_response import MotorResponse
from maidenflight.identification.unknowns import INERTIA
from maidenflight.parameters import COMPONENTS, QUANTITIES, Parameters, check, component, replace
from maidenflight.simulator.randomization import Ensemble, ensemble

WITHIN_A_DAY = {HOVERING: 0.87, "torque_bias_x": 0.7, "torque_bias_y": 0.7, "torque_bias_z": 0.55}
"""Standard deviation between flights of a day, as a share of that between all flights: of flights
of neighbouring policies in paper/notes/flight-times.md, whatever outer fold is left out. The day's
own standard deviation is what this leaves: sqrt(1 - share^2)."""


def flight_to_flight_sd(
    estimates: Mapping[str, Estimate], flights: Sequence[Flight], drone: Parameters
) -> dict[str, Estimate]:
    """Returns estimates of thrust and constant torques, with how they differ from flight to flight.

    Args:
        estimates: by name.
        flights: those of one name are pieces of one.
        drone: the identified drone.

    Returns:
        Those that differ; nothing where there are too few flights (`trims.ENOUGH_FLIGHTS`).
    """
    logs = by_log(flights).values()
    if len(logs) < ENOUGH_FLIGHTS or not estimates.keys() & set(BALANCED):
        return {}
    deviations = between_flights([trim(pieces, drone) for pieces in logs])
    if deviations is None:
        return {}
    return {
        name: replace_(estimates[name], between_sd=float(deviation))
        for name, deviation in zip(BALANCED, deviations, strict=True)
        if name in estimates
    }


def drone_of_the_day(
    drone: Parameters, estimates: Mapping[str, Estimate], flights: Sequence[Flight], source: str
) -> tuple[Parameters, dict[str, Estimate]]:
    """Returns the drone with the constant torques and the thrust that flights of the day show.

    What the drone's file says of each and how it differs from flight to flight, and what
    balances the mean commands of each flight, with its standard error, are normal: the result is
    their product. Flights of a day differ by `WITHIN_A_DAY` of that difference.

    Args:
        drone: the identified drone.
        estimates: see `DroneFile.estimates`.
        flights: of the day, by any policy or controller; those of one name are pieces of one.
        source: the drone's file, for errors.

    Returns:
        The drone, and its estimates: the SD between flights of what the day tells is what its
        flights leave open of the next one.

    Raises:
        InputError: no constant torque was identified, or no flight is long enough to tell one.
    """
    if not set(BY_MOMENT) & set(estimates):
        raise InputError(_DAY_EFFECTS.format(source=source))
    # Pieces of one flight have its trim: they are no flights of their own.
    rows = [trim(pieces, drone) for pieces in by_log(flights).values()]
    fitted_rows, errors = trims.with_standard_errors(rows)
    if not len(fitted_rows):
        raise InputError(
            f"none of {len(rows)} flights of the day determines a constant torque. Give one of "
            f"{2 * SEGMENT_S:g} s or more with the motors' commands."
        )
    text, values = dict(estimates), {}
    for column, name in enumerate(BALANCED):
        old = estimates.get(name)
        if old is None or not old.between_sd > 0.0:
            continue
        within = WITHIN_A_DAY[name] * old.between_sd
        weights = 1.0 / (errors[:, column] ** 2 + within**2)
        before = 1.0 / (old.between_sd**2 - within**2)
        total = before + weights.sum()
        value = float((before * old.value + weights @ fitted_rows[:, column]) / total)
        deviation = float(np.sqrt(1.0 / total + within**2))
        ends = value - 1.96 * deviation, value + 1.96 * deviation
        text[name] = Estimate(value, ends, (value,), deviation)
        values[name] = np.float32(value)
    return check(replace(drone, **values), source), text


_DAY_EFFECTS = (
    "{source}: none of torque_bias_x, torque_bias_y, torque_bias_z was identified, so it is not "
    "known how trims differ from flight to flight. Identify it from flights by likelihood, or "
    "choose another randomization."
)


def trim_ensemble(
    drone: Parameters, estimates: Mapping[str, Estimate], source: str, count: int = 256
) -> Ensemble:
    """Returns drones whose constant torques and thrust differ as those of identified flights did.

    Values are normal, cut off at their physical range: a drone that flew lifts its weight.

    Args:
        drone: the identified drone.
        estimates: see `DroneFile.estimates`.
        source: the drone's file, for errors.
        count: of drones, always the same ones.

    Raises:
        InputError: no constant torque was identified.
    """
    names = [name for name in (*BY_MOMENT, HOVERING) if name in estimates]
    if not set(BY_MOMENT) & set(names):
        raise InputError(_DAY_EFFECTS.format(source=source))
    deviations = np.array([max(estimates[name].between_sd, 1e-12) for name in names])
    values = np.array([component(drone, name) for name in names], np.float64)
    quantities = [QUANTITIES[COMPONENTS[name][0]] for name in names]
    limits = np.array([(quantity.lower, quantity.upper) for quantity in quantities])
    # A low-discrepancy sequence represents the distribution better than as many random points.
    sobol = scipy.stats.qmc.Sobol(len(names), rng=np.random.default_rng(0)).random(count)
    low, high = (limits.T - values) / deviations
    changes = scipy.stats.truncnorm.ppf(sobol.clip(1e-6, 1 - 1e-6), low, high)
    rows = (values + deviations * changes).astype(np.float32)
    drones = [replace(drone, **dict(zip(names, row, strict=True))) for row in rows]
    return ensemble([check(member, source) for member in drones])


LEAST: Mapping[str, float] = {
    "thrust_to_weight": 0.06,
    "inertia_x": 0.3,
    "inertia_y": 0.3,
    "motor lag": 0.4,
}
"""What is looked at, and the differences of logarithms below which flights of one drone differ: a
battery pack, propellers or a trim make up to 5 % of thrust; a real drone's inertia and lag are seen
far less exactly. Changes notes alone (paper/identification/constants.py)."""
MIN_DIFFERENCE = 6.0
"""Distance of two groups of flights over the standard deviation within, from which on they are
called apart. The best cut of flights of one kind, normally distributed, has 2.7."""
_FEWEST_SEGMENTS = 2
"""Segments of flight that a flight must have to be looked at."""


class Difference(NamedTuple):
    """Two groups of flights that differ in a parameter."""

    parameter: str
    """Of `LEAST`."""
    lower: tuple[str, ...]
    """Names of the flights with the lower value."""
    upper: tuple[str, ...]
    """Names of the others."""
    ratio: float
    """Mean of the upper over that of the lower."""

    def __str__(self) -> str:
        return (
            f"flights look like those of two drones or payloads: {self.parameter} is "
            f"{self.ratio:.2f} times as large in {_name_flights(self.upper)} as in "
            f"{_name_flights(self.lower)}. "
            "Are they one drone? If not, put their logs into folders of their own"
        )


def differences(
    flights: Sequence[Flight],
    target: OneStep,
    drone: Parameters,
    motors: MotorResponse | None = None,
) -> list[Difference]:
    """Returns parameters in which flights fall into two groups, the clearest first.

    Thrust-to-weight ratio of each flight is the one that hovering takes, inertia a Gauss-Newton
    step from the common one, the motors' lag what the sensors show.

    Args:
        flights: checked flights of one rate.
        target: the likelihood of these flights.
        drone: what was identified from all of them.
        motors: what their sensors show of the motors, if anything.
    """
    names = segment_names(flights, one_step.LENGTH, stride(flights[0]))
    deviations = {
        parameter: _of_flights(names, values, target.rows_per_segment)
        for parameter, values in _by_segment(target, drone).items()
    }
    if motors is not None:
        means, variances = np.array(list(motors.per_flight.values())).T
        deviations["motor lag"] = list(motors.per_flight), means, np.sqrt(variances)
    notes = []
    for parameter, of_flights in deviations.items():
        if split := _groups(*of_flights, LEAST[parameter]):
            notes.append((split[0], Difference(parameter, *split[1:])))
    return [note for _, note in sorted(notes, key=lambda each: -each[0])]


def _by_segment(target: OneStep, drone: Parameters) -> dict[str, Float[np.ndarray, "S"]]:
    """Logarithms of parameters by segment of flight."""
    with np.errstate(divide="ignore", invalid="ignore"):
        values = {"thrust_to_weight": np.log(np.maximum(target.hovering(drone), 1e-3))}
        _, scores, curvatures = target.derivatives(drone, INERTIA)
        for axis, name in enumerate(INERTIA):
            size = float(drone.inertia[axis])
            step = -scores[:, axis] / curvatures[:, axis, axis] / size
            values[name] = np.log1p(np.clip(step, -0.9, 9.0))
    return values


def _of_flights(
    names: Sequence[str], values: Float[np.ndarray, "S"], rows: Float[np.ndarray, "S"]
) -> tuple[list[str], Float[np.ndarray, "F"], Float[np.ndarray, "F"]]:
    """Names of flights with enough segments, their means, and the standard errors of these."""
    sound = np.isfinite(values) & (rows > 0)
    parts = {
        name: values[[own == name and fine for own, fine in zip(names, sound, strict=True)]]
        for name in dict.fromkeys(names)
    }
    parts = {name: part for name, part in parts.items() if len(part) >= _FEWEST_SEGMENTS}
    if not parts:
        return [], np.empty(0), np.empty(0)
    within = np.concatenate([part - part.mean() for part in parts.values()])
    free = max(len(within) - len(parts), 1)
    deviation = float(np.sqrt(within @ within / free))
    means = np.array([part.mean() for part in parts.values()])
    return list(parts), means, deviation / np.sqrt([len(part) for part in parts.values()])


def _groups(
    names: Sequence[str],
    means: Float[np.ndarray, "F"],
    errors: Float[np.ndarray, "F"],
    least: float,
) -> tuple[float, tuple[str, ...], tuple[str, ...], float] | None:
    """How far apart the two groups of flights are that differ most, and these; None if they do not.

    Source: Fisher 1958, On grouping for maximum homogeneity (the best cut of sorted values).
    """
    order = np.argsort(means).tolist()
    best = None
    for cut in range(1, len(order)):
        low, high = order[:cut], order[cut:]
        gap = float(means[high].mean() - means[low].mean())
        left = np.concatenate([means[low] - means[low].mean(), means[high] - means[high].mean()])
        between = left @ left / max(len(left) - 2, 1)
        difference = gap / float(np.sqrt(max(between, np.mean(errors**2))))
        if gap > least and difference > MIN_DIFFERENCE and (best is None or difference > best[0]):
            lower, upper = (sorted(str(names[index]) for index in side) for side in (low, high))
            best = difference, tuple(lower), tuple(upper), float(np.exp(gap))
    return best


def _name_flights(names: Sequence[str]) -> str:
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(names[:3]) + more
