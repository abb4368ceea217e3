"""Policies of Stable-Baselines3, from their files alone; its package is not needed.

`model.zip`, as `model.save` writes it, of PPO, A2C, SAC, TD3 and DDPG with an `MlpPolicy`; the
action is that of `model.predict(..., deterministic=True)`, of observations scaled by `VecNormalize`
if its file is given. These files hold pickled Python objects, which could run any code when they
are unpickled: here they are data (`pickled`), and what has code of its own is refused.

What trained in `maidenflight.integrations.gym` needs no description: the environment notes in its
space of observations, which the file holds, what an observation is (`interface.NOTE`).

Source: Stable-Baselines3 2.9, `common/policies.py`, `sac/policies.py`, `td3/policies.py` and
`common/vec_env/vec_normalize.py`.
"""

import base64
import zipfile
import zlib
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import erf, expit

from maidenflight import budget, inputs
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.integrations.policies.pickled import Made, Name, array, read_pickle
from maidenflight.integrations.policies.torch_file import read_tensors
from maidenflight.simulator.controllers.interface import NOTE
from maidenflight.simulator.policy_spec import PolicySpec

SCALING = "vecnormalize.pkl"
"""Name of the file of `VecNormalize` that is looked for beside a policy of our environments."""
_Function = Callable[[np.ndarray], np.ndarray]
_ACTIVATIONS: Mapping[str, _Function] = {
    "Tanh": np.tanh,
    "ReLU": lambda x: np.maximum(x, 0),
    "ELU": lambda x: np.where(x > 0, x, np.expm1(np.minimum(x, 0))),
    "LeakyReLU": lambda x: np.where(x > 0, x, 0.01 * x),
    "SiLU": lambda x: x * expit(x),
    "GELU": lambda x: 0.5 * x * (1 + erf(x / np.sqrt(2))),
    "Sigmoid": expit,
}
"""Of hidden layers, with PyTorch's own constants."""
_DAMAGED = (
    *(OSError, EOFError, ValueError, LookupError, TypeError, AttributeError, NotImplementedError),
    *(RuntimeError, zipfile.BadZipFile, zlib.error),
)
"""What is raised of files that are damaged, or hold other things."""
_Layers = list[tuple[np.ndarray, np.ndarray]]


class Kind(NamedTuple):
    """Where a policy's tensors lie: hidden layers, the layer behind them, and how it ends."""

    hidden: str
    last: str
    activation: str
    squashes: bool
    """Whether a tanh bounds its actions, which the space of actions then scales."""


KINDS = {
    "stable_baselines3.common.policies.ActorCriticPolicy": Kind(
        "mlp_extractor.policy_net", "action_net", "Tanh", False
    ),
    "stable_baselines3.sac.policies.SACPolicy": Kind("actor.latent_pi", "actor.mu", "ReLU", True),
    "stable_baselines3.td3.policies.TD3Policy": Kind("actor.mu", "", "ReLU", True),
}
"""By the class of the policy."""


_EXTRACTOR = "stable_baselines3.common.torch_layers.FlattenExtractor"


class Space(NamedTuple):
    """A space of numbers: its bounds, and what our environments note in it."""

    low: np.ndarray
    high: np.ndarray
    note: Any


class Scaling(NamedTuple):
    """What `VecNormalize` does to observations."""

    mean: np.ndarray
    variance: np.ndarray
    epsilon: float
    limit: float

    def apply(self, numbers: np.ndarray) -> np.ndarray:
        """Returns scaled observations."""
        scaled = (numbers - self.mean) / np.sqrt(self.variance + self.epsilon)
        return np.clip(scaled, -self.limit, self.limit).astype(np.float32)


class Model(NamedTuple):
    """A policy: its network, its spaces, and its observations' scaling if it has one."""

    observations: Space
    actions: Space
    layers: _Layers
    activation: _Function
    squashes: bool
    mean_limit: float
    scaling: Scaling | None

    @property
    def range(self) -> tuple[float, float]:
        """Of the actions.

        Raises:
            InputError: they are not four of one range.
        """
        low, high = self.actions.low, self.actions.high
        if low.shape != (4,) or np.ptp(low) or np.ptp(high) or not np.isfinite([low, high]).all():
            raise InputError(
                f"a policy of Stable-Baselines3 with actions from {low} to {high}; expected four "
                "numbers of one range, one for each motor."
            )
        return float(low[0]), float(high[0])

    def act(self, numbers: Float[np.ndarray, "N"]) -> Float[np.ndarray, "4"]:
        """Returns the deterministic action.

        Raises:
            ValueError: it takes another number of inputs.
        """
        if numbers.shape != self.observations.low.shape:
            raise ValueError(f"it takes {self.observations.low.shape}")
        values = numbers.astype(np.float32)
        if self.scaling is not None:
            values = self.scaling.apply(values)
        for weight, bias in self.layers[:-1]:
            values = self.activation(weight @ values + bias)
        weight, bias = self.layers[-1]
        values = np.clip(weight @ values + bias, -self.mean_limit, self.mean_limit)
        low, high = self.actions.low, self.actions.high
        if not self.squashes:
            return np.clip(values, low, high)
        return low + 0.5 * (np.tanh(values) + 1.0) * (high - low)


def read_model(path: StrPath, scaling: StrPath | None = None) -> Model:
    """Reads a policy.

    Args:
        path: `model.zip`.
        scaling: file of its `VecNormalize`, if it has one.

    Raises:
        InputError: a file cannot be read, or the policy is of another algorithm, has layers of its
            own, or sees more than a list of numbers.
    """
    try:
        with budget.NETWORK.open_zip(inputs.content(path, budget.NETWORK)) as file:
            data = inputs.from_json(budget.JSON.allow(file.read("data")).decode())
            tensors = read_tensors(file.read("policy.pth"))
        pickles = {name: _pickle_of(data, name) for name in ("policy_class", "policy_kwargs")}
        spaces = [_space(_pickle_of(data, f"{name}_space")) for name in ("observation", "action")]
        model = _model(spaces, tensors, str(pickles["policy_class"]), pickles["policy_kwargs"])
    except _DAMAGED as error:
        raise InputError(
            f"{path}: not a policy of Stable-Baselines3 that is read ({error!s:.160}). Expected "
            "what model.save of PPO, A2C, SAC, TD3 or DDPG writes with an MlpPolicy of its own."
        ) from error
    return model if scaling is None else model._replace(scaling=_read_scaling(scaling, model))


def environment_of(path: StrPath, model: Model) -> tuple[int, PolicySpec]:
    """Returns actions a second [Hz] and observations of the environment that trained a policy.

    Raises:
        InputError: it is none of ours, was wrapped, or does not command the motors.
    """
    note = model.observations.note
    if not isinstance(note, dict) or model.range != (-1.0, 1.0):
        raise InputError(
            f"{path}: trained in an environment that is none of maidenflight.integrations.gym, or "
            "that was wrapped, so what its numbers are is not known. Write a class that says it, "
            "such as examples/own_sb3_policy.py, and give MODULE:NAME (docs/evaluation.md)."
        )
    if note.get("control") != "pwm":
        raise InputError(
            f"{path}: a {note['control']} policy; of those by others only such fly that command "
            "the motors. Train with control='pwm'."
        )
    known = {name: note[name] for name in PolicySpec.OBSERVED if note.get(name) is not None}
    return note["rate"], PolicySpec.from_dict(known)


def _pickle_of(data: Any, name: str) -> Any:
    """What an entry of the settings holds: JSON where that can, and else a pickle."""
    entry = data[name]
    packed = entry.get(":serialized:") if isinstance(entry, dict) else None
    return entry if packed is None else read_pickle(base64.b64decode(packed, validate=True))


def _space(value: Any) -> Space:
    if not isinstance(value, Made) or value.name.rpartition(".")[2] != "Box":
        raise ValueError(f"it sees or does {getattr(value, 'name', value)!s:.60}, which is no Box")
    state = value.state[0] if isinstance(value.state, tuple) else value.state
    low, high = (array(state[name]) for name in ("low", "high"))
    if low.ndim != 1 or low.shape != high.shape:
        raise ValueError(f"a Box of shape {low.shape}, expected one dimension")
    return Space(low, high, state.get(NOTE))


def _model(spaces: list[Space], tensors: Mapping[str, np.ndarray], of: str, more: Any) -> Model:
    """Puts a network together of its tensors.

    Raises:
        ValueError: the policy is of another class, or has parts that are not known.
    """
    if of not in KINDS:
        raise ValueError(f"its policy is {of:.80}")
    kind, more = KINDS[of], more or {}
    activation = more.get("activation_fn", Name("torch.nn.modules.activation", kind.activation))
    if not (isinstance(activation, Name) and activation.module.startswith("torch.nn.")):
        raise ValueError(f"hidden layers of {activation!s:.60}")
    extractor = str(more.get("features_extractor_class", _EXTRACTOR))
    if extractor != _EXTRACTOR:
        raise ValueError(f"inputs by {extractor:.60}")
    # With exploration that depends on the state a SAC policy's means are limited.
    limited = f"{kind.last}.0.weight" in tensors
    last = f"{kind.last}.0" if limited else kind.last
    hidden = {name.rpartition(".")[0] for name in tensors if name.startswith(f"{kind.hidden}.")}
    names = [*sorted(hidden, key=_number), *([last] if last else [])]
    layers = [(tensors[f"{name}.weight"], tensors[f"{name}.bias"]) for name in names]
    sizes = [len(spaces[0].low), *(len(bias) for _, bias in layers)]
    shapes = [weight.shape for weight, _ in layers]
    if shapes != list(zip(sizes[1:], sizes, strict=False)) or sizes[-1] != len(spaces[1].low):
        raise ValueError(f"layers of {shapes} for {sizes[0]} inputs")
    return Model(
        spaces[0],
        spaces[1],
        layers,
        _ACTIVATIONS[activation.name],
        kind.squashes or bool(more.get("squash_output")),
        float(more.get("clip_mean", 2.0)) if limited else np.inf,
        None,
    )


def _number(layer: str) -> int:
    return int(layer.rpartition(".")[2])


def _read_scaling(path: StrPath, model: Model) -> Scaling:
    """A `VecNormalize` of the policy's observations."""
    try:
        state = read_pickle(inputs.content(path, budget.PICKLE)).state
        statistics = state["obs_rms"].state
        scaling = Scaling(
            array(statistics["mean"]),
            array(statistics["var"]),
            float(array(state["epsilon"])),
            float(array(state["clip_obs"])),
        )
    except _DAMAGED as error:
        raise InputError(f"{path}: not what VecNormalize.save writes ({error!s:.120}).") from error
    shape = model.observations.low.shape
    if scaling.mean.shape != shape or scaling.variance.shape != shape:
        raise InputError(
            f"{path}: of observations of {scaling.mean.shape}; the policy's are {shape}."
        )
    return (
        scaling
        if state.get("norm_obs", True)
        else scaling._replace(
            mean=np.zeros(shape), variance=np.ones(shape), epsilon=0.0, limit=np.inf
        )
    )
