"""What the sensors add to the truth: noise of a given strength, a bias that walks and an estimate
of a given age."""

from functools import partial

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from jax import lax
from scipy.signal import butter, sosfilt
from scipy.spatial.transform import Rotation

from arrays import float32, float64
from maidenflight.parameters import crazyflie, noiseless, replace
from maidenflight.simulator.physics import rotations, sensors
from maidenflight.simulator.physics.dynamics import State

PAPER = crazyflie()
SAMPLES = 20_000
NORMAL = jax.random.normal(jax.random.key(0), (SAMPLES, sensors.NORMALS))
UNIFORM = jax.random.uniform(
    jax.random.key(1), (SAMPLES, sensors.UNIFORMS), minval=-1.0, maxval=1.0
)
STATE = State(
    jnp.array([0.1, 0.2, 1.0]),
    jnp.array([0.5, -0.5, 0.1]),
    rotations.from_attitude(jnp.array([0.2, -0.3, 1.0])),
    jnp.array([1.0, -2.0, 0.5]),
    jnp.full(4, 0.7),
)
measure_many = jax.jit(jax.vmap(sensors.measure, (None, None, 0, 0)))
shake_many = jax.jit(jax.vmap(sensors.gyro_noise, (0, None, None, 0)))
walk_many = jax.jit(jax.vmap(sensors.walk_bias, (0, None, None, 0)))
walk = jax.jit(sensors.walk_bias)
delayed = jax.jit(sensors.delayed)


def test_without_noise_the_measurement_is_the_truth():
    seen = measure_many(STATE, noiseless(PAPER), NORMAL, UNIFORM)
    for name in seen._fields:
        np.testing.assert_allclose(
            getattr(seen, name)[:5], np.tile(getattr(STATE, name), (5, 1)), atol=1e-6
        )


def test_noise_has_the_strength_of_the_parameters_and_no_mean():
    parameters = replace(PAPER, position_noise_uniform=0.004, attitude_noise_uniform=0.003)
    seen = measure_many(STATE, parameters, NORMAL, UNIFORM)
    tilt = (
        Rotation.from_quat(STATE.quaternion).inv() * Rotation.from_quat(np.asarray(seen.quaternion))
    ).as_rotvec()
    expected = {  # error, Gaussian part, half width of the uniform part
        "position": (seen.position - STATE.position[None], 0.002, 0.004),
        "velocity": (seen.velocity - STATE.velocity[None], 0.01, 0.0),
        "attitude": (tilt, np.radians(0.1), 0.003),
    }
    for name, (error, gaussian, uniform) in expected.items():
        deviation = np.sqrt(gaussian**2 + uniform**2 / 3)
        np.testing.assert_allclose(np.std(error, axis=0), deviation, rtol=0.03, err_msg=name)
        np.testing.assert_allclose(
            np.mean(error, axis=0), 0, atol=4 * deviation / np.sqrt(SAMPLES), err_msg=name
        )
        correlation = np.corrcoef(np.asarray(error).T)
        np.testing.assert_allclose(correlation, np.eye(3), atol=0.03, err_msg=name)


@pytest.mark.parametrize(
    ("cutoff", "apart"), [(80.0, 0.002), (80.0, 0.01), (30.0, 0.004), (0.0, 0.002)]
)
def test_the_gyros_noise_is_that_of_a_butterworth_filter_fed_with_white_noise(cutoff, apart):
    """SciPy's filter, run a hundred times as fast, is the reference."""
    parameters = replace(PAPER, gyro_cutoff=cutoff)
    keys = jax.random.split(jax.random.key(11), 5)
    before = noise = float(parameters.gyro_noise) * jax.random.normal(keys[0], (SAMPLES, 3))
    for key in keys[1:]:
        before, normal = noise, jax.random.normal(key, (SAMPLES, 3))
        noise = shake_many(before, float32(apart), parameters, normal)
    np.testing.assert_allclose(np.std(noise, axis=0), 0.051, rtol=0.03)
    expected = 0.0
    if cutoff:
        rate = 100.0 / apart
        once = np.eye(1, 20_000)[0]
        answer = np.asarray(sosfilt(butter(2, cutoff, fs=rate, output="sos"), once))
        expected = float(answer[100:] @ answer[:-100] / (answer @ answer))
    for axis in range(3):
        found = np.corrcoef(before[:, axis], noise[:, axis])[0, 1]
        assert found == pytest.approx(expected, abs=0.03)


def test_a_measured_quaternion_has_length_one():
    seen = measure_many(STATE, replace(PAPER, attitude_noise=0.5), NORMAL, UNIFORM)
    np.testing.assert_allclose(np.linalg.norm(seen.quaternion, axis=1), 1, atol=1e-6)


def test_the_bias_at_power_on_has_its_deviation():
    found = jax.jit(jax.vmap(sensors.turn_on_bias, (None, 0)))(PAPER, NORMAL[:, :3])
    np.testing.assert_allclose(np.std(found, axis=0), np.radians(0.5), rtol=0.03)


def walked_variance(steps, total, parameters):
    """Variance of a bias that walked `total` seconds in `steps` steps from zero, read off two calls
    with the same draws."""
    normal = jnp.array([1.5, -0.5, 1.0])
    apart = float32(total / steps)
    kept = float64(walk(jnp.ones(3), apart, replace(parameters, gyro_bias_walk=0.0), normal)[0])
    spread = float64(walk(jnp.zeros(3), apart, parameters, normal)[0] / normal[0])
    return spread**2 * sum(kept ** (2 * step) for step in range(steps))


@pytest.mark.parametrize("steps", [1, 10, 100])
@pytest.mark.parametrize("time_constant", [0.5, 2.0])
def test_the_bias_walks_as_far_in_many_steps_as_in_one(steps, time_constant):
    parameters = replace(PAPER, gyro_bias_time=time_constant, gyro_bias_walk=0.1)
    expected = 0.1**2 * time_constant / 2 * (1 - np.exp(-2 / time_constant))
    np.testing.assert_allclose(walked_variance(steps, 1.0, parameters), expected, rtol=1e-3)


@pytest.mark.parametrize(
    ("time_constant", "apart"),
    [(constant, apart) for constant in (1e3, 1e5) for apart in (0.01, 0.002, 0.001)],
)
def test_a_slow_bias_walks_as_far_in_short_steps(time_constant, apart):
    """At a control period over tau of 1e-5 and less, 1 - exp(-2 t / tau) must not be lost in
    float32."""
    parameters = replace(PAPER, gyro_bias_time=time_constant, gyro_bias_walk=0.1)
    found = walked_variance(1, apart, parameters)
    np.testing.assert_allclose(found, 0.1**2 * apart, rtol=1e-2)


def test_samples_of_the_walk_have_that_variance():
    parameters = replace(PAPER, gyro_bias_time=2.0, gyro_bias_walk=0.1)
    bias = jnp.zeros((SAMPLES, 3))
    for step in range(4):
        bias = walk_many(
            bias, float32(0.25), parameters, jax.random.normal(jax.random.key(step), (SAMPLES, 3))
        )
    np.testing.assert_allclose(np.std(bias, axis=0), 0.1 * np.sqrt(1 - np.exp(-1)), rtol=0.03)


@given(st.floats(0, 0.03), st.floats(0.008, 0.012))
def test_a_linear_motion_is_seen_exactly_as_old_as_the_estimator_delay(delay, period):
    velocity = float32([1.0, -2.0, 0.5])
    past = jnp.zeros((6, 10))
    state = STATE._replace(velocity=velocity)
    for instant in range(7):
        state = state._replace(position=float32(period * instant) * velocity)
        past = sensors.remember(past, state)
    seen = delayed(past, state, float32(period), replace(PAPER, estimator_delay=delay))
    np.testing.assert_allclose(seen.position, (6 * period - delay) * velocity, atol=2e-6)
    np.testing.assert_allclose(seen.velocity, velocity, atol=1e-6)
    np.testing.assert_allclose(seen.quaternion, STATE.quaternion, atol=1e-6)


def test_a_late_estimator_reads_the_gyro_afresh():
    past = jnp.zeros((6, 10)) + jnp.array([0, 0, 1.0, 0, 0, 0, 0, 0, 0, 1])[None]
    seen = delayed(past, STATE, float32(0.01), replace(PAPER, estimator_delay=0.03))
    np.testing.assert_array_equal(seen.body_rates, STATE.body_rates)
    np.testing.assert_array_equal(seen.position, [0, 0, 1])


low_pass = jax.jit(sensors.low_pass)


def test_the_gyro_filter_passes_a_constant_and_lags_behind_a_ramp_by_its_time_constant():
    parameters, period, rate = (
        replace(PAPER, gyro_time_constant=0.0028),
        float32(0.002),
        float32([10.0, -20.0, 5.0]),
    )
    filtered = after = jnp.zeros(3)
    for instant in range(20):
        before, after = after, (instant + 1) * period * rate
        filtered = low_pass(filtered, before, after, period, parameters)
    np.testing.assert_allclose(after - filtered, 0.0028 * rate, rtol=1e-4)
    for _ in range(30):
        filtered = low_pass(filtered, after, after, period, parameters)
    np.testing.assert_allclose(filtered, after, rtol=1e-5)


@given(st.floats(0.0005, 0.02), st.integers(1, 10))
def test_the_gyro_filter_is_exact_however_finely_time_is_cut(lag, pieces):
    """Against the closed form of a first-order lag behind a ramp from rest."""
    parameters, total = replace(PAPER, gyro_time_constant=lag), 0.01
    filtered = jnp.zeros(3)
    for piece in range(pieces):
        before, after = float32([piece / pieces] * 3), float32([(piece + 1) / pieces] * 3)
        filtered = low_pass(filtered, before, after, float32(total / pieces), parameters)
    expected = 1 - lag / total * (1 - np.exp(-total / lag))
    np.testing.assert_allclose(filtered, expected, atol=2e-5)


def test_without_a_lag_the_gyro_filter_is_none_and_its_slope_is_finite():
    after = jnp.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(
        low_pass(jnp.full(3, 9.0), jnp.zeros(3), after, float32(0.002), PAPER), after, rtol=1e-6
    )
    slope = jax.grad(
        lambda lag: low_pass(
            after, jnp.zeros(3), after, float32(0.002), replace(PAPER, gyro_time_constant=lag)
        ).sum()
    )(float32(0.0))
    assert np.isfinite(slope)


@partial(jax.jit, static_argnums=(1, 4))
def drifted(parameters, steps, elapsed, key, rates=(0.0, 0.0, 5.0)):
    """Errors of many estimates after each of some steps from none, steps x samples x 6."""
    many = jax.vmap(sensors.walk_estimate, (0, None, None, 0, None))
    level = STATE._replace(quaternion=jnp.array([0.0, 0.0, 0.0, 1.0]), body_rates=jnp.array(rates))

    def one(drift, key):
        normal = jax.random.normal(key, (SAMPLES, sensors.DRIFT_NORMALS))
        drift = many(drift, elapsed, parameters, normal, level)
        return drift, drift

    return lax.scan(one, jnp.zeros((SAMPLES, 6)), jax.random.split(key, steps))[1]


WALKS = (
    replace(PAPER, position_walk=0.08, height_walk=0.08, velocity_walk=0.0),
    replace(PAPER, position_walk=0.0, velocity_walk=0.3),
)


def test_a_walking_positions_variance_grows_with_time():
    """w_r^2 t, and no memory in its steps: the variance of later minus earlier is that of the time
    between."""
    walked = float64(drifted(WALKS[0], 50, float32(0.02), jax.random.key(3)))
    times = 0.02 * np.arange(1, 51)
    np.testing.assert_allclose(
        walked[..., :3].var(axis=1), 0.08**2 * np.tile(times[:, None], 3), rtol=0.05
    )
    np.testing.assert_allclose(
        (walked[49, :, :3] - walked[24, :, :3]).var(axis=0), 0.08**2 * 0.5, rtol=0.05
    )
    np.testing.assert_allclose(walked[49, :, :3].mean(axis=0), 0, atol=4 * 0.08 / np.sqrt(SAMPLES))
    np.testing.assert_array_equal(walked[..., 3:], 0.0)


def test_a_rangers_noise_is_less_by_as_much_as_its_drift():
    own = replace(
        PAPER, position_walk=0.04, height_walk=0.01, position_noise_uniform=0.0, velocity_noise=0.02
    )
    seen = measure_many(STATE, own, NORMAL, UNIFORM)
    np.testing.assert_allclose(
        float64(seen.position).std(axis=0), [0.002, 0.002, 0.0005], rtol=0.03
    )
    np.testing.assert_allclose(float64(seen.velocity).std(axis=0), [0.02, 0.02, 0.005], rtol=0.03)


def test_height_walks_by_itself():
    parameters = replace(PAPER, position_walk=0.08, height_walk=0.01, velocity_walk=0.0)
    walked = float64(drifted(parameters, 50, float32(0.02), jax.random.key(9)))[-1, :, :3]
    np.testing.assert_allclose(walked.std(axis=0), [0.08, 0.08, 0.01], rtol=0.05)
    rates = (0.6 * sensors.TURNING, 0.8 * sensors.TURNING, 5.0)
    turned = float64(drifted(parameters, 50, float32(0.02), jax.random.key(9), rates))[-1, :, :3]
    np.testing.assert_allclose(turned, np.sqrt([2.0, 2.0, 1.0]) * walked, atol=1e-6)


def test_one_measurement_moves_position_and_velocity_alike():
    parameters = replace(PAPER, position_walk=0.08, height_walk=0.01, velocity_walk=0.3)
    step = float64(drifted(parameters, 1, float32(0.01), jax.random.key(10)))[0]
    walks = np.array([0.08, 0.08, 0.01])
    np.testing.assert_allclose(
        step[:, :3], (walks / 0.3 + 0.01) * step[:, 3:], rtol=1e-4, atol=1e-7
    )
    np.testing.assert_allclose(np.corrcoef(step[:, 3:].T), np.eye(3), atol=0.03)


def test_a_velocitys_error_is_forgotten_within_its_time():
    """An Ornstein-Uhlenbeck process: variance w_v^2 tau / 2 (1 - exp(-2 t / tau)), correlation
    exp(-t / tau)."""
    tau = sensors.DRIFT_TIME
    walked = float64(drifted(WALKS[1], 150, float32(0.02), jax.random.key(4)))[..., 3:]
    for row in (9, 49, 149):
        expected = 0.3**2 * tau / 2 * (1 - np.exp(-2 * 0.02 * (row + 1) / tau))
        np.testing.assert_allclose(walked[row].var(axis=0), expected, rtol=0.05)
    for apart in (10, 50):
        kept = np.mean(walked[149] * walked[149 - apart], axis=0) / np.mean(
            walked[149 - apart] ** 2, axis=0
        )
        np.testing.assert_allclose(kept, np.exp(-0.02 * apart / tau), atol=0.03)


def test_the_positions_error_integrates_the_velocitys():
    walked = float64(drifted(WALKS[1], 50, float32(0.02), jax.random.key(5)))
    np.testing.assert_allclose(
        walked[..., :3], 0.02 * np.cumsum(walked[..., 3:], axis=0), atol=1e-6
    )
    assert walked[49, :, :3].std() > 0.1


@pytest.mark.parametrize("parameters", WALKS, ids=["position", "velocity"])
def test_an_estimate_walks_as_far_however_often_it_is_drawn(parameters):
    """Half a second in steps of 20 ms or of 10 ms: the same variances, and the same covariance of
    position and velocity."""
    coarse = float64(drifted(parameters, 25, float32(0.02), jax.random.key(6)))[-1]
    fine = float64(drifted(parameters, 50, float32(0.01), jax.random.key(7)))[-1]
    one, other = (
        sum(np.cov(some[:, [axis, axis + 3]].T) for axis in range(3)) / 3 for some in (coarse, fine)
    )
    np.testing.assert_allclose(one, other, rtol=0.06, atol=1e-9)


def leant(angle, rate=0.0):
    """A drone that leans by an angle to where a yaw of 0.4 rad has forward, and turns on."""
    attitude = rotations.from_attitude(jnp.array([0.0, angle, 0.4]))
    return STATE._replace(quaternion=attitude, body_rates=jnp.array([0.0, rate, 0.0]))


def test_tilts_move_an_estimate_by_so_many_metres_a_radian():
    """By turn_drift times the sine of the tilt, and ahead of it while the drone turns."""
    drone, rate, steps = replace(noiseless(PAPER), turn_drift=0.2), 1.5, 200
    elapsed, forward = 0.3 / rate / steps, np.array([np.cos(0.4), np.sin(0.4), 0.0])
    drift, estimates = jnp.zeros(6), []
    for step in range(steps):
        state = leant(rate * elapsed * (step + 0.5), rate)
        drift = sensors.walk_estimate(drift, float32(elapsed), drone, jnp.zeros(3), state)
        estimates.append(sensors.add_drift(state, drift, drone, state))
    np.testing.assert_allclose(drift[3:], 0.2 * np.sin(0.3) * forward, rtol=0.1)
    moved = 0.2 * (np.sin(0.3) + 1.5 * np.cos(0.3) * sensors.TURN_LEAD) * forward
    # The velocity's error adds a tenth within these 0.2 s.
    np.testing.assert_allclose(estimates[-1].position - STATE.position, moved, rtol=0.1, atol=1e-6)
    at_rest = sensors.add_drift(leant(0.3), drift, drone, leant(0.3))
    np.testing.assert_allclose(at_rest.position, STATE.position + drift[:3], rtol=1e-6)


def test_a_step_of_an_estimate_is_that_of_its_drift():
    drone, elapsed = replace(noiseless(PAPER), turn_drift=0.2), float32(0.01)
    before, after = leant(0.1, 1.0), leant(0.112, 1.4)
    expected = sensors.estimate_after_turn(before, after, elapsed, drone)
    drift = sensors.walk_estimate(jnp.zeros(6), elapsed, drone, jnp.zeros(3), leant(0.106, 1.2))
    here = sensors.add_drift(before, jnp.zeros(6), drone, before)
    there = sensors.add_drift(after, drift, drone, after)
    assert np.abs(there.velocity - here.velocity).max() > 0.003
    for name, atol in (("velocity", 1e-6), ("position", 5e-5)):
        ended, began, right = (getattr(state, name) for state in (there, here, before))
        np.testing.assert_allclose(getattr(expected, name), ended - (began - right), atol=atol)


def test_a_noiseless_drones_estimate_does_not_walk():
    quiet = noiseless(
        replace(PAPER, position_walk=0.08, height_walk=0.02, velocity_walk=0.3, turn_drift=0.2)
    )
    np.testing.assert_array_equal(
        drifted(quiet, 5, float32(0.02), jax.random.key(8), (1.0, 1.0, 5.0)), 0.0
    )
