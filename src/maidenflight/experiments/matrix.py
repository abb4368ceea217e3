"""The paper's experiment: policies trained for many motors and flown in unseen realities.

A matrix has a cell for each control structure, motor time constant and latency. Its settings are
one TOML file:

    drone = "crazyflie"                     # nominal parameters: a name or a TOML file
    realities = ["virtual:7"]               # where to fly
    motor_time_constant = [0.04, 0.08]      # T_m to train for [s]
    latency = [0.0, 0.015]                  # latency to train for [s]
    [control.pwm]                           # a control structure: fields of AnalyticGradient, rate
    updates = 800

Source: Gronauer et al. 2022, sec. Zero-Shot Experiments.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import polars

from maidenflight import inputs
from maidenflight.errors import InputError
from maidenflight.experiments.transfer import MAX_DURATION_S, transfer
from maidenflight.inputs import StrPath
from maidenflight.parameters import QUANTITIES, Parameters, replace
from maidenflight.policy import Policy
from maidenflight.simulator import control, tasks
from maidenflight.simulator.battery import COUNTS
from maidenflight.simulator.control import Controller
from maidenflight.simulator.interface import CONTROLS, INTERFACES
from maidenflight.simulator.randomization import relative_box
from maidenflight.simulator.reality import AnyReality
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.train import recorded, train


class Cell(NamedTuple):
    """Control structure, motor time constant and latency that policies are trained for."""

    control: str
    motor_time_constant: float
    """[s]."""
    latency: float
    """[s]."""

    @property
    def name(self) -> str:
        """Such as pwm_80ms_15ms."""
        return f"{self.control}_{1e3 * self.motor_time_constant:g}ms_{1e3 * self.latency:g}ms"


@dataclass(frozen=True)
class Matrix:
    """Settings of training and of the flights."""

    controls: Mapping[str, AnalyticGradient]
    """Settings of training, by control structure."""
    rates: Mapping[str, int]
    """Actions per second in training [Hz], by control structure. All fly at their structure's own
    rate."""
    motor_time_constant: tuple[float, ...]
    """[s]."""
    latency: tuple[float, ...]
    """[s]."""
    realities: tuple[str, ...] = ("virtual:7",)
    drone: str = "crazyflie"
    randomization: float = 0.10
    """Half width of the box about each cell's drone."""
    policies: int = 3
    """Per cell, each with its own seed."""
    trials: int = 3
    """Flights of each policy in each reality."""
    duration: float = MAX_DURATION_S
    """Longest flight [s]."""
    seed: int = 0

    @property
    def cells(self) -> list[Cell]:
        """All cells, ordered by control structure."""
        return [
            Cell(kind, lag, latency)
            for kind in self.controls
            for lag in self.motor_time_constant
            for latency in self.latency
        ]

    def sketch(self) -> "Matrix":
        """The matrix with one policy per cell and a third of the updates."""
        shorter = {
            kind: dataclasses.replace(one, updates=max(1, one.updates // 3))
            for kind, one in self.controls.items()
        }
        return dataclasses.replace(self, controls=shorter, policies=1)

    def said(self, cell: Cell) -> dict[str, Any]:
        """All settings that a cell's policies depend on, except the drone's file and the seed."""
        own = {
            "randomization": self.randomization,
            "policies": self.policies,
            "training_rate": self.rates[cell.control],
        }
        return {
            **cell._asdict(),
            "drone": Path(self.drone).name,
            **own,
            **recorded(self.controls[cell.control]),
        }


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
        {kind: one for kind, (one, _) in settings.items()},
        {kind: rate for kind, (_, rate) in settings.items()},
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


def _settings(path: StrPath, kind: str, content: Mapping[str, Any]) -> tuple[AnalyticGradient, int]:
    """Settings of training and rate of a control structure."""
    if kind not in CONTROLS:
        raise InputError(f"{path}: [control.{kind}] is unknown. Expected {', '.join(CONTROLS)}.")
    rate = content.get("rate", INTERFACES[kind]().rate)
    if type(rate) is not int or not 1 <= rate <= 1000:
        raise InputError(
            f"{path}: [control.{kind}] rate = {rate!r}; expected a whole number from 1 to 1000."
        )
    _controller(kind, rate)
    defaults = {
        entry.name: entry.default
        for entry in dataclasses.fields(AnalyticGradient)
        if entry.name != "form"  # which is not the paper's
    }
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
    return AnalyticGradient(**own), rate


def _sensible(value: Any) -> bool:
    """Whether a setting of training is in range; tuples hold whole numbers."""
    if isinstance(value, tuple):
        return all(type(entry) is int and _sensible(entry) for entry in value)
    return (value > 0 if type(value) is int else value >= 0) and value <= _MOST


def _controller(kind: str, rate: int, full_scale_counts: float = COUNTS) -> Controller:
    """A control structure at the rate of training."""
    own = INTERFACES[kind]().rate
    if kind == "pwm" and rate != own:
        raise InputError(
            f"pwm at {rate} Hz; the motors take {own} commands a second. Leave out its rate."
        )
    return control.CONTROLLERS[kind](action_rate=rate, full_scale_counts=full_scale_counts)


def train_cell(
    matrix: Matrix, cell: Cell, nominal: Parameters, full_scale_counts: float = COUNTS
) -> tuple[Policy, ...]:
    """Trains the policies of a cell; they do not depend on the other cells.

    Args:
        matrix: settings.
        cell: one of its cells.
        nominal: drone with all other parameters.
        full_scale_counts: of that drone; see `ControlInterface`.
    """
    controller = _controller(cell.control, matrix.rates[cell.control], full_scale_counts)
    drone = replace(
        nominal,
        motor_time_constant=np.float32(cell.motor_time_constant),
        latency=np.float32(cell.latency),
    )
    box = relative_box(control.in_fitting_steps(drone, controller), matrix.randomization)
    key = jax.random.key(matrix.seed)
    for part in (
        CONTROLS.index(cell.control),
        round(1e6 * cell.motor_time_constant),
        round(1e6 * cell.latency),
    ):
        key = jax.random.fold_in(key, part)
    return train(
        tasks.circle(),
        controller,
        box,
        jax.random.split(key, matrix.policies),
        matrix.controls[cell.control],
    )


def fly(
    matrix: Matrix, policies: Mapping[Cell, Sequence[Policy]], realities: Sequence[AnyReality]
) -> polars.DataFrame:
    """Flies all policies, each at its structure's own rate, not that of training.

    Args:
        matrix: settings.
        policies: of each cell.
        realities: where to fly.

    Returns:
        One row per flight: control, training_rate [Hz], motor_time_constant and latency trained for
        [s], number (of the policy in its cell), reality, trial, duration [s], end_reason,
        position_error [m].
    """
    tables = []
    for kind in dict.fromkeys(cell.control for cell in policies):
        own = [
            (cell, number, one)
            for cell, several in policies.items()
            if cell.control == kind
            for number, one in enumerate(several, 1)
        ]
        names = [f"{cell.name}/{number}" for cell, number, _ in own]
        rate = INTERFACES[kind]().rate
        flying = [
            dataclasses.replace(one, interface=dataclasses.replace(one.interface, rate=rate))
            for *_, one in own
        ]
        key = jax.random.fold_in(jax.random.key(matrix.seed), CONTROLS.index(kind))
        table = transfer(
            flying, realities, matrix.trials, key, duration=matrix.duration, names=names
        ).table.drop("flight")
        content = [
            {
                "policy": name,
                "control": kind,
                "training_rate": matrix.rates[kind],
                "motor_time_constant": cell.motor_time_constant,
                "latency": cell.latency,
                "number": number,
            }
            for name, (cell, number, _) in zip(names, own, strict=True)
        ]
        tables.append(
            polars.DataFrame(content).join(table, on="policy", maintain_order="left").drop("policy")
        )
    return polars.concat(tables)


def by_cell(flights: polars.DataFrame, longest: float = MAX_DURATION_S) -> polars.DataFrame:
    """Flight times by reality and cell.

    Policies, flights, mean and median flight time [s], and the share of flights that reach the
    longest duration.
    """
    duration = polars.col("duration")
    return flights.group_by(
        "reality", "control", "motor_time_constant", "latency", maintain_order=True
    ).agg(
        polars.col("number").n_unique().alias("policies"),
        polars.len().alias("flights"),
        duration.mean().alias("mean"),
        duration.median().alias("median"),
        (duration >= longest).mean().alias("share"),
    )
