"""Whether flights look like those of several drones, by estimates from each flight alone."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from maidenflight.flights.log import Flight
from maidenflight.flights.windows import segment_names
from maidenflight.identification.likelihood import one_step
from maidenflight.identification.likelihood.one_step import OneStep
from maidenflight.identification.signals.flight_signals import stride
from maidenflight.identification.signals.motor_response import MotorResponse
from maidenflight.parameters import Parameters

LEAST: Mapping[str, float] = {
    "thrust_to_weight": 0.06,
    "inertia_x": 0.3,
    "inertia_y": 0.3,
    "motor lag": 0.4,
}
"""What is looked at, and the differences of logarithms below which flights of one drone differ: a
battery pack, propellers or a trim make up to 5 % of thrust; a real drone's inertia and lag are seen
far less exactly."""
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
        axes = ("inertia_x", "inertia_y")
        _, scores, curvatures = target.derivatives(drone, axes)
        for axis, name in enumerate(axes):
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
