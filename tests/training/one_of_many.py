"""One process of several that train together; `python one_of_many.py PROCESSES NUMBER PORT
FOLDER_OF_CHECKPOINTS FOLDER_OF_POLICIES METHOD`. `test_train` trains alone by the same program."""

import sys
from pathlib import Path

import jax
import numpy as np

from maidenflight.parameters import crazyflie, replace
from maidenflight.policy import Policy
from maidenflight.simulator.controllers import control
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.randomization import relative_box
from maidenflight.simulator.tasks import tasks
from maidenflight.simulator.tasks.look_ahead import LookAhead
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.settings import PPO, Settings
from maidenflight.training.train import train

BOX = relative_box(replace(crazyflie(), motor_time_constant=0.08, latency=0.012), 0.10)
TINY = AnalyticGradient(updates=4, num_envs=4, horizon=4, evaluations=4, episodes=4)
SPEC = PolicySpec(history=3, look_ahead=LookAhead(2, 0.2), memory=4, hidden=(8,))
# Two devices cannot share an odd number of episodes. Each shuffles its own drones' periods: only a
# whole batch holds the same ones however many devices there are.
ODD = PPO(
    updates=6,
    num_envs=8,
    horizon=8,
    evaluations=2,
    episodes=7,
    critic_hidden=(8,),
    actor_minibatches=1,
    critic_minibatches=1,
)
METHODS = {type(settings).__name__: settings for settings in (TINY, ODD)}


def learn(settings: Settings, checkpoint: Path) -> tuple[Policy, ...]:
    """Trains two policies."""
    keys = jax.random.split(jax.random.key(5), 2)
    asked = tasks.circle(), control.pwm(), BOX, keys, settings, SPEC
    return train(*asked, checkpoint=checkpoint)


def save(policies: tuple[Policy, ...], file: Path) -> None:
    """Writes the policies' numbers."""
    np.savez(file, *map(np.asarray, jax.tree.leaves(policies)))


if __name__ == "__main__":
    count, number, port = map(int, sys.argv[1:4])
    saved, folder = map(Path, sys.argv[4:6])
    method = sys.argv[6]
    jax.distributed.initialize(f"localhost:{port}", count, number)
    assert len(jax.devices()) == count
    save(learn(METHODS[method], saved / f"{count}.npz"), folder / "policies.npz")
