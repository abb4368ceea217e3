"""What rotors do under the commands of a log."""

import dataclasses

import numpy as np
import pytest
import scipy
from hypothesis import given
from hypothesis import strategies as st

from made_flights import calm
from maidenflight.flights.trims import BEGIN_S, rotors
from maidenflight.parameters import crazyflie, replace

STEADY = np.full((60, 4), 0.5)


def flown(command, drone):
    """Motors of a drone under one command a row, held until the next."""
    flight = calm(len(command), command=np.float32(command))
    return rotors(dataclasses.replace(flight, zero_order_hold=True), drone)


@given(st.floats(0.02, 0.2), st.floats(0.2, 0.9))
def test_a_step_is_followed_with_the_motors_lag(lag, high):
    drone = replace(crazyflie(), motor_time_constant=lag, latency=0.02)
    found = flown(np.concatenate([STEADY, np.full((100, 4), high)]), drone)
    # The step arrives two rows late; row k ends at k + 1.
    seconds = 0.01 * np.maximum(np.arange(160) + 1 - 62, 0)
    before, after = np.sqrt(0.5), np.sqrt(high)
    wanted = after + (before - after) * np.exp(-seconds / lag)
    np.testing.assert_allclose(found.speed, np.tile(wanted[:, None], 4), atol=2e-3)


def test_thrust_is_the_mean_over_a_row_of_the_thrust_curve():
    drone = replace(
        crazyflie(),
        thrust_linear=0.2,
        thrust_offset=0.05,
        rotor_thrust=[1, 1, 0.8, 1],
        latency=0.0,
    )
    found = flown(np.concatenate([STEADY, np.full((100, 4), 0.9)]), drone)
    edges = np.concatenate([[found.speed[0]], found.speed])
    curve = 0.05 + 0.2 * edges + 0.75 * edges**2
    wanted = [1, 1, 0.8, 1] * scipy.ndimage.uniform_filter1d(curve, 2, axis=0)[1:]
    np.testing.assert_allclose(found.thrust, wanted, atol=1e-3)


def test_rows_without_commands_have_no_speed_and_the_last_command_lasts():
    command = np.full((80, 4), 0.5)
    command[30:40] = np.nan
    found = flown(command, crazyflie())
    assert np.isnan(found.speed[30:40]).all()
    assert np.isnan(found.thrust[30:40]).all()
    np.testing.assert_allclose(
        np.delete(found.speed, np.s_[30:40], axis=0), np.sqrt(0.5), atol=1e-5
    )
    assert np.isnan(flown(np.full((80, 4), np.nan), crazyflie()).thrust).all()


def test_a_piece_begins_with_the_mean_of_its_first_commands():
    rows = round(BEGIN_S / 0.01)
    command = np.full((80, 4), 0.36)
    command[0] = 0.0
    found = flown(command, replace(crazyflie(), latency=0.0))
    mean = 0.6 * (rows - 1) / rows
    assert found.speed[0, 0] == pytest.approx(mean, abs=0.1)
    assert found.speed[0, 0] < mean
