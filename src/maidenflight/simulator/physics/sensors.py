"""Sensors: a noisy, optionally late estimate of the state, gyro and accelerometer."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax import lax
from jaxtyping import Array, Float

from maidenflight.parameters import Parameters
from maidenflight.simulator.physics import rotations
from maidenflight.simulator.physics.dynamics import State
from maidenflight.simulator.physics.vectors import like


class Measurement(NamedTuple):
    """The state as the controller and the policy see it."""

    position: Float[Any, "3"]
    """World [m]."""
    velocity: Float[Any, "3"]
    """World [m/s]."""
    quaternion: Float[Any, "4"]
    """Body to world, x, y, z, w."""
    body_rates: Float[Any, "3"]
    """[rad/s]."""


NORMALS, UNIFORMS = 9, 6
"""Random numbers of one `measure`."""
DRIFT_NORMALS = 3
"""Random numbers of one `walk_estimate`."""
ACCELEROMETER_CUTOFF = 30.0
"""Cut-off of a Crazyflie's accelerometer filter, Butterworth of second order [Hz] (firmware,
sensors_bmi088_bmp3xx.c)."""
ACCELEROMETER_NOISE = 0.5
"""Standard deviation of a reading before the filter, at 500 Hz [m/s2]: motors' vibration, of the
size between 20 and 40 Hz in logs of a brushed Crazyflie (IMRCLab 2026)."""
TURNING = 2.0
"""Roll and pitch rate together at which the variance of steps of horizontal drift has doubled
[rad/s], beside what `turn_drift` moves. In the authors' flights 2.5 under PWM, 1.8 under
attitude-rate and 1.9 under attitude policies, and at rest 0.038, 0.039 and 0.039 m/sqrt(s)."""
DRIFT_TIME = 1.0
"""Correlation time of the error of the estimated velocity [s]; a flight log of seconds cannot
distinguish it from a pure random walk. As one measurement corrects both, turns move the position by
so many times what they move the velocity: 1.1 s in the authors' flights."""
TURN_LEAD = 0.031
"""By which the drift of turns is ahead of the tilt [s]: the flow is older than the gyro's reading
that is taken off. In the authors' flights 0.030 to 0.034 s whatever the control structure."""


def turn_on_bias(parameters: Parameters, normal: Float[Array, "3"]) -> Float[Array, "3"]:
    """Draws the gyro bias [rad/s] at power-on.

    Args:
        parameters: uses `gyro_turn_on_bias`.
        normal: draws from the standard normal distribution.

    Source: Furrer et al. 2016 (RotorS), gyroscope model.
    """
    return parameters.gyro_turn_on_bias * normal


def walk_bias(
    bias: Float[Array, "3"],
    elapsed: Float[Array, ""],
    parameters: Parameters,
    normal: Float[Array, "3"],
) -> Float[Array, "3"]:
    """Returns the gyro's bias after some time, a Gauss-Markov process exact at any time step.

    Source: Furrer et al. 2016 (RotorS): sigma_b^2 tau / 2 (1 - exp(-2 t / tau)).
    """
    tau = parameters.gyro_bias_time
    decay = jnp.exp(-elapsed / tau)
    deviation = parameters.gyro_bias_walk * jnp.sqrt(-tau / 2 * jnp.expm1(-2 * elapsed / tau))
    return decay * bias + deviation * normal


def drifts(parameters: Parameters) -> bool:
    """Tests whether the estimates of position and velocity drift, as those of a real drone."""
    walks = parameters.position_walk, parameters.height_walk, parameters.velocity_walk
    return any(bool(np.any(np.asarray(walk) > 0)) for walk in walks)


def walk_factor(body_rates: Float[Any, "... 3"]) -> Float[Any, "..."]:
    """Returns how much further horizontal estimates walk while the drone turns.

    Args:
        body_rates: [rad/s].

    Source: ours; see `TURNING`.
    """
    return (1.0 + (body_rates[..., 0] ** 2 + body_rates[..., 1] ** 2) / TURNING**2) ** 0.5


def lean_rates(state: State) -> tuple[Float[Any, "..."], Float[Any, "..."]]:
    """Returns how fast the body's z axis moves along world x and y [1/s].

    Source: R (omega x z).
    """
    (x, y, _), (p, q, _) = rotations.axes(state.quaternion), state.body_rates
    return x[0] * q - y[0] * p, x[1] * q - y[1] * p


def way_of_turn(now: Any, then: Any, change: Any, elapsed: Any) -> Any:
    """Returns how far a turn moves an estimate, over `turn_drift` [rad].

    Args:
        now: lean rate at the end [1/s].
        then: lean rate at the beginning [1/s].
        change: of the lean rate between the two [1/s].
        elapsed: time between the two [s].

    Source: see `walk_estimate` and `TURN_LEAD`.
    """
    return (now + then) * (0.5 * elapsed) + change * TURN_LEAD


def walk_estimate(
    drift: Float[Array, "6"],
    elapsed: Float[Array, ""],
    parameters: Parameters,
    normal: Float[Array, "3"],
    state: State,
) -> Float[Array, "6"]:
    """Draws the drift of the estimated position [m] and velocity [m/s] after some time.

    What a Kalman filter's measurement corrects moves both alike: in the authors' flights the steps
    of horizontal position and velocity correlate by 0.92 to 0.97.

    The position error integrates the velocity error. The error of an estimator without a position
    sensor, such as that of optical flow, is a random walk, which a policy follows. White noise of
    the size between two rows of a log averages out within a few rows and does not model this.

    Optical flow sees a turn as motion. Of firmwares that take more than the turn off, or its gyro's
    reading of another instant, tilts move the estimate: by `turn_drift` times the tilt.

    Args:
        drift: errors of position and velocity before.
        elapsed: time between the two [s].
        parameters: uses `position_walk`, `height_walk`, `velocity_walk` and `turn_drift`.
        normal: draws from the standard normal distribution.
        state: the drone.

    Source: ours; sizes and spectrum from the authors' flights (docs/identification.md). Crazyflie
    firmware, mm_flow.c: earlier versions take 1.25 times the gyro's rate off (`omegaFactor`).
    """
    further, tilt = walk_factor(state.body_rates), (*lean_rates(state), 0.0)
    decay, root = jnp.exp(-elapsed / DRIFT_TIME), jnp.sqrt(elapsed)
    across, height = parameters.position_walk, parameters.height_walk
    # By entries: of vectors put together XLA's own choice makes loops that take three times as long
    # for a whole step.
    normals = normal[0] * further, normal[1] * further, normal[2]
    turned = [parameters.turn_drift * elapsed * rate for rate in tilt]
    velocity = [
        decay * before + parameters.velocity_walk * root * step + turn / DRIFT_TIME
        for before, step, turn in zip(drift[3:], normals, turned, strict=True)
    ]
    position = [
        before + elapsed * after + walk * root * step + turn
        for before, after, walk, step, turn in zip(
            drift[:3], velocity, (across, across, height), normals, turned, strict=True
        )
    ]
    return jnp.stack([*position, *velocity])


def estimate_after_turn(
    before: State, after: State, elapsed: Float[Array, ""], parameters: Parameters
) -> State:
    """Returns the estimate of a state, as a turn since a right one has moved it.

    Args:
        before: where the estimate was right.
        after: the state now.
        elapsed: time between the two [s].
        parameters: uses `turn_drift`.

    Source: see `way_of_turn`.
    """
    moved = [
        way_of_turn(now, then, now - then, elapsed) * parameters.turn_drift
        for now, then in zip(lean_rates(after), lean_rates(before), strict=True)
    ]
    moved = like(after.position, [*moved, 0.0 * after.position[2]])
    return after._replace(
        position=after.position + moved, velocity=after.velocity + moved * (1.0 / DRIFT_TIME)
    )


def add_drift(
    estimate: State, drift: Float[Array, "6"], parameters: Parameters, state: State
) -> State:
    """Returns an estimate of position and velocity with its drift.

    Args:
        estimate: without it.
        drift: of `walk_estimate`.
        parameters: uses `turn_drift`.
        state: the drone.

    Source: see `walk_estimate` and `TURN_LEAD`.
    """
    ahead = like(state.position, [*lean_rates(state), 0.0]) * (parameters.turn_drift * TURN_LEAD)
    return estimate._replace(
        position=estimate.position + drift[:3] + ahead,
        velocity=estimate.velocity + drift[3:] + ahead / DRIFT_TIME,
    )


def low_pass(
    filtered: Float[Array, "3"],
    before: Float[Array, "3"],
    after: Float[Array, "3"],
    elapsed: Float[Array, ""],
    parameters: Parameters,
) -> Float[Array, "3"]:
    """Returns the gyro's low-pass filter after some time: tau_g dy/dt = omega - y.

    Exact for body rates that change linearly.

    Args:
        filtered: y before [rad/s].
        before: body rates before [rad/s].
        after: body rates now [rad/s].
        elapsed: time between the two [s].
        parameters: uses `gyro_time_constant` tau_g [s]; 0 is no filter.
    """
    decay = jnp.exp(-elapsed / jnp.maximum(parameters.gyro_time_constant, 1e-6))
    behind = (after - before) * (parameters.gyro_time_constant / elapsed)
    return after - behind + decay * (filtered - before + behind)


def gyro_noise(
    before: Float[Array, "3"],
    elapsed: Float[Array, ""],
    parameters: Parameters,
    normal: Float[Array, "3"],
) -> Float[Array, "3"]:
    """Returns the noise of the gyro's next reading [rad/s].

    White noise behind a Butterworth filter of second order: two readings 2 ms apart have most of it
    in common, two 10 ms apart none. An autoregression of first order, whose coefficient is the
    filtered noise's autocorrelation, has it right from each reading to the next. It matters to rate
    PIDs, whose derivative takes the difference of two readings 2 ms apart.

    Args:
        before: that of the reading before.
        elapsed: time between the two [s].
        parameters: uses `gyro_noise` and `gyro_cutoff`.
        normal: draws from the standard normal distribution.

    Source: Crazyflie firmware, sensors_bmi088_bmp3xx.c. In ten logs of two Crazyflies (IMRCLab
        2026) what the gyro reads above 30 Hz correlates by 0.59 to 0.69 over 2 ms; here by 0.69.
    """
    phase = np.float32(np.sqrt(2.0) * np.pi) * parameters.gyro_cutoff * elapsed
    filtered = jnp.exp(-phase) * (jnp.cos(phase) + jnp.sin(phase))
    correlation = jnp.where(parameters.gyro_cutoff > 0.0, filtered, 0.0)
    rest = jnp.sqrt(1.0 - correlation * correlation)
    return correlation * before + rest * parameters.gyro_noise * normal


def measure(
    state: State,
    parameters: Parameters,
    normal: Float[Array, "9"],
    uniform: Float[Array, "6"],
) -> Measurement:
    """Returns one noisy reading of the state.

    Position and attitude carry Gaussian and uniform noise, velocity Gaussian noise. The attitude
    noise is a small rotation in the body frame, which for small tilt is what adding noise to roll,
    pitch and yaw does, and has no singular attitude. Where a ranger measures the height, its noise
    is less by as much as its drift: in the authors' flights 0.3 mm, along the ground 4 mm.

    Args:
        state: what is read; its body rates are what the gyro reads.
        parameters: uses the noise fields, `position_walk` and `height_walk`.
        normal: draws from the standard normal distribution.
        uniform: draws from the uniform distribution on [-1, 1].

    Source: Gronauer et al. 2022, sec. Simulation Environment, Noise.
    """
    across, height = parameters.position_walk, parameters.height_walk
    vertical = jnp.where(height < across, height / jnp.maximum(across, 1e-12), 1.0)
    share = like(state.position, [1.0, 1.0, vertical])
    tilt = parameters.attitude_noise * normal[6:9] + parameters.attitude_noise_uniform * uniform[3:]
    quaternion = state.quaternion + rotations.quaternion_derivative(state.quaternion, tilt)
    return Measurement(
        position=state.position
        + parameters.position_noise * share * normal[:3]
        + parameters.position_noise_uniform * uniform[:3],
        velocity=state.velocity + parameters.velocity_noise * share * normal[3:6],
        quaternion=rotations.normalise(quaternion),
        body_rates=state.body_rates,
    )


def accelerometer(
    velocity: Float[np.ndarray, "N 3"],
    attitude: Float[np.ndarray, "N 3"],
    period: float,
    gravity: float,
    generator: np.random.Generator,
) -> Float[np.ndarray, "N 3"]:
    """Returns what an accelerometer behind its low-pass filter reads in a flight [m/s2].

    Args:
        velocity: true velocity, world [m/s].
        attitude: true roll, pitch and yaw [rad].
        period: time between rows [s], at most 1/60 s.
        gravity: [m/s2].
        generator: random numbers for the noise.

    Returns:
        Specific force along body x, y and z.
    """
    change = np.gradient(velocity, period, axis=0)
    rotation = scipy.spatial.transform.Rotation.from_euler("ZYX", attitude[:, ::-1])
    force = rotation.inv().apply(change + np.array([0.0, 0.0, gravity]))
    noise = ACCELEROMETER_NOISE * np.sqrt(1.0 / (500.0 * period))
    read = force + noise * generator.standard_normal(force.shape)
    filters = scipy.signal.butter(2, ACCELEROMETER_CUTOFF, fs=1.0 / period, output="sos")
    rest = scipy.signal.sosfilt_zi(filters)[:, :, None] * force[:1]
    return scipy.signal.sosfilt(filters, read, axis=0, zi=rest)[0]


def remember(past: Float[Array, "memory 10"], state: State) -> Float[Array, "memory 10"]:
    """Puts the newest position, velocity and quaternion in front and drops the oldest."""
    newest = jnp.concatenate([state.position, state.velocity, state.quaternion])
    return jnp.concatenate([newest[None], past[:-1]])


def delayed(
    past: Float[Array, "memory 10"], state: State, period: Float[Array, ""], parameters: Parameters
) -> State:
    """Returns the state with its position, velocity and attitude `estimator_delay` old.

    Interpolated between remembered instants.

    Args:
        past: memory, newest first, one row an estimate; row 0 is the present.
        state: the present; its body rates stay, because the gyro is read afresh.
        period: time between two estimates [s].
        parameters: uses `estimator_delay` [s], at most (memory - 1) periods.
    """
    age = jnp.clip(parameters.estimator_delay / period, 0.0, past.shape[0] - 1.0)
    shares = jnp.clip(1.0 - jnp.abs(jnp.arange(past.shape[0], dtype=jnp.float32) - age), 0.0, 1.0)
    late = shares @ past
    return state._replace(
        position=late[:3], velocity=late[3:6], quaternion=rotations.normalise(late[6:])
    )


def draw_noise(
    key: Array, normals: int, uniforms: int
) -> tuple[Float[Array, "normals"], Float[Array, "uniforms"]]:
    """Draws independent random numbers.

    Args:
        key: random key.
        normals: how many of the standard normal distribution; the inverse error function of uniform
            ones, as in JAX.
        uniforms: how many of the uniform distribution on [-1, 1).
    """
    least = np.nextafter(np.float32(-1.0), np.float32(0.0))
    numbers = jax.random.uniform(key, (normals + uniforms,), minval=least, maxval=1.0)
    return np.float32(np.sqrt(2)) * lax.erf_inv(numbers[:normals]), numbers[normals:]
