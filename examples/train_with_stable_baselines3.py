"""PPO of Stable-Baselines3 learns to fly the circle, in minutes on two cores.

    pip install '.[gym,sb3]'
    python examples/train_with_stable_baselines3.py --steps 2500000

PyTorch's default wheel for Linux holds gigabytes of CUDA; with `--index-url
https://download.pytorch.org/whl/cpu` it does not. A line of the learning curve is printed ten
times and written to circle.csv; the best policy is kept in circle.zip, with the scaling of its
observations in vecnormalize.pkl; `maidenflight transfer circle.zip` flies it.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import torch  # pyright: ignore[reportMissingImports]
from stable_baselines3 import PPO  # pyright: ignore[reportMissingImports]
from stable_baselines3.common.callbacks import BaseCallback  # pyright: ignore[reportMissingImports]
from stable_baselines3.common.env_util import make_vec_env  # pyright: ignore[reportMissingImports]
from stable_baselines3.common.vec_env import VecNormalize  # pyright: ignore[reportMissingImports]

import maidenflight.integrations.gym  # noqa: F401  registers the environments also where maidenflight is not installed

arguments = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
arguments.add_argument(
    "--steps", type=int, default=2_500_000, help="environment steps to train for"
)
arguments.add_argument("--control", default="pwm", help="pwm, attitude_rate or attitude")
arguments.add_argument("--reward", default="shaped", help="shaped, or the task's own: task")
arguments.add_argument("--episodes", type=int, default=64, help="episodes of an evaluation")
arguments.add_argument("--evaluations", type=int, default=10)
arguments.add_argument("--seed", type=int, default=0)
given = arguments.parse_args()

ENVIRONMENTS = 64
settings = {"control": given.control, "reward": given.reward}


def drones(count: int, seed: int, training: bool) -> VecNormalize:
    """Environments that scale observations by what they have seen in training."""
    made = make_vec_env("maidenflight/Circle-v0", n_envs=count, seed=seed, env_kwargs=settings)
    return VecNormalize(made, training=training, norm_reward=False)


learning = drones(ENVIRONMENTS, given.seed, training=True)
testing = drones(16, given.seed + 1000, training=False)
steps = min(128, -(-given.steps // ENVIRONMENTS))
model = PPO(
    "MlpPolicy",
    learning,
    n_steps=steps,
    batch_size=16 * steps,
    n_epochs=10,
    learning_rate=lambda remaining: 5e-4 * remaining,
    gamma=0.995,
    target_kl=0.02,
    policy_kwargs={"activation_fn": torch.nn.ReLU, "log_std_init": -1.0},
    seed=given.seed,
    device="cpu",
)


class Curve(BaseCallback):
    """Evaluates the policy without noise, evenly through training, and prints how it flies."""

    rows = ("steps,seconds,survival,duration,position_error",)
    best = (-1.0, 0.0)

    def _on_training_start(self) -> None:
        self.began = time.perf_counter()
        self.next = 0

    def _on_rollout_end(self) -> None:
        if self.num_timesteps >= self.next:
            self.next += given.steps / given.evaluations
            self.evaluate()

    def evaluate(self) -> None:
        """Adds a row: share of episodes to the time limit, mean duration [s] and error [m]."""
        stopped = time.perf_counter()
        testing.obs_rms = learning.obs_rms
        ended: list[dict[str, float]] = []
        observations = testing.reset()
        while len(ended) < given.episodes:
            actions, _ = self.model.predict(observations, deterministic=True)
            observations, _, over, infos = testing.step(actions)
            ended += [info for info, done in zip(infos, over, strict=True) if done]
        survival = float(np.mean([info["end_reason"] == "time limit" for info in ended]))
        duration, error = (
            float(np.mean([info[name] for info in ended]))
            for name in ("duration", "position_error")
        )
        seconds = stopped - self.began
        self.began += time.perf_counter() - stopped  # the time of training alone
        print(
            f"{self.num_timesteps} steps, {seconds:.0f} s: {survival:.0%} of episodes to the time "
            f"limit, {duration:.2f} s, {100 * error:.1f} cm from the circle",
            flush=True,
        )
        numbers = (self.num_timesteps, f"{seconds:.1f}", survival, duration, error)
        self.rows += (",".join(map(str, numbers)),)
        if (survival, -error) > self.best:
            self.best = (survival, -error)
            self.model.save("circle")
            learning.save("vecnormalize.pkl")

    def _on_step(self) -> bool:
        return True


curve = Curve()
model.learn(given.steps, curve)
curve.evaluate()
Path("circle.csv").write_text("\n".join(curve.rows) + "\n")
