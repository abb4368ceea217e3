"""Simulated flights of many control periods, as logs: of our drones in JAX, or of any `Reality`.

`fly` is a pure function of one drone, of which `jax.vmap` makes many. `fly_reality` flies a
stateful reality, one command at a time, from the same starts.
"""

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from maidenflight.errors import InputError
from maidenflight.flights.log import Flight
from maidenflight.parameters import Parameters
from maidenflight.simulator import battery, dynamics, environment, rotations, stepping
from maidenflight.simulator.battery import Supply
from maidenflight.simulator.control import Controller
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.reality import MOTORS, Reality, Truth
from maidenflight.simulator.sensors import Measurement
from maidenflight.simulator.tasks import Task

Act = Callable[[Measurement, Float[np.ndarray, "3"]], Float[ArrayLike, "4"]]
"""(measurement, set-point [m]) to four numbers, once a period; it may keep a state."""


Change = Callable[[Parameters, Float[Array, ""]], Parameters]
"""(drone, time since the flight began [s]) to the drone as it is then."""


class Rows(NamedTuple):
    """What is logged of N control periods: the rows of `Flight`, and the true state."""

    position: Float[Array, "N 3"]
    velocity: Float[Array, "N 3"]
    attitude: Float[Array, "N 3"]
    body_rates: Float[Array, "N 3"]
    ratio: Float[Array, "N 4"]
    """Motor ratio; the thrust command where no battery is simulated. That of the row's own period
    where a command holds for it, else that in force when the row was measured."""
    battery: Float[Array, "N"]
    setpoint: Float[Array, "N 3"]
    true_position: Float[Array, "N 3"]
    """At the end of the period [m]."""
    true_setpoint: Float[Array, "N 3"]
    """At the end of the period [m]."""
    true_attitude: Float[Array, "N 3"]
    true_body_rates: Float[Array, "N 3"]
    true_velocity: Float[Array, "N 3"]
    """At the end of the period [m/s]; NaN where a reality does not tell."""


def fly(
    env: Environment,
    act: Callable[[Float[Array, "20H"], Int[Array, ""]], Float[Array, "4"]],
    parameters: Parameters,
    key: Array,
    steps: int,
    start: Float[Array, ""] | float = 0.0,
    during: Change | None = None,
) -> Rows:
    """Flies from hover near the reference's start and logs every control period.

    A failed flight goes on; the caller decides where it ended.

    Args:
        env: what is simulated.
        act: (observation, number of the control period) to action.
        parameters: the drone.
        key: random key.
        steps: control periods, static.
        start: the reference's clock at the start [s].
        during: what changes of the drone in the course of the flight; nothing unless given.
    """
    offset, begin_key, key = _start(key)
    state = dynamics.at_hover(env.task.reference(jnp.asarray(start)) + offset, parameters)
    first = environment.begin(env, state, jnp.asarray(start), parameters, begin_key)

    def one(
        env_state: environment.EnvState, now: tuple[Array, Array]
    ) -> tuple[environment.EnvState, Rows]:
        number, key = now
        drone = parameters if during is None else during(parameters, env_state.elapsed)
        after, step_result = stepping.step(
            env, env_state, act(environment.observation(env, env_state), number), drone, key
        )
        seen = env_state.measurement
        motors = after.actuators if env.commands_per_action == 1 else env_state.actuators
        return after, Rows(
            position=seen.position,
            velocity=seen.velocity,
            attitude=rotations.to_attitude(seen.quaternion),
            body_rates=seen.body_rates,
            ratio=motors.ratio,
            battery=motors.voltage,
            setpoint=env.task.reference(env_state.time),
            true_position=after.state.position,
            true_setpoint=step_result.setpoint,
            true_attitude=rotations.to_attitude(after.state.quaternion),
            true_body_rates=after.state.body_rates,
            true_velocity=after.state.velocity,
        )

    return jax.lax.scan(one, first, (jnp.arange(steps), jax.random.split(key, steps)))[1]


def _start(key: Array) -> tuple[Float[Array, "3"], Array, Array]:
    """Offset of the start from the reference [m]; keys of the first measurement and the rest."""
    place_key, begin_key, key = jax.random.split(key, 3)
    offset = 0.02 * jax.random.uniform(place_key, (3,), minval=-1.0, maxval=1.0)
    return offset, begin_key, key


class Pilot(NamedTuple):
    """What flies a reality."""

    command: Act
    """The reality's next command."""
    command_rate: int
    """Commands a second [Hz]."""
    rate: int
    """Set-points, and rows of the log, a second [Hz]."""
    zero_order_hold: bool
    """Whether a motor command holds for the whole period between two rows."""


def cascade(controller: Controller, act: Act) -> Pilot:
    """A pilot of the motors: actions, and the commands that a controller makes of them.

    Args:
        controller: the control structure; its memory is kept here, so a pilot flies once.
        act: measurement and set-point to action, called at the rate of the controller's interface.
    """
    compiled, every = _compiled(controller), controller.command_rate // controller.interface.rate
    memory, action, calls = controller.init(), np.zeros(4, np.float32), 0

    def command(
        measurement: Measurement, setpoint: Float[np.ndarray, "3"]
    ) -> Float[np.ndarray, "4"]:
        nonlocal memory, action, calls
        if calls % every == 0:
            action = np.asarray(act(measurement, setpoint), np.float32)
        calls += 1
        memory, motors = compiled(memory, action, measurement, setpoint)
        return np.asarray(motors)

    return Pilot(
        command, controller.command_rate, controller.interface.rate, zero_order_hold=every == 1
    )


@cache
def _compiled(controller: Controller) -> Any:
    return jax.jit(controller.command)


def fly_reality(
    reality: Reality,
    pilot: Pilot,
    task: Task,
    key: Array,
    steps: int,
    ended: Callable[[Truth, Float[np.ndarray, "3"]], bool] = lambda truth, setpoint: False,
) -> Rows:
    """Flies a reality one command at a time, and logs as `fly` does with the same key.

    Args:
        reality: what is flown; it is reset first.
        pilot: what flies it.
        task: whose reference is followed.
        key: random key.
        steps: periods of the pilot, at most.
        ended: (true state, set-point [m]) at the end of a period to whether the flight ends there.

    Raises:
        InputError: the reality's rate is no multiple of that of the pilot's commands, or what it
            returns has wrong shapes.
    """
    if reality.rate % pilot.command_rate:
        raise InputError(
            f"{reality.name}: rate = {reality.rate} Hz, expected a multiple of the "
            f"{pilot.command_rate} Hz at which it is commanded."
        )
    commands = pilot.command_rate // pilot.rate
    setpoints, offset, seed = map(np.asarray, _plan(task, pilot.rate, steps, key))
    reality.reset((setpoints[0] + offset).astype(np.float64), int(seed))
    rows: list[tuple[Measurement, Float[np.ndarray, 4], Truth]] = []
    for setpoint, following in zip(setpoints[:-1], setpoints[1:], strict=True):
        before, seen = _truth(reality), _measurement(reality)
        for number in range(commands):
            measurement = _measurement(reality) if number else seen
            command = np.asarray(pilot.command(measurement, setpoint), np.float64)
            if reality.takes == MOTORS:
                command = np.minimum(command, 1.0)
            for _ in range(reality.rate // pilot.command_rate):
                reality.step(command)
        after = _truth(reality)
        rows.append((seen, (after if pilot.zero_order_hold else before).command, after))
        if ended(after, following):
            break
    return _stacked(rows, setpoints)


@partial(jax.jit, static_argnums=(0, 1, 2))
def _plan(
    task: Task, rate: int, steps: int, key: Array
) -> tuple[Float[Array, "steps+1 3"], Float[Array, "3"], Array]:
    """Set-points at the ends of the periods, offset of the start from the first, and a seed."""
    times = jnp.arange(steps + 1, dtype=jnp.float32) / rate
    offset, begin_key, _ = _start(key)
    return jax.vmap(task.reference)(times), offset, jax.random.bits(begin_key, dtype=jnp.uint32)


def _stacked(
    rows: Sequence[tuple[Measurement, Float[np.ndarray, "4"], Truth]],
    setpoints: Float[np.ndarray, "M 3"],
) -> Rows:
    seen, commands, true = (
        jax.tree.map(lambda *parts: np.stack(parts), *column) for column in zip(*rows, strict=True)
    )
    fields: dict[str, Any] = {
        "position": seen.position,
        "velocity": seen.velocity,
        "attitude": np.asarray(_attitudes(seen.quaternion)),
        "body_rates": seen.body_rates,
        "ratio": commands,
        "battery": np.full(len(rows), np.nan, np.float32),
        "setpoint": setpoints[: len(rows)],
        "true_position": true.position,
        "true_setpoint": setpoints[1 : len(rows) + 1],
        "true_attitude": np.asarray(_attitudes(true.quaternion)),
        "true_body_rates": true.body_rates,
        "true_velocity": np.full((len(rows), 3), np.nan, np.float32),
    }
    return Rows(**fields)


_attitudes = jax.jit(jax.vmap(rotations.to_attitude))


def _measurement(reality: Reality) -> Measurement:
    parts: Any = _arrays(reality, "observe", reality.observe(), (3, 3, 4, 3))
    return Measurement(*parts)


def _truth(reality: Reality) -> Truth:
    return Truth(*_arrays(reality, "truth", reality.truth(), (3, 4, 3, 4)))


def _arrays(reality: Reality, name: str, parts: Any, sizes: Sequence[int]) -> list[np.ndarray]:
    """What a reality returned, as float32 vectors of these sizes."""
    try:
        arrays = [np.asarray(part, np.float32) for part in parts]
    except (TypeError, ValueError) as error:
        raise InputError(f"{reality.name}: {name}() gives {parts!r:.80}; {error}.") from error
    shapes = [array.shape for array in arrays]
    if shapes != [(size,) for size in sizes]:
        raise InputError(
            f"{reality.name}: {name}() gives arrays of shapes {shapes}, expected "
            f"{[(size,) for size in sizes]}."
        )
    return arrays


def to_flight(
    rows: Rows,
    name: str,
    *,
    zero_order_hold: bool,
    supply: Supply,
    simulated: str,
    period: float = 0.01,
) -> Flight:
    """A flight log of logged rows.

    The command is computed from the motor ratio by the law of `supply`, as for a real log.
    """
    logged: dict[str, np.ndarray] = {
        field: np.asarray(values) for field, values in rows._asdict().items()
    }
    command = battery.thrust_command(logged["ratio"], logged["battery"][:, None], supply)
    return Flight(
        name=name,
        period=period,
        position=logged["position"],
        velocity=logged["velocity"],
        attitude=logged["attitude"],
        body_rates=logged["body_rates"],
        command=np.asarray(command),
        full_scale_counts=supply.full_scale_counts,
        battery=logged["battery"],
        setpoint=logged["setpoint"],
        zero_order_hold=zero_order_hold,
        simulated=simulated,
        true_position=_at_rows(logged["true_position"], logged["true_velocity"], period),
    )


def _at_rows(
    position: Float[np.ndarray, "N 3"], velocity: Float[np.ndarray, "N 3"], period: float
) -> Float[np.ndarray, "N 3"]:
    """True positions when the rows were measured, at the end of the period before."""
    first = position[:1] - period * np.nan_to_num(velocity[:1])
    return np.concatenate([first, position[:-1]]).astype(np.float32)
