"""The rigid body and its four motors: one derivative and three integrators.

A `State` is one drone's. Where its rotors are and which way they turn are parameters; in
the X of a Crazyflie they are front right, back right, back left, front left, and 1 and 3 turn
counter-clockwise. Inside this module a *command* is a rotor speed command sqrt(u), already
delayed, noisy and averaged over the step. Vectors are arrays or, all of them, `vectors.Entries`.

Sums over axes are written out: a matrix product or a reduction over three numbers would keep XLA
from fusing loops, and cost two thirds of the speed. Torques are tuples until all are summed, since
stacking an array on the way costs as much again.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import tree
from jax.core import Tracer
from jaxtyping import Array, Float
from scipy.special import ndtr

from maidenflight.errors import InputError
from maidenflight.parameters import Parameters
from maidenflight.simulator.physics import rotations
from maidenflight.simulator.physics.vectors import each, like


class State(NamedTuple):
    """Where a drone is and how it moves."""

    position: Float[Array, "3"]
    """r [m], world."""
    velocity: Float[Array, "3"]
    """dr/dt [m/s], world."""
    quaternion: Float[Array, "4"]
    """Attitude, body to world (x, y, z, w)."""
    body_rates: Float[Array, "3"]
    """omega [rad/s], body."""
    rotor_speed: Float[Array, "4"]
    """nu [-]: 1 at a command of 1."""


Integrator = Callable[[State, Float[Array, "4"], Parameters], State]
Axes = tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]
"""A vector as its parts along the body's x, y and z."""


def rotor_forces(rotor_speed: Float[Array, "4"], parameters: Parameters) -> Float[Array, "4"]:
    """Returns the thrust of each rotor, F = m g / 4 k_F (c_0 + c_1 nu + (1 - c_0 - c_1) nu^2) [N].

    Each is multiplied by its rotor's share `rotor_thrust`, 1 for a sound one.

    Source: Gronauer et al. 2022, eq:motor-force, where c_0 = c_1 = 0; the affine-quadratic curve
    fits a load cell better.
    """
    full = parameters.mass * parameters.gravity / 4 * parameters.thrust_to_weight
    square = full * (1.0 - parameters.thrust_offset - parameters.thrust_linear)
    return parameters.rotor_thrust * (
        full * parameters.thrust_offset
        + rotor_speed * (full * parameters.thrust_linear + rotor_speed * square)
    )


def torque(forces: Float[Array, "4"], parameters: Parameters) -> Axes:
    """Returns the torque eta [N m] of the rotors on the body about x, y and z.

    It is the sum of y_i F_i, -x_i F_i and d_i M_i, with M_i = k_M1 F_i + k_M2.

    Source: r x F for rotors at (x_i, y_i); Gronauer et al. 2022, eq:torque for an X and
    eq:motor-torque.
    """
    moments = parameters.torque_to_thrust * forces + parameters.torque_offset
    return (
        _over_rotors(forces, parameters.rotor_y),
        -_over_rotors(forces, parameters.rotor_x),
        _over_rotors(moments, parameters.rotor_direction),
    )


def _over_rotors(values: Float[Array, "4"], weights: Float[Array, "4"]) -> Float[Array, ""]:
    (v1, v2, v3, v4), (w1, w2, w3, w4) = values, weights
    return w1 * v1 + w2 * v2 + w3 * v3 + w4 * v4


def further_torque(
    state: State,
    forces: Float[Array, "4"],
    spin_up: Float[Array, "4"],
    parameters: Parameters,
) -> Axes:
    """Returns the torque on the body [N m] about x, y and z that the paper's model lacks.

    It is zero for the paper's Crazyflie. Five parts: the rotors' moment against the flight's
    direction, (c_x v_y, -c_y v_x) (flapping blades, and rotors above the centre of mass); damping
    of roll and pitch rates; the reaction to rotors that spin up, with the signs of their drag
    torque; their precession -omega x h, whose momentum h has the opposite signs; and the trim of
    an off-centre battery or unequal motors, which grows with the thrust.

    Args:
        state: the drone.
        forces: of the rotors [N].
        spin_up: rate of change of the rotor speeds nu [1/s].
        parameters: uses `flapping_moment`, `rotational_damping`, `rotor_momentum` and
            `torque_bias`.

    Source: Hoffmann et al. 2007, Quadrotor helicopter flight dynamics and control, eq. 7-10
    (flapping); Bouabdallah 2007, sec. 2.4 (rotor inertia). Flapping, reaction and trim show in the
    authors' flights of a Crazyflie: 0.92 to 1.24 of the trim grow with the thrust by attitude rate,
    whose motors often stand still. In logs of three others c_y is 1.1 to 1.6 times c_x.
    """
    vx, vy, vz = _through_air(state, parameters)
    (p, q, _), (bias_x, bias_y, bias_z) = state.body_rates, parameters.torque_bias
    f1, f2, f3, f4 = forces
    # Without gravity rotors have no force either, which is in shares of the weight.
    lift = (f1 + f2 + f3 + f4) / jnp.maximum(parameters.mass * parameters.gravity, 1e-9)
    x, y, _ = rotations.axes(state.quaternion)
    forward, left = x[0] * vx + x[1] * vy + x[2] * vz, y[0] * vx + y[1] * vy + y[2] * vz
    momentum, signs = parameters.rotor_momentum, parameters.rotor_direction
    reaction = momentum * _over_rotors(spin_up, signs)
    precession = momentum * _over_rotors(state.rotor_speed, signs)
    (rolling, pitching), damping = parameters.flapping_moment, parameters.rotational_damping
    return (
        rolling * left - damping * p + precession * q + lift * bias_x,
        -pitching * forward - damping * q - precession * p + lift * bias_y,
        reaction + lift * bias_z,
    )


def _through_air(state: State, parameters: Parameters) -> Axes:
    """Velocity relative to the air [m/s], world."""
    (vx, vy, vz), (wx, wy, wz) = state.velocity, parameters.wind
    return vx - wx, vy - wy, vz - wz


def linear_acceleration(state: State, parameters: Parameters) -> Float[Array, "3"]:
    """Returns the acceleration of the centre of mass [m/s2], world.

    Source: Gronauer et al. 2022, eq:linear-acceleration; rotor drag -R diag(d) R^T v from Faessler
    et al. 2018, eq. 1.
    """
    f1, f2, f3, f4 = rotor_forces(state.rotor_speed, parameters)
    thrust = (f1 + f2 + f3 + f4) * (1.0 / parameters.mass)
    x, y, z = rotations.axes(state.quaternion)
    (vx, vy, vz), (dx, dy, dz) = _through_air(state, parameters), parameters.drag
    along_x = dx * (x[0] * vx + x[1] * vy + x[2] * vz)
    along_y = dy * (y[0] * vx + y[1] * vy + y[2] * vz)
    along_z = dz * (z[0] * vx + z[1] * vy + z[2] * vz) - thrust
    lift = [-x[i] * along_x - y[i] * along_y - z[i] * along_z for i in range(3)]
    return like(state.velocity, [lift[0], lift[1], lift[2] - parameters.gravity])


def angular_acceleration(
    state: State, spin_up: Float[Array, "4"], parameters: Parameters
) -> Float[Array, "3"]:
    """Returns the angular acceleration [rad/s2], body: I domega/dt = eta - omega x (I omega).

    eta is the sum of all torques on the body.

    Args:
        state: the drone.
        spin_up: rate of change of the rotor speeds nu [1/s].
        parameters: the drone's constants.

    Source: Gronauer et al. 2022, eq:angular-acceleration.
    """
    (p, q, r), (about_x, about_y, about_z) = state.body_rates, parameters.inertia
    gyroscopic = (
        q * r * (about_z - about_y),
        r * p * (about_x - about_z),
        p * q * (about_y - about_x),
    )
    forces = rotor_forces(state.rotor_speed, parameters)
    rotors = torque(forces, parameters)
    further = further_torque(state, forces, spin_up, parameters)
    all_torques = zip(rotors, further, gyroscopic, strict=True)
    total = like(state.body_rates, [of + more - lost for of, more, lost in all_torques])
    return total / parameters.inertia


def motor_derivative(
    rotor_speed: Float[Array, "4"], command: Float[Array, "4"], parameters: Parameters
) -> Float[Array, "4"]:
    """Returns the rate of change of the rotor speeds [1/s].

    T_m dnu/dt = sqrt(u) - nu, and less when coasting.

    A motor that slows down lags by T_m `spin_down_ratio` + T_c (nu - sqrt(u)) / nu^2: the time that
    the motor takes and the time that the air takes, one after the other. The air's drag grows with
    nu^2, so a rotor that coasts follows dnu/dt = -nu^2 / T_c.

    Args:
        rotor_speed: nu.
        command: sqrt(u) after the delay line.
        parameters: `motor_time_constant` T_m [s] holds while the motor speeds up, `spin_down_ratio`
            and `motor_coasting` T_c [s] besides while it slows down.

    Source: Gronauer et al. 2022, eq:motor-dynamics; coasting is ours, identified from the authors'
    flights (docs/identification.md).
    """

    def derivative(speed: Array, command: Array) -> Array:
        change = command - speed
        _, square, lag = _lags(change, speed, parameters)
        return change * square / lag

    return each(derivative, rotor_speed, command)


def equivalent_lag(speeding_up: Any, ratio: Any) -> Any:
    """Returns the lag of a linear motor that answers noise as one with two lags does [s].

    The motor follows dnu/dt = e / T_m, and e / (T_m r) where e = sqrt(u) - nu is below zero. Of
    normal e with a mean at which nu stays where it is, the share that is linear in e is the gain.

    Args:
        speeding_up: T_m [s].
        ratio: r, of slowing down over that.

    Source: Booton 1954, Nonlinear control systems with random inputs; Gelb and Vander Velde 1968,
    Multiple-input describing functions, sec. 2.2 (random-input describing function with bias).
    """
    mean, slower = np.zeros(np.shape(ratio)), 1.0 / np.asarray(ratio, float)
    gain = 0.5 * (1.0 + slower)
    # Newton, whose slope the gain is: exact to 1e-12 for ratios of 0.1 to 10.
    for _ in range(8):
        flow = (1.0 - slower) * np.exp(-0.5 * mean**2) / np.sqrt(2 * np.pi) + gain * mean
        mean = mean - flow / gain
        gain = ndtr(mean) + ndtr(-mean) * slower
    return speeding_up / gain


def _lags(
    change: Float[Array, "..."], rotor_speed: Float[Array, "..."], parameters: Parameters
) -> tuple[Array, Array, Array]:
    """Returns a motor's own lag [s], nu^2, and nu^2 times the lag with coasting [s].

    A rate thus takes one division, which is slow.
    """
    slower = parameters.motor_time_constant * parameters.spin_down_ratio
    time_constant = jnp.where(change < 0, slower, parameters.motor_time_constant)
    # Of a rotor too slow to lift anything; avoids a division by zero for one that stands.
    square = rotor_speed * rotor_speed + 1e-6
    return (
        time_constant,
        square,
        time_constant * square + parameters.motor_coasting * jnp.maximum(-change, 0.0),
    )


def spin_up(
    rotor_speed: Float[Array, "4"], command: Float[Array, "4"], parameters: Parameters
) -> Float[Array, "4"]:
    """Returns mean rate of change of the rotor speeds over a step with a constant command [1/s].

    One linearly implicit step, second order and stable at any step size; the trapezoidal rule where
    nothing coasts.

    Source: Rosenbrock 1963, Some general implicit processes for the numerical solution of
    differential equations (one stage).
    """

    def spin(speed: Array, command: Array) -> Array:
        change = command - speed
        time_constant, square, lag = _lags(change, speed, parameters)
        above = jnp.maximum(-change, 0.0)
        steepness = (
            time_constant * square * square
            + 2.0 * parameters.motor_coasting * above * above * speed
        )
        return change * square * lag / (lag * lag + 0.5 * parameters.time_step * steepness)

    return each(spin, rotor_speed, command)


def _rate_of_change(
    before: Float[Array, "4"], after: Float[Array, "4"], parameters: Parameters
) -> Float[Array, "4"]:
    """The rotors' mean rate of change over a step [1/s], from its ends; of no time at all, zero.

    Evaluating the motors' formula again would cost a third of the speed.
    """
    return (after - before) * (1.0 / jnp.maximum(parameters.time_step, 1e-9))


def derivative(state: State, command: Float[Array, "4"], parameters: Parameters) -> State:
    """Returns the time derivative of the whole state, f(x, u) of eq:discrete-system-diff-eq."""
    spin_up = motor_derivative(state.rotor_speed, command, parameters)
    return State(
        position=state.velocity,
        velocity=linear_acceleration(state, parameters),
        quaternion=rotations.quaternion_derivative(state.quaternion, state.body_rates),
        body_rates=angular_acceleration(state, spin_up, parameters),
        rotor_speed=spin_up,
    )


def euler(state: State, command: Float[Array, "4"], parameters: Parameters) -> State:
    """Returns one semi-implicit Euler step, of first order, as the paper's PyBullet does it.

    Motors, velocities, positions, each from the newest values.
    """
    dt = parameters.time_step
    rotor_speed = state.rotor_speed + dt * motor_derivative(state.rotor_speed, command, parameters)
    change = _rate_of_change(state.rotor_speed, rotor_speed, parameters)
    state = state._replace(rotor_speed=rotor_speed)
    velocity = state.velocity + dt * linear_acceleration(state, parameters)
    body_rates = state.body_rates + dt * angular_acceleration(state, change, parameters)
    turned = state.quaternion + dt * rotations.quaternion_derivative(state.quaternion, body_rates)
    return State(
        state.position + dt * velocity,
        velocity,
        rotations.normalise(turned),
        body_rates,
        state.rotor_speed,
    )


def midpoint(state: State, command: Float[Array, "4"], parameters: Parameters) -> State:
    """Returns one step under the forces at its middle.

    Motors (linearly implicit), velocities, positions: second order for all fast states, at the cost
    of `euler`. That one applies the forces of a step's end and so is half a step early in every
    integration: at 5 ms steps about 5 ms from command to attitude, as much as the latency of a
    Crazyflie.
    """
    dt = parameters.time_step
    rotor_speed = state.rotor_speed + dt * spin_up(state.rotor_speed, command, parameters)
    change = _rate_of_change(state.rotor_speed, rotor_speed, parameters)
    middle = state._replace(rotor_speed=0.5 * (state.rotor_speed + rotor_speed))
    turning = dt * angular_acceleration(middle, change, parameters)
    rates = state.body_rates + 0.5 * turning
    rotation = dt * rotations.quaternion_derivative(state.quaternion, rates)
    halfway = middle._replace(quaternion=state.quaternion + 0.5 * rotation)
    pulled = dt * linear_acceleration(halfway, parameters)
    turned = rotations.normalise(state.quaternion + rotation)
    position = state.position + dt * (state.velocity + 0.5 * pulled)
    return State(position, state.velocity + pulled, turned, state.body_rates + turning, rotor_speed)


def rk4(state: State, command: Float[Array, "4"], parameters: Parameters) -> State:
    """Returns one step of the classical fourth-order Runge-Kutta method with a constant command."""
    dt = parameters.time_step

    def shifted(slope: State, by: Float[Array, ""]) -> State:
        return tree.map(lambda value, change: value + by * change, state, slope)

    k1 = derivative(state, command, parameters)
    k2 = derivative(shifted(k1, dt / 2), command, parameters)
    k3 = derivative(shifted(k2, dt / 2), command, parameters)
    k4 = derivative(shifted(k3, dt), command, parameters)
    mean = tree.map(lambda a, b, c, d: (a + 2 * b + 2 * c + d) / 6, k1, k2, k3, k4)
    new = shifted(mean, dt)
    return new._replace(quaternion=rotations.normalise(new.quaternion))


def check_state(state: State) -> State:
    """Returns a state whose numbers are all finite; inside compiled functions any state.

    Raises:
        InputError: a number is not finite.
    """
    for name, value in state._asdict().items():
        if not isinstance(value, Tracer) and not np.all(np.isfinite(value)):
            raise InputError(
                f"state: {name} = {np.asarray(value).tolist()} is not finite. Give numbers."
            )
    return state


def hover_command(parameters: Parameters) -> Float[Array, ""]:
    """Returns the normalised thrust command u [-] at which thrust equals weight.

    1 / k_F for a quadratic thrust curve (eq:motor-force).
    """
    beyond = 1.0 / parameters.thrust_to_weight - parameters.thrust_offset
    return speed_for(beyond, parameters) ** 2


def speed_for(beyond: Float[Array, "..."], parameters: Parameters) -> Float[Array, "..."]:
    """Returns the rotor speed nu [-] of a share of full thrust beyond the offset.

    The root of c_1 nu + (1 - c_0 - c_1) nu^2, in the form that holds where nu^2 has no part.
    """
    linear = parameters.thrust_linear
    square = 1.0 - parameters.thrust_offset - linear
    return 2.0 * beyond / (linear + jnp.sqrt(linear**2 + 4.0 * square * beyond))


def at_hover(position: Float[Array, "3"], parameters: Parameters) -> State:
    """Returns a drone at rest and level, its rotors carrying its weight."""
    speed = jnp.sqrt(hover_command(parameters))
    level = jnp.array([0.0, 0.0, 0.0, 1.0], dtype=jnp.float32)
    return State(position, jnp.zeros(3), level, jnp.zeros(3), jnp.broadcast_to(speed, (4,)))
