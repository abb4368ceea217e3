"""The TOML file of a matrix, which says what to train for and where to fly.

Such as:

    drone = "crazyflie"                     # nominal parameters: a name or a TOML file
    realities = ["virtual:7"]               # where to fly
    motor_time_constant = [0.04, 0.08]      # T_m to train for [s]
    latency = [0.0, 0.015]                  # latency to train for [s]
    [control.pwm]                           # a control structure: fields of AnalyticGradient, rate
    updates = 800
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from maidenflight import inputs
from maidenflight.errors import InputError
from maidenflight.experiments.matrix import Matrix, controller_at
from maidenflight.experiments.transfer import MAX_DURATION_S
from maidenflight.inputs import StrPath
from maidenflight.parameters import QUANTITIES
from maidenflight.simulator.interface import CONTROLS, INTERFACES
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.training.analytic_gradient import AnalyticGradient

_PLAIN = {
    "realities": (list, "a list of names"),
    "drone": (str, "a name or a file"),
    "randomization": (float, "a number"),
    "policies": (int, "a whole number"),
    "trials": (int, "a whole number"),
    "duration": (float, "seconds"),
    "seed": (int, "a whole number"),
    "motor_time_constant": (list, "a list of seconds"),
    "latency": (list, "a list of seconds"),
}
_MOST = 10**6
"""Upper limit of any number in settings of training."""


def read(path: StrPath) -> Matrix:
    """Reads a matrix from its TOML file.

    Raises:
        InputError: the file is missing or not TOML, or an entry is unknown or out of range.
    """
    try:
        content = inputs.from_toml(inputs.text(path))
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: not settings of a matrix ({error}). Give a TOML file such as "
            "paper/zero_shot.toml."
        ) from error
    structures = content.pop("control", None)
    if (
        not isinstance(structures, dict)
        or not structures
        or not all(isinstance(own, dict) for own in structures.values())
    ):
        raise InputError(
            f"{path}: no control structure. Give a table [control.NAME] for each of "
            f"{', '.join(CONTROLS)} that is wanted."
        )
    plain = {name: _plain(path, name, value) for name, value in content.items()}
    for name in ("motor_time_constant", "latency"):
        plain[name] = _times(path, name, plain.get(name, ()))
    realities = plain.get("realities", ("virtual:7",))
    if not realities or not all(isinstance(name, str) for name in realities):
        raise InputError(f"{path}: realities = {list(realities)}; expected at least one name.")
    for name in ("policies", "trials"):
        if not 1 <= plain.get(name, 1) <= 1000:
            raise InputError(
                f"{path}: {name} = {plain[name]}; expected at least 1 and at most 1000."
            )
    if (
        not 0 < plain.get("duration", MAX_DURATION_S) <= 600
        or not 0 <= plain.get("randomization", 0.1) <= 0.9
    ):
        raise InputError(
            f"{path}: expected a duration above 0 s, up to 600 s, and a randomization from 0 to "
            "0.9."
        )
    if not abs(plain.get("seed", 0)) < 2**63:
        raise InputError(f"{path}: seed = {plain['seed']}; expected a number of 64 bits.")
    settings = {kind: _settings(path, kind, own) for kind, own in structures.items()}
    return Matrix(
        {kind: one for kind, (one, _, _) in settings.items()},
        {kind: rate for kind, (_, rate, _) in settings.items()},
        {kind: spec for kind, (_, _, spec) in settings.items()},
        **plain,
    )


def _plain(path: StrPath, name: str, value: Any) -> Any:
    if name not in _PLAIN:
        raise InputError(
            f"{path}: {name} is unknown. Expected {', '.join(_PLAIN)} and tables [control.NAME]."
        )
    kind, words = _PLAIN[name]
    value = _as(kind, value)
    if type(value) is not kind:
        raise InputError(f"{path}: {name} = {value!r}; expected {words}.")
    return tuple(value) if isinstance(value, list) else value


def _as(kind: type, value: Any) -> Any:
    """An integer as a float if one is expected, infinite if too large; all else unchanged."""
    return (
        (float(value) if abs(value) < 1e300 else math.inf)
        if kind is float and type(value) is int
        else value
    )


def _times(path: StrPath, name: str, given: tuple[Any, ...]) -> tuple[float, ...]:
    known = QUANTITIES[name]
    if not given or not all(
        type(time) in (int, float) and known.lower <= time <= known.upper for time in given
    ):
        raise InputError(
            f"{path}: {name} = {list(given)}; expected a list of at least one time from "
            f"{known.lower:g} to {known.upper:g} seconds, such as"
            " [0.04, 0.08]."
        )
    if len(set(given)) < len(given):
        raise InputError(f"{path}: {name} = {list(given)}; expected each time once.")
    return tuple(map(float, given))


def _settings(
    path: StrPath, kind: str, content: Mapping[str, Any]
) -> tuple[AnalyticGradient, int, PolicySpec]:
    """Settings of training, rate and spec of a control structure."""
    if kind not in CONTROLS:
        raise InputError(f"{path}: [control.{kind}] is unknown. Expected {', '.join(CONTROLS)}.")
    rate = content.get("rate", INTERFACES[kind]().rate)
    if type(rate) is not int or not 1 <= rate <= 1000:
        raise InputError(
            f"{path}: [control.{kind}] rate = {rate!r}; expected a whole number from 1 to 1000."
        )
    controller_at(kind, rate)
    defaults = {entry.name: entry.default for entry in dataclasses.fields(AnalyticGradient)}
    defaults["hidden"] = PolicySpec.hidden
    own = {name: value for name, value in content.items() if name != "rate"}
    for name, value in own.items():
        if name not in defaults:
            raise InputError(
                f"{path}: [control.{kind}] {name} is unknown. Expected rate, {', '.join(defaults)}."
            )
        own[name] = _as(type(defaults[name]), tuple(value) if isinstance(value, list) else value)
        if type(own[name]) is not type(defaults[name]):
            raise InputError(
                f"{path}: [control.{kind}] {name} = {value!r}; expected "
                f"{type(defaults[name]).__name__}."
            )
        if not _sensible(own[name]):
            raise InputError(
                f"{path}: [control.{kind}] {name} = {value!r}; expected numbers from 0, whole "
                f"ones from 1, to {_MOST}."
            )
    spec = PolicySpec(hidden=own.pop("hidden", PolicySpec.hidden))
    return AnalyticGradient(**own), rate, spec


def _sensible(value: Any) -> bool:
    """Whether a setting of training is in range; tuples hold whole numbers."""
    if isinstance(value, tuple):
        return all(type(entry) is int and _sensible(entry) for entry in value)
    return (value > 0 if type(value) is int else value >= 0) and value <= _MOST
