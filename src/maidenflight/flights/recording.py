"""`record`: flights of the firmware's position PID in a reality, excited so that motors show."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from maidenflight import names
from maidenflight.errors import InputError
from maidenflight.flights import flying
from maidenflight.flights.flying import Pilot, Rows
from maidenflight.flights.log import Flight, thinned
from maidenflight.parameters import Parameters
from maidenflight.simulator import dynamics, mellinger, sensors, tasks
from maidenflight.simulator.battery import COUNTS, MOST_COUNTS, Supply, law_for
from maidenflight.simulator.control import Controller
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.firmware import LEAST_THRUST_COUNTS
from maidenflight.simulator.pid import POSITION_RATE
from maidenflight.simulator.position_pid import EXCITATION, position_pid
from maidenflight.simulator.reality import MOTORS, POSITION, AnyReality, Reality, checked
from maidenflight.simulator.tasks import Task
from maidenflight.simulator.trajectories import Trajectory
from maidenflight.simulator.virtual_drone import VirtualDrone

CONTROLLERS: dict[str, Callable[[Trajectory, str, float], Controller]] = dict(
    zip(
        names.CONTROLLERS,
        (lambda _, firmware, counts: position_pid(firmware, counts), mellinger.mellinger),
        strict=True,
    )
)
"""What flies: (reference, firmware, counts of full scale) to controllers of the firmware."""
RATE = EXCITATION.rate
"""Rows a second of a recorded flight, as of a Crazyflie's micro-SD card [Hz]: the PID's rate."""
DITHER_PERIODS = 23
"""Commands of 2 ms for which `dither` holds: no multiple of the rows of slower logs, in which it
would change at rows only."""


def dither(
    strength: Float[Array, ""], steps: int, key: Array
) -> Callable[[Float[Array, "20H"], Int[Array, ""]], Float[Array, "4"]]:
    """Excitation for a PID: each motor's command is raised or lowered by `strength`.

    The signs are drawn every 46 ms. A PID that follows a slow circle hardly moves its motors, and
    what it does answers disturbances that a replay of its commands cannot know. Excitation from
    outside the loop is what makes lag and latency visible.

    Args:
        strength: thrust command [-].
        steps: commands.
        key: random key.
    """
    drawn = signs(steps, key)
    return lambda observation, number: strength * drawn[number // DITHER_PERIODS]


@partial(jax.jit, static_argnums=0)
def signs(steps: int, key: Array) -> Float[Array, "K 4"]:
    """Signs of `dither` for so many commands."""
    return jax.random.rademacher(key, (steps // DITHER_PERIODS + 1, 4), dtype=jnp.float32)


@partial(jax.jit, static_argnums=(0, 3))
def _fly_pid(
    env: Environment,
    parameters: Parameters,
    keys: Int[Array, "F"],
    steps: int,
    strength: Float[Array, ""],
) -> Rows:
    def one(key: Array) -> Rows:
        dither_key, key = jax.random.split(key)
        return flying.fly(env, dither(strength, steps, dither_key), parameters, key, steps)

    return jax.vmap(one)(keys)


def record(
    reality: AnyReality,
    key: Array,
    flights: int = 4,
    duration: float = 30.0,
    excitation: float = 0.05,
    task: Task | None = None,
    rate: int = RATE,
    firmware: str = "2021.10",
    controller: str = "pid",
) -> Sequence[Flight]:
    """Lets a controller of the firmware fly a task in a reality and logs it.

    Virtual drones have an accelerometer where rows are close enough for one. A reality that takes
    positions flies its own controller instead, at 100 Hz.

    Args:
        reality: what is flown.
        key: random key.
        flights: how many.
        duration: of each [s].
        excitation: strength of `dither` [-]; 0 is the plain PID.
        task: the circle of the paper unless given.
        rate: rows a second [Hz], a divisor of 500. Below 500 the log is subsampled.
        firmware: `"2021.10"`, as the paper's flights had, or `"2026.08"`: its PID, its battery
            compensation, and u = 1 is full PWM in its logs.
        controller: a key of `CONTROLLERS`.

    Raises:
        InputError: another controller or rate, a reality that takes neither motor commands nor
            positions, or one that takes positions and an excitation above 0.
    """
    must_divide(rate)
    task, steps = task or tasks.circle(), round(duration * RATE)
    counts = MOST_COUNTS if firmware == "2026.08" else COUNTS
    if controller not in CONTROLLERS:
        raise InputError(f"controller = {controller!r}; expected one of {', '.join(CONTROLLERS)}.")
    pid = CONTROLLERS[controller](task.reference, firmware, counts)
    keys = jax.random.split(key, flights)
    if isinstance(reality := checked(reality), VirtualDrone):
        must_be_held(reality.name, float(dynamics.hover_command(reality.parameters)), counts)
        if reality.thrust_law is not None:
            reality = replace(reality, thrust_law=law_for(counts))
        env = reality.environment(task, pid)
        rows = _fly_pid(env, reality.parameters, keys, steps, jnp.float32(excitation))
        logged = [
            jax.tree.map(lambda values, n=number: values[n], rows) for number in range(flights)
        ]
        supply = env.supply
    else:
        if reality.takes == MOTORS:
            must_be_held(reality.name, reality.hover, counts)
        logged = [_fly_one(reality, task, one, steps, excitation, pid) for one in keys]
        supply = Supply(full_scale_counts=counts)
    return [
        flight_log(rows, reality, f"flight_{number:02d}", rate, supply, one)
        for number, (rows, one) in enumerate(zip(logged, keys, strict=True), 1)
    ]


def must_divide(rate: int) -> None:
    """Refuses rates of a log at which rows would not be commands.

    Raises:
        InputError: it is no divisor of `RATE`.
    """
    if rate < 1 or RATE % rate:
        raise InputError(f"rate = {rate} Hz; expected a divisor of {RATE}, such as 500, 250, 100.")


_ROOM = 0.05
"""Share of the thrust at hover by which the PID must be able to change it."""


def must_be_held(name: str, hover_command: float, full_scale_counts: float) -> None:
    """Refuses a drone that the Crazyflie's PID cannot hold at a height.

    Raises:
        InputError: it hovers at less thrust than the PID gives at least, or at more than there is.
    """
    hover = full_scale_counts * hover_command
    if not LEAST_THRUST_COUNTS < (1 - _ROOM) * hover < (1 + _ROOM) * hover < MOST_COUNTS:
        raise InputError(
            f"{name} hovers at {hover:.0f} counts of thrust; the Crazyflie's position PID, "
            f"which records flights, gives {LEAST_THRUST_COUNTS:.0f} to {MOST_COUNTS:.0f}. "
            "Identify it from logs of its own autopilot, or give a reality that flies its own "
            "position controller (docs/realities.md)."
        )


def flight_log(
    rows: Rows, reality: AnyReality, name: str, rate: int, supply: Supply, key: Array
) -> Flight:
    """The log of a flight: every row, or as many as a slower one holds."""
    made = RATE if getattr(reality, "takes", MOTORS) == MOTORS else POSITION_RATE
    flight = flying.to_flight(
        rows,
        name,
        zero_order_hold=made == RATE,
        supply=supply,
        simulated=reality.name,
        period=1 / made,
    )
    if isinstance(reality, VirtualDrone):
        seed = np.asarray(jax.random.bits(jax.random.fold_in(key, RATE), (2,))).tolist()
        force = sensors.accelerometer(
            np.asarray(rows.true_velocity, np.float64),
            np.asarray(rows.true_attitude, np.float64),
            flight.period,
            float(reality.parameters.gravity),
            np.random.default_rng(seed),
        )
        # True states are those at the ends of the periods, rows those at their beginnings.
        late = np.concatenate([force[:1], force[:-1]]).astype(np.float32)
        flight = replace(flight, accelerometer=late)
    return flight if rate >= made else thinned(flight, made // rate)


def _fly_one(
    reality: Reality, task: Task, key: Array, steps: int, excitation: float, pid: Controller
) -> Rows:
    """A flight of the PID, or of a reality's own position controller."""
    dither_key, key = jax.random.split(key)
    if reality.takes == MOTORS:
        drawn = np.asarray(signs(steps, dither_key))
        actions = iter(np.float32(excitation) * np.repeat(drawn, DITHER_PERIODS, axis=0))
        pilot = flying.cascade(pid, lambda *_: next(actions))
    elif reality.takes == POSITION and excitation == 0.0:
        steps = steps * POSITION_RATE // RATE
        pilot = Pilot(
            lambda _, setpoint: np.append(setpoint, 0.0), POSITION_RATE, POSITION_RATE, False
        )
    else:
        raise InputError(
            f"{reality.name} takes {reality.takes!r} with excitation = {excitation}; recording "
            f"needs a reality that takes {MOTORS!r}, or {POSITION!r} with excitation = 0."
        )
    return flying.fly_reality(reality, pilot, task, key, steps)
