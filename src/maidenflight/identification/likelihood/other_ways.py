"""Fits in other ways, of which the difference counts as a standard error.

Where commands are samples of a faster loop, parameters are identified from every second row too: an
error that grows with the distance of rows is as large as what this changes.

What accelerometer or gyro tell counts half of what white noise changes, which weighs slow motion
more and takes the answers of a controller for causes, and of inertia half of what a lag of the
gyro's own changes, so that flights which hardly excite an axis have wide intervals.

Flights whose likelihood rises clearly with something that the fitted drone lacks contradict it: no
optimum is then the drone's to more than a few hundredths, however little noise there is.

Source: Richardson 1911, The approximate arithmetical solution by finite differences (error from the
change with the step); Rao 1948, Large sample tests of statistical hypotheses (score test).
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from maidenflight.flights.log import Flight, thinned
from maidenflight.identification.likelihood.estimator import Ways
from maidenflight.identification.likelihood.fit import Fit
from maidenflight.identification.likelihood.observation import BY_MOMENT
from maidenflight.identification.likelihood.one_step import one_step_objective
from maidenflight.identification.likelihood.sensor_errors import SensorErrors
from maidenflight.identification.methods import Likelihood
from maidenflight.identification.outcome.about_z import ABOUT_Z
from maidenflight.identification.outcome.plausible import HOVERING
from maidenflight.identification.signals.flight_signals import is_zero_order_hold
from maidenflight.identification.signals.lag import DELAYS, SLOWING_DOWN
from maidenflight.identification.signals.motor_response import DELAY_ERROR
from maidenflight.identification.uncertainty import inverse
from maidenflight.identification.unknowns import INERTIA

WHITE, OWN_LAG, SPARSER = "white noise", "its own lag", "every second row"
"""Other ways of fitting."""
_SHARES = {WHITE: 0.5, OWN_LAG: 0.5, SPARSER: 1.0}
"""What of their difference counts as a standard error."""
_ANSWERS = 0.15
"""Share of an inertia beyond which white noise only shows a controller's answers, which are hardly
left in the fit itself; its own lag tells where they are. Harmless
(paper/identification/constants.py)."""
FILTER = 1e-3
"""Standard error of the delay of a sensor's own filter [s], which passes for latency. Where
commands are samples of a faster loop, half a row is added."""


_LACKING = (
    "thrust_linear",
    "rotational_damping",
    *(f"{name}_{axis}" for name in ("flapping_moment", "drag") for axis in "xy"),
)
"""What a drone may lack: the curve of its thrust, the lag of its sensors, and its air."""
_CONTRADICTED = 10.0
"""Log-likelihood gain of all rows [nats] by what is lacking, beyond which flights contradict a
drone; chance has it once in 360 times. Source: Wilks 1938, chi-square of the six of `_LACKING`."""
_LIKE = 0.03
"""Least standard error of a drone that flights contradict, a share: of drones in crazyflow, whose
thrust and motors follow other laws, lag and inertia come out 1 to 5 % off; of a ratio of lags it
is that of any drone: with noise in the motors 2.4 comes out 2 to 6 % too small."""
_EXACT = 0.003
"""The same of a drone that they do not contradict: physics steps are exact to so much, and l2f's
lag is 0.2 % off (paper/notes/truth-board.md)."""
_FILTERED = 0.002
"""Standard error of its latency [s]: the gyro may be filtered or not (a Crazyflie's is, 2.8 ms
late), and a simulator adds a step of its own."""


def ways_of_states(flights: Sequence[Flight], settings: Likelihood, names: Sequence[str]) -> Ways:
    """Returns other ways of fitting logs with a state."""
    if is_zero_order_hold(flights):
        return {}
    sparse = [thinned(flight, 2) for flight in flights]
    return {SPARSER: (one_step_objective(sparse, settings), names)}


def doubt_of_states(
    fit_result: Fit, others: Mapping[str, Fit], *, measured: bool = False
) -> Float[np.ndarray, "d d"]:
    """Returns the covariance in the unit cube of what they differ by, each parameter by itself.

    Where lag and latency are not `measured` by other signals, with the errors of the model.
    """
    names, unit = fit_result.box.names, fit_result.optimum
    errors = np.zeros(len(names))
    if not measured:
        contradicted = "thrust_linear" in names or what_is_lacking(fit_result) > _CONTRADICTED
        share = _LIKE if contradicted else _EXACT
        # Thrust has its own error, and trims are of a flight.
        errors = share * np.abs(fit_result.box.values(unit))
        errors[[name == HOVERING or name.startswith("torque_bias") for name in names]] = 0.0
        errors = np.maximum(errors, [DELAY_ERROR * (name in DELAYS) for name in names])
        if contradicted:
            errors[[name == "latency" for name in names]] = _FILTERED
    if SLOWING_DOWN in names:
        # Noise of the motors that no log holds lets them speed up and slow down in between.
        ratio = names.index(SLOWING_DOWN)
        errors[ratio] = max(errors[ratio], _LIKE * float(fit_result.drone.spin_down_ratio))
    difference = [other.optimum - unit for other in others.values()]
    return np.diag(
        np.sum(np.square(difference), axis=0) + (errors / fit_result.box.slope(unit)) ** 2
    )


def what_is_lacking(fit_result: Fit) -> float:
    """Returns the gain of the log likelihood [nats] by what the drone lacks, in one step."""
    names, model = fit_result.box.names, fit_result.model
    lacking = [name for name in _LACKING if name not in names]
    known = [name for name in names if name not in (*BY_MOMENT, HOVERING)]
    hover = [HOVERING] if model.means is not None else []
    _, scores, curvatures = model.derivatives(fit_result.drone, [*lacking, *known, *hover])
    slope, curvature = scores.sum(axis=0), curvatures.sum(axis=0)
    along = np.eye(len(slope))
    if model.means is not None:
        climbs = model.means.climbs(fit_result.drone, [*lacking, *known, *hover])
        along = np.concatenate([along[:-1, :-1], -climbs[None, :-1] / climbs[-1]])
    slope, curvature = along.T @ slope, along.T @ curvature @ along
    step = inverse(curvature) @ slope
    best = inverse(curvature[len(lacking) :, len(lacking) :]) @ slope[len(lacking) :]
    return float(model.rows * 0.5 * (slope @ step - slope[len(lacking) :] @ best))


def ways_of_sensor(flights: Sequence[Flight], model: SensorErrors, names: Sequence[str]) -> Ways:
    """Returns other ways of fitting a sensor."""
    fit_result: dict[str, tuple[SensorErrors, Sequence[str]]] = {WHITE: (model.white(), names)}
    if set(INERTIA) <= set(names):
        fit_result[OWN_LAG] = model, (*names, *DELAYS)
    if not is_zero_order_hold(flights):
        sparse = [thinned(flight, 2) for flight in flights]
        fit_result[SPARSER] = type(model).of(sparse, model.priors, model.signals.limit), names
    return fit_result


def doubt_of_sensor(
    flights: Sequence[Flight], fit_result: Fit, others: Mapping[str, Fit]
) -> Float[np.ndarray, "d d"]:
    """Returns the covariance in the unit cube of what they differ by, and of the sensor's delay."""
    late = (
        FILTER
        if is_zero_order_hold(flights)
        else float(np.hypot(FILTER, flights[0].period / np.sqrt(12)))
    )
    box, names, unit = fit_result.box, fit_result.box.names, fit_result.optimum
    slope = box.slope(unit)
    covariance = np.zeros((len(names), len(names)))
    for way, other in others.items():
        difference = _SHARES[way] * (box.unit_of(other.drone) - unit)
        if way == WHITE:
            # All of it counts about z: no lag of its own tells of a controller's answers there.
            about_z = np.array([name in ABOUT_Z for name in names])
            difference = np.where(about_z, 2.0 * difference, difference)
        if way == WHITE and OWN_LAG in others:
            most = _ANSWERS * np.abs(box.values(unit)) / slope
            level = np.array([name in INERTIA for name in names])
            difference = np.where(level, np.clip(difference, -most, most), difference)
        covariance += np.outer(difference, difference)
    return (
        covariance + np.diag([late**2 if name == "latency" else 0.0 for name in names]) / slope**2
    )
