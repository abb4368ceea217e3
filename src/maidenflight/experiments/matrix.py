"""The paper's experiment: policies trained for many motors and flown in unseen realities.

A matrix has a cell for each control structure, motor time constant and latency; `matrix_file` reads
its settings.

Source: Gronauer et al. 2022, sec. Zero-Shot Experiments.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import polars
from jaxtyping import Array

from maidenflight.errors import InputError
from maidenflight.experiments.transfer import MAX_DURATION_S, transfer
from maidenflight.parameters import Parameters, replace
from maidenflight.policy import Policy
from maidenflight.simulator import control, tasks
from maidenflight.simulator.battery import COUNTS
from maidenflight.simulator.control import Controller
from maidenflight.simulator.interface import CONTROLS, INTERFACES
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.randomization import Distribution, relative_box
from maidenflight.simulator.reality import AnyReality
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.settings import recorded
from maidenflight.training.train import train


class Row(NamedTuple):
    """Control structure and motor time constant, whose cells' policies are trained in one call.

    There they share XLA's calls (docs/studies/roofline.md).
    """

    control: str
    motor_time_constant: float
    """[s]."""
    latencies: tuple[float, ...]
    """[s]."""

    @property
    def name(self) -> str:
        """Such as pwm_80ms."""
        return f"{self.control}_{1e3 * self.motor_time_constant:g}ms"

    @property
    def cells(self) -> list["Cell"]:
        """One for each latency."""
        return [Cell(self.control, self.motor_time_constant, one) for one in self.latencies]


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
    specs: Mapping[str, PolicySpec]
    """Of the policies, by control structure."""
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
    def rows(self) -> list[Row]:
        """All rows, ordered by control structure."""
        return [
            Row(kind, lag, self.latency)
            for kind in self.controls
            for lag in self.motor_time_constant
        ]

    @property
    def cells(self) -> list[Cell]:
        """All cells, row by row."""
        return [cell for row in self.rows for cell in row.cells]

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
            **self.specs[cell.control].to_dict(),
            **recorded(self.controls[cell.control]),
        }


def controller_at(kind: str, rate: int, full_scale_counts: float = COUNTS) -> Controller:
    """A control structure at the rate of training [Hz].

    Raises:
        InputError: PWM at another rate than its own, or the rate does not divide that of commands.
    """
    own = INTERFACES[kind]().rate
    if kind == "pwm" and rate != own:
        raise InputError(
            f"pwm at {rate} Hz; the motors take {own} commands a second. Leave out its rate."
        )
    return control.CONTROLLERS[kind](action_rate=rate, full_scale_counts=full_scale_counts)


def train_cells(
    matrix: Matrix, cells: Sequence[Cell], nominal: Parameters, full_scale_counts: float = COUNTS
) -> dict[Cell, tuple[Policy, ...]]:
    """Trains the policies of cells in one call, such as those of a row.

    Args:
        matrix: settings.
        cells: of one control structure. With others beside it a cell's policies differ by rounding.
        nominal: drone with all other parameters.
        full_scale_counts: of that drone; see `ControlInterface`.
    """
    (kind,) = {cell.control for cell in cells}
    controller = controller_at(kind, matrix.rates[kind], full_scale_counts)
    count = matrix.policies
    trained = train(
        tasks.circle(),
        controller,
        [_drones(matrix, cell, nominal, controller) for cell in cells for _ in range(count)],
        jnp.concatenate([jax.random.split(_key(matrix, cell), count) for cell in cells]),
        matrix.controls[kind],
        matrix.specs[kind],
    )
    return {
        cell: trained[number * count : (number + 1) * count] for number, cell in enumerate(cells)
    }


def _drones(
    matrix: Matrix, cell: Cell, nominal: Parameters, controller: Controller
) -> Distribution:
    """What a cell's policies are trained over."""
    drone = replace(
        nominal,
        motor_time_constant=np.float32(cell.motor_time_constant),
        latency=np.float32(cell.latency),
    )
    return relative_box(control.in_fitting_steps(drone, controller), matrix.randomization)


def _key(matrix: Matrix, cell: Cell) -> Array:
    """Random key of a cell, which depends on its values alone."""
    key = jax.random.key(matrix.seed)
    for part in (
        CONTROLS.index(cell.control),
        round(1e6 * cell.motor_time_constant),
        round(1e6 * cell.latency),
    ):
        key = jax.random.fold_in(key, part)
    return key


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
