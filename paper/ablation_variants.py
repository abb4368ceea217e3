"""What the ablations train and fly: variants of training, and drones with other parts.

Source: Gronauer et al. 2022, sec. Discussion.
"""

import re
import zlib
from collections.abc import Sequence
from dataclasses import replace as replaced
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from kept_policies import kept_policies

from maidenflight import parameters
from maidenflight.identification import drone_file
from maidenflight.identification.likelihood.flight_differences import trim_ensemble
from maidenflight.parameters import Parameters, component, replace
from maidenflight.policy import Policy
from maidenflight.simulator.controllers import control
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.controllers.interface import HIGHEST_RATE_DEG
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.randomization import Ensemble, relative_box
from maidenflight.simulator.tasks import tasks
from maidenflight.simulator.tasks.rewards import ACTION_PENALTY, ACTION_RATE_PENALTY
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.settings import PPO, Settings
from maidenflight.training.train import train

RANDOMIZATION = 0.10
"""Half width of the box of drones to train over."""
QUICK = {
    "pwm": AnalyticGradient(updates=400, hidden_learning_rate=0.0, action_change_penalty=0.0),
    "attitude_rate": AnalyticGradient(
        updates=300, horizon=32, hidden_learning_rate=0.0, action_change_penalty=0.0
    ),
}
"""Settings of training, by control structure: a quarter as long as the command line's, and by Adam
alone, as paper/notes/ablations.md was measured."""
METHODS = ("gradient", "ppo", "ppo-paper")
"""Names in `maidenflight.names.METHODS` that the study trains by."""
PPO_UPDATES = 400
"""Of 16,384 steps, as in paper/settings/zero_shot_ppo.toml."""
NO_LAG = 0.0025
"""T_m [s] of a motor without lag: in steps of 5 ms the trapezoidal rule then reaches the command at
the end of the step, and a shorter one would overshoot."""
ITSELF = "itself"
"""The reality that is the very drone of `--drone`."""
BASELINE = "as the paper"
"""The variant that others are compared with."""


class Variant(NamedTuple):
    """How some policies are trained."""

    control: str
    name: str = BASELINE
    action_penalty: float = ACTION_PENALTY
    action_rate_penalty: float = ACTION_RATE_PENALTY
    excess: float = AnalyticGradient.action_excess_penalty
    """Our training's own cost of actions beyond [-1, 1]."""
    highest_rate: float = HIGHEST_RATE_DEG
    """[deg/s]."""
    motor_time_constant: float | None = None
    """Of the drone in the middle of the training box [s], where it is not the true one; `latency`
    likewise."""
    latency: float | None = None

    @property
    def folder(self) -> str:
        """Of its policies."""
        return re.sub(r"[^a-z0-9]+", "_", f"{self.control} {self.name}")

    def controller(self) -> Controller:
        """What its policies' actions mean."""
        ranged = {"highest_rate": self.highest_rate} if self.control == "attitude_rate" else {}
        return control.CONTROLLERS[self.control](**ranged)

    def drone(self, nominal: Parameters) -> Parameters:
        """The drone in the middle of the training box, in steps that fit the control structure."""
        left_out = {"motor_time_constant": self.motor_time_constant, "latency": self.latency}
        known = {name: np.float32(value) for name, value in left_out.items() if value is not None}
        return control.in_fitting_steps(replace(nominal, **known), self.controller())


FREE = {"action_penalty": 0.0, "action_rate_penalty": 0.0}
VARIANTS = (
    Variant("pwm"),
    Variant("pwm", "no action penalty", action_penalty=0.0),
    Variant("pwm", "no action-rate penalty", action_rate_penalty=0.0),
    Variant("pwm", "neither penalty", **FREE),
    Variant("pwm", "neither, nor of excess", **FREE, excess=0.0),
    Variant("pwm", "no motor lag", motor_time_constant=NO_LAG),
    Variant("pwm", "no latency", latency=0.0),
    Variant("pwm", "neither lag nor latency", motor_time_constant=NO_LAG, latency=0.0),
    Variant("attitude_rate"),
    Variant("attitude_rate", "neither penalty", **FREE),
    Variant("attitude_rate", "+-360 deg/s", highest_rate=360.0),
    Variant("attitude_rate", "+-360, neither penalty", **FREE, highest_rate=360.0),
    Variant("attitude_rate", "no motor lag", motor_time_constant=NO_LAG),
    Variant("attitude_rate", "no latency", latency=0.0),
    Variant("attitude_rate", "neither lag nor latency", motor_time_constant=NO_LAG, latency=0.0),
)
"""The first of each control structure is the one that the others are compared with."""


class Parts(NamedTuple):
    """How drones with other parts differ."""

    factors: dict[str, float]
    """Half widths of uniform factors, by parameter."""
    imbalance: float = 0.0
    """Standard deviation of each motor's thrust at hover, as a share of it."""


_PROPELLERS, _MOTORS = (
    {"thrust_to_weight": 0.15, "torque_to_thrust": 0.30},
    {"motor_time_constant": 0.30},
)
PARTS = {
    "other propellers": Parts(_PROPELLERS),
    "other motors": Parts(_MOTORS),
    "unequal motors, 5 %": Parts({}, imbalance=0.05),
    "unequal motors, 10 %": Parts({}, imbalance=0.10),
    "all parts, 5 %": Parts(_PROPELLERS | _MOTORS, imbalance=0.05),
}
"""Ours: half wider to three times as wide as the training box. Between the published flights roll
and pitch trims scatter by 1.1e-4 and 1.5e-4 N m, which is what motors that differ by 3 and 4 %
make."""
POSTERIOR, TRIM = "posterior", "trims between flights"


def with_other_parts(drone: Parameters, parts: Parts, generator: np.random.Generator) -> Parameters:
    """One drone with other propellers or motors."""
    factors = {
        name: component(drone, name) * np.float32(generator.uniform(1 - half, 1 + half))
        for name, half in parts.factors.items()
    }
    forces = np.full(4, drone.mass * drone.gravity / 4) * (
        1.0 + parts.imbalance * generator.standard_normal(4)
    )
    even = np.full(4, forces.sum() / 4)
    changed = replace(drone, **factors)
    pairs: Any = (forces, even)
    uneven, none = (
        np.stack([np.asarray(axis) for axis in dynamics.torque(each, changed)]) for each in pairs
    )
    return parameters.check(
        replace(changed, torque_bias=np.asarray(drone.torque_bias + uneven - none, np.float32)),
        "a drone of other parts",
    )


def other_drones(
    drone: Parameters, file: str, draws: int, seed: int
) -> dict[str, list[Parameters]]:
    """Drones like the one of a file: posterior samples with its trims, and with other parts."""
    identified = drone_file.read(file)
    groups: dict[str, list[Parameters]] = {}
    if identified.posterior:
        groups[POSTERIOR] = _first(identified.posterior.ensemble(drone, file), draws)
        groups[TRIM] = _first(trim_ensemble(drone, identified.estimates, file), draws)
    for name, parts in PARTS.items():
        generator = np.random.default_rng([seed, number_name(name)])
        groups[name] = [with_other_parts(drone, parts, generator) for _ in range(draws)]
    return groups


def _first(drones: Ensemble, count: int) -> list[Parameters]:
    return [
        jax.tree.map(lambda leaf, place=place: np.asarray(leaf)[place], drones.drones)
        for place in range(count)
    ]


def choose_variants(structures: Sequence[str], method: str) -> list[Variant]:
    """Returns variants of control structures, of those that a method can tell apart."""
    usual = AnalyticGradient.action_excess_penalty
    return [
        one
        for one in VARIANTS
        if one.control in structures and (method == "gradient" or one.excess == usual)
    ]


def choose_settings(variant: Variant, method: str, updates: int | None) -> Settings:
    """Returns the settings of training of a variant.

    Args:
        variant: to train.
        method: a name in `METHODS`.
        updates: instead of the method's own.
    """
    if method != "gradient":
        settings = PPO.paper() if method == "ppo-paper" else PPO(updates=PPO_UPDATES)
        return replaced(settings, updates=updates or settings.updates)
    quick = QUICK[variant.control]
    return replaced(quick, updates=updates or quick.updates, action_excess_penalty=variant.excess)


def number_name(name: str) -> int:
    """That stands for a name in random keys, so that what is drawn for it depends on it alone."""
    return zlib.crc32(name.encode())


def train_variant(
    variant: Variant,
    nominal: Parameters,
    settings: Settings,
    seeds: int,
    record: dict[str, Any],
    folder: Path,
) -> list[Policy]:
    """Policies of a variant: those that the folder holds, or new ones that it holds then.

    Raises:
        InputError: the folder holds policies of other settings.
    """

    def learn() -> Sequence[Policy]:
        keys = jax.random.split(
            jax.random.fold_in(jax.random.key(record["seed"]), number_name(variant.folder)), seeds
        )
        task = tasks.paper_circle(
            action_penalty=variant.action_penalty, action_rate_penalty=variant.action_rate_penalty
        )
        return train(
            task,
            variant.controller(),
            relative_box(variant.drone(nominal), RANDOMIZATION),
            keys,
            settings,
        )

    return kept_policies(folder / variant.folder, seeds, record, learn)
