"""Flights by a plan in a reality, as logs, and how far they went."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from maidenflight.errors import InputError
from maidenflight.flights import flying, recording
from maidenflight.flights.flight_plan import Extremes, FlightPlan
from maidenflight.flights.flying import Pilot, Rows
from maidenflight.flights.log import Flight
from maidenflight.flights.manoeuvres import RATE
from maidenflight.flights.recording import DITHER_PERIODS
from maidenflight.parameters import Parameters
from maidenflight.simulator import dynamics, tasks
from maidenflight.simulator.battery import COUNTS, MOST_COUNTS, Supply, law_for
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.mixing import Mixer, mixer_of
from maidenflight.simulator.pid import POSITION_RATE
from maidenflight.simulator.pid import checked as generation
from maidenflight.simulator.position_pid import position_pid, turning_pid
from maidenflight.simulator.reality import MOTORS, POSITION, AnyReality, Reality, checked
from maidenflight.simulator.virtual_drone import VirtualDrone

_EVERY = recording.RATE // RATE


def record(
    reality: AnyReality,
    plan: FlightPlan,
    key: Array,
    flights: int = 1,
    rate: int = recording.RATE,
    firmware: str = "2021.10",
) -> Sequence[Flight]:
    """Lets the firmware's position PID fly a plan in a reality and logs it.

    Args:
        reality: what is flown; see `recording.record`.
        plan: what to fly.
        key: random key.
        flights: how often.
        rate: rows a second [Hz], a divisor of 500.
        firmware: see `recording.record`.

    Raises:
        InputError: another rate, a reality that cannot fly it, or a drone that the PID cannot hold.
    """
    recording.must_divide(rate)
    counts = MOST_COUNTS if generation(firmware) == "2026.08" else COUNTS
    keys = jax.random.split(key, flights)
    if isinstance(reality := checked(reality), VirtualDrone):
        rows, supply = fly(reality, [plan] * flights, keys, firmware)
    else:
        rows = [_fly_one(reality, plan, one, firmware, counts) for one in keys]
        supply = Supply(full_scale_counts=counts)
    return [
        recording.flight_log(one, reality, f"flight_{number:02d}", rate, supply, of)
        for number, (one, of) in enumerate(zip(rows, keys, strict=True), 1)
    ]


def fly(
    drone: VirtualDrone, plans: Sequence[FlightPlan], keys: Int[Array, "F"], firmware: str
) -> tuple[list[Rows], Supply]:
    """Flies plans of one length on a virtual drone, all at once.

    Returns:
        What is logged of each, and the drone's supply.

    Raises:
        InputError: the PID cannot hold the drone.
    """
    counts = MOST_COUNTS if generation(firmware) == "2026.08" else COUNTS
    hover = float(dynamics.hover_command(drone.parameters))
    recording.must_be_held(drone.name, hover, counts)
    if drone.thrust_law is not None:
        drone = replace(drone, thrust_law=law_for(counts))
    env = drone.environment(tasks.hover(), position_pid(firmware, counts))
    places = np.stack([plan.setpoints() for plan in plans]).astype(np.float32)
    strengths = np.stack([plan.excitation() for plan in plans]).astype(np.float32)
    rows = _fly(
        env, firmware, counts, mixer_of(drone.parameters), drone.parameters, keys, places, strengths
    )
    rows = jax.tree.map(np.asarray, rows)
    return [
        jax.tree.map(lambda values, n=n: values[n], rows) for n in range(len(plans))
    ], env.supply


@partial(jax.jit, static_argnums=(0, 1, 2, 3))
def _fly(
    env: Environment,
    firmware: str,
    counts: float,
    mixer: Mixer | None,
    drone: Parameters,
    keys: Int[Array, "F"],
    places: Float[Array, "F N 4"],
    strengths: Float[Array, "F N"],
) -> Rows:
    steps = places.shape[1] * _EVERY

    def one(key: Array, table: Float[Array, "N 4"], strength: Float[Array, "N"]) -> Rows:
        last = table.shape[0] - 1

        def reference(time: Float[Array, ""]) -> Float[Array, "3"]:
            return table[jnp.clip(jnp.floor(time * RATE + 0.01).astype(int), 0, last), :3]

        def heading(number: Int[Array, ""]) -> Float[Array, ""]:
            return table[jnp.clip(number // _EVERY, 0, last), 3]

        flown = replace(
            env,
            task=env.task._replace(reference=reference),
            controller=turning_pid(heading, firmware, counts, mixer),
        )
        sign_key, key = jax.random.split(key)
        signs = recording.signs(steps, sign_key)

        def act(_: Float[Array, "20H"], number: Int[Array, ""]) -> Float[Array, "4"]:
            return strength[number // _EVERY] * signs[number // DITHER_PERIODS]

        return flying.fly(flown, act, drone, key, steps)

    return jax.vmap(one)(keys, places, strengths)


def _fly_one(reality: Reality, plan: FlightPlan, key: Array, firmware: str, counts: float) -> Rows:
    """A flight of the PID, or of a reality's own position controller."""
    sign_key, key = jax.random.split(key)
    table, strength = plan.setpoints().astype(np.float32), plan.excitation()
    last = len(table) - 1
    shown = jnp.asarray(table)

    def reference(time: Float[Array, ""]) -> Float[Array, "3"]:
        return shown[jnp.clip(jnp.floor(time * RATE + 0.01).astype(int), 0, last), :3]

    task = tasks.hover()._replace(reference=reference)
    if reality.takes == MOTORS:
        steps = len(table) * _EVERY
        signs = np.asarray(recording.signs(steps, sign_key))
        added = np.repeat(signs, DITHER_PERIODS, axis=0)[:steps]
        actions = iter((np.repeat(strength, _EVERY)[:, None] * added).astype(np.float32))
        pid = turning_pid(
            lambda number: shown[jnp.clip(number // _EVERY, 0, last), 3], firmware, counts
        )
        return flying.fly_reality(
            reality, flying.cascade(pid, lambda *_: next(actions)), task, key, steps
        )
    if reality.takes == POSITION and plan.by_setpoints:
        yaws = iter(table[:, 3])
        pilot = Pilot(
            lambda _, setpoint: np.append(setpoint, next(yaws)), POSITION_RATE, POSITION_RATE, False
        )
        return flying.fly_reality(reality, pilot, task, key, len(table))
    raise InputError(
        f"{reality.name} takes {reality.takes!r}; a plan needs a reality that takes {MOTORS!r}, or "
        f"{POSITION!r} without excitation of the motors. Plan without --motors, or fly another."
    )


def extremes(rows: Rows) -> Extremes:
    """How far a flight went."""
    true = np.asarray(rows.true_position, float)
    away = np.asarray(rows.true_setpoint, float) - true
    upright = np.cos(rows.true_attitude[:, 0]) * np.cos(rows.true_attitude[:, 1])
    command = np.asarray(rows.ratio)
    return Extremes(
        lateral_x=_largest(np.abs(true[:, 0])),
        lateral_y=_largest(np.abs(true[:, 1])),
        lowest=-_largest(-true[:, 2]),
        highest=_largest(true[:, 2]),
        tilt=_largest(np.arccos(np.clip(upright, -1.0, 1.0))),
        speed=_largest(np.linalg.norm(rows.true_velocity, axis=1)),
        astray=_largest(np.linalg.norm(away, axis=1)),
        sunk=_largest(away[:, 2]),
        at_limits=float(np.mean((command <= 0.0) | (command >= 1.0))),
    )


def _largest(values: Float[np.ndarray, "N"]) -> float:
    """The largest; a large number where a flight left the numbers."""
    worst = float(np.max(values)) if np.isfinite(values).all() else 1e6
    return min(worst, 1e6)


def worst(found: Sequence[Extremes]) -> Extremes:
    """The extremes of several flights together."""
    rows = np.array([[getattr(one, name) for name in _NAMES] for one in found])
    lows = {"lowest": rows[:, _NAMES.index("lowest")].min()}
    highs = dict(zip(_NAMES, rows.max(axis=0), strict=True))
    return Extremes(**{name: float(value) for name, value in (highs | lows).items()})


_NAMES = list(Extremes.__dataclass_fields__)
