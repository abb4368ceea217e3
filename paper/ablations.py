"""Ablations for the claims of the paper's Discussion: effects on zero-shot flights.

`python paper/ablations.py -o ablations` trains policies around a drone, five seeds each: as the
paper did, and then with one thing changed at a time: penalties of actions, the range of attitude
rates, and what the simulation knows of motor lag and latency. It flies each of them in virtual
realities and on the drone itself, and those trained as the paper's also on drones with other parts,
or drawn from the posterior of an identified drone. `flights.csv` has a row a flight,
`ablations.svg` shows effects with 95 % intervals over policies. Stopped, it goes on where it was by
the same command; what has flown is kept by variant, and only the picture is drawn anew.

Source: Gronauer et al. 2022, sec. Discussion.
"""

import argparse
import io
import json
import re
import warnings
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace as replaced
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import polars
from jaxtyping import Bool, Float
from kept_policies import kept_policies
from scipy import stats
from scipy.spatial.transform import Rotation

from maidenflight import compiler, parameters, results, terminal
from maidenflight.errors import InputError
from maidenflight.experiments.drones import find_reality
from maidenflight.experiments.transfer import MAX_DURATION_S, transfer
from maidenflight.flights.log import Flight
from maidenflight.identification import drone_file
from maidenflight.identification.outcome.ensembles import posterior_ensemble, trim_ensemble
from maidenflight.parameters import Parameters, component, replace
from maidenflight.policy import Policy
from maidenflight.reporting.figures import charts, intervals, picture
from maidenflight.reporting.figures.charts import Entry, Figure, Spec
from maidenflight.simulator.controllers import control
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.controllers.interface import HIGHEST_RATE_DEG
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.randomization import Ensemble, relative_box
from maidenflight.simulator.realities.virtual_drone import VirtualDrone
from maidenflight.simulator.tasks import tasks
from maidenflight.simulator.tasks.rewards import ACTION_PENALTY, ACTION_RATE_PENALTY
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.ppo_settings import PPO
from maidenflight.training.settings import Settings, recorded
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
"""Of 16,384 steps, as in paper/zero_shot_ppo.toml."""
NO_LAG = 0.0025
"""T_m [s] of a motor without lag: in steps of 5 ms the trapezoidal rule then reaches the command at
the end of the step, and a shorter one would overshoot."""
LIMIT = 0.01
"""A command within this of 0 or 1 is at its limit; steps of the motors' 8-bit timers are as large
at full thrust."""
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
        groups[POSTERIOR] = _first(posterior_ensemble(drone, identified.posterior, file), draws)
        groups[TRIM] = _first(trim_ensemble(drone, identified.estimates, file), draws)
    for name, parts in PARTS.items():
        generator = np.random.default_rng([seed, _number(name)])
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


def _number(name: str) -> int:
    """That stands for a name in random keys, so that what is drawn for it depends on it alone."""
    return zlib.crc32(name.encode())


def trained(
    variant: Variant,
    nominal: Parameters,
    settings: Settings,
    seeds: int,
    made: dict[str, Any],
    folder: Path,
) -> list[Policy]:
    """Policies of a variant: those that the folder holds, or new ones that it holds then.

    Raises:
        InputError: the folder holds policies of other settings.
    """

    def learn() -> Sequence[Policy]:
        keys = jax.random.split(
            jax.random.fold_in(jax.random.key(made["seed"]), _number(variant.folder)), seeds
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

    return kept_policies(folder / variant.folder, seeds, made, learn)


def _same(found: Any, made: Mapping[str, Any], path: Path) -> None:
    if found != results.plain(made):
        raise InputError(
            f"{path}: from a run with other settings or of another version. Choose another folder "
            "with -o."
        )


def actions(
    flown: Policy, flights: Sequence[Flight], levels: Float[np.ndarray, "F 4"]
) -> list[Float[np.ndarray, "N 4"]]:
    """What a policy did in its flights, from what their logs say that it saw; not clipped.

    Args:
        flown: the policy that flew them.
        flights: with a row a control period.
        levels: of each flight the action that stands in the first observation, of level hover.
    """
    longest = max(len(flight) for flight in flights)
    # Flights that have ended stay what they were last, which is cut off again.
    seen = np.stack(
        [
            np.pad(_seen(flight), ((0, longest - len(flight)), (0, 0)), mode="edge")
            for flight in flights
        ]
    )
    layers = [
        (np.asarray(weight), np.asarray(bias))
        for weight, bias in zip(flown.weights, flown.biases, strict=True)
    ]
    mean, deviation = np.asarray(flown.observation_mean), np.asarray(flown.observation_std)
    action, history, done = np.asarray(levels), None, []
    for row in seen.swapaxes(0, 1):
        instant = np.concatenate([row, action], axis=1)
        history = (
            np.tile(instant, flown.spec.history)
            if history is None
            else np.concatenate([history[:, instant.shape[1] :], instant], axis=1)
        )
        values = (history - mean) / deviation
        for weight, bias in layers[:-1]:
            values = np.maximum(values @ weight.T + bias, 0.0)
        action = values @ layers[-1][0].T + layers[-1][1]
        done.append(action)
    return [np.stack(done)[: len(flight), number] for number, flight in enumerate(flights)]


def _seen(flight: Flight) -> Float[np.ndarray, "N 16"]:
    """An observation's instants but for their actions, in the order of `environment.observe`."""
    quaternions = Rotation.from_euler("xyz", flight.attitude).as_quat()
    # Attitudes do not tell a quaternion's sign; the simulator's begins upright and does not jump.
    flips = np.where(np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0, -1.0, 1.0)
    signs = np.cumprod(np.concatenate([[1.0 if quaternions[0, 3] >= 0 else -1.0], flips]))
    error = flight.setpoint - flight.position
    return np.concatenate(
        [flight.position, quaternions * signs[:, None], flight.velocity, flight.body_rates, error],
        axis=1,
    )


class Activity(NamedTuple):
    """How near a flight is to bang-bang control."""

    beyond: float
    """Share of actions with |a| > 1."""
    change: float
    """Mean |u_t - u_(t-1)| of the motor commands, a control period."""
    at_limits: float
    """Share of motor commands at 0 or 1."""


def activity(done: Float[np.ndarray, "N 4"], command: Float[np.ndarray, "N 4"]) -> Activity:
    """Of a flight's actions and motor commands u, a row a control period."""
    limits: Bool[np.ndarray, "N 4"] = (command <= LIMIT) | (command >= 1.0 - LIMIT)
    change = float(np.abs(np.diff(command, axis=0)).mean()) if len(command) > 1 else 0.0
    return Activity(float((np.abs(done) > 1.0).mean()), change, float(limits.mean()))


def flown(
    variant: Variant,
    policies: Sequence[Policy],
    realities: Mapping[str, Sequence[VirtualDrone]],
    trials: int,
    duration: float,
    key: jax.Array,
) -> polars.DataFrame:
    """One row per flight.

    Columns: variant, control, policy, reality, drone (its number in the reality), trial, those of
    `transfer`, and `Activity`.

    All variants start alike and meet the same noise, as far as the key is the same.
    """
    controller = variant.controller()
    places = {
        one.name: (name, number, one)
        for name, drones in realities.items()
        for number, one in enumerate(drones, 1)
    }
    names = [str(number) for number in range(1, len(policies) + 1)]
    made = transfer(
        policies,
        [one for *_, one in places.values()],
        trials,
        key,
        task=tasks.paper_circle(),
        controller=controller,
        duration=duration,
        names=names,
    )
    levels = {
        name: np.asarray(controller.interface.level(dynamics.hover_command(one.parameters)))
        for name, (*_, one) in places.items()
    }
    done: dict[int, Float[np.ndarray, "N 4"]] = {}
    for name, one in zip(names, policies, strict=True):
        own = [number for number, pilot in enumerate(made.table["policy"]) if pilot == name]
        begun = np.stack([levels[made.table["reality"][number]] for number in own])
        done |= dict(
            zip(own, actions(one, [made.flights[number] for number in own], begun), strict=True)
        )
    rows = []
    for place, (row, flight) in enumerate(
        zip(made.table.iter_rows(named=True), made.flights, strict=True)
    ):
        reality, number, _ = places[row["reality"]]
        ended = {name: row[name] for name in ("duration", "end_reason", "position_error")}
        told = {
            name: round(value, 6)
            for name, value in activity(done[place], flight.command)._asdict().items()
        }
        begun = {
            "variant": variant.name,
            "control": variant.control,
            "policy": int(row["policy"]),
            "reality": reality,
            "drone": number,
        }
        rows.append({**begun, "trial": row["trial"], **ended, **told})
    return polars.DataFrame(rows)


class Measure(NamedTuple):
    """A column of `flights.csv`, as it is shown."""

    column: str
    title: str
    unit: str
    scale: float
    decimals: int


MEASURES = (
    Measure("duration", "flight time", "s", 1.0, 1),
    Measure("position_error", "distance", "cm", 100.0, 1),
    Measure("beyond", "actions beyond 1", "%", 100.0, 1),
    Measure("change", "change of u", "%", 100.0, 2),
    Measure("at_limits", "u at 0 or 1", "%", 100.0, 1),
)


def by_policy(flights: polars.DataFrame) -> polars.DataFrame:
    """Means of a policy's flights in a reality, a row a policy.

    All but the duration are means over time.
    """
    weight = polars.col("duration")
    others = [
        ((polars.col(each.column) * weight).sum() / weight.sum()).alias(each.column)
        for each in MEASURES[1:]
    ]
    return flights.group_by("control", "variant", "reality", "policy", maintain_order=True).agg(
        *others, weight.mean().alias("duration")
    )


def effects(flights: polars.DataFrame) -> polars.DataFrame:
    """Of everything that was changed, in the order of the flights.

    Returns:
        control, variant, reality, measure, policies, mean, effect, low, high (95 % interval), in
        the units of `MEASURES`. A variant's effect is the difference to the baseline of its control
        structure in the same reality (Welch's interval, policies are the sample); that of drones
        which resemble the one trained for is the mean difference to the flights of the same
        policies on that one. An interval is not a number where no policy differs from another.
    """
    means, rows = by_policy(flights), []
    for structure, name, reality in (
        means.select("control", "variant", "reality").unique(maintain_order=True).iter_rows()
    ):
        own = means.filter(
            (polars.col("control") == structure)
            & (polars.col("variant") == name)
            & (polars.col("reality") == reality)
        )
        paired = reality in (POSTERIOR, TRIM, *PARTS)
        base = means.filter(
            (polars.col("control") == structure)
            & (polars.col("variant") == BASELINE)
            & (polars.col("reality") == (ITSELF if paired else reality))
        )
        for each in MEASURES:
            values, others = (each.scale * frame[each.column].to_numpy() for frame in (own, base))
            low, high = (
                (np.nan, np.nan)
                if name == BASELINE and not paired
                else _interval(values, others, paired)
            )
            effect = float(values.mean() - others.mean())
            told = {
                "control": structure,
                "variant": name,
                "reality": reality,
                "measure": each.column,
                "policies": len(values),
            }
            rows.append(
                {**told, "mean": float(values.mean()), "effect": effect, "low": low, "high": high}
            )
    return polars.DataFrame(rows)


def _interval(
    values: Float[np.ndarray, "n"], others: Float[np.ndarray, "m"], paired: bool
) -> tuple[float, float]:
    """Of the difference of means."""
    with warnings.catch_warnings():  # of policies that do not differ, which give no interval
        warnings.simplefilter("ignore", RuntimeWarning)
        found: Any = (
            stats.ttest_rel(values, others)
            if paired
            else stats.ttest_ind(values, others, equal_var=False)
        )
        low, high = found.confidence_interval(0.95)
    return (float(low), float(high)) if low < high else (np.nan, np.nan)


COLOURS = ("blue", "orange", "green", "purple")
COLUMN = 132
"""Width of a panel [px]."""
NOTE = (
    "Dots: difference of means over policies; whiskers: its 95 % interval. Left of the line is "
    "less than without the change."
)


def chart(table: polars.DataFrame, drone: str) -> Figure:
    """Effects with intervals: blocks by structure and kind of change, panels by measure."""
    realities = _trained_in(table)
    changed = table.filter(
        (polars.col("variant") != BASELINE) | ~polars.col("reality").is_in(realities)
    )
    colours = dict(zip(realities, COLOURS, strict=False))
    legend = [
        Entry("on the drone itself" if name == ITSELF else f"in {name}", colours[name], "bar")
        for name in realities
    ]
    ranges = {
        each.column: charts.margin([0.0, *_ends(changed.filter(measure=each.column))])
        for each in MEASURES
    }
    panels = []
    for structure in table["control"].unique(maintain_order=True):
        own = changed.filter(control=structure)
        for column, block, words in (
            ("variant", own.filter(polars.col("variant") != BASELINE), "trained otherwise"),
            ("reality", own.filter(variant=BASELINE), "flown on other drones"),
        ):
            title = f"{structure.replace('_', ' ')}: {words}"
            cells = list(_block(block, column, ranges, colours)) if block.height else []
            head = {"text": title, "frame": "group"}
            panels += [{"title": head, "hconcat": cells, "spacing": 14}] if cells else []
    title = f"What zero-shot flights depend on: drone {drone}"
    return Figure(title, panels, legend, columns=1)


def _trained_in(table: polars.DataFrame) -> list[str]:
    """Realities in which all variants flew."""
    return (
        table.filter(polars.col("variant") != BASELINE)["reality"]
        .unique(maintain_order=True)
        .to_list()
    )


def _ends(rows: polars.DataFrame) -> Float[np.ndarray, "n"]:
    return rows.select("effect", "low", "high").to_numpy().ravel()


def _block(
    block: polars.DataFrame,
    column: str,
    ranges: Mapping[str, tuple[float, float]],
    colours: Mapping[str, str],
) -> Iterator[Spec]:
    """A panel a measure, a row a name in a column, side by side."""
    names = block[column].unique(maintain_order=True).to_list()
    shifts = np.linspace(-0.2, 0.2, len(colours)) if len(colours) > 1 else [0.0]
    # Flights on other drones are compared with those on the drone itself.
    places = dict(zip(colours, shifts, strict=True)) if column == "variant" else {ITSELF: 0.0}
    nothing = {"type": "rule", "strokeWidth": 1.2}
    for number, each in enumerate(MEASURES):
        marks: list[Spec] = []
        for row in block.filter(measure=each.column).iter_rows(named=True):
            reality = row["reality"] if column == "variant" else ITSELF
            common = {"row": names.index(row[column]), "shift": float(places[reality])}
            common["colour"] = charts.paint(colours[reality])
            if np.isfinite([row["low"], row["high"]]).all():
                whisker = {**common, "kind": "whisker", "x": row["low"], "x2": row["high"]}
                marks.append(whisker)
            marks.append({**common, "kind": "dot", "x": row["effect"]})
        left = names if number == 0 else [""] * len(names)
        x = charts.number("x", f"{each.title} [{each.unit}]", **charts.within(*ranges[each.column]))
        panel = intervals.rows(
            [(name, "") for name in left],
            marks,
            {**x, "axis": {"tickCount": 4}},
            across=[(0.0, nothing)],
        )
        yield {**panel, "width": COLUMN}


def summary(table: polars.DataFrame) -> polars.DataFrame:
    """One row per control structure, variant and reality.

    Policies, mean flight time, and for each measure the mean and the effect with its interval.
    """
    rows: dict[tuple[str, str, str], dict[str, Any]] = {}
    plain = {each.column: each for each in MEASURES}
    for row in table.iter_rows(named=True):
        each = plain[row["measure"]]
        kept = rows.setdefault(
            (row["control"], row["variant"], row["reality"]),
            {
                **{name: row[name] for name in ("control", "variant", "reality")},
                "n": row["policies"],
            },
        )
        mean, effect, low, high = (
            f"{row[name]:+.{each.decimals}f}" for name in ("mean", "effect", "low", "high")
        )
        unchanged = row["variant"] == BASELINE and row["reality"] not in (POSTERIOR, TRIM, *PARTS)
        # Where policies do not differ among themselves there is nothing to tell an interval from.
        interval = f" ({low} to {high})" if np.isfinite([row["low"], row["high"]]).all() else ""
        kept[f"{each.title} [{each.unit}]"] = mean.removeprefix("+") + (
            "" if unchanged else f"   {effect}{interval}"
        )
    return polars.DataFrame(list(rows.values()))


def main(arguments: Sequence[str] | None = None) -> None:
    """Trains, flies, writes, prints and draws."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        help="folder for policies, flights.csv and ablations.svg",
    )
    parser.add_argument(
        "--drone",
        default="crazyflie",
        help="drone to train around: a name or a TOML file (crazyflie)",
    )
    elsewhere = (
        "where to fly beside the drone itself, as `maidenflight transfer` takes it; may "
        "be repeated (virtual:7)"
    )
    parser.add_argument("--reality", action="append", help=elsewhere)
    parser.add_argument(
        "--control",
        action="append",
        choices=list(QUICK),
        help="a control structure; may be repeated (both)",
    )
    parser.add_argument(
        "--method", choices=METHODS, default="gradient", help="of training (gradient)"
    )
    parser.add_argument(
        "--seeds", type=int, default=5, help="policies of each variant (default: 5)"
    )
    parser.add_argument(
        "--trials", type=int, default=3, help="flights of each policy and drone (default: 3)"
    )
    parser.add_argument(
        "--draws", type=int, default=8, help="drones with other parts, of each kind (default: 8)"
    )
    parser.add_argument(
        "--duration",
        type=float,
        default=MAX_DURATION_S,
        help="longest flight, seconds (default: %(default)g)",
    )
    parser.add_argument("--updates", type=int, help="of training, for both control structures")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(arguments)
    if min(given.seeds, given.trials, given.draws) < 1 or given.seeds < 2:
        parser.error("--seeds must be at least 2, --trials and --draws at least 1.")
    try:
        run(given)
    except InputError as error:
        parser.error(str(error))


def run(given: argparse.Namespace) -> None:
    """All of it, for given arguments."""
    nominal = parameters.read_drone(given.drone)
    home = VirtualDrone(ITSELF, replace(nominal, time_step=np.float32(0.001)))
    realities = {
        one.name: [one]
        for one in [home, *(find_reality(name) for name in given.reality or ["virtual:7"])]
    }
    others = other_drones(home.parameters, given.drone, given.draws, given.seed)
    inputs = [given.drone] if Path(given.drone).is_file() else []
    said = {
        "drone": Path(given.drone).stem,
        "policies": given.seeds,
        "randomization": RANDOMIZATION,
    }

    def record(settings: Mapping[str, Any]) -> dict[str, Any]:
        return results.record(seed=given.seed, inputs=inputs, settings={**said, **settings})

    chosen = choose_variants(given.control or tuple(QUICK), given.method)
    settings = {one: choose_settings(one, given.method, given.updates) for one in chosen}
    made = {one: record({**one._asdict(), **recorded(settings[one])}) for one in chosen}
    flying: dict[str, Any] = {
        name: getattr(given, name) for name in ("trials", "draws", "duration")
    }
    flying |= {"realities": list(realities), "others": list(others)}
    tables = []
    with terminal.Bar("ablations") as bar:
        for number, one in enumerate(chosen):
            bar.move(number, len(chosen), f"{one.control}, {one.name}")
            path, wanted = (
                given.output / "flights" / f"{one.folder}.csv",
                record({**made[one]["settings"], **flying}),
            )
            if not path.exists():
                policies = trained(
                    one, nominal, settings[one], given.seeds, made[one], given.output / "policies"
                )
                rows = polars.concat(_all_flights(one, policies, realities, others, given))
                results.write(path, results.table_text(_FLIGHTS, wanted, rows.write_csv()))
            tables.append(read_flights(path, wanted))
    flights = polars.concat(tables)
    everything = record({**flying, "variants": [made[one]["settings"] for one in chosen]})
    text = results.table_text(_FLIGHTS, everything, flights.write_csv())
    results.write(given.output / "flights.csv", text)
    found = effects(flights)
    results.write(
        given.output / "ablations.svg", picture.svg(chart(found, Path(given.drone).stem), note=NOTE)
    )
    with polars.Config(
        tbl_cols=-1,
        tbl_rows=-1,
        tbl_width_chars=300,
        fmt_str_lengths=60,
        tbl_hide_column_data_types=True,
        tbl_hide_dataframe_shape=True,
    ):
        print(summary(found))
    if POSTERIOR not in others:
        print(
            f"{given.drone} has no posterior: give the file of an identified drone to fly on what "
            "its logs leave possible."
        )


def _all_flights(
    one: Variant,
    policies: Sequence[Policy],
    realities: Mapping[str, Sequence[VirtualDrone]],
    others: Mapping[str, Sequence[Parameters]],
    given: argparse.Namespace,
) -> Iterator[polars.DataFrame]:
    key = jax.random.key(given.seed)
    yield flown(
        one,
        policies,
        realities,
        given.trials,
        given.duration,
        jax.random.fold_in(key, _number("realities")),
    )
    if one.name == BASELINE:
        for name, drones in others.items():
            group = {
                name: [
                    VirtualDrone(f"{name}, {number}", drone)
                    for number, drone in enumerate(drones, 1)
                ]
            }
            yield flown(
                one,
                policies,
                group,
                given.trials,
                given.duration,
                jax.random.fold_in(key, _number(name)),
            )


def read_flights(path: Path, made: Mapping[str, Any]) -> polars.DataFrame:
    """The table that a run with these settings wrote.

    Raises:
        InputError: it is of other settings, or no such table.
    """
    text = path.read_text(encoding="utf-8")
    head = [line.removeprefix("# record: ") for line in text.splitlines()[:2]]
    try:
        found = json.loads(head[-1]) if head else None
    except ValueError as error:
        raise InputError(
            f"{path}: not a table of this script ({error}). Choose another folder with -o."
        ) from error
    _same(found, made, path)
    return polars.read_csv(io.StringIO(text), comment_prefix="#")


_FLIGHTS = (
    "# maidenflight ablations 1: simulated, a row a flight; duration s, position_error m, beyond "
    "= share of actions with |a| > 1,"
    " change = mean |u_t - u_(t-1)| a control period, at_limits = share of motor commands at 0 or 1"
)

if __name__ == "__main__":
    compiler.prepare_jax()
    main()
