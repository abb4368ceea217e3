"""How long policies would fly on the real drone: a judge of drones in closed loop.

Flight times of policies that were not trained on a drone are a harder test of it than replays: an
error in its lag or its thrust feeds back through the policy until the guard trips. Policies fly
here as the authors' drone ran them. Attitude and rate PIDs are those of firmware 2021.10 at 500 Hz;
instants of the history are one control period apart and hold the network's raw output; the guard
reads the estimates 100 times a second, between two actions too; the reference starts at its
beginning.

Of 216 published flights 159 lasted less than 20 s. In the last row of 157 of them roll or pitch is
25.8 to 38.6 deg, 29.3 deg in the median and whatever the control structure: that is the 30 deg
guard. No guard looked at the distance from the set-point: three quarters of the attitude-rate
flights go on for more than 0.3 s beyond 0.25 m, as far as 3.4 m. The other two flights ended 3.0 m
from the room's centre and near the ground.

Source: Gronauer et al. 2022, sec. Zero-Shot Experiments; logs of the authors' flights.
"""

import hashlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import islice, starmap
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import polars
from jax import lax, tree
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Bool, Float, Int, UInt

from maidenflight.errors import InputError
from maidenflight.experiments.as_flown import GUARD_RATE, controller_as_flown
from maidenflight.experiments.transfer import MAX_BODY_RATE_RAD_S, MAX_DURATION_S, MAX_TILT_RAD
from maidenflight.parameters import Parameters, replace
from maidenflight.policy import Policy
from maidenflight.simulator import (
    control,
    dynamics,
    environment,
    failures,
    rotations,
    stepping,
    tasks,
    vectors,
)
from maidenflight.simulator.control import Controller
from maidenflight.simulator.environment import Environment, EnvState
from maidenflight.simulator.failures import END_REASONS
from maidenflight.simulator.interface import ControlInterface

MAX_POSITION_ERROR_M = 2.5
"""Distance from the set-point [m] at which a flight ends: no guard of the drone, but the room; one
published flight went further."""


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

LANES = 16
"""Trials of a policy that one compiled program flies together, until the last of them has ended."""
AT_ONCE = {"cpu": 1}
"""Policies that a device flies together, by platform."""
AT_ONCE_ELSEWHERE = 64


class _Flights(NamedTuple):
    steps: Int[Array, "policies lanes"]
    """Rows of 10 ms flown."""
    reason: Int[Array, "policies lanes"]
    """Index of `END_REASONS`; 0 while it flies."""


def predict_flight_times(
    policies: Sequence[Policy],
    drone: Parameters,
    key: Array,
    *,
    trials: int = 16,
    duration: float = MAX_DURATION_S,
    farthest: float = MAX_POSITION_ERROR_M,
    start: Start = PUBLISHED_START,
    controller_for: Callable[[ControlInterface], Controller] = controller_as_flown,
    names: Sequence[str] | None = None,
    on_policy: Callable[[int, int], None] | None = None,
) -> polars.DataFrame:
    """Flies every policy on the authors' circle until a guard trips.

    A policy's flights depend on the key, on its weights and on the drone, not on the policies
    beside it nor on how many devices share them. Compiled once for policies of one control
    structure, rate, history and layer sizes, whatever their number, the trials, the duration and
    the drone; an estimator that is late (`estimator_delay`) is another compilation.

    Args:
        policies: of any control structures, histories and layer sizes.
        drone: a point, or an ensemble stacked along a first axis, from which each trial draws one.
        key: random key.
        trials: flights of each policy.
        duration: longest flight [s].
        farthest: distance from the set-point at which a flight ends [m].
        start: spread of first states.
        controller_for: the controller of a policy's interface: that of the authors' drone unless
            given. `control.controller_for` makes those that ours are trained with by default.
        names: what table and errors call the policies; policy_1, policy_2, ... unless given.
        on_policy: called with (policies flown, policies).

    Returns:
        One row a flight: policy, control, trial, duration [s], end_reason.

    Raises:
        InputError: no policy, trial or time, names that do not tell the policies apart, or a rate
            that does not divide 100 Hz.
    """
    names = list(names or (f"policy_{number}" for number in range(1, len(policies) + 1)))
    if not policies or trials < 1 or not len(set(names)) == len(names) == len(policies):
        raise InputError(
            f"{len(policies)} policies, {len(names)} names and {trials} trials; expected at least "
            "one, and a name for each."
        )
    rows = round(duration * GUARD_RATE)
    if rows < 1:
        raise InputError(f"flights of {duration} s, expected at least {1 / GUARD_RATE} s.")
    for name, policy in zip(names, policies, strict=True):
        if GUARD_RATE % policy.interface.rate:
            raise InputError(
                f"{name}: {policy.interface.name} at {policy.interface.rate} Hz, which does not "
                f"divide the guard's {GUARD_RATE} Hz."
            )
    drones = drone if np.ndim(drone.mass) else tree.map(lambda leaf: np.asarray(leaf)[None], drone)
    kinds: dict[tuple, list[int]] = {}
    for place, policy in enumerate(policies):
        kinds.setdefault(
            (
                policy.interface,
                policy.history,
                policy.look_ahead,
                policy.layer_sizes,
                policy.memory,
            ),
            [],
        ).append(place)
    steps, reasons = (np.zeros((len(policies), trials), np.int32) for _ in _Flights._fields)
    done = 0
    for places in kinds.values():
        flown = _fly_kind(
            [policies[place] for place in places],
            drones,
            key,
            trials,
            rows,
            farthest,
            start,
            controller_for,
        )
        for place, (rows_flown, why) in zip(places, flown, strict=True):
            steps[place], reasons[place] = rows_flown, why
            done += 1
            if on_policy is not None:
                on_policy(done, len(policies))
    return polars.DataFrame(
        {
            "policy": np.repeat(names, trials).tolist(),
            "control": np.repeat([policy.interface.name for policy in policies], trials).tolist(),
            "trial": np.tile(np.arange(1, trials + 1), len(policies)),
            "duration": steps.ravel() / GUARD_RATE,
            "end_reason": [END_REASONS[reason] for reason in reasons.ravel()],
        }
    )


def _fly_kind(
    policies: Sequence[Policy],
    drones: Parameters,
    key: Array,
    trials: int,
    rows: int,
    farthest: float,
    start: Start,
    controller_for: Callable[[ControlInterface], Controller],
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Rows and reasons of each policy's flights, policies of one kind.

    They fly in portions of one size: the same program flies few and many, in bounded memory.
    """
    # The guard looks between two actions.
    structure = controller_for(policies[0].interface).acting_at(GUARD_RATE)
    step = np.float32(control.time_step(structure, float(np.max(drones.time_step))))
    late = bool(np.any(np.asarray(drones.estimator_delay) > 0))
    drones = tree.map(
        np.asarray, replace(drones, time_step=np.broadcast_to(step, np.shape(drones.mass)))
    )
    nominal = tree.map(lambda leaf: leaf[0], drones)
    env = Environment.matching(
        nominal,
        tasks.circle(),
        structure,
        estimator_memory=_MEMORY if late else 0,
        look_ahead=policies[0].look_ahead,
        memory=policies[0].memory,
    )
    laid = NamedSharding(_mesh(), PartitionSpec(_POLICIES))
    size = laid.mesh.size * AT_ONCE.get(jax.default_backend(), AT_ONCE_ELSEWHERE)
    policies = [tree.map(np.asarray, policy) for policy in policies]
    own, blocks = (
        np.array([_identity(policy) for policy in policies], np.uint32),
        -(-trials // LANES),
    )

    def portion(first: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, Array]:
        places, block = np.divmod(np.arange(first, first + size), blocks)
        numbers = block[:, None] * LANES + np.arange(LANES)
        # The last portion is filled up with flights that end at once.
        wanted = (numbers < trials) & (places < len(policies))[:, None]
        places = np.minimum(places, len(policies) - 1)
        drawn, keys = _draw(key, own[places], numbers.astype(np.uint32), np.int32(len(drones.mass)))
        return places, wanted, np.asarray(drawn), keys

    def fly(places: np.ndarray, wanted: np.ndarray, drawn: np.ndarray, keys: Array) -> _Flights:
        flying = tree.map(lambda *leaves: np.stack(leaves), *(policies[place] for place in places))
        flights = jax.device_put(
            (flying, tree.map(lambda leaf: leaf[drawn], drones), keys, wanted), laid
        )
        return _fly(
            env,
            GUARD_RATE // policies[0].interface.rate,
            *flights,
            np.int32(rows),
            np.float32(farthest),
            start,
        )

    # Drones are drawn first: waiting for a draw would be waiting for the flights before it.
    portions = [portion(first) for first in range(0, blocks * len(policies), size)]
    landed = (
        part
        for flights in _landed(starmap(fly, portions))
        for part in zip(flights.steps, flights.reason, strict=True)
    )
    for _ in policies:
        steps, reasons = (
            np.concatenate(values)[:trials] for values in zip(*islice(landed, blocks), strict=True)
        )
        yield steps, reasons


_UNDER_WAY = 8
"""Portions begun before the first of them has landed: devices that are ahead need not wait, and
memory is bounded."""


def _landed(begun: Iterable[_Flights]) -> Iterator[_Flights]:
    under_way: deque[_Flights] = deque()
    for flights in begun:
        under_way.append(flights)
        if len(under_way) > _UNDER_WAY:
            yield tree.map(np.asarray, under_way.popleft())
    for flights in under_way:
        yield tree.map(np.asarray, flights)


_POLICIES = "policies"


def _mesh() -> Mesh:
    return Mesh(np.array(jax.local_devices()), (_POLICIES,))


def _identity(policy: Policy) -> int:
    """A number of 32 bits that stands for what a policy is, so that its flights are its own."""
    kind = f"{policy.interface.name} {policy.interface.rate} {policy.history} {policy.layer_sizes}"
    ahead = policy.look_ahead
    kind += f" {ahead.points} {ahead.spacing}" if ahead.points else ""
    kind += f" memory {policy.memory}" if policy.memory else ""
    known = hashlib.sha256(kind.encode())
    for leaf in tree.leaves(policy):
        known.update(np.asarray(leaf, "<f4").tobytes())
    return int.from_bytes(known.digest()[:4], "little")


@jax.jit
def _draw(
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


_MEMORY = 7
"""Estimates at 100 Hz that hold any `estimator_delay` within its bounds, 50 ms."""


@partial(jax.jit, static_argnums=(0, 1))
def _fly(
    env: Environment,
    every: int,
    policies: Policy,
    drones: Parameters,
    keys: Array,
    wanted: Bool[Array, "policies lanes"],
    rows: Int[Array, ""],
    farthest: Float[Array, ""],
    start: Start,
) -> _Flights:
    """Flies until the last flight has ended, on each device for itself."""

    def take_over(policy: Policy, drone: Parameters, key: Array) -> tuple[EnvState, Array]:
        start_key, begin_key = jax.random.split(jax.random.fold_in(key, 0))
        state = _first_state(env, drone, start, start_key)
        env_state = environment.begin(env, state, jnp.zeros(()), drone, begin_key)
        return env_state, jnp.broadcast_to(
            env_state.history[-1], (policy.history, environment.OBSERVATION_SIZE)
        )

    def fly(
        policies: Policy,
        drones: Parameters,
        keys: Array,
        wanted: Array,
        rows: Array,
        farthest: Array,
    ) -> _Flights:
        def decide(now: tuple[Array, Any, _Flights]) -> tuple[Array, Any, _Flights]:
            row, before, flights = now
            act = partial(_until_next_action, env, every, rows, farthest, row)
            after, reasons = jax.vmap(jax.vmap(act, in_axes=(None, 0, 0, 0)))(
                policies, drones, keys, before
            )
            first = jnp.argmax(reasons > 0, axis=-1)
            reason = jnp.take_along_axis(reasons, first[..., None], axis=-1)[..., 0]
            over = flights.reason > 0
            flown = _Flights(
                jnp.where(over, flights.steps, row + first + 1),
                jnp.where(over, flights.reason, reason),
            )
            return row + every, after, flown

        begun = jax.vmap(jax.vmap(take_over, in_axes=(None, 0, 0)))(policies, drones, keys)
        flights = _Flights(
            jnp.zeros(wanted.shape, jnp.int32), jnp.where(wanted, 0, failures.TIME_LIMIT)
        )
        return lax.while_loop(
            lambda now: jnp.any(now[-1].reason == 0),
            decide,
            (jnp.zeros((), jnp.int32), begun, flights),
        )[-1]

    laid, everywhere = PartitionSpec(_POLICIES), PartitionSpec()
    shared = jax.shard_map(
        fly,
        mesh=_mesh(),
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


QUANTILES = (10, 25, 50, 75, 90)
"""Of the duration, in percent."""


def summary(flights: polars.DataFrame) -> polars.DataFrame:
    """One row a policy, in the order of the flights.

    Args:
        flights: what `predict_flight_times` gives.

    Returns:
        policy, control, trials; mean and quantiles (`QUANTILES`, in percent) of the duration [s];
        and the share of flights that ended by each of the reasons there are.
    """
    duration, reason = polars.col("duration"), polars.col("end_reason")
    reasons = [name for name in END_REASONS if name in set(flights["end_reason"])]
    return flights.group_by("policy", "control", maintain_order=True).agg(
        polars.len().alias("trials"),
        duration.mean().alias("mean"),
        *(
            duration.quantile(share / 100, "linear").alias(f"quantile_{share}")
            for share in QUANTILES
        ),
        *((reason == name).mean().alias(name) for name in reasons),
    )
