"""From thrust command to rotor speed command."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from maidenflight.parameters import crazyflie, noiseless, replace
from maidenflight.simulator.physics import actuators
from maidenflight.simulator.physics.battery import AUTHORS, Supply

NOISY = replace(crazyflie(), actuator_noise=0.05, actuator_noise_rate=32.5)
actuate = jax.jit(actuators.actuate, static_argnums=5)
STILL = jnp.zeros(4)


@partial(jax.jit, static_argnums=2)
def noise(period, key, steps):
    """Many independent chains of the actuator noise, from zero."""

    def one(state, key):
        state = jax.vmap(partial(actuators.ornstein_uhlenbeck, elapsed=period, parameters=NOISY))(
            state, normal=jax.random.normal(key, (5000, 4))
        )
        return state, state

    return lax.scan(one, jnp.zeros((5000, 4)), jax.random.split(key, steps))[1]


@pytest.mark.slow
@pytest.mark.parametrize("period", [0.002, 0.01])
def test_the_noise_is_as_strong_and_as_slow_however_often_it_is_drawn(period):
    chains = np.asarray(noise(np.float32(period), jax.random.key(0), round(0.24 / period)))
    late, lag = chains[round(0.2 / period) - 1], round(0.02 / period)
    later = chains[round(0.2 / period) - 1 + lag]
    np.testing.assert_allclose(late.std(axis=0), 0.05, rtol=0.04)
    np.testing.assert_allclose(late.mean(axis=0), 0, atol=4 * 0.05 / np.sqrt(5000))
    correlation = [np.corrcoef(late[:, motor], later[:, motor])[0, 1] for motor in range(4)]
    np.testing.assert_allclose(correlation, np.exp(-32.5 * 0.02), atol=0.03)
    np.testing.assert_allclose(np.corrcoef(late.T), np.eye(4), atol=0.06)


def test_the_rotor_speed_command_is_the_square_root_with_a_finite_slope_at_zero():
    command = jnp.array([0.0, 0.25, 0.5, 1.0])
    np.testing.assert_allclose(actuators.rotor_speed_command(command), np.sqrt(command), rtol=1e-6)
    slope = jax.grad(lambda u: actuators.rotor_speed_command(u).sum())(command)
    np.testing.assert_allclose(slope, [0, 1, 1 / np.sqrt(2), 0.5], rtol=1e-6)


def test_noise_never_drives_a_command_out_of_its_range():
    memory = actuators.switched_on(jnp.float32(0.5), NOISY, Supply())
    loud = replace(NOISY, actuator_noise=0.5)
    found = [
        actuate(
            memory,
            jnp.array([0.0, 1.0, 0.0, 1.0]),
            np.float32(0.01),
            loud,
            jax.random.normal(jax.random.key(seed), (4,)),
            Supply(),
        )[1]
        for seed in range(20)
    ]
    assert np.min(found) == 0
    assert np.max(found) == 1


def test_without_noise_and_battery_the_command_passes_as_it_is():
    memory = actuators.switched_on(jnp.float32(0.5), NOISY, Supply())
    command = jnp.array([0.1, 0.4, 0.7, 0.9])
    memory, speed = actuate(memory, command, np.float32(0.01), noiseless(NOISY), STILL, Supply())
    np.testing.assert_allclose(speed, np.sqrt(command), rtol=1e-6)
    np.testing.assert_array_equal(memory.ratio, command)


def test_a_fresh_stiff_battery_changes_a_command_by_less_than_a_timer_step():
    quiet = noiseless(NOISY)
    command = jnp.array([0.1, 0.4, 0.7, 0.9])
    memory = actuators.switched_on(jnp.float32(0.5), quiet, AUTHORS)
    _, speed = actuate(memory, command, np.float32(0.01), quiet, STILL, AUTHORS)
    np.testing.assert_allclose(np.square(speed), command, atol=0.012)


def test_a_sagging_battery_weakens_a_sudden_command_until_the_firmware_has_seen_the_sag():
    weak = replace(noiseless(NOISY), battery_resistance=0.8)
    memory = actuators.switched_on(jnp.float32(0.2), weak, AUTHORS)
    command = jnp.full(4, 0.6)
    memory, first = actuate(memory, command, np.float32(0.01), weak, STILL, AUTHORS)
    later = first
    for _ in range(5):
        memory, later = actuate(memory, command, np.float32(0.01), weak, STILL, AUTHORS)
    assert np.all(np.square(first) < 0.58)
    np.testing.assert_allclose(np.square(later), 0.6, atol=0.012)


def test_a_battery_delivers_the_mean_ratio_over_time():
    quiet = noiseless(NOISY)
    memory = actuators.switched_on(jnp.float32(0.5), quiet, AUTHORS)
    after, _ = actuate(memory, jnp.full(4, 0.5), np.float32(0.01), quiet, STILL, AUTHORS)
    np.testing.assert_allclose(after.charge_drawn, 0.01 * np.mean(after.ratio), rtol=1e-5)
