"""Flights of many policies at once until a guard trips, spread over devices by one program.

The guard reads the estimates 100 times a second, between two actions too. Beside the engine's
`simulate` this is a loop of its own: it keeps no rows, and ends with the last flight.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array, Bool, Float, Int, UInt

from maidenflight.flying.scenario import Start, after_hover
from maidenflight.parameters import Parameters
from maidenflight.policy import Policy
from maidenflight.simulator import environment, stepping
from maidenflight.simulator.environment import Environment, EnvState
from maidenflight.simulator.physics import rotations, vectors
from maidenflight.simulator.policy_spec import OBSERVATION_SIZE
from maidenflight.simulator.tasks import failures
from maidenflight.simulator.tasks.failures import End, Excursion, Guard


class Trials(NamedTuple):
    """Trials of policies of one kind."""

    policies: Policy
    """Stacked along a first axis."""
    drones: Parameters
    """What each trial of each policy flies."""
    keys: Array
    """Of each trial."""
    included: Bool[Any, "policies lanes"]
    """Whether a trial is simulated; the others end at once."""


class Limits(NamedTuple):
    """Of a flight."""

    rows: Int[Array, ""]
    """Longest flight."""
    guard: Guard
    """At which it ends."""


class FlightOutcome(NamedTuple):
    """How flights went up to their ends."""

    end: End
    largest: Excursion
    """The largest of each of its parts, by the estimates that guards look at."""
    distance: Float[Any, "..."]
    """Sum over rows of the distance from the set-point, of the true position [m]."""
    distance_by_estimate: Float[Any, "..."]
    """The same by the estimates [m]."""


POLICIES = "policies"
"""The axis along which devices share the policies."""


def mesh() -> Mesh:
    """Returns all devices, in a row."""
    return Mesh(np.array(jax.local_devices()), (POLICIES,))


@jax.jit
def draw(
    key: Array,
    own: UInt[Array, "policies"],
    trials: UInt[Array, "policies lanes"],
    count: Int[Array, ""],
) -> tuple[Int[Array, "policies lanes"], Array]:
    """Draws one of `count` drones for each trial, and its key, by itself."""

    def draw_trial(own: Array, trial: Array) -> tuple[Array, Array]:
        drone_key, flight_key = jax.random.split(
            jax.random.fold_in(jax.random.fold_in(key, own), trial)
        )
        return jax.random.randint(drone_key, (), 0, count), flight_key

    return jax.vmap(jax.vmap(draw_trial, in_axes=(None, 0)))(own, trials)


@partial(jax.jit, static_argnums=(0, 1))
def fly_together(
    env: Environment,
    every: int,
    trials: Trials,
    limits: Limits,
    start: Start,
) -> FlightOutcome:
    """Flies until the last flight has ended, on each device for itself.

    Args:
        env: what is simulated; its actions last for a row of 10 ms.
        every: rows from one action of the policies to the next.
        trials: drones and initial states to simulate.
        limits: of each flight.
        start: spread of first states.
    """

    def take_over(policy: Policy, drone: Parameters, key: Array) -> tuple[EnvState, Array]:
        start_key, begin_key = jax.random.split(jax.random.fold_in(key, 0))
        state = start.draw(env, drone, start_key)
        first_state = environment.begin(env, state, jnp.zeros(()), drone, begin_key)
        env_state = after_hover(env, first_state, drone)
        return env_state, jnp.broadcast_to(
            env_state.history[-1], (policy.spec.history, OBSERVATION_SIZE)
        )

    def fly(trials: Trials, limits: Limits) -> FlightOutcome:
        policies, drones, keys, included = trials

        def decide(now: tuple[Array, Any, FlightOutcome]) -> tuple[Array, Any, FlightOutcome]:
            row, before, flights = now
            act = partial(_until_next_action, env, every, limits, row)
            after, (reasons, excursions, true) = jax.vmap(jax.vmap(act, in_axes=(None, 0, 0, 0)))(
                policies, drones, keys, before
            )
            first = jnp.argmax(reasons > 0, axis=-1)
            reason = jnp.take_along_axis(reasons, first[..., None], axis=-1)[..., 0]
            over = flights.end.reason > 0
            end = End(
                jnp.where(over, flights.end.steps, row + first + 1),
                jnp.where(over, flights.end.reason, reason),
            )
            # Rows up to the end count, with the one that a guard ends.
            last = jnp.where(reason > 0, first, every - 1)
            counts = ~over[..., None] & (jnp.arange(every)[None, None] <= last[..., None])
            rows, true = jax.tree.map(
                lambda values: jnp.where(counts, values, 0.0), (excursions, true)
            )
            largest = jax.tree.map(
                lambda old, new: jnp.maximum(old, jnp.max(new, axis=-1)), flights.largest, rows
            )
            distances = (
                flights.distance + jnp.sum(true, axis=-1),
                flights.distance_by_estimate + jnp.sum(rows.position_error, axis=-1),
            )
            return row + every, after, FlightOutcome(end, largest, *distances)

        begun = jax.vmap(jax.vmap(take_over, in_axes=(None, 0, 0)))(policies, drones, keys)
        end = End(jnp.zeros(included.shape, jnp.int32), jnp.where(included, 0, failures.TIME_LIMIT))
        nothing = jnp.zeros(included.shape)
        flights = FlightOutcome(end, Excursion(nothing, nothing, nothing), nothing, nothing)
        first = jnp.zeros((), jnp.int32), begun, flights
        return lax.while_loop(lambda now: jnp.any(now[-1].end.reason == 0), decide, first)[-1]

    laid, everywhere = PartitionSpec(POLICIES), PartitionSpec()
    specs = (laid, everywhere)
    shared = jax.shard_map(fly, mesh=mesh(), in_specs=specs, out_specs=laid, check_vma=False)
    return shared(trials, limits)


def _until_next_action(
    env: Environment,
    every: int,
    limits: Limits,
    row: Int[Array, ""],
    policy: Policy,
    drone: Parameters,
    key: Array,
    before: tuple[EnvState, Float[Array, "H 20"]],
) -> tuple[
    tuple[EnvState, Float[Array, "H 20"]],
    tuple[Int[Array, "every"], Excursion, Float[Array, "every"]],
]:
    """Returns drone and history one action, `every` rows of 10 ms, later.

    Also, after each row, why the flight would end, what guards see, and the true distance from the
    set-point.
    """
    env_state, history = before
    observation = environment.observation(env, env_state._replace(history=history))
    action = policy(observation)

    def hold(env_state: EnvState, row: Array) -> tuple[EnvState, tuple[Array, Excursion, Array]]:
        after, step_result = stepping.step(
            env, env_state, action, drone, jax.random.fold_in(key, row)
        )
        reason, excursion = end_reason(after, step_result.setpoint, limits.guard)
        late = (reason == 0) & (row >= limits.rows)
        true = vectors.norm(step_result.setpoint - after.state.position)
        return after, (jnp.where(late, failures.TIME_LIMIT, reason), excursion, true)

    env_state, rows = lax.scan(hold, env_state, row + jnp.arange(1, every + 1))
    instant = environment.observe(
        env_state.measurement, env.task.reference(env_state.time), env_state.action
    )
    return (env_state, jnp.concatenate([history[1:], instant[None]])), rows


def end_reason(
    env_state: EnvState, setpoint: Float[Array, "3"], guard: Guard
) -> tuple[Int[Array, ""], Excursion]:
    """Returns why the drone's guards would stop the policy now, by its measurements, and those.

    The first is an index of `END_REASONS`; 0: they would not.

    Args:
        env_state: the drone.
        setpoint: [m].
        guard: of the drone; the ground ends flights too.
    """
    measurement = env_state.measurement
    attitude = rotations.to_attitude(measurement.quaternion)
    excursion = failures.excursion(measurement.position, attitude, measurement.body_rates, setpoint)
    low = env_state.state.position[2] < 0.0
    return failures.reason(**guard.trips(excursion), height=low), excursion
