"""A control structure of your own: collective thrust and torques, mixed for the motors.

In Python by `python examples/own_controller.py`; on the command line, in this folder, by
`maidenflight train --drone crazyflie --control own_controller:torques`, and the same `--control`
in `transfer`, `envelope` and `predict`.
"""

import jax
import jax.numpy as jnp

import maidenflight as mf

MIXER = jnp.array([[1.0, -1, -1, -1], [1, -1, 1, 1], [1, 1, 1, -1], [1, 1, -1, 1]])
"""Thrust, roll, pitch and yaw to the four motors, ordered as in a flight log."""
INTERFACE = mf.simulator.ControlInterface(
    "torques",
    centre=(0.55, 0.0, 0.0, 0.0),
    span=(0.4, 0.2, 0.2, 0.1),
    units=("share of full thrust", "-", "-", "-"),
    rate=100,
)


def torques():
    """Makes the control structure."""

    def drive(memory, command, measurement, setpoint):
        return memory, jnp.clip(MIXER @ command, 0.0, 1.0)

    return mf.simulator.driven(INTERFACE, drive)


if __name__ == "__main__":
    drones = mf.simulator.relative_box(mf.crazyflie(), 0.1)
    keys, settings = jax.random.split(jax.random.key(0), 1), mf.AnalyticGradient(updates=300)
    policies = mf.train(mf.simulator.circle(), torques(), drones, keys, settings)
    flights = mf.transfer(policies, [mf.virtual_drone(7)], 3, controller=torques())
    print(flights.table)
