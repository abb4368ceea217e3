"""Makes the files of Stable-Baselines3 beside it, and what its own `predict` answers.

`pip install stable-baselines3 'maidenflight[gym]'`, then `python make.py`. Weights are drawn, so
that outputs fill their range; what only a training needs is left out of the files.
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false

import json
import zipfile
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import stable_baselines3
import torch
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.tasks.look_ahead import LookAhead

FOLDER = Path(__file__).parent
CIRCLE = "maidenflight.integrations.gym:maidenflight/Circle-v0"
AHEAD: dict[str, Any] = {"spec": PolicySpec(history=2, look_ahead=LookAhead(2, 0.3))}
SDE = {"net_arch": {"pi": [8], "vf": [4]}, "squash_output": True, "activation_fn": torch.nn.ReLU}
ROLLOUT: dict[str, Any] = {"n_steps": 64}
REPLAY: dict[str, Any] = {"buffer_size": 10}


class Elsewhere(gymnasium.Env[np.ndarray, np.ndarray]):
    """An environment that is none of ours."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (18,), np.float32)
    action_space = gymnasium.spaces.Box(0.0, 1.0, (4,), np.float32)


CASES: dict[str, tuple[str, dict[str, Any] | None, dict[str, Any], dict[str, Any]]] = {
    "ppo": ("PPO", {}, ROLLOUT, {"net_arch": [8, 8]}),
    "ppo_sde": ("PPO", {}, {**ROLLOUT, "use_sde": True}, SDE),
    "a2c": ("A2C", {}, {"n_steps": 5}, {"net_arch": [8], "activation_fn": torch.nn.ELU}),
    "sac": ("SAC", {}, REPLAY, {"net_arch": [8]}),
    "sac_sde": ("SAC", {}, {**REPLAY, "use_sde": True}, {"net_arch": [8], "clip_mean": 1.5}),
    "td3": ("TD3", {}, REPLAY, {"net_arch": [8, 6], "activation_fn": torch.nn.LeakyReLU}),
    "ddpg": ("DDPG", {}, REPLAY, {"net_arch": [8]}),
    "scaled": ("PPO", AHEAD, ROLLOUT, {"net_arch": [8]}),
    "attitude_rate": ("PPO", {"control": "attitude_rate"}, ROLLOUT, {"net_arch": [4]}),
    "elsewhere": ("PPO", None, ROLLOUT, {"net_arch": [8]}),
}


def make(name: str, generator: np.random.Generator) -> dict[str, Any]:
    """Writes a policy, and returns observations with the actions for them."""
    algorithm, settings, learning, layers = CASES[name]
    environment = Elsewhere() if settings is None else gymnasium.make(CIRCLE, **settings)
    model = getattr(stable_baselines3, algorithm)(
        "MlpPolicy", environment, seed=1, device="cpu", policy_kwargs=layers, **learning
    )
    with torch.no_grad():
        for place, values in model.policy.named_parameters():
            drawn = torch.tensor(generator.normal(0.0, 0.3, tuple(values.shape)))
            values += drawn * (1.0 if "weight" in place else 0.3)
    model.save(FOLDER / name)
    slim(FOLDER / f"{name}.zip")
    observations = generator.normal(0.0, 0.5, (3, model.observation_space.shape[0])).round(4)
    inputs = observations.astype(np.float32)
    if name == "scaled":
        scaling = VecNormalize(DummyVecEnv([lambda: gymnasium.make(CIRCLE, **AHEAD)]))
        scaling.obs_rms.mean = generator.normal(0.0, 0.2, inputs.shape[1])
        scaling.obs_rms.var = generator.uniform(0.1, 2.0, inputs.shape[1])
        scaling.save(str(FOLDER / "vecnormalize.pkl"))
        inputs = scaling.normalize_obs(inputs)
    actions = [model.predict(one, deterministic=True)[0] for one in inputs]
    return {"observations": observations.tolist(), "actions": np.array(actions).tolist()}


def slim(path: Path) -> None:
    """Leaves out what only a training needs."""
    with zipfile.ZipFile(path) as file:
        entries = {name: file.read(name) for name in file.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name in ("data", "policy.pth", "_stable_baselines3_version"):
            file.writestr(zipfile.ZipInfo(name), entries[name], zipfile.ZIP_DEFLATED)


def main() -> None:
    """Makes all."""
    generator = np.random.default_rng(0)
    predictions = {name: make(name, generator) for name in CASES}
    (FOLDER / "predictions.json").write_text(json.dumps(predictions) + "\n")


if __name__ == "__main__":
    main()
