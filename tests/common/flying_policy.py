"""A policy that flies without training, a linear controller written as a network, and its logs."""

import jax.numpy as jnp
import numpy as np

from made_flights import calm
from maidenflight.flights.log import Flight
from maidenflight.parameters import Parameters, levers
from maidenflight.policy import Actor, Policy
from maidenflight.simulator.physics import dynamics, rotations
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.policy_spec import PolicySpec

SIZE = 20
"""Of an instant: position, quaternion, velocity, body rates, set-point - position, last action."""


def flying_policy(drone: Parameters, gain: float = 1.0) -> Policy:
    """Holds the set-point of a Crazyflie: position to tilt, tilt and rate to differential thrust.

    Args:
        drone: what hovers.
        gain: factor of the inner loop's gains.
    """
    gains, signs = np.zeros((4, 2 * SIZE)), np.sign(levers(drone))
    now = SIZE
    quaternion, velocity, rates, error = now + 3, now + 7, now + 10, now + 13
    stiff, damped = 0.029 * gain, 0.0115 * gain
    # Roll drives the drone along -y, pitch along x.
    for axis, along, sign in ((0, 1, -1.0), (1, 0, 1.0)):
        row = np.zeros(2 * SIZE)
        row[error + along], row[velocity + along] = sign * stiff / 9.81, -sign * stiff * 1.6 / 9.81
        row[quaternion + axis], row[rates + axis] = -2.0 * stiff, -damped
        gains += signs[:, axis : axis + 1] * row
    turn = np.zeros(2 * SIZE)
    turn[quaternion + 2], turn[rates + 2] = -0.06, -0.02
    gains += signs[:, 2:] * turn
    gains[:, error + 2] += 0.6
    gains[:, velocity + 2] -= 0.35
    actions = 2.0 * gains  # an action of -1 to 1 is a command of 0 to 1
    level = 2.0 * float(dynamics.hover_command(drone)) - 1.0
    identity = np.eye(8)
    weights = (
        np.concatenate([actions, -actions]),
        identity,
        np.concatenate([np.eye(4), -np.eye(4)], axis=1),
    )
    biases = (np.zeros(8), np.zeros(8), np.full(4, level))
    return Policy(
        tuple(np.float32(weight) for weight in weights),  # type: ignore[arg-type]
        tuple(np.float32(bias) for bias in biases),  # type: ignore[arg-type]
        np.zeros(2 * SIZE, np.float32),  # type: ignore[arg-type]
        np.ones(2 * SIZE, np.float32),  # type: ignore[arg-type]
        spec=PolicySpec(hidden=(8, 8)),
    )


def flown(policy: Policy, seed: int, rows: int = 30) -> Flight:
    """A log of estimates and of what an `Actor` does with them, one instant at a time."""
    flight = calm(rows, seed)
    actor = Actor(policy, 0.6)
    commands = []
    for row in range(rows):
        seen = Measurement(
            jnp.asarray(flight.position[row]),
            jnp.asarray(flight.velocity[row]),
            rotations.from_attitude(jnp.asarray(flight.attitude[row])),
            jnp.asarray(flight.body_rates[row]),
        )
        commands.append(actor.act(seen, flight.setpoint[row]).command)
    return calm(rows, seed, command=np.stack(commands).astype(np.float32), name=f"flight {seed}")
