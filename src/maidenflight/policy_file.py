"""The policy file: a network and all that is needed to fly it, as JSON.

It is exact to the last bit of float32. `read` also reads the files of Gronauer et al.
"""

import json
from collections.abc import Callable, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from maidenflight import budget, inputs, results
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.parameters import GEOMETRY
from maidenflight.policy import Policy
from maidenflight.registry import POLICY_FORMATS
from maidenflight.simulator.controllers.interface import ControlInterface
from maidenflight.simulator.gru import Gru
from maidenflight.simulator.policy_spec import INSTANT, PolicySpec

FORMAT = "maidenflight policy 2"
_SUCH_AS = "Give a policy file, such as policies/policy_1.json, which maidenflight train writes."


class UnknownControl(InputError):
    """Nothing says what a policy by others commands."""


class PolicyFormat(NamedTuple):
    """A way in which others write policies like ours down as JSON."""

    keys: AbstractSet[str]
    """What all of its files have, and ours have not."""
    read: Callable[[Mapping[str, Any], str, str | None], Policy]
    """Of the content, the file that errors name, and what the policy commands if known."""


@dataclass(frozen=True, eq=False)
class PolicyFile:
    """A policy and what its file says of how it was made."""

    policy: Policy
    record: Mapping[str, Any] = field(default_factory=dict, repr=False)
    """As `results.record` makes it, with `hover`, `rotors`, `drone`, `doubts`, `number`; empty if
    unknown."""
    name: str = "policy"
    """Of the file, without its ending."""

    @classmethod
    def read(cls, path: StrPath, control: str | None = None) -> "PolicyFile":
        """Reads a policy file, ours or the authors', recognised by content.

        Args:
            path: the file.
            control: what the authors' policy commands; by default, the control structure that the
                file's name begins with, such as `attitude_rate_066.json`, or that its folder is
                called. Ours say it themselves.

        Raises:
            InputError: no such file; or see `from_json`.
        """
        path = Path(path)
        if path.is_dir():
            first = min(path.glob("*.json"), default=None)
            cure = f"Give one file of it, such as {first}." if first else _SUCH_AS
            raise InputError(f"{path}: a folder, not a policy. {cure}")
        if not path.exists():
            raise InputError(f"{path}: cannot be read as a policy: no such file. {_SUCH_AS}")
        return from_json(inputs.readable(path, budget.JSON, "a policy"), str(path), control)

    def write(self, path: StrPath) -> Path:
        """Writes the policy with its record.

        Raises:
            WriteError: the file cannot be written.
        """
        return write_policy(path, self.policy, self.record)

    @property
    def spec(self) -> PolicySpec:
        """What the policy sees and remembers."""
        return self.policy.spec

    @property
    def interface(self) -> ControlInterface:
        """What the policy commands."""
        return self.policy.interface

    @property
    def settings(self) -> Mapping[str, Any]:
        """Settings with which the policy was trained; empty if unknown."""
        settings = self.record.get("settings")
        return settings if isinstance(settings, dict) else {}

    @property
    def task(self) -> str | None:
        """Name of the task that the policy was trained for; None if unknown."""
        task = self.settings.get("task")
        return None if task is None else str(task)

    @property
    def hover(self) -> float | None:
        """Share of full thrust at which the policy's drone hovers; None if unknown."""
        share = self.record.get("hover")
        return share if isinstance(share, float) and 0.0 < share <= 1.0 else None

    @property
    def identity(self) -> dict[str, Any]:
        """What the file says of its drone; see `identification.identity`. Empty if unknown."""
        drone: Any = self.record.get("drone")
        sound = isinstance(drone, dict) and inputs.is_number(drone.get("mass", 1.0))
        return dict(drone) if sound and drone.get("mass", 1.0) > 0 else {}

    @property
    def doubts(self) -> list[str]:
        """What made the flights or values of its drone doubtful, a line each."""
        lines = self.record.get("doubts")
        return list(map(str, lines)) if isinstance(lines, list) else []

    @property
    def rotors(self) -> dict[str, list[float]] | None:
        """Places [m] and directions of the rotors trained for, by field, if known."""
        rotors = self.record.get("rotors")
        if not isinstance(rotors, dict) or rotors.keys() != set(GEOMETRY):
            return None
        rows = [rotors[name] for name in GEOMETRY]
        numbers = all(
            isinstance(row, list) and len(row) == 4 and all(isinstance(cell, float) for cell in row)
            for row in rows
        )
        return dict(zip(GEOMETRY, rows, strict=True)) if numbers else None


def _decimals(array: Any) -> Any:
    """Nested lists of the shortest decimals that read back to the same float32."""
    array = np.asarray(array, np.float32)
    if array.ndim > 1:
        return [_decimals(row) for row in array]
    return [float(str(entry)) for entry in array]


def to_json(policy: Policy, record: Mapping[str, Any] | None = None) -> str:
    """Returns the text of a policy file; `record` says how the policy was made."""
    layers = [
        {"weights": _decimals(weight), "biases": _decimals(bias)}
        for weight, bias in zip(policy.weights, policy.biases, strict=True)
    ]
    spec = policy.spec.to_dict()
    content = {
        "format": FORMAT,
        "interface": policy.interface.to_dict(),
        **{name: spec[name] for name in spec if name not in PolicySpec.OF_NETWORK},
        "instant": INSTANT,
        "activation": "relu",
        "record": dict(record or {}),
        "observation_mean": _decimals(policy.observation_mean),
        "observation_std": _decimals(policy.observation_std),
        "layers": layers,
    }
    if policy.gru is not None:
        content["gru"] = {name: _decimals(array) for name, array in vars(policy.gru).items()}
    return json.dumps(content)


def from_json(text: str, source: str = "policy", control: str | None = None) -> PolicyFile:
    """Reads the text of a policy file, ours or the authors', recognised by content.

    Args:
        text: content of the file.
        source: what errors name, usually the file.
        control: what the authors' policy commands, one of `interface.CONTROLS`, which also sets the
            rate; by default, what `source` begins with or its folder is called. Ours say it
            themselves.

    Raises:
        InputError: neither kind of policy; it is damaged, or its shapes or numbers make no sense;
            ours commands something else; or nothing says what the authors' policy commands.
    """
    try:
        content = inputs.from_json(text)
    except ValueError as error:
        damage = f" ({error})" if Path(source).suffix == ".json" else ""
        raise InputError(
            f"{source}: not a policy, ours or the authors': not valid JSON{damage}. {_SUCH_AS}"
        ) from error
    keys = content.keys() if isinstance(content, dict) else set()
    ours = "format" in keys and content["format"] == FORMAT
    other = None if ours else _format_of(keys)
    if not ours and other is None:
        raise InputError(
            f"{source}: not a policy, neither ours (format is not {FORMAT!r}) nor the authors' (no "
            f"check_sum and layers). {_SUCH_AS}"
        )
    policy = _own(content, source) if other is None else other.read(content, source, control)
    policy.check(source)
    if control not in (None, policy.interface.name):
        raise InputError(
            f"{source}: a {policy.interface.name} policy, as its file says, not {control}. Leave "
            "out --control, which is for the authors' policies."
        )
    return PolicyFile(policy, content["record"] if ours else {}, Path(source).stem)


def _own(content: Mapping[str, Any], source: str) -> Policy:
    try:
        weights = tuple(_numbers(layer["weights"]) for layer in content["layers"])
        biases = tuple(_numbers(layer["biases"]) for layer in content["layers"])
        gru = None
        if "gru" in content:
            gru = Gru(**{name: _numbers(array) for name, array in content["gru"].items()})
        observed_fields = {"history": content["history"], **content}
        observed_fields["hidden"] = tuple(bias.size for bias in biases[:-1])
        observed_fields["memory"] = gru.size if gru is not None and gru.recurrent.ndim == 2 else 0
        policy = Policy(
            weights=weights,
            biases=biases,
            observation_mean=_numbers(content["observation_mean"]),
            observation_std=_numbers(content["observation_std"]),
            interface=ControlInterface.from_dict(content["interface"]),
            gru=gru,
            spec=PolicySpec.from_dict(observed_fields),
        )
    except InputError as error:
        raise InputError(f"{source}: {error}") from error
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(
            f"{source}: damaged policy ({type(error).__name__}: {error}). Export it again."
        ) from error
    _check_rest(content, source)
    return policy


def _format_of(keys: AbstractSet[str]) -> PolicyFormat | None:
    """The format by others of a file with some keys."""
    formats = (POLICY_FORMATS[name] for name in POLICY_FORMATS)
    return next((policy_format for policy_format in formats if keys >= policy_format.keys), None)


def _numbers(nested: Any) -> Array:
    """Converts nested lists of numbers that float32 can hold."""
    array = inputs.numbers(nested)
    if array.dtype.kind not in "fi" or np.any(
        np.isfinite(array) & (np.abs(array) > float(np.finfo(np.float32).max) * (1 + 1e-7))
    ):
        raise ValueError("expected numbers that float32 can hold")
    return jnp.asarray(array.astype(np.float32))


def _check_rest(content: Mapping[str, Any], source: str) -> None:
    """What a file says beside the policy's fields."""
    for name, expected in (("instant", INSTANT), ("activation", "relu")):
        if content.get(name) != expected:
            raise InputError(f"{source}: {name} = {content.get(name)!r}, expected {expected!r}.")
    if not isinstance(content.get("record"), dict):
        raise InputError(
            f"{source}: record = {content.get('record')!r}, expected how the policy was made, {{}} "
            "if unknown."
        )


def write_policy(path: StrPath, policy: Policy, record: Mapping[str, Any] | None = None) -> Path:
    """Writes a policy file; see `to_json`.

    Raises:
        InputError: the policy has a network of its own.
    """
    policy.must_be_plain()
    return results.write(path, to_json(policy, record) + "\n")


read_policy = PolicyFile.read
