"""One process of several that train together; `python one_of_many.py PROCESSES NUMBER PORT CHECKPOINT POLICIES.npz`."""

import sys

import jax
import numpy as np

from maidenflight.parameters import crazyflie
from maidenflight.simulator import control, tasks
from maidenflight.simulator.randomization import relative_box
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.train import train

if __name__ == "__main__":
    count, number, port = map(int, sys.argv[1:4])
    if count > 1:
        jax.distributed.initialize(f"localhost:{port}", count, number)
    assert len(jax.devices()) == count
    settings = AnalyticGradient(updates=6, drones=8, horizon=8, evaluations=2, episodes=8)
    keys = jax.random.split(jax.random.key(0), 2)
    policies = train(tasks.circle(), control.pwm(), relative_box(crazyflie()), keys, settings, saved=sys.argv[4])
    np.savez(sys.argv[5], *map(np.asarray, jax.tree.leaves(policies)))
