"""Inertia by the gain of a loop, of logs without a state."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from maidenflight.identification.outcome.plausible import HOVERING
from maidenflight.identification.outcome.posterior import RESAMPLES
from maidenflight.identification.outcome.problem import Problem
from maidenflight.identification.signals.motor_response import MotorResponse, is_clear
from maidenflight.parameters import Parameters


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
