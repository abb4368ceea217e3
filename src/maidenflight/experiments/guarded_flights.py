"""Flights of many policies at once until a guard trips, spread over devices by one program.

The guard reads the estimates 100 times a second, between two actions too.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array, Bool, Float, Int, UInt

from maidenflight.experiments.transfer import MAX_BODY_RATE_RAD_S, MAX_TILT_RAD
from maidenflight.parameters import Parameters
from maidenflight.policy import Policy
from maidenflight.simulator import (
    actuators,
    dynamics,
    environment,
    failures,
    rotations,
    stepping,
    vectors,
)
from maidenflight.simulator.balance import balanced
from maidenflight.simulator.environment import Environment, EnvState
from maidenflight.simulator.policy_spec import OBSERVATION_SIZE


class Start(NamedTuple):
    """Standard deviations of the state in which the policy takes over.

    It is normal about hover at the reference's start. The numbers are those of the first rows of
    216 published flights (1.4826 times the median deviation from the median).
    """

    position: Float[Array, "3"]
    """[m]."""
    velocity: Float[Array, "3"]
    """[m/s]."""
    attitude: Float[Array, "3"]
    """[rad]."""
    body_rates: Float[Array, "3"]
    """[rad/s]."""
    homeward: Float[Array, ""]
    """Minus the correlation of horizontal position and velocity: the PID that hands over moves
    towards the start."""


def _start(*numbers: tuple[float, ...] | float) -> Start:
    return Start(*(np.array(number, np.float32) for number in numbers))  # type: ignore[arg-type]


PUBLISHED_START = _start(
    (0.029, 0.023, 0.010), (0.044, 0.043, 0.018), (0.015, 0.014, 0.011), (0.135, 0.145, 0.035), 0.77
)


class Flights(NamedTuple):
    """How flights ended."""

    steps: Int[Array, "policies lanes"]
    """Rows of 10 ms flown."""
    reason: Int[Array, "policies lanes"]
    """Index of `END_REASONS`; 0 while it flies."""


POLICIES = "policies"
"""The axis along which devices share the policies."""


def mesh() -> Mesh:
    """All devices, in a row."""
    return Mesh(np.array(jax.local_devices()), (POLICIES,))


@jax.jit
def draw(
    key: Array,
    own: UInt[Array, "policies"],
    trials: UInt[Array, "policies lanes"],
    count: Int[Array, ""],
) -> tuple[Int[Array, "policies lanes"], Array]:
    """Which of `count` drones each trial flies, and its key.

    Neither depends on the other trials or policies.
    """

    def one(own: Array, trial: Array) -> tuple[Array, Array]:
        drone_key, flight_key = jax.random.split(
            jax.random.fold_in(jax.random.fold_in(key, own), trial)
        )
        return jax.random.randint(drone_key, (), 0, count), flight_key

    return jax.vmap(jax.vmap(one, in_axes=(None, 0)))(own, trials)


@partial(jax.jit, static_argnums=(0, 1))
def fly_together(
    env: Environment,
    every: int,
    policies: Policy,
    drones: Parameters,
    keys: Array,
    wanted: Bool[Array, "policies lanes"],
    rows: Int[Array, ""],
    farthest: Float[Array, ""],
    start: Start,
) -> Flights:
    """Flies until the last flight has ended, on each device for itself.

    Args:
        env: what is simulated; its actions are held for a row of 10 ms.
        every: rows from one action of the policies to the next.
        policies: of one kind, stacked along a first axis.
        drones: what each trial of each policy flies.
        keys: of each trial.
        wanted: whether a trial is flown at all; the others end at once.
        rows: longest flight.
        farthest: distance from the set-point at which a flight ends [m].
        start: spread of first states.
    """

    def take_over(policy: Policy, drone: Parameters, key: Array) -> tuple[EnvState, Array]:
        start_key, begin_key = jax.random.split(jax.random.fold_in(key, 0))
        state = _first_state(env, drone, start, start_key)
        env_state = _after_hover(
            env, environment.begin(env, state, jnp.zeros(()), drone, begin_key), drone
        )
        return env_state, jnp.broadcast_to(
            env_state.history[-1], (policy.spec.history, OBSERVATION_SIZE)
        )

    def fly(
        policies: Policy,
        drones: Parameters,
        keys: Array,
        wanted: Array,
        rows: Array,
        farthest: Array,
    ) -> Flights:
        def decide(now: tuple[Array, Any, Flights]) -> tuple[Array, Any, Flights]:
            row, before, flights = now
            act = partial(_until_next_action, env, every, rows, farthest, row)
            after, reasons = jax.vmap(jax.vmap(act, in_axes=(None, 0, 0, 0)))(
                policies, drones, keys, before
            )
            first = jnp.argmax(reasons > 0, axis=-1)
            reason = jnp.take_along_axis(reasons, first[..., None], axis=-1)[..., 0]
            over = flights.reason > 0
            flown = Flights(
                jnp.where(over, flights.steps, row + first + 1),
                jnp.where(over, flights.reason, reason),
            )
            return row + every, after, flown

        begun = jax.vmap(jax.vmap(take_over, in_axes=(None, 0, 0)))(policies, drones, keys)
        flights = Flights(
            jnp.zeros(wanted.shape, jnp.int32), jnp.where(wanted, 0, failures.TIME_LIMIT)
        )
        return lax.while_loop(
            lambda now: jnp.any(now[-1].reason == 0),
            decide,
            (jnp.zeros((), jnp.int32), begun, flights),
        )[-1]

    laid, everywhere = PartitionSpec(POLICIES), PartitionSpec()
    shared = jax.shard_map(
        fly,
        mesh=mesh(),
        in_specs=(*[laid] * 4, *[everywhere] * 2),
        out_specs=laid,
        check_vma=False,
    )
    return shared(policies, drones, keys, wanted, rows, farthest)


def _first_state(env: Environment, drone: Parameters, start: Start, key: Array) -> dynamics.State:
    """Hover at the reference's start, and a draw of how far from it the policy takes over."""
    normal = jax.random.normal(key, (4, 3))
    hover = dynamics.at_hover(env.task.reference(jnp.zeros(())), drone)
    side = start.homeward * jnp.array([1.0, 1.0, 0.0])
    return hover._replace(
        position=hover.position + start.position * normal[0],
        velocity=start.velocity * (jnp.sqrt(1.0 - side * side) * normal[1] - side * normal[0]),
        quaternion=rotations.from_attitude(start.attitude * normal[2]),
        body_rates=start.body_rates * normal[3],
    )


def _after_hover(env: Environment, env_state: EnvState, drone: Parameters) -> EnvState:
    """The beginning of a flight before which the firmware has hovered the drone.

    Its rotors balance the constant torques, and so do the integrals of PIDs that go on: in the
    published flights the yaw command of the first rows is that of the rest (docs/studies/
    flight-times.md).
    """
    hovers = balanced(drone)
    command = actuators.rotor_speed_command(hovers)
    taking_over = env.controller.taking_over
    return env_state._replace(
        state=env_state.state._replace(rotor_speed=command),
        delay_line=jnp.broadcast_to(command, env_state.delay_line.shape),
        controller=env_state.controller
        if taking_over is None
        else taking_over(hovers, env_state.measurement),
    )


def _until_next_action(
    env: Environment,
    every: int,
    rows: Int[Array, ""],
    farthest: Float[Array, ""],
    row: Int[Array, ""],
    policy: Policy,
    drone: Parameters,
    key: Array,
    before: tuple[EnvState, Float[Array, "H 20"]],
) -> tuple[tuple[EnvState, Float[Array, "H 20"]], Int[Array, "every"]]:
    """Drone and history one action, `every` rows of 10 ms, later.

    Also, after each row, why the flight would end.
    """
    env_state, history = before
    seen = environment.observation(env, env_state._replace(history=history))
    action = policy(seen)

    def hold(env_state: EnvState, row: Array) -> tuple[EnvState, Array]:
        after, step_result = stepping.step(
            env, env_state, action, drone, jax.random.fold_in(key, row)
        )
        reason = guard(after, step_result.setpoint, farthest)
        return after, jnp.where((reason == 0) & (row >= rows), failures.TIME_LIMIT, reason)

    env_state, reasons = lax.scan(hold, env_state, row + jnp.arange(1, every + 1))
    instant = environment.observe(
        env_state.measurement, env.task.reference(env_state.time), env_state.action
    )
    return (env_state, jnp.concatenate([history[1:], instant[None]])), reasons


def guard(
    env_state: EnvState, setpoint: Float[Array, "3"], farthest: Float[Array, ""]
) -> Int[Array, ""]:
    """Why the drone's guards would stop the policy now, by its measurements.

    An index of `END_REASONS`; 0: they would not.

    Args:
        env_state: the drone.
        setpoint: [m].
        farthest: distance from it [m].

    Source: Gronauer et al. 2022, sec. Zero-Shot Experiments; the ground and the distance are ours.
    """
    seen = env_state.measurement
    tilt, rates = jnp.abs(rotations.to_attitude(seen.quaternion)[:2]), jnp.abs(seen.body_rates[:2])
    distance = vectors.norm(setpoint - seen.position)
    return failures.reason(
        not_finite=~jnp.isfinite(distance + tilt[0] + tilt[1] + rates[0] + rates[1]),
        body_rate=jnp.maximum(rates[0], rates[1]) > np.float32(MAX_BODY_RATE_RAD_S),
        tilt=jnp.maximum(tilt[0], tilt[1]) > np.float32(MAX_TILT_RAD),
        position_error=distance > farthest,
        height=env_state.state.position[2] < 0.0,
    )
