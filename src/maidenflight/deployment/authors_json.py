"""Reads and writes the JSON policy files of Gronauer et al.

Such a file holds layers "0", "1", ..., means and standard deviations of the inputs, and a checksum:
the sum of the outputs for an unscaled input of ones. It does not hold the control structure, the
rate or the number of instants.

Source: github SvenGronauer/phoenix-drone-simulation c5d6907, described from reading, not copied.
"""

import json
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from maidenflight import inputs, results
from maidenflight.deployment.commands import check_form
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.policy import Policy
from maidenflight.policy_file import FORMAT, from_json, numbers, text_of
from maidenflight.simulator.environment import OBSERVATION_SIZE
from maidenflight.simulator.interface import CONTROLS, INTERFACES, ControlInterface

EPSILON = 1e-5
"""What the authors' scaling adds to a standard deviation; one that is zero divides all the same."""
RATES = {"pwm": 100, "attitude_rate": 50, "attitude": 25}
"""Actions a second [Hz] of the authors' drone (Gronauer et al. 2022, sec. Control Structures;
measured on the published logs)."""
TOLERANCE = 1e-6
"""How far a check sum may be off, relative to the sum of the sizes of what it adds up: some ten
roundings of float32."""
HISTORY = 2
"""H, instants in the inputs of all their policies."""
MOST_LAYERS = 7
"""Layers that their firmware takes."""
_MARKS = {"check_sum", "scaling_parameters", "activation", "0"}
"""What all of the authors' policies have."""


def from_authors_json(text: str, where: str, control: str) -> Policy:
    """Reads one of the authors' policies.

    Args:
        text: content of the file.
        where: what errors name, usually the file.
        control: what the policy commands, one of `interface.CONTROLS`; it also sets the rate.

    Raises:
        InputError: no such control structure, not such a file, or its check sum does not hold.
    """
    if control not in CONTROLS:
        raise InputError(f"{where}: control = {control!r}, expected one of {', '.join(CONTROLS)}.")
    try:
        content = inputs.from_json(text)
    except ValueError as error:
        raise InputError(
            f"{where}: not valid JSON ({error}). Expected one of the authors' policies."
        ) from error
    if not isinstance(content, dict) or not content.keys() >= _MARKS:
        raise InputError(
            f"{where}: not one of the authors' policies; check_sum, scaling_parameters, "
            "activation or layer 0 is missing."
        )
    if content["activation"] != "relu":
        raise InputError(f"{where}: activation = {content['activation']!r}, expected 'relu'.")
    try:
        layers = [content[str(number)] for number in range(sum(key.isdecimal() for key in content))]
        if any(layer["type"] != "standard" for layer in layers):
            raise ValueError("expected layers of type 'standard'")
        weights, biases = (
            [_numbers(layer[name]) for layer in layers] for name in ("weights", "biases")
        )
        mean, deviation = _numbers(content["scaling_parameters"])
        expected = float(content["check_sum"])
        _verify(weights, biases, expected, where)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{where}: damaged policy ({type(error).__name__}: {error}). Export it again."
        ) from error
    made = Policy(
        weights=tuple(jnp.asarray(weight) for weight in weights),
        biases=tuple(jnp.asarray(bias) for bias in biases),
        observation_mean=jnp.asarray(mean),
        observation_std=jnp.asarray(deviation + np.float32(EPSILON)),
        interface=interface_of(control),
        history=len(mean) // OBSERVATION_SIZE,
    )
    made.check(where)
    return made


def interface_of(control: str) -> ControlInterface:
    """What policies of the authors' drone command, by the name of the control structure."""
    return INTERFACES[control](action_rate=RATES[control])


def read_authors_json(path: StrPath, control: str) -> Policy:
    """Reads one of the authors' policy files; see `from_authors_json`.

    Raises:
        InputError: no such file, or not such a policy.
    """
    return from_authors_json(text_of(path), str(path), control)


def to_authors_json(policy: Policy) -> str:
    """The text of one of the authors' policy files; `from_authors_json` reads it back.

    All numbers read back to the last bit, except standard deviations between 6.1e-5 and 1.2e-4,
    which may be one rounding of float32 off once `EPSILON` is added. The file does not hold the
    control structure: begin its name with that.

    Args:
        policy: the policy.

    Raises:
        InputError: the policy makes no sense, or is one that the authors' tools would take for
            another: by its interface, its form, its history or its deviations; or it has more
            layers than their firmware takes.
    """
    policy.check()
    check_form(policy)
    _check_interface(policy.interface)
    if policy.history != HISTORY:
        raise InputError(
            f"policy: history = {policy.history}, but the authors' policies see {HISTORY} "
            f"instants. Train with --history {HISTORY}."
        )
    if policy.memory:
        raise InputError(
            f"policy: it remembers {policy.memory} numbers, which the authors' firmware cannot. "
            "Train with memory 0, or export to another target."
        )
    if policy.look_ahead.points:
        raise InputError(
            f"policy: it looks ahead at {policy.look_ahead.points} points of the reference, which "
            "the authors' files cannot hold. Train without --look-ahead, or export to c."
        )
    if len(policy.weights) > MOST_LAYERS:
        raise InputError(
            f"policy: {len(policy.weights)} layers, but the authors' firmware takes at most "
            f"{MOST_LAYERS}. Train fewer."
        )
    deviation = np.asarray(policy.observation_std)
    if np.any(deviation < np.float32(EPSILON)):
        raise InputError(
            f"policy: an observation's deviation is {deviation.min():.3g}, but the authors' files "
            f"hold none below {EPSILON:g}, which their "
            "tools add to it. Train with a larger one."
        )
    weights, biases = ([np.asarray(array) for array in arrays] for arrays in policy.network[:2])
    with np.errstate(over="ignore"):
        found = np.float32(_check_sum(weights, biases)[0])
    if not np.isfinite(found):
        raise InputError("policy: its check sum overflows float32. Training diverged: train again.")
    content = {
        "check_sum": str(found),
        "scaling_parameters": [
            np.asarray(policy.observation_mean).tolist(),
            _before_adding(deviation).tolist(),
        ],
        "activation": "relu",
    }
    for number, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        content[str(number)] = {
            "type": "standard",
            "weights": weight.tolist(),
            "biases": bias.tolist(),
        }
    return json.dumps(content)


def _check_interface(interface: ControlInterface) -> None:
    """Their files hold a network alone; what its outputs command is fixed in their firmware."""
    if interface.name not in CONTROLS:
        raise InputError(
            f"policy: control = {interface.name!r}; the authors' drone knows {', '.join(CONTROLS)}."
        )
    theirs = interface_of(interface.name).to_dict()
    for name, value in interface.to_dict().items():
        if value != theirs[name]:
            raise InputError(
                f"policy: {name} = {value}, but the authors' drone runs {interface.name} policies "
                f"with {theirs[name]} and their files cannot say otherwise. Train with that."
            )


def export_authors_json(policy: Policy, directory: StrPath, *, name: str = "policy") -> list[Path]:
    """Writes one of the authors' policy files; see `to_authors_json`.

    Args:
        policy: the policy.
        directory: where to write; made if missing.
        name: of the file, without its ending. Unless it begins with the control structure, that is
            put before it, so that `read_policy` knows what the policy commands.

    Returns:
        The file written, alone in a list.

    Raises:
        InputError: the authors' files cannot hold the policy, or the directory cannot be written.
    """
    text = to_authors_json(policy)
    if _control_of(Path("/", f"{name}.json")) != policy.interface.name:
        name = f"{policy.interface.name}_{name}"
    return [results.write(Path(directory) / f"{name}.json", text)]


def read_policy(path: StrPath, control: str | None = None) -> Policy:
    """Reads a policy file, ours or the authors', told apart by content.

    Args:
        path: the file.
        control: what the authors' policy commands; unless given, the control structure that the
            file's name begins with, such as `attitude_rate_066.json`, or that its folder is called.
            Ours say it themselves.

    Raises:
        InputError: no such file, neither kind of policy, or nothing says what an authors' policy
            commands.
    """
    text = _text_of(Path(path))
    try:
        content = inputs.from_json(text)
    except ValueError as error:
        damage = f" ({error})" if Path(path).suffix == ".json" else ""
        raise InputError(
            f"{path}: not a policy, ours or the authors': not valid JSON{damage}. {_SUCH_AS}"
        ) from error
    keys = content.keys() if isinstance(content, dict) else set()
    if "format" in keys and content["format"] == FORMAT:
        return from_json(text, str(path))
    if not keys >= _MARKS:
        raise InputError(
            f"{path}: not a policy, neither ours (format is not {FORMAT!r}) nor the authors' (no "
            "check_sum and layers)."
        )
    control = control or _control_of(Path(path))
    if control is None:
        raise InputError(
            f"{path}: one of the authors' policies, which do not say what they command. Begin its "
            "name, or call its folder, with one of "
            f"{', '.join(CONTROLS)}, or give --control."
        )
    return from_authors_json(text, str(path), control)


_SUCH_AS = "Give a policy file, such as policies/policy_1.json, which maidenflight train writes."


def _text_of(path: Path) -> str:
    """Text of a policy file; a folder and a path that leads nowhere are told in our words."""
    if path.is_dir():
        first = min(path.glob("*.json"), default=None)
        raise InputError(
            f"{path}: a folder, not a policy. "
            f"{f'Give one file of it, such as {first}.' if first else _SUCH_AS}"
        )
    if not path.exists():
        raise InputError(f"{path}: cannot be read as a policy: no such file. {_SUCH_AS}")
    return text_of(path)


def _control_of(path: Path) -> str | None:
    """The control structure that a file's name or its folder's says.

    "attitude_rate" before "attitude", with which it begins.
    """
    names = path.stem.lower(), path.absolute().parent.name.lower()
    longest = sorted(CONTROLS, key=len, reverse=True)
    return next(
        (
            control
            for name in names
            for control in longest
            if name == control or name.startswith(f"{control}_")
        ),
        None,
    )


def _numbers(nested: Any) -> np.ndarray:
    array = numbers(nested)
    if array.dtype.kind not in "fi" or array.ndim < 1:
        raise ValueError("expected lists of numbers")
    with np.errstate(
        over="ignore"
    ):  # what float32 cannot hold is infinite, and so is its check sum
        return array.astype(np.float32)


def _verify(
    weights: list[np.ndarray], biases: list[np.ndarray], expected: float, where: str
) -> None:
    """Compares the check sum with that of the layers, in float64."""
    for number, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        if weight.ndim != 2 or bias.shape != weight.shape[:1]:
            raise ValueError(f"layer {number} has weights {weight.shape} and biases {bias.shape}")
    if any(after.shape[1] != before.shape[0] for before, after in pairwise(weights)):
        raise ValueError("a layer's inputs are not the outputs of the layer before")
    with np.errstate(invalid="ignore", over="ignore"):  # what is not finite is no check sum
        found, size = _check_sum(weights, biases)
    if not math.isfinite(expected) or not abs(found - expected) <= TOLERANCE * max(1.0, size):
        raise InputError(
            f"{where}: check sum {found:.7g}, but the file says {expected:.7g}: a weight was "
            "changed. Export it again."
        )


def _check_sum(weights: list[np.ndarray], biases: list[np.ndarray]) -> tuple[float, float]:
    """The checksum in float64, and the sum of the magnitudes of its terms."""
    values = np.ones(weights[0].shape[1])
    size = 0.0
    for number, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        values = np.maximum(values, 0.0) if number > 0 else values
        size = float(
            np.abs(weight.astype(np.float64)).sum(axis=0) @ np.abs(values) + np.abs(bias).sum()
        )
        values = weight.astype(np.float64) @ values + bias
    return float(values.sum()), size


def _before_adding(deviation: np.ndarray) -> np.ndarray:
    """Numbers of float32 that are the deviations once `EPSILON` is added.

    Where there is none, those that come nearest.
    """
    epsilon = np.float32(EPSILON)
    below = deviation - epsilon
    tried = np.stack(
        [below, np.nextafter(below, np.float32(0)), np.nextafter(below, np.float32(np.inf))]
    )
    best = np.argmin(np.abs((tried + epsilon).astype(np.float64) - deviation), axis=0)
    return np.take_along_axis(tried, best[None], axis=0)[0]
