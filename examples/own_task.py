"""A task of your own: a helix, and a reward that counts height twice.

In Python by `python examples/own_task.py`; on the command line, in this folder, by
`maidenflight train --drone crazyflie --task own_task:helix`.
"""

import jax
import jax.numpy as jnp

import maidenflight as mf


def reference(time):
    """Returns the set-point [m] at a time [s]: a circle of 5 s that rises and falls by 0.2 m."""
    turn = 2 * jnp.pi * time / 5.0
    height = 1.0 + 0.2 * jnp.sin(turn / 2)
    return jnp.stack([0.3 * jnp.cos(turn), 0.3 * jnp.sin(turn), height])


def helix():
    """Makes the task."""
    task = mf.simulator.tracking(reference, 5.0, latest_start=10.0)

    def reward(state, setpoint, action, previous_action):
        height_error = jnp.abs(state.position[2] - setpoint[2])
        return task.reward(state, setpoint, action, previous_action) - height_error

    # Its name tells checkpoints and records from those of other tasks.
    return task._replace(name="helix", reward=reward)


if __name__ == "__main__":
    drones = mf.simulator.relative_box(mf.crazyflie(), 0.1)
    keys, settings = jax.random.split(jax.random.key(0), 1), mf.AnalyticGradient(updates=300)
    policies = mf.train(helix(), mf.simulator.pwm(), drones, keys, settings)
    print(mf.transfer(policies, [mf.virtual_drone(7)], 3, task=helix(), duration=10.0).table)
