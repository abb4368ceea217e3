"""What the drone knows of itself: a noisy, perhaps late estimate of its state, and a gyro with noise and bias."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from maidenflight.parameters import Parameters
from maidenflight.simulator import rotations
from maidenflight.simulator.dynamics import State


class Measurement(NamedTuple):
    """The state as the controller and the policy see it."""

    position: Float[Array, "3"]
    velocity: Float[Array, "3"]
    quaternion: Float[Array, "4"]
    body_rates: Float[Array, "3"]


def turn_on_bias(parameters: Parameters, key: Array) -> Float[Array, "3"]:
    """Gyro bias [rad/s] at power-on, constant over a flight but for its random walk.

    Source: Furrer et al. 2016 (RotorS), gyroscope model.
    """
    return parameters.gyro_turn_on_bias * jax.random.normal(key, (3,))


def walk_bias(bias: Float[Array, "3"], elapsed: Float[Array, ""], parameters: Parameters, key: Array) -> Float[Array, "3"]:
    """The gyro's bias after some time: a first-order Gauss-Markov process, exact at any time step.

    Source: Furrer et al. 2016 (RotorS): sigma_b^2 tau / 2 (1 - exp(-2 t / tau)).
    """
    tau = parameters.gyro_bias_time
    kept = jnp.exp(-elapsed / tau)
    spread = parameters.gyro_bias_walk * jnp.sqrt(-tau / 2 * jnp.expm1(-2 * elapsed / tau))
    return kept * bias + spread * jax.random.normal(key, (3,))


def gyro(body_rates: Float[Array, "3"], bias: Float[Array, "3"], parameters: Parameters, key: Array) -> Float[Array, "3"]:
    """Measured body rates [rad/s]: truth, bias and white noise."""
    return body_rates + bias + parameters.gyro_noise * jax.random.normal(key, (3,))


def measure(state: State, bias: Float[Array, "3"], parameters: Parameters, key: Array) -> Measurement:
    """One noisy reading of the state.

    Position and attitude carry Gaussian and uniform noise, velocity Gaussian noise. The attitude noise is a small rotation in
    the body frame, which for small tilt is what adding noise to roll, pitch and yaw does, and has no singular attitude.

    Source: Gronauer et al. 2022, sec. Simulation Environment, Noise.
    """
    gaussian_key, uniform_key, gyro_key = jax.random.split(key, 3)
    gaussian = jax.random.normal(gaussian_key, (9,))
    uniform = jax.random.uniform(uniform_key, (6,), minval=-1.0, maxval=1.0)
    tilt = parameters.attitude_noise * gaussian[6:] + parameters.attitude_noise_uniform * uniform[3:]
    turned = state.quaternion + rotations.quaternion_derivative(state.quaternion, tilt)
    return Measurement(
        position=state.position + parameters.position_noise * gaussian[:3] + parameters.position_noise_uniform * uniform[:3],
        velocity=state.velocity + parameters.velocity_noise * gaussian[3:6],
        quaternion=rotations.normalise(turned),
        body_rates=gyro(state.body_rates, bias, parameters, gyro_key),
    )


def remember(past: Float[Array, "memory 10"], state: State) -> Float[Array, "memory 10"]:
    """Puts the newest position, velocity and quaternion in front of an estimator's memory and forgets the oldest."""
    newest = jnp.concatenate([state.position, state.velocity, state.quaternion])
    return jnp.concatenate([newest[None], past[:-1]])


def delayed(past: Float[Array, "memory 10"], state: State, period: Float[Array, ""], parameters: Parameters) -> State:
    """The state with its position, velocity and attitude `estimator_delay` old, blended between remembered instants.

    Args:
        past: memory, newest first, one row a control period; row 0 is the present.
        state: the present; its body rates are kept, because the gyro is read afresh.
        period: control period [s].
        parameters: uses `estimator_delay` [s], at most (memory - 1) periods.
    """
    age = jnp.clip(parameters.estimator_delay / period, 0.0, past.shape[0] - 1.0)
    shares = jnp.clip(1.0 - jnp.abs(jnp.arange(past.shape[0], dtype=jnp.float32) - age), 0.0, 1.0)
    late = shares @ past
    return state._replace(position=late[:3], velocity=late[3:6], quaternion=rotations.normalise(late[6:]))
