"""Inertia of logs without a state: by the loop's gain, and about z by the start's ratio."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from maidenflight.identification.likelihood.other_ways import ABOUT_Z
from maidenflight.identification.outcome.plausible import HOVERING, Ranges
from maidenflight.identification.outcome.posterior import RESAMPLES
from maidenflight.identification.outcome.problem import Problem
from maidenflight.identification.signals.motor_response import MotorResponse, is_clear
from maidenflight.parameters import Parameters, component, replace


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
