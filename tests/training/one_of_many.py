"""One process of several that train together; `python one_of_many.py PROCESSES NUMBER PORT
FOLDER_OF_CHECKPOINTS FOLDER_OF_POLICIES`."""

import sys
from typing import Any

import jax
import numpy as np

from maidenflight.parameters import crazyflie
from maidenflight.simulator.controllers import control
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.randomization import relative_box
from maidenflight.simulator.tasks import tasks
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.ppo_settings import PPO
from maidenflight.training.train import train

if __name__ == "__main__":
    count, number, port = map(int, sys.argv[1:4])
    if count > 1:
        jax.distributed.initialize(f"localhost:{port}", count, number)
    assert len(jax.devices()) == count
    few: dict[str, Any] = {
        "updates": 6,
        "num_envs": 8,
        "horizon": 8,
        "evaluations": 2,
        "episodes": 8,
    }
    # Two devices cannot share an odd number of episodes.
    odd: dict[str, Any] = {**few, "episodes": 7}
    keys = jax.random.split(jax.random.key(0), 2)
    # Each device shuffles its own drones' periods: only a whole batch holds the same ones however
    # many devices there are.
    for settings in (
        AnalyticGradient(**few),
        PPO(**odd, critic_hidden=(8,), actor_minibatches=1, critic_minibatches=1),
    ):
        name, saved = (
            type(settings).__name__,
            f"{sys.argv[4]}/{type(settings).__name__}_{count}.npz",
        )
        policies = train(
            *(tasks.circle(), control.pwm(), relative_box(crazyflie()), keys, settings),
            PolicySpec(hidden=(8,)),
            checkpoint=saved,
        )
        np.savez(f"{sys.argv[5]}/{name}.npz", *map(np.asarray, jax.tree.leaves(policies)))
