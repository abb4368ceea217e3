"""A policy: what a network sees, the network, and what its outputs mean.

One JSON file, exact to the last bit of float32.
"""

import dataclasses
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maidenflight import inputs, results, run_folder
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.simulator.control import Controller
from maidenflight.simulator.environment import ACTION_SIZE, OBSERVATION_SIZE
from maidenflight.simulator.firmware import ATTITUDE_RATE

FORMAT = "maidenflight policy 1"
INSTANT = (
    "position 3, quaternion xyzw 4, velocity 3, body rates 3, setpoint - position 3, last "
    "action 4; oldest first"
)
"""What a file says of the order of an observation."""
CONTROLS = ("pwm", "attitude_rate", "attitude")
"""Control structures that a policy can be made for."""

_MEAN = (
    0.25,
    0.0,
    1.0,
    0.0,
    0.0,
    0.0,
    1.0,
    0.0,
    0.0,
    0.0,
    0.0,
    0.0,
    0.0,
    0.0,
    0.0,
    0.0,
    0.2,
    0.2,
    0.2,
    0.2,
)
_DEVIATION = (
    0.2,
    0.2,
    0.2,
    0.1,
    0.1,
    0.1,
    0.05,
    0.4,
    0.4,
    0.4,
    1.0,
    1.0,
    1.0,
    0.1,
    0.1,
    0.1,
    0.5,
    0.5,
    0.5,
    0.5,
)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Policy:
    """A multi-layer perceptron with ReLU between its layers, and all that is needed to fly it.

    Output: four actions, of which the control structure uses the part in [-1, 1].
    """

    weights: tuple[Float[Array, "outputs inputs"], ...]
    biases: tuple[Float[Array, "outputs"], ...]
    observation_mean: Float[Array, "20H"]
    observation_std: Float[Array, "20H"]
    control: str = dataclasses.field(default="pwm", metadata={"static": True})
    """Control structure that the actions are meant for."""
    rate: int = dataclasses.field(default=100, metadata={"static": True})
    """Actions a second [Hz]."""
    history: int = dataclasses.field(default=2, metadata={"static": True})
    """H, observed instants in the input."""

    def __call__(self, observation: Float[Array, "20H"]) -> Float[Array, "4"]:
        """Action for an observation.

        Not clipped, because the next observation holds it as it is.
        """
        values = (observation - self.observation_mean) / self.observation_std
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            values = jax.nn.relu(weight @ values + bias)
        return self.weights[-1] @ values + self.biases[-1]

    @property
    def network(self) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        """Weights and biases: what a gradient changes."""
        return self.weights, self.biases

    def with_network(self, network: Any) -> "Policy":
        """The same policy with other weights and biases."""
        weights, biases = network
        return dataclasses.replace(self, weights=weights, biases=biases)

    @property
    def layer_sizes(self) -> tuple[int, ...]:
        """Sizes of input, hidden layers and output, such as (40, 50, 50, 4)."""
        return (self.weights[0].shape[-1], *(weight.shape[-2] for weight in self.weights))


def untrained(
    key: Array,
    hidden: tuple[int, ...] = (50, 50),
    history: int = 2,
    controller: Controller | None = None,
) -> Policy:
    """A policy with Kaiming-uniform weights and zero biases.

    Its last layer is small, so that it starts near a constant.

    Observations are scaled by fixed, round numbers of the circle task's size; training changes only
    the network.

    Args:
        key: random key.
        hidden: sizes of the hidden layers.
        history: H, observed instants in the input.
        controller: control structure that it acts on; PWM at 100 Hz unless given.

    Source: Gronauer et al. 2022, sec. Zero-Shot Experiments (layer sizes and initial weights).
    """
    sizes = (OBSERVATION_SIZE * history, *hidden, ACTION_SIZE)
    weights = []
    for key_, fan_in, outputs in zip(
        jax.random.split(key, len(sizes) - 1), sizes[:-1], sizes[1:], strict=True
    ):
        bound = np.float32(np.sqrt(6.0 / fan_in) * (0.1 if outputs == ACTION_SIZE else 1.0))
        weights.append(jax.random.uniform(key_, (outputs, fan_in), minval=-bound, maxval=bound))
    biases = tuple(jnp.zeros(outputs) for outputs in sizes[1:])
    mean = jnp.tile(jnp.array(_MEAN), history)
    acting = (
        {} if controller is None else {"control": controller.name, "rate": controller.action_rate}
    )
    return Policy(
        tuple(weights),
        biases,
        mean,
        jnp.tile(jnp.array(_DEVIATION), history),
        history=history,
        **acting,
    )


def _decimals(array: Any) -> Any:
    """Nested lists of the shortest decimals that read back to the same float32."""
    array = np.asarray(array, np.float32)
    return (
        [_decimals(row) for row in array]
        if array.ndim > 1
        else [float(str(entry)) for entry in array]
    )


def to_json(policy: Policy, record: Mapping[str, Any] | None = None) -> str:
    """The text of a policy file; `record` says how the policy was made."""
    layers = [
        {"weights": _decimals(weight), "biases": _decimals(bias)}
        for weight, bias in zip(policy.weights, policy.biases, strict=True)
    ]
    return json.dumps(
        {
            "format": FORMAT,
            "control": policy.control,
            "rate": policy.rate,
            "history": policy.history,
            "instant": INSTANT,
            "activation": "relu",
            "record": dict(record or {}),
            "observation_mean": _decimals(policy.observation_mean),
            "observation_std": _decimals(policy.observation_std),
            "layers": layers,
        }
    )


def from_json(text: str, where: str = "policy") -> Policy:
    """Reads a policy.

    Raises:
        InputError: not a policy file, or its shapes or numbers make no sense.
    """
    try:
        content = inputs.from_json(text)
    except ValueError as error:
        raise InputError(
            f"{where}: not valid JSON ({error}). Expected a policy file written by maidenflight "
            "train."
        ) from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise InputError(
            f"{where}: not a maidenflight policy (format is not {FORMAT!r}). Give a file written "
            "by maidenflight train."
        )
    try:
        policy = Policy(
            weights=tuple(_numbers(layer["weights"]) for layer in content["layers"]),
            biases=tuple(_numbers(layer["biases"]) for layer in content["layers"]),
            observation_mean=_numbers(content["observation_mean"]),
            observation_std=_numbers(content["observation_std"]),
            control=content["control"],
            rate=content["rate"],
            history=content["history"],
        )
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(
            f"{where}: damaged policy ({type(error).__name__}: {error}). Export it again."
        ) from error
    return _checked(policy, content, where)


def numbers(nested: Any) -> np.ndarray:
    """Nested lists as an array, in which true and false do not pass for 1 and 0.

    Raises:
        ValueError: a list holds one of them, or lists of different lengths.
    """
    array = np.asarray(nested)
    if array.dtype.kind in "fiu" and any(
        type(entry) is bool for entry in np.asarray(nested, object).flat
    ):
        raise ValueError("expected numbers, not true or false")
    return array


def _numbers(nested: Any) -> Array:
    """Nested lists of numbers as float32.

    Text, true and false, missing numbers and what float32 cannot hold are refused.
    """
    array = numbers(nested)
    if array.dtype.kind not in "fi" or np.any(
        np.isfinite(array) & (np.abs(array) > float(np.finfo(np.float32).max) * (1 + 1e-7))
    ):
        raise ValueError("expected numbers that float32 can hold")
    return jnp.asarray(array.astype(np.float32))


def _checked(policy: Policy, content: Mapping[str, Any], where: str) -> Policy:
    if policy.control not in CONTROLS:
        raise InputError(
            f"{where}: control = {policy.control!r}, expected one of {', '.join(CONTROLS)}."
        )
    if content.get("instant") != INSTANT:
        raise InputError(f"{where}: instant = {content.get('instant')!r}, expected {INSTANT!r}.")
    if not isinstance(content.get("record"), dict):
        raise InputError(
            f"{where}: record = {content.get('record')!r}, expected how the policy was made, {{}} "
            "if unknown."
        )
    if content.get("activation") != "relu":
        raise InputError(f"{where}: activation = {content.get('activation')!r}, expected 'relu'.")
    for name, value in (("rate", policy.rate), ("history", policy.history)):
        if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= 1000:
            raise InputError(
                f"{where}: {name} = {value!r}, expected a whole number from 1 to 1000."
            )
    if policy.control != "pwm" and ATTITUDE_RATE % policy.rate:
        raise InputError(
            f"{where}: rate = {policy.rate}, expected one that divides the {ATTITUDE_RATE} Hz of "
            "the firmware's PIDs."
        )
    if not policy.weights:
        raise InputError(f"{where}: no layers.")
    size = OBSERVATION_SIZE * policy.history
    if policy.observation_mean.shape != (size,) or policy.observation_std.shape != (size,):
        raise InputError(
            f"{where}: the normaliser has {policy.observation_mean.shape} values, expected {size} "
            "(20 x history)."
        )
    for number, (weight, bias) in enumerate(zip(policy.weights, policy.biases, strict=True), 1):
        if weight.ndim != 2 or weight.shape[1] != size or bias.shape != weight.shape[:1]:
            raise InputError(
                f"{where}: layer {number} has weights {weight.shape} and biases {bias.shape}, "
                f"expected ({size} inputs)."
            )
        size = weight.shape[0]
    if size != ACTION_SIZE:
        raise InputError(f"{where}: {size} outputs, expected {ACTION_SIZE}.")
    if not all(bool(jnp.all(jnp.isfinite(leaf))) for leaf in jax.tree.leaves(policy)):
        raise InputError(
            f"{where}: a weight is not a finite number. Train again or restore the file."
        )
    if not bool(jnp.all(policy.observation_std > 0)):
        raise InputError(f"{where}: an observation's deviation is not positive.")
    return policy


def write(path: StrPath, policy: Policy, record: Mapping[str, Any] | None = None) -> Path:
    """Writes a policy file; see `to_json`."""
    return results.write(path, to_json(policy, record) + "\n")


def read(path: StrPath) -> Policy:
    """Reads a policy file.

    Raises:
        InputError: no such file, or not a valid policy.
    """
    return from_json(text_of(path), str(path))


def record(path: StrPath) -> dict[str, Any]:
    """How the policy of a file was made, as `results.record` tells it.

    Raises:
        InputError: see `read`.
    """
    text = text_of(path)
    from_json(text, str(path))
    return inputs.from_json(text)["record"]


def kept(
    folder: StrPath,
    count: int,
    made: Mapping[str, Any],
    learn: Callable[[], Iterable[Policy]],
    anew: bool = False,
) -> list[Policy]:
    """Policies that a folder holds, or new ones that it holds then: what was interrupted goes on,
    and nothing is trained twice.

    Args:
        folder: of `policy_1.json`, `policy_2.json`, ...
        count: how many.
        made: record of their making.
        learn: makes them; called where one of the files is missing.
        anew: use nothing of what is there.

    Raises:
        InputError: the folder holds policies with another record.
    """
    files = [run_folder.POLICY.path(folder, number) for number in range(1, count + 1)]
    if anew or not all(path.exists() for path in files):
        for path in files if anew else []:
            path.unlink(missing_ok=True)
        for path, one in zip(files, learn(), strict=True):
            write(path, one, made)
    for path in files:
        if record(path) != results.plain(made):
            raise InputError(
                f"{path}: from a run with other settings or of another version. Choose another "
                "folder with -o."
            )
    return [read(path) for path in files]


def text_of(path: StrPath) -> str:
    """Text of a policy file, of whatever format.

    Raises:
        InputError: it cannot be read.
    """
    try:
        return inputs.text(path)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as a policy ({error}).") from error
