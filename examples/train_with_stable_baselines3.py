"""PPO of Stable-Baselines3 learns to fly the circle.

    pip install 'maidenflight[gym]' stable-baselines3 torch==2.13.0
    python examples/train_with_stable_baselines3.py --steps 1000000

PyTorch's default wheel for Linux holds gigabytes of CUDA; with `--index-url
https://download.pytorch.org/whl/cpu` it does not.
"""

import argparse

from stable_baselines3 import PPO  # pyright: ignore[reportMissingImports]
from stable_baselines3.common.env_util import make_vec_env  # pyright: ignore[reportMissingImports]
from stable_baselines3.common.evaluation import evaluate_policy  # pyright: ignore[reportMissingImports]

import maidenflight.gym  # noqa: F401  registers the environments also where maidenflight is not installed

arguments = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
arguments.add_argument(
    "--steps", type=int, default=1_000_000, help="environment steps to train for"
)
arguments.add_argument("--control", default="attitude_rate", help="pwm, attitude_rate or attitude")
arguments.add_argument("--episodes", type=int, default=20, help="episodes of the evaluation")
arguments.add_argument("--seed", type=int, default=0)
given = arguments.parse_args()

drones = make_vec_env(
    "maidenflight/Circle-v0", n_envs=16, seed=given.seed, env_kwargs={"control": given.control}
)
steps = min(256, -(-given.steps // 16))
model = PPO(
    "MlpPolicy",
    drones,
    n_steps=steps,
    batch_size=4 * steps,
    gamma=0.98,
    seed=given.seed,
    device="cpu",
    verbose=1,
)
model.learn(given.steps)

mean, deviation = evaluate_policy(model, drones, n_eval_episodes=given.episodes)
print(f"return of {given.episodes} episodes: {mean:.1f} +- {deviation:.1f}")
model.save("circle")
