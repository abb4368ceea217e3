"""How long policies would fly on the real drone: a judge of drones in closed loop.

Flight times of policies that were not trained on a drone are a harder test of it than replays: an error in its lag or its thrust
feeds back through the policy until the guard trips. Policies fly here as the authors' drone ran them. Attitude and rate PIDs are
those of firmware 2021.10 at 500 Hz; instants of the history are one control period apart and hold the network's raw output; the
guard reads the estimates 100 times a second, between two actions too; the reference starts at its beginning.

Of 216 published flights 159 lasted less than 20 s. In the last row of 157 of them roll or pitch is 25.8 to 38.6 deg, 29.3 deg in the
median and whatever the control structure: that is the 30 deg guard. No guard looked at the distance from the set-point: three quarters
of the attitude-rate flights go on for more than 0.3 s beyond 0.25 m, as far as 3.4 m. The other two flights ended 3.0 m from the room's
centre and near the ground.

Source: Gronauer et al. 2022, sec. Zero-Shot Experiments; logs of the authors' flights.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import polars
from jax import lax, tree
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float, Int
from scipy import stats

from maidenflight.errors import InputError
from maidenflight.experiments.transfer import FASTEST, LONGEST, STEEPEST
from maidenflight.parameters import Parameters, replace
from maidenflight.policy import Policy
from maidenflight.simulator import control, dynamics, environment, firmware, rotations, tasks
from maidenflight.simulator.control import Controller
from maidenflight.simulator.environment import Environment, Episode
from maidenflight.simulator.firmware import Generation
from maidenflight.simulator.sensors import Measurement
from maidenflight.simulator.tasks import END_REASONS

FIRMWARE: Generation = "2021.10"
"""What the authors' drone ran."""
GUARD_RATE = 100
"""How often the guard looks [Hz], which is also the rate of the authors' logs and of the estimates."""
FARTHEST = 2.5
"""Distance from the set-point [m] at which a flight ends: no guard of the drone, but the room; one published flight went further."""


def attitude_rate_as_flown() -> Controller:
    """Attitude-rate control as the authors' drone did it: yaw's rate PID, too, follows the rate that the policy asks for.

    The firmware's commander would turn it into a heading. In the 47 published flights of 150 rows and more the rate PID fed with the
    policy's yaw rate explains 95 % of the variance of the yaw torque at a slope of 1.00, that of the heading less than 1 %.
    """
    return _attitude_rate_as_flown()


@cache
def _attitude_rate_as_flown() -> Controller:
    commander = control.attitude_rate(FIRMWARE, GUARD_RATE)

    def init() -> firmware.PIDMemory:
        zero = np.zeros(3, np.float32)
        return firmware.PIDMemory(zero, zero)  # type: ignore[arg-type]

    def command(
        memory: firmware.PIDMemory, action: Float[Array, "4"], measurement: Measurement, setpoint: Float[Array, "3"]
    ) -> tuple[firmware.PIDMemory, Float[Array, "4"]]:
        asked = jnp.clip(action, -1.0, 1.0)
        memory, torque = firmware.pid(memory, 60.0 * asked[1:], jnp.degrees(measurement.body_rates), firmware.RATE, FIRMWARE)
        motors = firmware.mix(30000.0 + 30000.0 * asked[0], firmware.cut(torque), FIRMWARE)
        return memory, jnp.clip(motors / 60000.0, 0.0, 1.0)

    return commander._replace(init=init, command=command)


def attitude_as_flown() -> Controller:
    """Attitude control as the authors' drone did it: the policy's outputs are not clipped.

    In 22 of the 54 published flights (those of 150 rows and more) the PIDs fed with 10 deg times the outputs explain 96, 95 and 85 % of
    the variance of the roll, pitch and yaw torque; fed with outputs clipped to [-1, 1] it is 79, 79 and 64 %.
    """
    return _attitude_as_flown()


@cache
def _attitude_as_flown() -> Controller:
    commander = control.attitude(FIRMWARE, GUARD_RATE)
    mode = np.array([firmware.DISABLE] * 3 + [firmware.ABSOLUTE] * 3, np.int32)

    def command(
        memory: firmware.Memory, action: Float[Array, "4"], measurement: Measurement, setpoint: Float[Array, "3"]
    ) -> tuple[firmware.Memory, Float[Array, "4"]]:
        wanted = control.NOTHING._replace(mode=mode, attitude=10.0 * action[1:], thrust=45000.0 + 10000.0 * action[0])
        memory, motors = firmware.tick(memory, wanted, control.sensed(measurement), FIRMWARE, position_due=False)
        return memory, jnp.clip(motors / 60000.0, 0.0, 1.0)

    return commander._replace(command=command)


AS_FLOWN: dict[str, Callable[[], Controller]] = {
    "pwm": control.pwm,
    "attitude_rate": attitude_rate_as_flown,
    "attitude": attitude_as_flown,
}
"""Control structures of the authors' drone, with a place for the guard between actions."""


class Start(NamedTuple):
    """Standard deviations of the state in which the policy takes over, normal about hover at the reference's start.

    The numbers are those of the first rows of 216 published flights (1.4826 times the median deviation from the median).
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
    """Minus the correlation of horizontal position and velocity: the PID that hands over is on its way to the start."""


def _start(*numbers: tuple[float, ...] | float) -> Start:
    return Start(*(np.array(number, np.float32) for number in numbers))  # type: ignore[arg-type]


PUBLISHED_START = _start((0.029, 0.023, 0.010), (0.044, 0.043, 0.018), (0.015, 0.014, 0.011), (0.135, 0.145, 0.035), 0.77)


class _Flights(NamedTuple):
    steps: Int[Array, "policies trials"]
    """Rows of 10 ms flown."""
    reason: Int[Array, "policies trials"]
    """Index of `END_REASONS`."""


def predict_flight_times(
    policies: Sequence[Policy],
    drone: Parameters,
    key: Array,
    *,
    trials: int = 16,
    duration: float = LONGEST,
    farthest: float = FARTHEST,
    start: Start = PUBLISHED_START,
    names: Sequence[str] | None = None,
) -> polars.DataFrame:
    """Flies every policy on the authors' circle until a guard trips.

    Compiled once for a control structure, whatever the drone; an estimator that is late (`estimator_delay`) is another compilation.
    Where JAX has several devices they share the policies.

    Args:
        policies: of any control structures, of one history and layer sizes within each.
        drone: a point, or an ensemble stacked along a first axis, from which each trial draws one.
        key: random key.
        trials: flights of each policy.
        duration: longest flight [s].
        farthest: distance from the set-point at which a flight ends [m].
        start: spread of first states.
        names: what the table calls the policies; policy_1, policy_2, ... unless given.

    Returns:
        One row a flight: policy, control, trial, duration [s], end_reason.

    Raises:
        InputError: no policy or trial, policies of one control structure differ in shape, or a rate does not divide 100 Hz.
    """
    names = list(names or (f"policy_{number}" for number in range(1, len(policies) + 1)))
    if not policies or trials < 1 or len(names) != len(policies):
        raise InputError(f"{len(policies)} policies, {len(names)} names and {trials} trials; expected at least one, and a name for each.")
    drones = drone if np.ndim(drone.mass) else tree.map(lambda leaf: np.asarray(leaf)[None], drone)
    rows = round(duration * GUARD_RATE)
    tables = []
    for kind in dict.fromkeys((policy.control, policy.rate) for policy in policies):
        places = [place for place, policy in enumerate(policies) if (policy.control, policy.rate) == kind]
        flown = _fly_kind([policies[place] for place in places], places, drones, key, trials, rows, farthest, start)
        tables.append(
            {
                "place": np.repeat(places, trials),
                "trial": np.tile(np.arange(1, trials + 1), len(places)),
                "duration": np.asarray(flown.steps).ravel() / GUARD_RATE,
                "end_reason": [END_REASONS[reason] for reason in np.asarray(flown.reason).ravel()],
            }
        )
    table = polars.concat([polars.DataFrame(part) for part in tables]).sort("place", "trial")
    place = table["place"].to_list()
    made = [polars.Series("policy", [names[one] for one in place]), polars.Series("control", [policies[one].control for one in place])]
    return polars.DataFrame([*made, *table.drop("place").get_columns()])


def _fly_kind(
    policies: list[Policy], places: list[int], drones: Parameters, key: Array, trials: int, rows: int, farthest: float, start: Start
) -> _Flights:
    """All flights of one control structure, laid on as many devices as divide the policies."""
    kind, rate = policies[0].control, policies[0].rate
    if len({(policy.history, policy.layer_sizes) for policy in policies}) > 1:
        raise InputError(f"{kind} policies of different history or layer sizes; predict each kind by itself.")
    if GUARD_RATE % rate:
        raise InputError(f"{kind} policies of {rate} Hz, which does not divide the guard's {GUARD_RATE} Hz.")
    structure = AS_FLOWN[kind]()
    step = np.float32(control.time_step(structure, float(np.max(drones.time_step))))
    late = bool(np.any(np.asarray(drones.estimator_delay) > 0))
    drones = replace(drones, time_step=np.broadcast_to(step, np.shape(drones.mass)))
    nominal = tree.map(lambda leaf: np.asarray(leaf)[0], drones)
    simulated = Environment.matching(nominal, tasks.circle(), structure, estimator_memory=_MEMORY if late else 0)
    draw_keys, keys = _keys(key, jnp.asarray(places), trials)
    drawn = np.asarray(jax.vmap(lambda key: jax.random.randint(key, (trials,), 0, len(drones.mass)))(draw_keys))
    flights = tree.map(lambda *leaves: np.stack(leaves), *policies), tree.map(lambda leaf: np.asarray(leaf)[drawn], drones), keys
    devices = jax.devices()
    if len(devices) > 1 and len(policies) % len(devices) == 0:
        flights = jax.device_put(flights, NamedSharding(Mesh(np.array(devices), ("policies",)), PartitionSpec("policies")))
    return _fly(simulated, GUARD_RATE // rate, rows, *flights, np.float32(farthest), start)


@partial(jax.jit, static_argnums=2)
def _keys(key: Array, places: Int[Array, "policies"], trials: int) -> tuple[Array, Array]:
    """For each policy a key to draw drones with, and one for each of its flights; others beside it do not change them."""
    own = jax.vmap(partial(jax.random.fold_in, key))(places)
    return jax.vmap(lambda key: jax.random.fold_in(key, 0))(own), jax.vmap(
        lambda key: jax.random.split(jax.random.fold_in(key, 1), trials)
    )(own)


_MEMORY = 7
"""Estimates at 100 Hz that hold any `estimator_delay` within its bounds, 50 ms."""


@partial(jax.jit, static_argnums=(0, 1, 2))
def _fly(
    simulated: Environment, every: int, rows: int, policies: Policy, drones: Parameters, keys: Array, farthest: Array, start: Start
) -> _Flights:
    def one(policy: Policy, drone: Parameters, key: Array) -> _Flights:
        start_key, begin_key, key = jax.random.split(key, 3)
        state = _first_state(simulated, drone, start, start_key)
        episode = environment.begin(simulated, state, jnp.zeros(()), drone, begin_key)
        reasons = _guarded(simulated, every, policy, episode, drone, farthest, jax.random.split(key, -(-rows // every) * every))[:rows]
        tripped = reasons > 0
        first = jnp.argmax(tripped)
        over = tripped[first]
        return _Flights(jnp.where(over, first + 1, rows), jnp.where(over, reasons[first], tasks.TIME_LIMIT))

    return jax.vmap(jax.vmap(one, in_axes=(None, 0, 0)))(policies, drones, keys)


def _first_state(simulated: Environment, drone: Parameters, start: Start, key: Array) -> dynamics.State:
    """Hover at the reference's start, and a draw of how far from it the policy takes over."""
    normal = jax.random.normal(key, (4, 3))
    hover = dynamics.at_hover(simulated.task.reference(jnp.zeros(())), drone)
    side = start.homeward * jnp.array([1.0, 1.0, 0.0])
    return hover._replace(
        position=hover.position + start.position * normal[0],
        velocity=start.velocity * (jnp.sqrt(1.0 - side * side) * normal[1] - side * normal[0]),
        quaternion=rotations.from_attitude(start.attitude * normal[2]),
        body_rates=start.body_rates * normal[3],
    )


def _guarded(
    simulated: Environment, every: int, policy: Policy, episode: Episode, drone: Parameters, farthest: Array, keys: Array
) -> Int[Array, "rows"]:
    """Why the guard would end the flight, after each 10 ms; an action holds for `every` of them, and so far apart are instants."""

    def decide(before: tuple[Episode, Array], keys: Array) -> tuple[tuple[Episode, Array], Array]:
        episode, history = before
        action = policy(history.reshape(-1))

        def hold(episode: Episode, key: Array) -> tuple[Episode, Array]:
            after, outcome = environment.step(simulated, episode, action, drone, key)
            return after, guard(after, outcome.setpoint, farthest)

        episode, reasons = lax.scan(hold, episode, keys)
        instant = environment.observe(episode.measurement, simulated.task.reference(episode.time), action)
        return (episode, jnp.concatenate([history[1:], instant[None]])), reasons

    history = jnp.broadcast_to(episode.history[-1], (policy.history, environment.OBSERVATION_SIZE))
    return lax.scan(decide, (episode, history), keys.reshape(-1, every))[1].reshape(-1)


def guard(episode: Episode, setpoint: Float[Array, "3"], farthest: Float[Array, ""]) -> Int[Array, ""]:
    """Why the drone would stop the policy now, from what its sensors tell, an index of `END_REASONS`; 0: it would not.

    Args:
        episode: the drone.
        setpoint: [m].
        farthest: distance from it [m].

    Source: Gronauer et al. 2022, sec. Zero-Shot Experiments; the ground and the distance are ours.
    """
    seen = episode.measurement
    tilt, rates = jnp.abs(rotations.to_attitude(seen.quaternion)[:2]), jnp.abs(seen.body_rates[:2])
    distance = tasks.norm(setpoint - seen.position)
    return tasks.reason(
        not_finite=~jnp.isfinite(distance + tilt[0] + tilt[1] + rates[0] + rates[1]),
        body_rate=jnp.maximum(rates[0], rates[1]) > np.float32(FASTEST),
        tilt=jnp.maximum(tilt[0], tilt[1]) > np.float32(STEEPEST),
        position_error=distance > farthest,
        height=episode.state.position[2] < 0.0,
    )


def summary(flights: polars.DataFrame) -> polars.DataFrame:
    """One row a policy, in the order of the flights.

    Args:
        flights: what `predict_flight_times` gives.

    Returns:
        policy, control, trials; mean, 10 %, 50 % and 90 % quantile of the duration [s]; and the share of flights that ended by each of
        the reasons there are.
    """
    duration, reason = polars.col("duration"), polars.col("end_reason")
    reasons = [name for name in END_REASONS if name in set(flights["end_reason"])]
    return flights.group_by("policy", "control", maintain_order=True).agg(
        polars.len().alias("trials"),
        duration.mean().alias("mean"),
        *(duration.quantile(share / 100, "linear").alias(f"quantile_{share}") for share in (10, 50, 90)),
        *((reason == name).mean().alias(name) for name in reasons),
    )


@dataclass(frozen=True)
class Agreement:
    """How well predictions tell what was measured."""

    policies: int
    spearman: float
    """Rank correlation."""
    pearson: float
    """Linear correlation."""
    mean_absolute_error: float
    """In the unit of what was measured."""


def agreement(predicted: Float[np.ndarray, "P"], measured: Float[np.ndarray, "P"]) -> Agreement:
    """Compares predicted and measured mean flight times, policy by policy; correlations with a constant are not numbers.

    Raises:
        InputError: not two rows of one length of at least two finite numbers.
    """
    predicted, measured = np.asarray(predicted, np.float64), np.asarray(measured, np.float64)
    if predicted.ndim != 1 or predicted.shape != measured.shape or len(predicted) < 2 or not np.isfinite([predicted, measured]).all():
        raise InputError(f"predictions of shape {predicted.shape} for measurements of shape {measured.shape}; expected two equal rows.")

    def correlation(first: np.ndarray, second: np.ndarray) -> float:
        spread = float(np.std(first) * np.std(second))
        return float(np.mean((first - first.mean()) * (second - second.mean()))) / spread if spread > 0 else float("nan")

    return Agreement(
        policies=len(predicted),
        spearman=correlation(stats.rankdata(predicted), stats.rankdata(measured)),
        pearson=correlation(predicted, measured),
        mean_absolute_error=float(np.mean(np.abs(predicted - measured))),
    )
