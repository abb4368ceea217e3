"""Noise-free logs of the training model itself, flown with a known xi: what identification must
find again.

Each flight starts in hover. Feedback of the true state keeps the drone level, and each axis
(thrust, roll, pitch, yaw) is excited by pulses + - - + of random sign, 50 ms each.
"""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from maidenflight.flights.log import Flight
from maidenflight.identification.signals.flight_signals import delay_command
from maidenflight.parameters import crazyflie, noiseless, replace
from maidenflight.simulator import environment, stepping
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics import dynamics, rotations
from maidenflight.simulator.tasks import tasks

WORLD = Environment(task=tasks.circle())
ROWS = 200
FLIGHTS = 16
LENGTH = 30
"""T of every window here, so that one compilation serves all."""
AXES = np.array([[1, 1, 1, 1], [-1, -1, 1, 1], [-1, 1, 1, -1], [-1, 1, -1, 1]], np.float32)


def drone(thrust_to_weight, motor_time_constant, latency):
    """The noiseless Crazyflie with a planted xi."""
    return replace(
        noiseless(crazyflie()),
        thrust_to_weight=thrust_to_weight,
        motor_time_constant=motor_time_constant,
        latency=latency,
    )


def excitation(generator):
    """Additions to the hover command, ROWS x 4; the first row is hover itself."""
    pulse = np.repeat([1, -1, -1, 1], 5)
    signs = generator.choice([-1.0, 1.0], (ROWS // 20, 1, 4)) * [0.08, 0.02, 0.02, 0.04]
    axes = (signs * pulse[None, :, None]).reshape(ROWS, 4)
    return np.concatenate([np.zeros((1, 4)), (axes @ AXES)[:-1]]).astype(np.float32)


def stabilised(state, parameters):
    """What keeps the drone level, as an addition to the four commands: every axis gets three poles
    at -5/s, were there no latency."""
    lag, pole = parameters.motor_time_constant, 5.0
    acceleration = dynamics.angular_acceleration(state, jnp.zeros(4), parameters)
    attitude = rotations.to_attitude(state.quaternion)
    jerk = -3 * pole * acceleration - 3 * pole**2 * state.body_rates - pole**3 * attitude
    full = parameters.mass * parameters.gravity * parameters.thrust_to_weight
    lever = jnp.stack(
        [
            jnp.mean(jnp.abs(parameters.rotor_y)),
            jnp.mean(jnp.abs(parameters.rotor_x)),
            parameters.torque_to_thrust,
        ]
    )
    turning = (acceleration + lag * jerk) * parameters.inertia / (full * lever)
    climb = jnp.sum(
        jnp.array([-0.1, -0.05]) * jnp.stack([state.velocity[2], state.position[2] - 1.0])
    )
    return jnp.concatenate([climb[None], jnp.clip(turning, -0.1, 0.1)]) @ AXES


@partial(jax.jit, static_argnums=0)
def _fly(world, parameters, additions, keys):
    state = dynamics.at_hover(world.task.reference(jnp.zeros(())), parameters)
    first = environment.begin(world, state, jnp.zeros(()), parameters, jax.random.key(0))

    def one(env_state, row):
        addition, key = row
        command = (
            dynamics.hover_command(parameters) + addition + stabilised(env_state.state, parameters)
        )
        after, _ = stepping.step(world, env_state, 2.0 * command - 1.0, parameters, key)
        return after, (env_state.state, after.actuators.ratio)

    return jax.lax.scan(one, first, (additions, keys))[1]


def logs(parameters, count=FLIGHTS, seed=0, strength=1.0):
    """Flights whose rows are the exact states and whose commands are exact and held; the motors are
    as noisy as the drone's. Without strength nothing excites them."""
    generator = np.random.default_rng(seed)
    flights = []
    for number in range(count):
        keys = jax.random.split(jax.random.key(1000 * seed + number), ROWS)
        additions = jnp.float32(strength) * jnp.asarray(excitation(generator))
        states, command = _fly(WORLD, parameters, additions, keys)
        flights.append(
            Flight(
                name=f"planted {number}",
                period=0.01,
                position=np.asarray(states.position),
                velocity=np.asarray(states.velocity),
                attitude=np.asarray(jax.vmap(rotations.to_attitude)(states.quaternion)),
                body_rates=np.asarray(states.body_rates),
                command=np.asarray(command),
                battery=np.full(ROWS, np.nan, np.float32),
                setpoint=np.full((ROWS, 3), np.nan, np.float32),
                zero_order_hold=True,
            )
        )
    return flights


def with_noise(flights, seed=0, velocity=0.01, rates=0.05):
    """The same flights with white noise on what was measured of velocity and body rates."""
    generator = np.random.default_rng(seed)

    def noisy(exact, size):
        return exact + generator.normal(0, size, exact.shape).astype(np.float32)

    return [
        dataclasses.replace(
            flight,
            velocity=noisy(flight.velocity, velocity),
            body_rates=noisy(flight.body_rates, rates),
        )
        for flight in flights
    ]


def lagged(command: np.ndarray, period: float, lag: float, latency: float) -> np.ndarray:
    """Speeds nu of rotors of a lag [s] whose commands come late, at each row and behind the last.

    They begin at the speed of the first command.

    Args:
        command: sqrt(u), held until the next row.
        period: of a row [s].
        lag: of the motors [s].
        latency: of the commands [s].
    """
    late = delay_command(command, latency / period)
    kept = np.exp(-period / lag)
    after = scipy.signal.lfilter([1 - kept], [1.0, -kept], late, axis=0, zi=kept * late[:1])[0]
    return np.concatenate([late[:1], after])
