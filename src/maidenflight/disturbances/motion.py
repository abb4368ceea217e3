"""A drone that a regulator holds, on which torques and forces act that its parameters lack.

Measured rotor torque alone does not tell how a flight goes on: a regulator answers whatever turns
the drone, so that below some hertz the torque of its rotors cancels what no parameter knows. The
model therefore has both: torques and forces that change slowly, and what the regulator wants.

Source: Söderström and Stoica 1989, System identification, ch. 10 (flights in closed loop);
Barrau and Bonnabel 2017, The invariant extended Kalman filter as a stable observer (errors in the
body's axes do not depend on where the drone is).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from maidenflight.parameters import Parameters
from maidenflight.simulator.physics import dynamics, rotations
from maidenflight.simulator.physics.dynamics import State

SIZE = 27
"""Entries of an error: position, velocity, attitude, body rates, then those of `Slow`."""
MEASURED = 12
"""Of which a log measures the first."""


class Slow(NamedTuple):
    """What changes slowly and no log measures; each a stationary Gauss-Markov process."""

    gust: Float[Any, "3"]
    """Torque over inertia that lasts some tenths of a second, of turbulent air [rad/s2]."""
    trim: Float[Any, "3"]
    """Torque over inertia that lasts for seconds, of motors, battery and wind [rad/s2]."""
    push: Float[Any, "3"]
    """Force over mass along body x, y, z, of air, wind and battery [m/s2]."""
    demand: Float[Any, "3"]
    """Angular acceleration that the regulator wants for its set-points [rad/s2]."""
    drift: Float[Any, "3"]
    """By which the logged velocity is off, body axes, as an estimator's is [m/s]."""


class Processes(NamedTuple):
    """How large and slow all of that is, the regulator, and the errors of logs; all positive."""

    gust_size: Float[Any, "3"]
    """Standard deviation [rad/s2]."""
    gust_time: Float[Any, "3"]
    """Correlation time [s]."""
    trim_size: Float[Any, "3"]
    trim_time: Float[Any, "3"]
    push_size: Float[Any, "3"]
    push_time: Float[Any, "3"]
    demand_size: Float[Any, "3"]
    demand_time: Float[Any, "3"]
    drift_size: Float[Any, "3"]
    drift_time: Float[Any, "3"]
    velocity_scale: Float[Any, "3"]
    """Logged velocity over that of the logged position, body axes, an estimator's gain [-]."""
    rate_gain: Float[Any, "3"]
    """Angular acceleration by which the regulator answers a body rate [1/s]."""
    tilt_gain: Float[Any, "2"]
    """The same of a tilt about body x and y [1/s2]."""
    regulator_delay: Float[Any, ""]
    """Time from a tilt to the answer [s]."""
    speed_delay: Float[Any, ""]
    """Time by which the state is logged behind the rotors [s]."""
    velocity_walk: Float[Any, "3"]
    """White acceleration, body axes [m/s2 per root Hz]."""
    rate_walk: Float[Any, "3"]
    """White angular acceleration [rad/s2 per root Hz]."""
    position_error: Float[Any, "3"]
    """White error of the log, body axes [m]; also of the next."""
    velocity_error: Float[Any, "3"]
    attitude_error: Float[Any, "3"]
    rate_error: Float[Any, "3"]
    regulator_error: Float[Any, "3"]
    """White error of the regulator's answer [rad/s2]."""
    tails: Float[Any, "4"]
    """Degrees of freedom, beyond two, of Student's t of predictions' errors: position, velocity,
    attitude, body rates."""
    core: Float[Any, "4"]
    """Squared scale of Student's t over the variance that the filter and unrest tell, which tails
    make larger than that of most errors."""
    unrest_time: Float[Any, ""]
    """Over which it is averaged how much more than expected rows before surprise [s]."""
    unrest_power: Float[Any, "4 2"]
    """With which that share of variance carries over to predictions of each quantity: of its own
    surprises to that of the next row, of the body rates' and the regulator's to what is added
    later, which comes from turns; 0 is not at all."""


class Motion(NamedTuple):
    """A drone's state, its rotors' speeds apart, and what changes slowly."""

    position: Float[Any, "3"]
    velocity: Float[Any, "3"]
    quaternion: Float[Any, "4"]
    body_rates: Float[Any, "3"]
    slow: Slow

    def with_rotors(self, rotor_speed: Float[Any, "4"]) -> State:
        """Returns the state of physics."""
        return State(*self[:4], rotor_speed)


def advance(
    motion: Motion,
    rotor_speed: Float[Array, "4"],
    drone: Parameters,
    processes: Processes,
    period: Float[Array, ""] | float,
) -> Motion:
    """Returns the motion a period later, under rotors at a constant speed.

    One step under the forces at its middle; what changes slowly decays towards its mean, zero.

    Source: see `dynamics.midpoint`.
    """
    state, slow = motion.with_rotors(rotor_speed), motion.slow
    turning = period * angular_acceleration(motion, rotor_speed, drone)
    rates = state.body_rates + 0.5 * turning
    rotation = period * rotations.quaternion_derivative(state.quaternion, rates)
    halfway = state._replace(quaternion=state.quaternion + 0.5 * rotation)
    push = rotations.to_matrix(halfway.quaternion) @ slow.push
    pulled = period * (dynamics.linear_acceleration(halfway, drone) + push)
    return Motion(
        state.position + period * (state.velocity + 0.5 * pulled),
        state.velocity + pulled,
        rotations.normalise(state.quaternion + rotation),
        state.body_rates + turning,
        Slow(
            *(
                jnp.exp(-period / time) * value
                for value, time in zip(slow, times(processes), strict=True)
            )
        ),
    )


def times(processes: Processes) -> tuple[Array, ...]:
    """Returns the correlation times of `Slow` [s]."""
    model = processes
    return model.gust_time, model.trim_time, model.push_time, model.demand_time, model.drift_time


def sizes(processes: Processes) -> tuple[Array, ...]:
    """Returns the standard deviations of `Slow`."""
    model = processes
    return model.gust_size, model.trim_size, model.push_size, model.demand_size, model.drift_size


def angular_acceleration(
    motion: Motion, rotor_speed: Float[Array, "4"], drone: Parameters
) -> Float[Array, "3"]:
    """Returns the angular acceleration by rotors, parameters and slow torques [rad/s2]."""
    known = dynamics.angular_acceleration(
        motion.with_rotors(rotor_speed), jnp.zeros_like(rotor_speed), drone
    )
    return known + motion.slow.gust + motion.slow.trim


def regulator(motion: Motion, processes: Processes) -> Float[Array, "3"]:
    """Returns the angular acceleration that the regulator makes [rad/s2].

    -k_w omega - k_t tilt + demand, of a tilt some time ago: a cascade of attitude and rate, whose
    gains are fitted.

    Source: Crazyflie firmware, attitude_pid_controller.c; any cascade is alike to first order.
    """
    x, y, z = rotations.axes(motion.quaternion)
    up = jnp.stack([x[2], y[2], z[2]])
    before = up + processes.regulator_delay * jnp.cross(motion.body_rates, up)
    tilt = jnp.stack([before[1], -before[0]])
    levelled = jnp.concatenate([processes.tilt_gain * tilt, jnp.zeros(1)])
    return motion.slow.demand - processes.rate_gain * motion.body_rates - levelled


def move(motion: Motion, error: Float[Array, "27"]) -> Motion:
    """Returns a motion that is off by an error in its body's axes."""
    rotation = rotations.to_matrix(motion.quaternion)
    return Motion(
        motion.position + rotation @ error[:3],
        motion.velocity + rotation @ error[3:6],
        rotations.product(motion.quaternion, _turn(error[6:9])),
        motion.body_rates + error[9:12],
        Slow(
            *(value + by for value, by in zip(motion.slow, error[12:].reshape(5, 3), strict=True))
        ),
    )


def as_logged(motion: Motion, processes: Processes) -> Motion:
    """Returns a motion with the velocity that its log holds."""
    rotation = rotations.to_matrix(motion.quaternion)
    own = processes.velocity_scale * (rotation.T @ motion.velocity)
    return motion._replace(velocity=rotation @ (own + motion.slow.drift))


def difference(motion: Motion, other: Motion) -> Float[Array, "12"]:
    """Returns what moves the measured part of a motion to another's."""
    back = rotations.to_matrix(motion.quaternion).T
    conjugate = motion.quaternion * jnp.array([-1.0, -1.0, -1.0, 1.0])
    return jnp.concatenate(
        [
            back @ (other.position - motion.position),
            back @ (other.velocity - motion.velocity),
            rotation_vector(rotations.product(conjugate, other.quaternion)),
            other.body_rates - motion.body_rates,
        ]
    )


def hover(drone: Parameters) -> tuple[Motion, Float[Array, "4"]]:
    """Returns a drone at rest, and its rotors' speeds."""
    still = dynamics.at_hover(jnp.zeros(3), drone)
    position, velocity, quaternion, rates = (jnp.asarray(vector, float) for vector in still[:4])
    slow = Slow(*[jnp.zeros(3)] * 5)
    return Motion(position, velocity, quaternion, rates, slow), jnp.asarray(still[4], float)


def rotation_vector(quaternion: Float[Array, "4"]) -> Float[Array, "3"]:
    """Returns the rotation vector [rad] of a unit quaternion, at most pi long."""
    nearest = jnp.where(quaternion[3] < 0, -1.0, 1.0) * quaternion
    sine = jnp.sqrt(nearest[:3] @ nearest[:3] + 1e-24)
    return nearest[:3] * (2 * jnp.arctan2(sine, nearest[3]) / sine)


def _turn(vector: Float[Array, "3"]) -> Float[Array, "4"]:
    angle = jnp.sqrt(vector @ vector + 1e-24)
    return jnp.concatenate([vector * (jnp.sin(angle / 2) / angle), jnp.cos(angle / 2)[None]])


def linearise(
    drone: Parameters, processes: Processes, period: Float[Array, ""] | float
) -> tuple[Float[Array, "27 27"], Float[Array, "3 27"]]:
    """Returns how an error grows in a period, and what it changes of the regulator's answer.

    About hover; in the body's axes an error grows alike wherever the drone is, to first order in
    its rates and in thrust beyond its weight.
    """
    still, speed = hover(drone)

    def grow(error: Array) -> Array:
        later = advance(move(still, error), speed, drone, processes, period)
        return jnp.concatenate([difference(still, later), *later.slow])

    def answer(error: Array) -> Array:
        motion = move(still, error)
        return regulator(motion, processes) - angular_acceleration(motion, speed, drone)

    none = jnp.zeros(SIZE)
    return jax.jacfwd(grow)(none), jax.jacfwd(answer)(none)
