"""How close to its set-point any controller holds a drone whose estimate of position drifts.

The estimates follow p' = v + w_r n, v' = a - d + w_v n and d' = -d + w_v n, all with the same
white noise n (`sensors.walk_estimate`, without `turn_drift`); a is gravity times a tilt, which
torques behind the motors' lag and the latency turn. A linear-quadratic regulator knows all of this
and weighs error, body rate and torque; `sensors.walk_factor` of the rates that it makes grows the
noise. The least error over the weights bounds linear controllers (paper/notes/training.md).

    python paper/policies/drift_floor.py identified/authors/drone.toml
"""

import argparse
from itertools import product
from pathlib import Path

import numpy as np
import scipy
from jaxtyping import Float

from maidenflight.parameters import Parameters, read_drone
from maidenflight.simulator.physics.sensors import DRIFT_TIME, TURNING

PERIOD = 0.01
TORQUES, RATES = np.logspace(-10, -5, 11), np.logspace(-5, -1, 33)
"""Weights of squared torque over inertia and of squared body rate; the squared error has 1."""
PLANE = np.sqrt(np.pi / 2.0)
"""Mean distance in the plane over the deviation along each axis, of a normal distribution."""


def transition(drone: Parameters) -> tuple[Float[np.ndarray, "7 7"], Float[np.ndarray, "7 1"]]:
    """Returns what a period makes of a state, and what a command adds.

    The state is p, v, tilt, its rate, its acceleration, d, and the command of the period before: a
    latency of 10 ms.
    """
    lag, gravity = float(drone.motor_time_constant), float(drone.gravity)
    rates = np.zeros((7, 7))
    rates[0, 1], rates[1, 2], rates[2, 3], rates[3, 4] = 1.0, gravity, 1.0, 1.0
    rates[1, 5] = rates[5, 5] = -1.0 / DRIFT_TIME
    rates[4, 4], rates[4, 6] = -1.0 / lag, 1.0 / lag
    after = scipy.linalg.expm(rates * PERIOD)
    after[6] = 0.0
    return after, np.eye(7)[:, 6:]


def error_and_rate(drone: Parameters, torque: float, rate: float) -> tuple[float, float]:
    """Returns the mean distance in the plane [m] and the deviation of the body rate [rad/s].

    Infinite where the noise by turning grows without bound.
    """
    after, command = transition(drone)
    root, noise = np.sqrt(PERIOD), np.zeros((7, 1))
    walk, velocity_walk = float(drone.position_walk), float(drone.velocity_walk)
    noise[[0, 1, 5], 0] = root * np.array(
        [walk + PERIOD * velocity_walk, velocity_walk, velocity_walk]
    )
    costs = np.diag([1.0, 0.0, 0.0, rate, 0.0, 0.0, 0.0])
    value = scipy.linalg.solve_discrete_are(after, command, costs, np.array([[torque]]))
    gain = np.linalg.solve(torque + command.T @ value @ command, command.T @ value @ after)
    covariance = scipy.linalg.solve_discrete_lyapunov(
        after - command @ gain, noise @ noise.T, "bilinear"
    )
    # Roll and pitch turn alike: the noise has 1 + 2 rate^2 / TURNING^2 times the variance.
    rest = 1.0 - 2.0 * covariance[3, 3] / TURNING**2
    factor = rest**-0.5 if rest > 0.0 else np.inf
    return PLANE * factor * np.sqrt(covariance[0, 0]), factor * np.sqrt(covariance[3, 3])


def main() -> None:
    """Prints the bound of a drone."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("drone", type=Path)
    drone = read_drone(parser.parse_args().drone)
    error, rate = min(error_and_rate(drone, *weights) for weights in product(TORQUES, RATES))
    print(f"{100 * error:.2f} cm in the plane, at {np.degrees(rate):.0f} deg/s")


if __name__ == "__main__":
    main()
