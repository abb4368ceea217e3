"""Policies of Stable-Baselines3, run by its own code (extra `sb3`).

`model.zip`, as `model.save` writes it, of PPO, A2C, SAC, TD3 and DDPG with an `MlpPolicy`; the
action is `model.predict(..., deterministic=True)`, of observations scaled by `VecNormalize` if its
file is given. These files hold pickled Python objects, which could run any code when they are read:
`unpickling` reads numbers and known classes only, and refuses others.

An environment of `maidenflight.integrations.gym` notes in its space of observations, which the file
holds, what an observation is (`interface.NOTE`).
"""

import importlib
import zipfile
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from maidenflight import inputs
from maidenflight.errors import InputError, optional
from maidenflight.inputs import StrPath
from maidenflight.integrations.policies.unpickling import data_of, objects_of, unpickled
from maidenflight.simulator.controllers.interface import NOTE
from maidenflight.simulator.policy_spec import PolicySpec

SCALING = "vecnormalize.pkl"
"""Name of the file of `VecNormalize` that is looked for beside a policy of our environments."""
_UNREAD = ("ep_info_buffer", "ep_success_buffer", "_last_obs", "_last_episode_starts")
"""Objects of `model.zip` that only a training needs."""


class Model(NamedTuple):
    """A policy, and its observations' scaling if it has one."""

    algorithm: Any
    scaling: Any

    def act(self, numbers: Float[np.ndarray, "N"]) -> Float[np.ndarray, "4"]:
        """Returns the deterministic action.

        Raises:
            ValueError: it takes another number of inputs.
        """
        shape = self.algorithm.observation_space.shape
        if numbers.shape != shape:
            raise ValueError(f"it takes {shape}")
        observation = numbers.astype(np.float32)
        if self.scaling is not None:
            observation = self.scaling.normalize_obs(observation)
        return self.algorithm.predict(observation, deterministic=True)[0]


def read_model(path: StrPath, scaling: StrPath | None = None) -> Model:
    """Reads a policy.

    Args:
        path: `model.zip`.
        scaling: file of its `VecNormalize`, if it has one.

    Raises:
        InputError: stable-baselines3 is not installed, a file cannot be read, or the policy is of
            another algorithm or sees more than a list of numbers.
    """
    with optional("stable_baselines3", "sb3", "a policy of Stable-Baselines3"):
        package: Any = importlib.import_module("stable_baselines3")
    name = _algorithm(path)
    # Schedules of training are pickled code, often of another version; flying needs none, nor a
    # replay buffer.
    unused: Any = {"learning_rate": 0.0, "lr_schedule": _no_rate, "clip_range": _no_rate}
    unused |= dict.fromkeys(_UNREAD)
    objects = {**objects_of(path, unused), **unused, "buffer_size": 1}
    try:
        algorithm = getattr(package, name).load(path, device="cpu", custom_objects=objects)
    except Exception as error:  # whatever unpickling raises
        raise InputError(
            f"{path}: Stable-Baselines3 cannot read it as {name} ({error!s:.120}). Is it of "
            "another version?"
        ) from error
    if len(getattr(algorithm.observation_space, "shape", None) or ()) != 1:
        raise InputError(
            f"{path}: it sees {algorithm.observation_space}; expected a Box of one dimension."
        )
    return Model(algorithm, None if scaling is None else _scaling(scaling, algorithm))


def environment_of(path: StrPath, model: Model) -> tuple[int, PolicySpec]:
    """Returns actions a second [Hz] and observations of the environment that trained a policy.

    Raises:
        InputError: it is none of ours, was wrapped, or does not command the motors.
    """
    note = getattr(model.algorithm.observation_space, NOTE, None)
    space = model.algorithm.action_space
    low, high = (np.ravel(getattr(space, name, ())) for name in ("low", "high"))
    if note is None or [*low, *high] != [-1.0] * 4 + [1.0] * 4:
        raise InputError(
            f"{path}: trained in an environment that is none of maidenflight.integrations.gym, or "
            "that was wrapped, so what its numbers are is not known. Write a class that says it, "
            "such as examples/own_sb3_policy.py, and give MODULE:NAME (docs/evaluation.md)."
        )
    if note["control"] != "pwm":
        raise InputError(
            f"{path}: a {note['control']} policy; of those by others only such fly that command "
            "the motors. Train with control='pwm'."
        )
    known = {name: note[name] for name in PolicySpec.OBSERVED if note.get(name) is not None}
    return note["rate"], PolicySpec.from_dict(known)


def _algorithm(path: StrPath) -> str:
    """Name of the algorithm, by the policy's class and the settings that the file holds."""
    try:
        data = data_of(path)
        module = str(data["policy_class"]["__module__"])
    except (OSError, ValueError, LookupError, TypeError, zipfile.BadZipFile) as error:
        raise InputError(
            f"{path}: not a policy of Stable-Baselines3 ({error}); expected what its model.save "
            "writes."
        ) from error
    if module == "stable_baselines3.common.policies":
        return "PPO" if "clip_range" in data else "A2C"
    names = {"stable_baselines3.sac.policies": "SAC", "stable_baselines3.td3.policies": "TD3"}
    if module not in names:
        raise InputError(
            f"{path}: its policy is of {module}; expected an MlpPolicy of PPO, A2C, SAC, TD3 or "
            "DDPG."
        )
    return names[module]


def _no_rate(_: float) -> float:
    return 0.0


def _scaling(path: StrPath, algorithm: Any) -> Any:
    """A `VecNormalize` of the policy's observations."""
    try:
        scaling = unpickled(inputs.content(path))
        fits = scaling.observation_space.shape == algorithm.observation_space.shape
        assert callable(scaling.normalize_obs)
    except Exception as error:  # whatever unpickling raises
        raise InputError(f"{path}: not what VecNormalize.save writes ({error!s:.120}).") from error
    if not fits:
        raise InputError(
            f"{path}: of observations of {scaling.observation_space.shape}; the policy's are "
            f"{algorithm.observation_space.shape}."
        )
    return scaling
