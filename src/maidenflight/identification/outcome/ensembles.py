"""Drones to randomize over: posterior samples, or trims and thrust as flights differed."""

from collections.abc import Mapping, Sequence
from dataclasses import replace as replace_

import numpy as np
import scipy

from maidenflight.errors import InputError
from maidenflight.flights import trims
from maidenflight.flights.log import Flight, by_log
from maidenflight.flights.trims import ENOUGH_FLIGHTS, SEGMENT_S, between_flights, trim
from maidenflight.identification.drone_file import Estimate
from maidenflight.identification.outcome.plausible import HOVERING
from maidenflight.parameters import COMPONENTS, QUANTITIES, Parameters, check, component, replace
from maidenflight.simulator.randomization import Ensemble, ensemble

TRIM = ("torque_bias_x", "torque_bias_y", "torque_bias_z")
"""Constant torques: how the battery sits and the propellers are mounted, which people change
between flights."""
BETWEEN_FLIGHTS = (*TRIM, HOVERING)
"""What differs from flight to flight: a log of the day tells it."""
_IN_A_TRIM = (HOVERING, *TRIM)
"""The same in the order of `trims.with_standard_errors`."""

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
    if len(logs) < ENOUGH_FLIGHTS or not estimates.keys() & set(BETWEEN_FLIGHTS):
        return {}
    deviations = between_flights([trim(pieces, drone) for pieces in logs])
    if deviations is None:
        return {}
    return {
        name: replace_(estimates[name], between_sd=float(deviation))
        for name, deviation in zip(_IN_A_TRIM, deviations, strict=True)
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
    if not set(TRIM) & set(estimates):
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
    for column, name in enumerate(_IN_A_TRIM):
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
    names = [name for name in BETWEEN_FLIGHTS if name in estimates]
    if not set(TRIM) & set(names):
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
