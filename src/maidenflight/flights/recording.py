"""Recording flights on a virtual drone: the firmware's position PID, or a policy, flies.

The sensors' signals are logged.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from maidenflight.flights.log import Flight
from maidenflight.parameters import Parameters
from maidenflight.simulator import battery, control, dynamics, environment, rotations, tasks
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.tasks import Task
from maidenflight.simulator.virtual_drone import VirtualDrone


class Rows(NamedTuple):
    """What is logged of N control periods; the rows of `Flight`, and the truth that no log has."""

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


def fly(
    env: Environment,
    act: Callable[[Float[Array, "20H"], Int[Array, ""]], Float[Array, "4"]],
    parameters: Parameters,
    key: Array,
    steps: int,
    start: Float[Array, ""] | float = 0.0,
) -> Rows:
    """Flies from hover at the reference's start and logs every control period.

    A failed flight goes on; who reads the rows decides where it ended.

    Args:
        env: what is simulated.
        act: (observation, number of the control period) to action.
        parameters: the drone.
        key: random key.
        steps: control periods, static.
        start: the reference's clock at the start [s].
    """
    place_key, begin_key, key = jax.random.split(key, 3)
    offset = 0.02 * jax.random.uniform(place_key, (3,), minval=-1.0, maxval=1.0)
    state = dynamics.at_hover(env.task.reference(jnp.asarray(start)) + offset, parameters)
    first = environment.begin(env, state, jnp.asarray(start), parameters, begin_key)

    def one(
        env_state: environment.EnvState, now: tuple[Array, Array]
    ) -> tuple[environment.EnvState, Rows]:
        number, key = now
        after, step_result = environment.step(
            env, env_state, act(environment.observation(env_state), number), parameters, key
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
        )

    return jax.lax.scan(one, first, (jnp.arange(steps), jax.random.split(key, steps)))[1]


def dither(
    strength: Float[Array, ""], steps: int, key: Array
) -> Callable[[Float[Array, "20H"], Int[Array, ""]], Float[Array, "4"]]:
    """Excitation for a PID: each motor's command is raised or lowered by `strength`, anew every 50
    ms.

    A PID that only follows a slow circle hardly moves its motors, and what it does answers the very
    disturbances that a replay of its commands cannot know. Excitation from outside the loop is what
    makes lag and latency visible.

    Args:
        strength: thrust command [-].
        steps: control periods.
        key: random key.
    """
    signs = jax.random.rademacher(key, (steps // 5 + 1, 4), dtype=jnp.float32)
    return lambda observation, number: strength * signs[number // 5]


def to_flight(
    rows: Rows, name: str, *, held: bool, has_battery: bool, simulated: str, period: float = 0.01
) -> Flight:
    """A flight log of logged rows.

    The command is read back from the motor ratio, as from a real log.
    """
    logged: dict[str, np.ndarray] = {
        field: np.asarray(values) for field, values in rows._asdict().items()
    }
    command = logged["ratio"]
    if has_battery:
        command = np.asarray(battery.thrust_command(command, logged["battery"][:, None]))
    return Flight(
        name=name,
        period=period,
        position=logged["position"],
        velocity=logged["velocity"],
        attitude=logged["attitude"],
        body_rates=logged["body_rates"],
        command=command,
        battery=logged["battery"],
        setpoint=logged["setpoint"],
        held=held,
        simulated=simulated,
    )


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
        return fly(env, dither(strength, steps, dither_key), parameters, key, steps)

    return jax.vmap(one)(keys)


def record(
    drone: VirtualDrone,
    key: Array,
    flights: int = 4,
    duration: float = 30.0,
    excitation: float = 0.05,
    task: Task | None = None,
) -> Sequence[Flight]:
    """Lets the firmware's position PID fly a task on a virtual drone and logs it at 100 Hz.

    Args:
        drone: the reality.
        key: random key.
        flights: how many.
        duration: of each [s].
        excitation: strength of `dither` [-]; 0 is the plain PID.
        task: the circle of the paper unless given.
    """
    env = drone.environment(task or tasks.circle(), control.position_pid())
    rows = _fly_pid(
        env,
        drone.parameters,
        jax.random.split(key, flights),
        round(duration * 100),
        jnp.float32(excitation),
    )
    return [
        to_flight(
            jax.tree.map(lambda values, number=number: values[number], rows),
            f"flight_{number + 1:02d}",
            held=False,
            has_battery=env.battery,
            simulated=drone.name,
        )
        for number in range(flights)
    ]
