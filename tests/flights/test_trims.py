"""Trims: what balances the means of a flight is what acts on the drone."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from made_flights import calm
from maidenflight.flights.trims import (
    ENOUGH_FLIGHTS,
    Trim,
    between_flights,
    hover_command,
    trim,
)
from maidenflight.parameters import crazyflie, replace
from maidenflight.simulator.physics import dynamics

torques = st.floats(-2e-3, 2e-3)


@given(st.tuples(torques, torques, torques.map(lambda torque: torque / 10)), st.floats(1.5, 2.2))
def test_a_drone_that_hovers_tells_its_thrust_and_its_torques(bias, ratio):
    drone = replace(crazyflie(), thrust_to_weight=ratio, torque_bias=jnp.array(bias))
    # The command at which thrust carries the weight and the rotors cancel the bias.
    unit = np.eye(4)
    effect = np.stack(
        [[float(part) for part in dynamics.torque(jnp.array(one), drone)] + [1.0] for one in unit],
        axis=1,
    )
    wanted = [*(-np.array(bias)), float(drone.mass * drone.gravity)]
    forces = np.linalg.solve(effect, wanted)
    command = forces / float(drone.mass * drone.gravity / 4 * drone.thrust_to_weight)
    still = np.zeros((200, 3), np.float32)
    flight = calm(200, command=np.float32(np.tile(command, (200, 1))))
    flight = dataclasses.replace(flight, velocity=still, attitude=still, body_rates=still)
    found = trim([flight], crazyflie())
    assert found.thrust_to_weight == pytest.approx(ratio, rel=1e-4)
    np.testing.assert_allclose(found.torque_bias, bias, atol=1e-7, rtol=1e-3)
    np.testing.assert_allclose(found.command, command, rtol=1e-5)
    assert found.battery == pytest.approx(3.7)


def test_the_hover_command_carries_the_weight_whatever_drone_flies():
    still = np.zeros((200, 3), np.float32)
    flight = calm(200, command=np.full((200, 4), 0.57, np.float32))
    flight = dataclasses.replace(flight, velocity=still, attitude=still, body_rates=still)
    assert hover_command(flight)[0] == pytest.approx(0.57)
    tilted = np.float32(np.tile([np.arccos(0.9), 0.0, 0.0], (200, 1)))
    command, error = hover_command(dataclasses.replace(flight, attitude=tilted))
    assert command == pytest.approx(0.9 * 0.57)
    assert error == pytest.approx(0.0, abs=1e-6)


def test_what_a_log_lacks_is_not_known_and_short_flights_have_no_error():
    flight = calm(60, attitude=np.full((60, 3), np.nan, np.float32))
    found = trim([flight], crazyflie())
    assert np.isnan([found.thrust_to_weight, found.thrust_to_weight_error]).all()
    assert np.isfinite(found.torque_bias).all()
    assert np.isnan(found.torque_bias_error).all()
    off = trim([calm(80, command=np.zeros((80, 4), np.float32))], crazyflie())
    assert np.isnan(off.thrust_to_weight)
    assert np.isnan(trim([calm(30)], crazyflie()).torque_bias).all()
    assert (trim([calm(400)], crazyflie()).torque_bias_error > 0).all()


def test_a_flight_in_pieces_tells_what_it_tells_whole():
    flight = calm(400)
    whole = trim([flight], crazyflie())
    pieces = trim([flight.part(0, 200), flight.part(200, 400), calm(30)], crazyflie())
    error = whole.torque_bias_error
    # A piece does not say how fast its rotors were before it.
    assert (np.abs(pieces.torque_bias - whole.torque_bias) < error).all()
    np.testing.assert_allclose(pieces.torque_bias_error, error, rtol=0.2)
    assert pieces.thrust_to_weight == pytest.approx(whole.thrust_to_weight, rel=2e-3)


def test_thrust_is_that_of_the_speeds_which_motors_reach():
    # Steps faster than the motors: what carries is the square of the mean speed, not the mean of
    # the commands; rotors that slow down late keep more.
    drone = replace(crazyflie(), motor_time_constant=0.1, latency=0.0)
    high, low = 0.9, 0.3
    steps = np.where(np.arange(1000) % 2, high, low)[:, None]
    still = np.zeros((1000, 3), np.float32)
    flight = calm(1000, command=np.float32(np.tile(steps, 4)))
    flight = dataclasses.replace(
        flight, velocity=still, attitude=still, body_rates=still, zero_order_hold=True
    )
    carried = ((np.sqrt(high) + np.sqrt(low)) / 2) ** 2
    assert trim([flight], drone).thrust_to_weight == pytest.approx(1 / carried, rel=3e-3)
    late = trim([flight], replace(drone, motor_coasting=0.2)).thrust_to_weight
    assert late < 0.97 / carried
    curved = replace(drone, thrust_linear=0.2)
    assert trim([flight], curved).thrust_to_weight < 0.99 / carried


def seen(generator, deviations, errors, known=True):
    """What a flight shows whose k_F and torques are so far from the mean, and not well known."""
    values = np.array([1.8, 1e-5, -2e-5, 5e-5]) + generator.normal(size=4) * np.hypot(
        deviations, errors
    )
    shown = errors if known else np.full(4, np.nan)
    return Trim(values[0], values[1:], shown[0], shown[1:], np.full(4, 0.6), 3.9)


def test_how_flights_differ_is_told_beyond_what_is_not_known_of_each():
    generator = np.random.default_rng(3)
    deviations, errors = np.array([0.05, 1e-4, 2e-4, 8e-5]), np.array([0.03, 1e-4, 1e-4, 2e-5])
    flights = [seen(generator, deviations, errors) for _ in range(4000)]
    unknown = seen(generator, 1e3 * deviations, errors, known=False)
    found = between_flights([*flights, unknown])
    assert found is not None
    np.testing.assert_allclose(found, deviations, rtol=0.1)
    assert between_flights([*flights[: ENOUGH_FLIGHTS - 1], unknown]) is None
    alike = between_flights([seen(generator, 0.0 * deviations, errors) for _ in range(4000)])
    assert alike is not None
    np.testing.assert_array_less(alike, 0.3 * errors)
