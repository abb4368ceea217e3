"""The paper's quadrotor once more, in plain float64 loops: an independent transcription that shares
no code with maidenflight.

Source: Gronauer et al. 2022, eq:linear-acceleration, eq:angular-acceleration, eq:torque,
eq:motor-force, eq:motor-torque, eq:motor-dynamics. Quaternions here are (w, x, y, z). A state is a
list of r, v, q, omega, nu.
"""

from itertools import pairwise
from typing import Any

import numpy as np

PAPER: dict[str, Any] = {
    "g": 9.81,
    "m": 0.028,
    "I": [1.33e-5, 1.33e-5, 2.64e-5],
    "L": 0.0396,
    "k_M1": 5.96e-3,
    "k_M2": 1.56e-5,
}
PAPER |= {"k_F": 1.725, "T_m": 0.088}


def product(a, b):
    """Hamilton's product of two quaternions."""
    return np.array(
        [
            a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
        ]
    )


def turned(q, vector):
    """A body vector in the world, q v q*."""
    return product(product(q, [0.0, *vector]), q * [1, -1, -1, -1])[1:]


def accelerations(state, c):
    """Linear (world) and angular (body) acceleration."""
    _, _, q, omega, nu = state
    force = [c["m"] * c["g"] / 4 * c["k_F"] * speed**2 for speed in nu]
    moment = [c["k_M1"] * f + c["k_M2"] for f in force]
    eta = [
        c["L"] / np.sqrt(2) * (-force[0] - force[1] + force[2] + force[3]),
        c["L"] / np.sqrt(2) * (-force[0] + force[1] + force[2] - force[3]),
        -moment[0] + moment[1] - moment[2] + moment[3],
    ]
    linear = (np.array([0.0, 0.0, -c["m"] * c["g"]]) + turned(q, [0.0, 0.0, sum(force)])) / c["m"]
    angular = np.linalg.solve(np.diag(c["I"]), eta - np.cross(omega, np.diag(c["I"]) @ omega))
    return linear, angular


def slope(state, target, c):
    """Time derivative of a state whose motors are told the speeds `target`."""
    _, v, q, omega, nu = state
    linear, angular = accelerations(state, c)
    return [v, linear, 0.5 * product(q, [0.0, *omega]), angular, (target - nu) / c["T_m"]]


def euler(state, target, c, dt):
    """Motors, then velocities, then positions."""
    r, v, q, omega, nu = state
    nu = nu + dt * (target - nu) / c["T_m"]
    linear, angular = accelerations([r, v, q, omega, nu], c)
    v, omega = v + dt * linear, omega + dt * angular
    q = q + dt * 0.5 * product(q, [0.0, *omega])
    return [r + dt * v, v, q / np.linalg.norm(q), omega, nu]


def rk4(state, target, c, dt):
    """Classical Runge-Kutta."""

    def moved(change, by):
        return [value + by * rate for value, rate in zip(state, change, strict=True)]

    a = slope(state, target, c)
    b = slope(moved(a, dt / 2), target, c)
    d = slope(moved(b, dt / 2), target, c)
    e = slope(moved(d, dt), target, c)
    new = moved([(w + 2 * x + 2 * y + z) / 6 for w, x, y, z in zip(a, b, d, e, strict=True)], dt)
    new[2] = new[2] / np.linalg.norm(new[2])
    return new


def delayed_speeds(commands, latency, dt, steps, c):
    """Rotor speed commands sqrt(u) that act in each physics step, and its length [s].

    Half of a command's steps end when a command arrives.

    Args:
        commands: thrust commands u, each held for `steps` physics steps; hover before the first.
        latency: delay [s].
        dt: mean physics step [s].
        steps: physics steps a command.
        c: constants.
    """
    period, half = steps * dt, steps // 2
    speeds, lengths = [], []
    for number in range(len(commands)):
        arrival = latency % period
        ends = [*np.linspace(0, arrival, half + 1), *np.linspace(arrival, period, half + 1)[1:]]
        for begin, end in pairwise(ends):
            given = int(np.floor((number * period + (begin + end) / 2 - latency) / period))
            thrust = 1 / c["k_F"] if given < 0 else commands[given]
            speeds.append(np.sqrt(thrust) * np.ones(4))
            lengths.append(end - begin)
    return np.array(speeds), np.array(lengths)


def fly(integrate, state, speeds, lengths, c):
    """States after each physics step under these rotor speed commands: a list of arrays r, v, q,
    omega, nu."""
    flown = []
    for target, dt in zip(speeds, lengths, strict=True):
        state = integrate(state, target, c, dt)
        flown.append(state)
    return [np.array(column) for column in zip(*flown, strict=True)]
