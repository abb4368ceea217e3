"""The policy file: a network and all that is needed to fly it, as JSON.

It is exact to the last bit of float32.
"""

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from maidenflight import inputs, results, run_folder
from maidenflight.errors import InputError
from maidenflight.gru import Gru, fields_of
from maidenflight.inputs import StrPath
from maidenflight.policy import INSTANTS, Policy
from maidenflight.simulator import look_ahead as ahead_of
from maidenflight.simulator.interface import ControlInterface
from maidenflight.simulator.look_ahead import LookAhead

FORMAT = "maidenflight policy 2"
INSTANT = (
    "position 3, quaternion xyzw 4, velocity 3, body rates 3, setpoint - position 3, last "
    "action 4; oldest first"
)
"""What a file says of the order of an observation."""


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
            "interface": policy.interface.to_dict(),
            "history": policy.history,
            **_look_ahead_told(policy.look_ahead),
            **({} if policy.form == INSTANTS else {"form": policy.form}),
            "instant": INSTANT,
            "activation": "relu",
            "record": dict(record or {}),
            "observation_mean": _decimals(policy.observation_mean),
            "observation_std": _decimals(policy.observation_std),
            "layers": layers,
            **_gru_told(policy.gru),
        }
    )


def _gru_told(gru: Gru | None) -> dict[str, Any]:
    """What a file holds of a recurrent unit; nothing where there is none."""
    if gru is None:
        return {}
    return {"gru": {name: _decimals(array) for name, array in fields_of(gru).items()}}


def _look_ahead_told(look_ahead: LookAhead) -> dict[str, Any]:
    """What a file says of a look-ahead; nothing where there is none."""
    return {"look_ahead": look_ahead.to_dict()} if look_ahead.points else {}


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
            interface=ControlInterface.from_dict(content["interface"]),
            history=content["history"],
            look_ahead=(
                LookAhead.from_dict(content["look_ahead"])
                if "look_ahead" in content
                else ahead_of.NONE
            ),
            gru=(
                Gru(**{name: _numbers(array) for name, array in content["gru"].items()})
                if "gru" in content
                else None
            ),
            form=content.get("form", INSTANTS),
        )
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(
            f"{where}: damaged policy ({type(error).__name__}: {error}). Export it again."
        ) from error
    _check_rest(content, where)
    policy.check(where)
    return policy


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


def _check_rest(content: Mapping[str, Any], where: str) -> None:
    """What a file says beside the policy's fields."""
    for name, expected in (("instant", INSTANT), ("activation", "relu")):
        if content.get(name) != expected:
            raise InputError(f"{where}: {name} = {content.get(name)!r}, expected {expected!r}.")
    if not isinstance(content.get("record"), dict):
        raise InputError(
            f"{where}: record = {content.get('record')!r}, expected how the policy was made, {{}} "
            "if unknown."
        )


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
    restart: bool = False,
) -> list[Policy]:
    """Reads the policies of a folder, or makes and writes them: nothing is trained twice.

    Args:
        folder: of `policy_1.json`, `policy_2.json`, ...
        count: how many.
        made: record of their making.
        learn: makes them; called where one of the files is missing.
        restart: use nothing of what is there.

    Raises:
        InputError: the folder holds policies with another record.
    """
    files = [run_folder.POLICY.path(folder, number) for number in range(1, count + 1)]
    if restart or not all(path.exists() for path in files):
        for path in files if restart else []:
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
    return inputs.readable(path, "a policy")
