"""The firmware's battery compensation, its 8-bit timer and the way back from a logged ratio."""

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arrays import float32, float64
from hypothesis import given

from maidenflight.parameters import crazyflie, replace
from maidenflight.simulator import battery

commands = st.tuples(*[st.floats(0, 1, width=32)] * 4).map(float32)
voltages = st.floats(3.0, 4.25, width=32).map(float32)
motor_ratio = jax.jit(battery.motor_ratio)
thrust_command = jax.jit(battery.thrust_command)


def needed_volts(command):
    """Motor voltage that the firmware computes for u."""
    grams = 60 * (60000 / 65536) * float64(command)
    return -0.0006239 * grams**2 + 0.088 * grams


@pytest.mark.parametrize(
    ("command", "voltage", "steps"),
    # mot = floor256(min(volts / bat, 1) * 65535), reckoned by hand: u = 1 is 54.93 g and 2.951 V, u
    # = 0.5 is 27.47 g and 1.946 V.
    [
        (1.0, 4.2, 179),
        (1.0, 3.2, 236),
        (0.5, 3.7, 134),
        (0.5, 4.2, 118),
        (0.25, 3.0, 93),
        (0.0, 3.7, 0),
        (1.0, 2.6, 255),
    ],
)
def test_the_ratio_is_the_firmwares(command, voltage, steps):
    found = battery.motor_ratio(np.full(4, command, np.float32), float32(voltage))
    np.testing.assert_array_equal(found, float32(steps / 256))


@given(commands, voltages)
def test_the_ratio_is_within_one_timer_step_of_the_law(command, voltage):
    exact = needed_volts(command) / voltage * 65535 / 256
    found = np.asarray(motor_ratio(command, voltage)) * 256
    assert np.all(found == np.floor(found))
    assert np.all((found <= exact + 0.01) & (exact - 1.01 < found))


@given(commands, voltages)
def test_command_to_ratio_and_back_is_within_one_timer_step(command, voltage):
    back = thrust_command(motor_ratio(command, voltage), voltage)
    np.testing.assert_array_less(
        np.abs(needed_volts(back) - needed_volts(command)) / voltage, 1 / 256
    )


@given(commands, voltages)
def test_ratio_to_command_and_back_is_the_same_ratio(command, voltage):
    ratio = motor_ratio(command, voltage)
    again = motor_ratio(thrust_command(ratio, voltage), voltage)
    inside = np.asarray(thrust_command(ratio, voltage)) < 1
    np.testing.assert_array_equal(np.asarray(again)[inside], np.asarray(ratio)[inside])


@given(commands, voltages)
def test_numpy_and_jax_agree(command, voltage):
    ratio = motor_ratio(command, voltage)
    np.testing.assert_allclose(battery.motor_ratio(command, voltage), ratio, atol=1.001 / 256)
    np.testing.assert_allclose(
        battery.thrust_command(np.asarray(ratio), voltage),
        thrust_command(ratio, voltage),
        atol=1e-5,
    )
    assert isinstance(battery.thrust_command(np.asarray(ratio), voltage), np.ndarray)


def test_a_low_battery_saturates_and_has_less_thrust_than_commanded():
    full = np.ones(4, np.float32)
    ratio = battery.motor_ratio(full, float32(2.6))
    np.testing.assert_array_equal(ratio, float32(255 / 256))
    np.testing.assert_array_less(battery.thrust_command(ratio, float32(2.6)), 0.85)
    np.testing.assert_array_less(battery.motor_ratio(full, float32(3.2)), 255 / 256)


def test_a_motor_that_is_off_gives_no_thrust():
    np.testing.assert_array_equal(battery.thrust_command(np.zeros(4, np.float32), float32(3.7)), 0)


def test_thrust_grows_with_ratio_and_stays_in_range_at_any_voltage():
    ratio = jnp.arange(256.0) / 256
    for voltage in (2.0, 3.0, 3.7, 4.2, 60.0):
        found = np.asarray(battery.thrust_command(ratio, jnp.float32(voltage)))
        assert np.all(np.diff(found) >= 0)
        assert found[0] == 0
        assert np.all((found >= 0) & (found <= 1))


def test_the_voltage_sags_with_load_and_falls_with_charge():
    parameters = replace(
        crazyflie(), battery_voltage=4.0, battery_resistance=0.5, battery_discharge=0.01
    )
    found = battery.voltage(jnp.float32(20.0), jnp.array([0.2, 0.4, 0.6, 0.8]), parameters)
    np.testing.assert_allclose(found, 4.0 - 0.01 * 20 - 0.5 * 0.5, rtol=1e-6)
