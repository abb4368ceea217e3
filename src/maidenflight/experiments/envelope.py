"""`envelope`: how far policies fly as a flight becomes harder.

Along each axis a flight grows harder, in speed or in what the drone is made to bear, until it is
lost: a guard trips, or the mean distance from the set-point exceeds `WITHIN_M`. What
a flight reaches is the hardest that it still flew. What 95 % of flights reach is the envelope.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import polars
from jax.tree_util import Partial
from jaxtyping import Array, Float

from maidenflight import inputs
from maidenflight import names as known
from maidenflight.errors import InputError
from maidenflight.flying.engine import fly_all
from maidenflight.flying.pilots import AnyPolicy, ForeignPilot, PolicyPilot, pilots_of
from maidenflight.flying.rows import Rows, SimulatedFlight
from maidenflight.flying.scenario import Change, Scenario
from maidenflight.parameters import QUANTITIES, Parameters, replace
from maidenflight.simulator.realities.additions import loaded
from maidenflight.simulator.realities.reality import AnyReality, Reality
from maidenflight.simulator.realities.virtual_drone import VirtualDrone, must_be_virtual
from maidenflight.simulator.tasks import tasks, trajectories
from maidenflight.simulator.tasks.failures import LOST, TIME_LIMIT
from maidenflight.simulator.tasks.tasks import Task

WITHIN_M = 0.10
"""Mean distance from the set-point [m] up to which a flight succeeds."""
WINDOW_S = 1.0
"""Time over which that mean is taken where a flight grows faster [s]."""
SHARE = 0.95
"""Share of flights that reach what is called the envelope."""
DURATION_S = 20.0
"""Length of a flight under a condition [s]."""
_RESAMPLINGS = 1000
"""Of the bootstrap."""


class SpeedRamp(NamedTuple):
    """A reference whose speed grows within one flight."""

    unit: str
    of: Callable[[float], trajectories.Trajectory] | None
    """(fastest [m/s]) to the reference; none: the task's own, from its own speed on."""
    fastest: float
    """Speed to which it grows in `trajectories.RAMP_DURATION_S`, in the unit."""
    tightest: float = math.nan
    """Least radius of curvature of the path [m], where it is fastest."""


class Condition(NamedTuple):
    """What a drone is made to bear, in grades; each grade is a flight of its own."""

    unit: str
    grades: tuple[float, ...]
    changed: Callable[[Parameters, float, int], Parameters]
    """(drone, grade, number of the flight) to the drone that bears it."""
    during: Change | None = None
    """What changes in the course of a flight."""


def gust(drone: Parameters, elapsed: Float[Array, ""]) -> Parameters:
    """Returns the drone in a gust, 1 s long and every 4 s, that is at most as strong as its wind.

    Source: MIL-F-8785C, sec. 3.7.3 (discrete gusts in the shape of one less a cosine).
    """
    since = jnp.mod(elapsed, 4.0)
    share = jnp.where(since < 1.0, 0.5 - 0.5 * jnp.cos(2 * jnp.pi * since), 0.0)
    return replace(drone, wind=share * drone.wind)


def _in_wind(drone: Parameters, grade: float, number: int) -> Parameters:
    # Directions of successive flights divide the circle evenly, however many there are.
    heading = 2 * math.pi * number * (math.sqrt(5.0) - 1) / 2
    return replace(drone, wind=(grade * math.cos(heading), grade * math.sin(heading), 0.0))


def _drained(drone: Parameters, grade: float, _: int) -> Parameters:
    return replace(drone, battery_voltage=drone.battery_voltage - np.float32(grade))


def _damaged(drone: Parameters, grade: float, number: int) -> Parameters:
    share = np.array(drone.rotor_thrust, np.float32)
    share[number % 4] *= np.float32(1.0 - grade)
    return replace(drone, rotor_thrust=share)


def _late(drone: Parameters, grade: float, _: int) -> Parameters:
    longest = np.float32(QUANTITIES["latency"].upper)
    return replace(drone, latency=np.minimum(drone.latency + np.float32(grade), longest))


def _grades(step: float, count: int) -> tuple[float, ...]:
    return tuple(round(step * number, 6) for number in range(count + 1))


_HARDER = (
    SpeedRamp("of the task's speed", None, 3.0),
    SpeedRamp("m/s", trajectories.accelerating_circle, 3.0, 0.5),
    SpeedRamp("m/s", trajectories.accelerating_figure_eight, 3.0, 1.0 / 3.0),
    Condition("m/s", _grades(1.0, 12), _in_wind, Partial(gust)),
    Condition("of mass", _grades(0.05, 12), lambda drone, grade, _: loaded(drone, grade)),
    Condition("V less", _grades(0.1, 12), _drained),
    Condition("of a rotor's thrust", _grades(0.05, 10), _damaged),
    Condition("s more", _grades(0.0025, 12), _late),
)
AXES: dict[str, SpeedRamp | Condition] = dict(zip(known.AXES, _HARDER, strict=True))
"""What grows harder, by name."""


def choose_axes(task: str) -> tuple[str, ...]:
    """Returns along which policies for a task are judged by default, by names of `AXES`.

    Speed grows where the path goes on, which that of a file does not.
    """
    own = {"fast_circle": ("circle",), "fast_figure_eight": ("figure_eight",)}
    standing = task in ("hover", "take_off") or task.endswith(".csv")
    return (*(() if standing else own.get(task, ("speed",))), "gusts")


def limit(axis: str, reality: AnyReality) -> float:
    """Returns the fastest that physics allows [m/s].

    NaN under a condition and where thrust is not known. A level curve of radius r takes v^2 / r
    sideways beside g upwards, and thrust gives k_F g.
    """
    pace = AXES[axis]
    if not isinstance(pace, SpeedRamp) or isinstance(reality, Reality):
        return float("nan")
    thrust, gravity = (
        float(value) for value in (reality.parameters.thrust_to_weight, reality.parameters.gravity)
    )
    return math.sqrt(pace.tightest * gravity * math.sqrt(max(thrust**2 - 1.0, 0.0)))


def envelope(
    policies: Sequence[AnyPolicy],
    reality: AnyReality,
    axis: str,
    *,
    flights: int = 20,
    key: Array | int | None = None,
    task: Task | None = None,
    names: Sequence[str] | None = None,
) -> polars.DataFrame:
    """Flies policies along one axis in one reality.

    Args:
        policies: ours of one control structure and layer sizes, and others'.
        reality: where to fly; other than a virtual drone, only axes of speed.
        axis: a name of `AXES`.
        flights: of each policy, along the whole axis each.
        key: random key; `jax.random.key(0)` by default. Flights of the same number have the same
            noise for each policy and grade.
        task: of speed and under a condition; the circle by default.
        names: what the table calls the policies; policy_1, policy_2, ... by default.

    Returns:
        One row a flight: policy, reality, axis, flight, reached (the hardest success, in
        `unit`; NaN if nothing was), unit, hardest (the end of the axis) and limit (of `limit`).

    Raises:
        InputError: an unknown axis, policies of different kinds, or a condition of a reality whose
            parameters are not ours to change.
    """
    if axis not in AXES:
        raise InputError(f"axis {axis!r}: no such axis. Give one of {', '.join(AXES)}.")
    if flights < 1 or not policies:
        raise InputError("an envelope needs at least one policy and one flight.")
    along, pilots, base_task = AXES[axis], pilots_of(policies), task or tasks.circle()
    keys = jax.random.split(inputs.random_key(key), flights)
    if isinstance(along, SpeedRamp):
        hardest = along.fastest
        reached = [_speeds_reached(pilot, reality, along, keys, base_task) for pilot in pilots]
    else:
        hardest = along.grades[-1]
        paces = [name for name in AXES if isinstance(AXES[name], SpeedRamp)]
        drone = must_be_virtual(reality, f"Give axes of speed: {', '.join(paces)}.")
        reached = [_grades_reached(pilot, drone, along, keys, base_task) for pilot in pilots]
    labels = names or [f"policy_{number}" for number in range(1, len(policies) + 1)]
    of_axis = {"unit": along.unit, "hardest": hardest, "limit": round(limit(axis, reality), 6)}
    rows = [
        {"policy": name, "reality": reality.name, "axis": axis, "flight": number}
        | {"reached": round(value, 6), **of_axis}
        for name, values in zip(labels, reached, strict=True)
        for number, value in enumerate(values, 1)
    ]
    return polars.DataFrame(rows)


def _speeds_reached(
    pilot: PolicyPilot | ForeignPilot,
    reality: AnyReality,
    pace: SpeedRamp,
    keys: Array,
    base_task: Task,
) -> list[float]:
    if pace.of is None:
        path, slowest = trajectories.hastening(base_task.reference, pace.fastest), 1.0
    else:
        path, slowest = pace.of(pace.fastest), 0.0
    task = tasks.tracking(path, trajectories.RAMP_DURATION_S)
    scenario, reached = Scenario(task, trajectories.RAMP_DURATION_S), []
    for flight in fly_all(reality, pilot, scenario, keys, LOST):
        done = steps_done(flight.rows, flight.rate, flight.estimated)
        share = done / round(trajectories.RAMP_DURATION_S * flight.rate)
        reached.append(slowest + (pace.fastest - slowest) * share if share else float("nan"))
    return reached


def steps_done(rows: Rows, rate: int, estimated: bool = False) -> int:
    """Returns rows until a guard trips or the distance's mean over `WINDOW_S` exceeds `WITHIN_M`.

    Args:
        rows: one flight.
        rate: its rows a second.
        estimated: whether the drone's estimates are judged.
    """
    steps, reason = rows.end(LOST, estimated)
    # The row in which it is lost does not count; the tilt that speed takes trips no guard here.
    end = int(steps) - (reason != TIME_LIMIT)
    distance = rows.excursion(estimated).position_error[:end]
    window = round(WINDOW_S * rate)
    if len(distance) < window:
        return 0
    means = np.convolve(distance, np.ones(window), "valid") / window
    far = means > WITHIN_M
    # The flight succeeded up to the first window that strayed.
    return int(np.argmax(far)) if far.any() else end


def _grades_reached(
    pilot: PolicyPilot | ForeignPilot,
    reality: VirtualDrone,
    condition: Condition,
    keys: Array,
    task: Task,
) -> list[float]:
    """Returns the grade up to which each flight stays within the distance."""
    success = np.ones((len(keys), len(condition.grades)), bool)
    own, flights = reality.parameters, range(len(keys))
    for index, grade in enumerate(condition.grades):
        drones = [condition.changed(own, grade, number) for number in flights]
        scenario = Scenario(task, DURATION_S, drones=drones, during=condition.during)
        simulated = fly_all(reality, pilot, scenario, keys, LOST)
        success[:, index] = [_succeeds(flight) for flight in simulated]
    return [
        condition.grades[int(np.argmin([*row, False])) - 1] if row[0] else float("nan")
        for row in success
    ]


def _succeeds(flight: SimulatedFlight) -> bool:
    return (
        flight.reason == TIME_LIMIT and float(np.mean(flight.excursion.position_error)) <= WITHIN_M
    )


def summary(flights: polars.DataFrame) -> polars.DataFrame:
    """Returns the envelope of each policy and reality along each axis, with a 95 % interval.

    Args:
        flights: rows of `envelope`.

    Returns:
        One row a policy, reality and axis: flights, envelope (what `SHARE` of the flights reach),
        low and high (percentiles of a bootstrap over flights), median, unit, hardest and limit.
        NaN: more than the other flights fly nothing at all.

    Source: Efron and Tibshirani 1993, An introduction to the bootstrap, sec. 13.3.
    """
    rows: list[dict[str, Any]] = []
    for (policy, reality, axis), part in flights.group_by(
        "policy", "reality", "axis", maintain_order=True
    ):
        reached = np.nan_to_num(part["reached"].to_numpy(), nan=-np.inf)
        generator = np.random.default_rng(0)
        again = [
            _reached_by_most(generator.choice(reached, len(reached))) for _ in range(_RESAMPLINGS)
        ]
        low, high = np.quantile(again, [0.025, 0.975], method="nearest")
        values = {
            "envelope": _reached_by_most(reached),
            "low": low,
            "high": high,
            "median": float(np.quantile(reached, 0.5, method="lower")),
        }
        rows.append(
            {"policy": policy, "reality": reality, "axis": axis, "flights": len(reached)}
            | {name: float(v) if np.isfinite(v) else float("nan") for name, v in values.items()}
            | {name: part[name][0] for name in ("unit", "hardest", "limit")}
        )
    return polars.DataFrame(rows)


def _reached_by_most(reached: Float[np.ndarray, "n"]) -> float:
    return float(np.sort(reached)[math.floor((1.0 - SHARE) * len(reached) + 1e-9)])
