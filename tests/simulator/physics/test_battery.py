"""The firmware's battery compensation, its 8-bit timer and the way back from a logged ratio."""

from functools import partial
from pathlib import Path

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given

from arrays import float32, float64
from maidenflight.parameters import crazyflie, replace
from maidenflight.simulator.physics import battery

commands = st.tuples(*[st.floats(0, 1, width=32)] * 4).map(float32)
voltages = st.floats(3.0, 4.25, width=32).map(float32)
AUTHORS = battery.AUTHORS
motor_ratio = jax.jit(partial(battery.motor_ratio, supply=AUTHORS))
thrust_command = jax.jit(partial(battery.thrust_command, supply=AUTHORS))


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
    found = battery.motor_ratio(np.full(4, command, np.float32), float32(voltage), AUTHORS)
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
    inside = np.asarray(thrust_command(ratio, voltage)) < 65535 / 60000
    np.testing.assert_array_equal(np.asarray(again)[inside], np.asarray(ratio)[inside])


@given(commands, voltages)
def test_numpy_and_jax_agree(command, voltage):
    ratio = motor_ratio(command, voltage)
    np.testing.assert_allclose(
        battery.motor_ratio(command, voltage, AUTHORS), ratio, atol=1.001 / 256
    )
    np.testing.assert_allclose(
        battery.thrust_command(np.asarray(ratio), voltage, AUTHORS),
        thrust_command(ratio, voltage),
        atol=1e-5,
    )
    assert isinstance(battery.thrust_command(np.asarray(ratio), voltage, AUTHORS), np.ndarray)


def test_a_low_battery_saturates_and_has_less_thrust_than_commanded():
    full = np.ones(4, np.float32)
    ratio = battery.motor_ratio(full, float32(2.6), AUTHORS)
    np.testing.assert_array_equal(ratio, float32(255 / 256))
    np.testing.assert_array_less(battery.thrust_command(ratio, float32(2.6), AUTHORS), 0.85)
    np.testing.assert_array_less(battery.motor_ratio(full, float32(3.2), AUTHORS), 255 / 256)


def test_thrust_grows_with_ratio_and_stays_in_range_at_any_voltage():
    ratio = jnp.arange(256.0) / 256
    for voltage in (2.0, 3.0, 3.7, 4.2, 60.0):
        found = np.asarray(battery.thrust_command(ratio, jnp.float32(voltage), AUTHORS))
        assert np.all(np.diff(found) >= 0)
        assert found[0] == 0
        assert np.all((found >= 0) & (found <= 65535 / 60000))


def test_the_voltage_sags_with_load_and_falls_with_charge():
    parameters = replace(
        crazyflie(), battery_voltage=4.0, battery_resistance=0.5, battery_discharge=0.01
    )
    found = battery.voltage(jnp.float32(20.0), jnp.array([0.2, 0.4, 0.6, 0.8]), parameters)
    np.testing.assert_allclose(found, 4.0 - 0.01 * 20 - 0.5 * 0.5, rtol=1e-6)


TRACES = Path(__file__).parents[4] / "shared/data/firmware/pid_trace.npz"
TABLES = {
    "2.1+ propellers": "battery/bat_comp_CRAZYFLIE_21_PLUS",
    "legacy propellers": "battery/bat_comp_CRAZYFLIE_LEGACY_PROPELLERS",
    "thrust upgrade": "battery/bat_comp_CRAZYFLIE_THRUST_UPGRADE_KIT",
    "firmware of 2021": "fw2021/battery_comp",
}
TODAYS = [law for law in battery.LAWS.values() if law.capped_together]


@pytest.mark.parametrize("law", battery.LAWS)
def test_the_laws_are_the_compiled_firmwares(law):
    if not TRACES.exists():
        pytest.skip(f"{TRACES}: recordings of the real firmware are not here")
    with np.load(TRACES) as traces:
        counts, voltage, real = (
            traces[name].astype(float)
            for name in ("battery/bat_thrust_in", "battery/bat_voltage", TABLES[law])
        )
    of, volts = battery.LAWS[law], np.broadcast_to(voltage, real.shape)
    found = 65535 * np.where(counts[:, None] < of.least_counts, 0, of.volts(counts)[:, None])
    ours = found / volts
    seen = (real < 65535) & (volts >= 2)  # Below, the firmware of 2021 does not compensate.
    np.testing.assert_allclose(ours[seen], real[seen], rtol=1e-4, atol=2)  # compiled in float32
    assert seen.mean() > 0.5


@pytest.mark.parametrize("law", TODAYS, ids=lambda law: law.name)
def test_counts_to_volts_and_back_are_the_same_counts(law):
    counts = np.linspace(7000, 160_000, 200, dtype=np.float32)
    np.testing.assert_allclose(law.counts(law.volts(counts)), counts, rtol=1e-4)
    assert np.all(np.diff(law.volts(counts)) > 0)


def test_full_pwm_is_far_above_full_scale_and_follows_the_voltage():
    # crazyflie.md of the reference, read in the real firmware: 122,000 counts at 3.9 V, 90,600 at
    # 3.5 V.
    found = battery.PLUS.counts(np.array([3.9, 3.5]))
    np.testing.assert_allclose(found, [122_000, 90_600], rtol=0.005)


def test_commands_above_1_are_flown_and_the_cap_lowers_all_four_motors():
    supply = battery.Supply(battery.PLUS, 65535.0, battery=True)
    command, volts = float32([0.5, 1.2, 0.8, 0.3]), float32(3.9)
    ratio = battery.motor_ratio(command, volts, supply)
    np.testing.assert_allclose(battery.thrust_command(ratio, volts, supply), command, atol=0.015)
    low = float32(3.2)
    lowered = battery.motor_ratio(command, low, supply)
    free = battery.PLUS.volts(command * 65535) / low
    np.testing.assert_allclose(lowered, free - (free.max() - 1), atol=1.01 / 256)


def test_a_motor_is_off_below_7000_counts_of_todays_firmware_only():
    command, volts = float32([0.105, 0.108, 0.5, 0.0]), float32(3.9)
    for battery_sags in (True, False):
        supply = battery.Supply(battery.PLUS, 65535.0, battery_sags)
        turning = np.asarray(battery.motor_ratio(command, volts, supply)) > 0
        np.testing.assert_array_equal(turning, [False, True, True, False])
    assert np.all(battery.motor_ratio(command, volts, AUTHORS)[:3] > 0)


def test_without_a_battery_commands_end_where_a_nominal_one_ends():
    command, volts = float32([0.5, 1.2, 3.0, 1.0]), float32(3.9)
    plain = battery.motor_ratio(command, volts, battery.Supply())
    np.testing.assert_array_equal(plain, float32([0.5, 1, 1, 1]))
    today = battery.Supply(battery.PLUS, 65535.0)
    most = battery.PLUS.counts(np.float64(3.7)) / 65535
    np.testing.assert_allclose(
        battery.motor_ratio(command, volts, today), [0.5, 1.2, most, 1.0], rtol=1e-6
    )
