"""Inertia of logs without a state: by measured speeds, by the loop's gain, by the start's ratio."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from maidenflight.flights.log import Flight
from maidenflight.identification.likelihood.other_ways import ABOUT_Z
from maidenflight.identification.outcome.plausible import HOVERING, Ranges
from maidenflight.identification.outcome.posterior import RESAMPLES
from maidenflight.identification.outcome.problem import Problem
from maidenflight.identification.signals.flight_signals import force_along_z, means
from maidenflight.identification.signals.loop_spectra import spectra
from maidenflight.identification.signals.motor_response import (
    LIKE,
    OWN,
    SHORTEST,
    MotorResponse,
    is_clear,
    random_effects,
)
from maidenflight.parameters import Parameters, component, levers, replace

_DELAYS = 5e-4 * np.arange(25)
"""Delays of the gyro behind the speeds that are tried [s]."""
_ROUNDS = 5
"""Solutions of the weighted least squares."""
_BLOCK = 0.5
"""Time over which thrust by squared speed is taken [s]: the median of such blocks passes over hands
that throw or catch, falls and landings, which carry a drone without its rotors."""
_TORQUE = 0.07
"""Standard error of the rotors' torque, a share: planted drones that are thrown leave 9 % and more
(paper/notes/identification.md)."""


def inertia_of_speeds(problem: Problem, drone: Parameters) -> dict[str, Float[np.ndarray, "N"]]:
    """Returns samples of inertia by measured rotor speeds, whose squares carry and turn the drone.

    The accelerometer tells thrust by squared speed, the gyro what its differences turn; neither
    the motors' lag nor the curve of thrust over command has a part in it.

    Args:
        problem: none with parameters of the user's choice.
        drone: its mass and levers.
    """
    if problem.over is not None:
        return {}
    flights = [
        one
        for one in problem.flights
        if one.rotor_speed is not None
        and one.accelerometer is not None
        and one.duration >= SHORTEST
    ]
    inertia = {}
    for axis, name in enumerate(("inertia_x", "inertia_y")):
        estimates = [
            one for flight in flights if (one := _log_inertia(flight, drone, axis)) is not None
        ]
        if not estimates:
            continue
        values, errors = np.array(estimates).T
        mean, error = random_effects(values, np.hypot(errors, OWN) ** 2)
        noise = np.linalg.norm([error, LIKE, _TORQUE]) * problem.generator.standard_normal(
            RESAMPLES
        )
        inertia[name] = np.exp(mean + noise)
    return {name: samples for name, samples in inertia.items() if is_clear(samples)}


def _log_inertia(flight: Flight, drone: Parameters, axis: int) -> tuple[float, float] | None:
    """Returns the logarithm of the inertia [kg m2] and its error; None where nothing follows.

    In bands of frequency disturbances have sizes of their own, which weigh the lines. Source:
    Whittle 1953.
    """
    squares = np.asarray(flight.rotor_speed, float) ** 2
    pushes = np.column_stack([force_along_z(flight), squares.sum(axis=1)])
    force, square = means(pushes, round(_BLOCK / flight.period)).T
    thrust = float(drone.mass) * np.median(force / np.maximum(square, 1e-9))
    torque = thrust * squares @ levers(drone)[:, [axis]]
    rates = flight.body_rates[:, [axis]].astype(float)
    spectrum = spectra(torque, rates, flight.period, zero_order_hold=False, differentiate=True)
    fits = []
    for delay in _DELAYS:
        cross, weight = (
            np.real(spectrum.cross * np.exp(spectrum.s * delay)),
            np.ones(len(spectrum.s)),
        )
        gain = 0.0
        for _ in range(_ROUNDS):
            gain = (weight @ cross) / (weight @ spectrum.drive)
            left = spectrum.means(spectrum.motion - 2 * gain * cross + gain**2 * spectrum.drive)
            weight = 1.0 / left[spectrum.band]
        fits.append((float(-np.log(weight).sum()), float(gain), float(weight @ spectrum.drive)))
    _, gain, information = min(fits)
    if not (np.isfinite(information) and gain > 0):
        return None
    return -np.log(gain * spectrum.scale), 1 / (gain * np.sqrt(2 * spectrum.averages * information))


def inertia_of_loop(
    problem: Problem,
    motors: MotorResponse | None,
    known: Mapping[str, Float[np.ndarray, "N"]],
    drone: Parameters,
) -> dict[str, Float[np.ndarray, "N"]]:
    """Returns samples of inertia by the gain of the loop, where it tells that clearly.

    It does for planted PX4 drones of which the gyro's likelihood leaves it untold; where that tells
    it, the loop is worse (paper/notes/identification.md).

    Args:
        problem: none with parameters of the user's choice.
        motors: what logs show of the motors.
        known: samples of other parameters, such as the thrust-to-weight ratio.
        drone: its ratio is used where that is not known.
    """
    if motors is None or problem.over is not None or not motors.is_identifiable:
        return {}
    thrust = known.get(HOVERING, np.full(RESAMPLES, float(drone.thrust_to_weight)))
    # A command turns the drone by the slope of the thrust's curve, of which each sample has that at
    # one of the flight's commands: it is not known at which one a loop shows.
    linear = known.get("thrust_linear", float(drone.thrust_linear))
    commands = np.concatenate([one.command.mean(axis=1) for one in problem.flights])
    chosen = problem.generator.choice(commands.clip(0.01), RESAMPLES)
    slope = 1.0 - float(drone.thrust_offset) + linear * (0.5 / np.sqrt(chosen) - 1.0)
    thrust = thrust * np.maximum(slope, 0.1)
    inertia = {
        name: problem.generator.choice(samples, RESAMPLES) * thrust
        for name, samples in motors.inertia_per_thrust.items()
    }
    return {name: samples for name, samples in inertia.items() if is_clear(samples)}


def with_inertia_z(
    start: Parameters,
    drone: Parameters,
    draws: dict[str, Float[np.ndarray, "N"]],
    spread: dict[str, float],
    unidentifiable: Ranges,
) -> tuple[Parameters, dict[str, Float[np.ndarray, "N"]], dict[str, float], list[str]]:
    """Returns what is told, with the inertia about z in the start's ratio to those about x and y.

    Torques about z follow, since yaw shows them as shares of that inertia.
    """
    answer_of = draws.keys() - unidentifiable.keys()
    if not answer_of.intersection(ABOUT_Z) or "inertia_z" in draws:
        return drone, draws, spread, []
    level = [name for name in ("inertia_x", "inertia_y") if name in answer_of]
    if not level:
        note = "yaw shows its torques only as shares of inertia_z, which is the start's"
        return drone, draws, spread, [note]
    shares = {name: 1 / float(component(start, name)) / len(level) for name in level}
    factor = np.sum([share * draws[name] for name, share in shares.items()], axis=0)
    best = sum(share * float(component(drone, name)) for name, share in shares.items())
    about_z = float(component(start, "inertia_z"))
    changes = {"inertia_z": np.float32(best * about_z)}
    draws, spread = dict(draws), dict(spread)
    for name in answer_of.intersection(ABOUT_Z):
        changes[name] = np.float32(best * float(component(drone, name)))
        draws[name], spread[name] = factor * draws[name], best * spread[name]
    draws["inertia_z"] = about_z * factor
    spread["inertia_z"] = about_z * float(
        np.linalg.norm([share * spread.get(name, 0.0) for name, share in shares.items()])
    )
    ratio = about_z / np.mean([float(component(start, name)) for name in level])
    note = (
        f"yaw shows its torques only as shares of inertia_z, which is taken as {ratio:.3g} times "
        f"the mean of {' and '.join(level)}, as in the start"
    )
    return replace(drone, **changes), draws, spread, [note]
