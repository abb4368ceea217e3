"""The authors' policy files: the JSON that their firmware's tools read, made into a `Policy`.

Such a file holds layers "0", "1", ..., the means and standard deviations of the inputs, and a check sum: the sum of the outputs for an
input of ones that is not scaled. It does not say what the outputs command, nor how often.

Source: github SvenGronauer/phoenix-drone-simulation c5d6907, described from reading, not copied.
"""

import json
import math
import os
from itertools import pairwise
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from maidenflight.errors import InputError
from maidenflight.policy import CONTROLS, FORMAT, Policy, from_json, text_of, to_json
from maidenflight.simulator.environment import OBSERVATION_SIZE

EPSILON = 1e-5
"""What the authors' scaling adds to a standard deviation; one that is zero divides all the same."""
RATES = {"pwm": 100, "attitude_rate": 50, "attitude": 25}
"""Actions a second [Hz] of the authors' drone (Gronauer et al. 2022, sec. Control Structures; measured on the published logs)."""
TOLERANCE = 1e-6
"""How far a check sum may be off, relative to the sum of the sizes of what it adds up: some ten roundings of float32."""
_MARKS = {"check_sum", "scaling_parameters", "activation", "0"}
"""What all of the authors' policies have."""


def from_authors_json(text: str, where: str, control: str) -> Policy:
    """Reads one of the authors' policies.

    Args:
        text: content of the file.
        where: what errors name, usually the file.
        control: what the policy commands, one of `policy.CONTROLS`; it also sets the rate.

    Raises:
        InputError: no such control structure, not such a file, or its check sum does not hold.
    """
    if control not in CONTROLS:
        raise InputError(f"{where}: control = {control!r}, expected one of {', '.join(CONTROLS)}.")
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}: not valid JSON ({error}). Expected one of the authors' policies.") from error
    if not isinstance(content, dict) or not content.keys() >= _MARKS:
        raise InputError(f"{where}: not one of the authors' policies; check_sum, scaling_parameters, activation or layer 0 is missing.")
    if content["activation"] != "relu":
        raise InputError(f"{where}: activation = {content['activation']!r}, expected 'relu'.")
    try:
        layers = [content[str(number)] for number in range(sum(key.isdecimal() for key in content))]
        if any(layer["type"] != "standard" for layer in layers):
            raise ValueError("expected layers of type 'standard'")
        weights, biases = ([_numbers(layer[name]) for layer in layers] for name in ("weights", "biases"))
        mean, deviation = _numbers(content["scaling_parameters"])
        expected = float(content["check_sum"])
        _verify(weights, biases, expected, where)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{where}: damaged policy ({type(error).__name__}: {error}). Export it again.") from error
    made = Policy(
        weights=tuple(jnp.asarray(weight) for weight in weights),
        biases=tuple(jnp.asarray(bias) for bias in biases),
        observation_mean=jnp.asarray(mean),
        observation_deviation=jnp.asarray(deviation + np.float32(EPSILON)),
        control=control,
        rate=RATES[control],
        history=len(mean) // OBSERVATION_SIZE,
    )
    return from_json(to_json(made), where)


def read_authors_json(path: str | os.PathLike[str], control: str) -> Policy:
    """Reads one of the authors' policy files; see `from_authors_json`.

    Raises:
        InputError: no such file, or not such a policy.
    """
    return from_authors_json(text_of(path), str(path), control)


def read_policy(path: str | os.PathLike[str], control: str | None = None) -> Policy:
    """Reads a policy file, ours or the authors', told apart by content.

    Args:
        path: the file.
        control: what the authors' policy commands; unless given, the control structure that the file's name begins with, such as
            `attitude_rate_066.json`, or that its folder is called. Ours say it themselves.

    Raises:
        InputError: no such file, neither kind of policy, or nothing says what an authors' policy commands.
    """
    text = text_of(path)
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not a policy, ours or the authors': not valid JSON ({error}).") from error
    keys = content.keys() if isinstance(content, dict) else set()
    if "format" in keys and content["format"] == FORMAT:
        return from_json(text, str(path))
    if not keys >= _MARKS:
        raise InputError(f"{path}: not a policy, neither ours (format is not {FORMAT!r}) nor the authors' (no check_sum and layers).")
    control = control or _control_of(Path(path))
    if control is None:
        raise InputError(
            f"{path}: one of the authors' policies, which do not say what they command. Begin its name, or call its folder, with one of "
            f"{', '.join(CONTROLS)}, or give --control."
        )
    return from_authors_json(text, str(path), control)


def _control_of(path: Path) -> str | None:
    """The control structure that a file's name or its folder's says; "attitude_rate" before "attitude", with which it begins."""
    names = path.stem.lower(), path.absolute().parent.name.lower()
    longest = sorted(CONTROLS, key=len, reverse=True)
    return next((control for name in names for control in longest if name == control or name.startswith(f"{control}_")), None)


def _numbers(nested: Any) -> np.ndarray:
    array = np.asarray(nested)
    if array.dtype.kind not in "fi" or array.ndim < 1:
        raise ValueError("expected lists of numbers")
    return array.astype(np.float32)


def _verify(weights: list[np.ndarray], biases: list[np.ndarray], expected: float, where: str) -> None:
    """Compares the check sum with that of the layers, in float64."""
    for number, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        if weight.ndim != 2 or bias.shape != weight.shape[:1]:
            raise ValueError(f"layer {number} has weights {weight.shape} and biases {bias.shape}")
    if any(after.shape[1] != before.shape[0] for before, after in pairwise(weights)):
        raise ValueError("a layer's inputs are not the outputs of the layer before")
    values = np.ones(weights[0].shape[1])
    size = 0.0
    for number, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        values = np.maximum(values, 0.0) if number > 0 else values
        size = float(np.abs(weight.astype(np.float64)).sum(axis=0) @ np.abs(values) + np.abs(bias).sum())
        values = weight.astype(np.float64) @ values + bias
    found = float(values.sum())
    if not math.isfinite(expected) or not abs(found - expected) <= TOLERANCE * max(1.0, size):
        raise InputError(f"{where}: check sum {found:.7g}, but the file says {expected:.7g}: a weight was changed. Export it again.")
