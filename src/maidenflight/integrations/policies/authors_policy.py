"""Reads the JSON policy files of Gronauer et al.

Such a file holds layers "0", "1", ..., means and standard deviations of the inputs, and a checksum:
the sum of the outputs for an unscaled input of ones. It does not hold the control structure, the
rate or the number of instants.

Source: github SvenGronauer/phoenix-drone-simulation c5d6907, described from reading, not copied.
"""

import math
from collections.abc import Mapping
from itertools import pairwise, product
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from maidenflight import inputs
from maidenflight.errors import InputError
from maidenflight.policy import Policy
from maidenflight.policy_file import PolicyFormat, UnknownControl
from maidenflight.simulator.controllers.interface import CONTROLS, INTERFACES, ControlInterface
from maidenflight.simulator.policy_spec import OBSERVATION_SIZE, PolicySpec

EPSILON = 1e-5
"""What the authors' scaling adds to a standard deviation; one that is zero divides all the same."""
RATES = {"pwm": 100, "attitude_rate": 50, "attitude": 25}
"""Actions a second [Hz] of the authors' drone (Gronauer et al. 2022, sec. Control Structures;
measured on the published logs)."""
TOLERANCE = 1e-6
"""How far a check sum may be off, relative to the sum of the sizes of what it adds up: some ten
roundings of float32."""
MARKS = {"check_sum", "scaling_parameters", "activation", "0"}
"""What all of the authors' policies have."""


class Network(NamedTuple):
    """What a file holds, float32."""

    weights: list[Float[np.ndarray, "outputs inputs"]]
    biases: list[Float[np.ndarray, "outputs"]]
    mean: Float[np.ndarray, "inputs"]
    deviation: Float[np.ndarray, "inputs"]


def read_authors_policy(content: Mapping[str, Any], source: str, control: str | None) -> Policy:
    """Reads the policy of a file of the authors.

    Args:
        content: the object in the file, with all of `MARKS`.
        source: what errors name, usually the file.
        control: what it commands; what `source` says by default.

    Raises:
        InputError: it is damaged, or what it commands is not known.
    """
    control = control or control_of(Path(source))
    if control is None:
        raise UnknownControl(
            f"{source}: one of the authors' policies, which do not say what they command. Begin "
            f"its name, or call its folder, with one of {', '.join(CONTROLS)}, or give --control."
        )
    if control not in CONTROLS:
        raise InputError(f"{source}: control = {control!r}, expected one of {', '.join(CONTROLS)}.")
    network = _network(content, source)
    hidden = tuple(bias.size for bias in network.biases[:-1])
    try:
        spec = PolicySpec(history=len(network.mean) // OBSERVATION_SIZE, hidden=hidden)
    except InputError as error:
        raise InputError(f"{source}: {error}") from error
    return Policy(
        weights=tuple(map(jnp.asarray, network.weights)),
        biases=tuple(map(jnp.asarray, network.biases)),
        observation_mean=jnp.asarray(network.mean),
        observation_std=jnp.asarray(network.deviation),
        interface=interface_of(control),
        spec=spec,
    )


def _network(content: Mapping[str, Any], source: str) -> Network:
    """The network of one of the authors' policies."""
    if content["activation"] != "relu":
        raise InputError(f"{source}: activation = {content['activation']!r}, expected 'relu'.")
    try:
        layers = [content[str(number)] for number in range(sum(key.isdecimal() for key in content))]
        if any(layer["type"] != "standard" for layer in layers):
            raise ValueError("expected layers of type 'standard'")
        weights = [_numbers(layer["weights"]) for layer in layers]
        biases = [_numbers(layer["biases"]) for layer in layers]
        mean, deviation = _numbers(content["scaling_parameters"])
        expected = float(content["check_sum"])
        _verify(weights, biases, expected, source)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{source}: damaged policy ({type(error).__name__}: {error}). Export it again."
        ) from error
    return Network(weights, biases, mean, deviation + np.float32(EPSILON))


def interface_of(control: str) -> ControlInterface:
    """Returns what policies of the authors' drone command, by the name of the control structure."""
    return INTERFACES[control](action_rate=RATES[control])


def control_of(path: Path) -> str | None:
    """Finds the control structure that the name of a file or of its folder begins with."""
    names = path.stem.lower(), path.absolute().parent.name.lower()
    for name, control in product(names, sorted(CONTROLS, key=len, reverse=True)):
        if name == control or name.startswith(f"{control}_"):
            return control
    return None


def _numbers(nested: Any) -> np.ndarray:
    array = inputs.numbers(nested)
    if array.dtype.kind not in "fi" or array.ndim < 1:
        raise ValueError("expected lists of numbers")
    # What float32 cannot hold is infinite, and so is its check sum.
    with np.errstate(over="ignore"):
        return array.astype(np.float32)


def _verify(
    weights: list[np.ndarray], biases: list[np.ndarray], expected: float, source: str
) -> None:
    """Compares the check sum with that of the layers, in float64."""
    for number, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        if weight.ndim != 2 or bias.shape != weight.shape[:1]:
            raise ValueError(f"layer {number} has weights {weight.shape} and biases {bias.shape}")
    if any(after.shape[1] != before.shape[0] for before, after in pairwise(weights)):
        raise ValueError("a layer's inputs are not the outputs of the layer before")
    with np.errstate(invalid="ignore", over="ignore"):  # what is not finite is no check sum
        check, size = check_sum(weights, biases)
    if not math.isfinite(expected) or not abs(check - expected) <= TOLERANCE * max(1.0, size):
        raise InputError(
            f"{source}: check sum {check:.7g}, but the file says {expected:.7g}: a weight was "
            "changed. Export it again."
        )


def check_sum(weights: list[np.ndarray], biases: list[np.ndarray]) -> tuple[float, float]:
    """Computes the checksum in float64, and the sum of the magnitudes of its terms."""
    values = np.ones(weights[0].shape[1])
    size = 0.0
    for number, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        values = np.maximum(values, 0.0) if number > 0 else values
        weight = weight.astype(np.float64)
        size = float(np.abs(weight).sum(axis=0) @ np.abs(values) + np.abs(bias).sum())
        values = weight @ values + bias
    return float(values.sum()), size


FORMAT = PolicyFormat(MARKS, read_authors_policy)
