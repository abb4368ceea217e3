"""How a policy's loop behaves in a log, and which policy flew a log."""

from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax import lax, tree
from jaxtyping import Array, Float
from scipy.spatial.transform import Rotation

from maidenflight.errors import InputError
from maidenflight.flights.log import Flight
from maidenflight.parameters import Parameters, levers
from maidenflight.policy import Policy
from maidenflight.simulator import environment
from maidenflight.simulator.controllers import control
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.policy_spec import OBSERVATION_SIZE

BEHAVIOUR = (
    "body rates",
    "change of body rates",
    "torques",
    "change of torques",
    "tilt",
    "change of velocity",
    "change of position",
)
"""Of roll and pitch or of x and y: what is compared, logarithms of standard deviations."""
EDGE_S, LONGEST_S, SHORTEST_S = 0.2, 6.0, 0.4
"""Of a flight, what is left out at its begin, where the PID hands over, and at its end, where it
falls; and how much at most and at least counts between [s]. Chosen; real and simulated flights are
cut alike."""
SAME = 0.02
"""Median difference of commands below which a policy is the one that flew: of 108 flights of the
authors' policies 82, with 0.014 and 0.028 82 and 87 (paper/identification/constants.py)."""
_ROWS = 100
"""Rows of a flight by which its policy is found; with 70 and 140 81 and 85, measured as `SAME`."""
_PHASE_HZ, _PHASE_ROWS = (2.0, 9.0), 150
"""Frequencies at which attitude and gyro are compared, and fewest rows of a flight for it: 0.7 and
1.4 times as high, the authors' 9.4 ms become 9.5 and 9.3 (paper/identification/constants.py)."""


def flights_of_policies(
    flights: Sequence[Flight], policies: Mapping[str, Policy]
) -> dict[str, tuple[Flight, ...]]:
    """Returns the flights of each policy.

    Those whose logged commands it gives for the logged estimates.

    Args:
        flights: logs of any policies or controllers, at the policies' rate.
        policies: policies for motor commands, of one kind, by name.

    Returns:
        By name, the policies that flew any of them.

    Raises:
        InputError: policies that do not command the motors, or look ahead.
    """
    for name, policy in policies.items():
        beyond = policy.spec.beyond("history", "memory", "hidden")
        if policy.interface.name != control.pwm().interface.name or beyond:
            raise InputError(
                f"{name}: a policy for {policy.interface.name}{beyond and f' with {beyond}'}; only "
                "flights of pwm policies without such tell by their commands which policy flew."
            )
    by_policy: dict[str, list[Flight]] = {}
    names = list(policies)
    together = stacked(list(policies.values()))
    for whole in flights:
        flight = whole.part(whole.lead, len(whole))
        rate = round(1.0 / flight.period)
        if rate != policies[names[0]].interface.rate or len(flight) < _ROWS // 4:
            continue
        rows = flight.part(0, min(len(flight), _ROWS))
        measurement = Measurement(
            position=jnp.asarray(_filled(rows.position)),
            velocity=jnp.asarray(_filled(rows.velocity)),
            quaternion=jnp.asarray(_filled(_quaternions(rows.attitude))),
            body_rates=jnp.asarray(_filled(rows.body_rates)),
        )
        command = _commands(together, measurement, _filled(rows.setpoint), _filled(rows.command))
        first = policies[names[0]].spec.history + 3
        logged = np.clip(rows.command[first:], 0.0, 1.0)
        off = np.median(np.abs(np.asarray(command)[:, first : len(rows)] - logged), axis=(1, 2))
        if off.min() < SAME:
            by_policy.setdefault(names[int(off.argmin())], []).append(flight)
    return {name: tuple(by_policy[name]) for name in names if name in by_policy}


def _filled(values: Float[np.ndarray, "N D"]) -> Float[np.ndarray, "rows D"]:
    """As many rows as every flight has here, the last one repeated."""
    more = _ROWS - len(values)
    return np.concatenate([values, np.repeat(values[-1:], more, axis=0)]).astype(np.float32)


def _quaternions(attitude: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 4"]:
    return Rotation.from_euler("ZYX", attitude[:, ::-1]).as_quat()


@jax.jit
def _commands(
    policies: Policy,
    measurement: Measurement,
    setpoint: Float[Array, "rows 3"],
    logged: Float[Array, "rows 4"],
) -> Float[Array, "policies rows 4"]:
    """What each policy commands, fed with logged estimates and its own last actions."""

    def replay(policy: Policy) -> Array:
        def step(carry: tuple[Array, Array, Array], row: tuple) -> tuple[tuple, Array]:
            history, action, memory = carry
            measured, target = row
            instant = environment.observe(measured, target, action)
            history = jnp.concatenate([history[1:], instant[None]])
            action, memory = jnp.split(policy(jnp.concatenate([history.ravel(), memory])), [4])
            return (history, action, memory), policy.interface.command(action)

        level = policy.interface.level(jnp.mean(jnp.clip(logged[0], 0.0, 1.0)))
        begin = environment.observe(
            Measurement(*(part[0] for part in measurement)), setpoint[0], level
        )
        history = jnp.broadcast_to(begin, (policy.spec.history, OBSERVATION_SIZE))
        start = history, level, jnp.zeros(policy.spec.memory)
        return lax.scan(step, start, (measurement, setpoint))[1]

    return jax.vmap(replay)(policies)


def stacked(policies: Sequence[Policy]) -> Policy:
    """Returns policies of one kind as one, with a leading axis.

    Raises:
        InputError: they are of different kinds.
    """
    if len({tree.structure(policy) for policy in policies}) > 1:
        raise InputError(
            "policies of different layers, histories or memories; compare each kind by itself."
        )
    return tree.map(lambda *leaves: np.stack(leaves), *policies)


def behaviour(
    position: Float[np.ndarray, "N 3"],
    velocity: Float[np.ndarray, "N 3"],
    attitude: Float[np.ndarray, "N 3"],
    body_rates: Float[np.ndarray, "N 3"],
    command: Float[np.ndarray, "N 4"],
    drone: Parameters,
    period: float,
) -> Float[np.ndarray, "7"] | None:
    """Returns the `BEHAVIOUR` of a flight; None where it is too short.

    Args:
        position: estimates [m].
        velocity: estimates [m/s].
        attitude: estimated roll, pitch and yaw [rad].
        body_rates: of the gyro [rad/s].
        command: u of each motor.
        drone: its frame.
        period: time between two rows [s].
    """
    first, last = round(EDGE_S / period), len(position) - round(EDGE_S / period)
    last = min(last, first + round(LONGEST_S / period))
    if last - first < round(SHORTEST_S / period):
        return None
    torque = np.clip(command[first:last], 0.0, 1.0) @ np.asarray(levers(drone))[:, :2]
    rates = body_rates[first:last, :2]
    each = (
        rates,
        np.diff(rates, axis=0),
        torque,
        np.diff(torque, axis=0),
        attitude[first:last, :2],
        np.diff(velocity[first:last, :2], axis=0),
        np.diff(position[first:last, :2], axis=0),
    )
    return np.log(np.array([values.std() for values in each]) + 1e-9)


def attitude_delay(flights: Sequence[Flight]) -> tuple[float, float] | None:
    """Returns how far the estimated attitude is behind the gyro [s], and its standard error.

    It is the slope of the phase between the gyro's roll and pitch rates and the change of the
    estimated angles, over frequencies weighted by the cross spectrum of a whole flight.

    Args:
        flights: those of less than 150 rows tell nothing.

    Returns:
        Median over flights; None where less than two flights tell.
    """
    delays = []
    for flight in flights:
        if len(flight) < _PHASE_ROWS:
            continue
        change = np.gradient(flight.attitude[:, :2], flight.period, axis=0)
        frequency, cross = scipy.signal.csd(
            flight.body_rates[:, :2], change, 1.0 / flight.period, nperseg=len(flight), axis=0
        )
        band = (frequency > _PHASE_HZ[0]) & (frequency < _PHASE_HZ[1])
        angular = 2.0 * np.pi * frequency[band, None]
        weight, phase = np.abs(cross[band]), np.angle(cross[band])
        delays.append(-np.sum(weight * angular * phase) / np.sum(weight * angular**2))
    if len(delays) < 2:
        return None
    # Of a median, where delays are normal.
    error = np.sqrt(np.pi / 2.0 / len(delays)) * np.std(delays, ddof=1)
    return float(np.median(delays)), float(error)


def mean_behaviour(flights: Sequence[Flight], drone: Parameters) -> Float[np.ndarray, "7"] | None:
    """Returns the mean `behaviour` of a policy's flights; None where all are too short.

    Args:
        flights: its logs.
        drone: its frame.
    """
    measured_rows = []
    for flight in flights:
        motion = flight.position, flight.velocity, flight.attitude, flight.body_rates
        row = behaviour(*motion, flight.command, drone, flight.period)
        if row is not None:
            measured_rows.append(row)
    return np.mean(measured_rows, axis=0) if measured_rows else None
