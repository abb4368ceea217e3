"""Controllers of the firmware: plans are flown as they ask, in any reality, and logged."""

import dataclasses

import jax
import numpy as np
import pytest

from maidenflight.flights import flight_plan
from maidenflight.flights.flight_plan import Block, FlightPlan
from maidenflight.flights.manoeuvres import MOTORS, Manoeuvre
from maidenflight.flying.firmware_pilot import dither
from maidenflight.flying.recording import fly_plans, record_plan
from maidenflight.identification.design.flight_limits import extremes_of, worst_of
from maidenflight.simulator.realities.virtual_drone import virtual_drone
from numpy_drone import NumpyDrone

DRONE = virtual_drone(3)
PLAN = FlightPlan(
    (Block(Manoeuvre("steps_yaw", 0.5, 2.0), 2.0), Block(Manoeuvre("steps_x", 0.2, 1.0), 2.0)),
    (2.0, 2.0, 1.5),
    0.8,
)
SHAKEN = dataclasses.replace(
    PLAN, blocks=(Block(Manoeuvre("hover"), 2.0), Block(Manoeuvre(MOTORS, 0.06), 2.0))
)


@pytest.fixture(scope="module")
def flown():
    first, second = jax.random.split(jax.random.key(0))
    calm = flight_plan.hovering(SHAKEN)
    keys = jax.numpy.stack([first, second, second])
    return [one.rows for one in fly_plans(DRONE, [PLAN, SHAKEN, calm], keys, "2021.10")]


@pytest.mark.slow
def test_the_drone_turns_and_moves_where_the_plan_says_so(flown):
    yaw = np.asarray(flown[0].true_attitude[:, 2])
    position = np.asarray(flown[0].true_position)
    assert yaw[450:500].mean() == pytest.approx(0.5, abs=0.1)
    assert yaw[950:1000].mean() == pytest.approx(-0.5, abs=0.1)
    assert np.abs(yaw[1400:]).max() < 0.1
    assert np.abs(position[:1500, 0]).max() < 0.1
    assert position[1500:2500, 0].max() > 0.08
    assert position[1500:2500, 0].min() < -0.08
    assert position[:, 2] == pytest.approx(0.8, abs=0.1)


@pytest.mark.slow
def test_motors_are_excited_where_the_plan_says_so_alone(flown):
    added = np.asarray(flown[1].ratio) - np.asarray(flown[2].ratio)
    np.testing.assert_array_equal(added[:1490], 0.0)
    assert np.abs(added[1520:2500]).mean() > 0.01


@pytest.mark.slow
def test_extremes_are_of_the_true_flight(flown):
    found = extremes_of(flown[0])
    assert found.lateral_x == pytest.approx(np.abs(flown[0].true_position[:, 0]).max())
    assert found.lowest <= 0.8 <= found.highest
    assert 0.0 < found.tilt < 0.6
    assert 0.2 <= found.astray < 0.6
    assert -0.01 <= found.sunk <= found.astray
    assert 0.0 <= found.at_limits < 0.1
    other = extremes_of(flown[1])
    both = worst_of([found, other])
    assert both.lowest == min(found.lowest, other.lowest)
    assert both.highest == max(found.highest, other.highest)
    lost = flown[0]._replace(true_position=np.full_like(flown[0].true_position, np.nan))
    assert extremes_of(lost).lateral_x > 100.0


@pytest.mark.slow
def test_a_recorded_plan_is_a_log_like_any_other():
    log, again = (record_plan(DRONE, PLAN, jax.random.key(5), 3, 100)[0] for _ in range(2))
    assert (len(log), log.period) == (600, 0.01)
    np.testing.assert_array_equal(log.position, again.position)
    setpoint = log.setpoint
    assert setpoint is not None
    np.testing.assert_allclose(setpoint, PLAN.setpoints()[:, :3], atol=1e-6)


@pytest.mark.slow
def test_another_reality_flies_it_by_motors_or_by_positions():
    short = dataclasses.replace(PLAN, blocks=(Block(Manoeuvre("steps_yaw", 0.4, 2.0), 1.0),))
    log = record_plan(NumpyDrone(), short, jax.random.key(0))[0]
    assert log.attitude[400:500, 2].mean() == pytest.approx(0.4, abs=0.15)


def test_dither_is_plus_or_minus_one_and_new_every_46_ms():
    signs = np.asarray(dither(460, jax.random.key(4)))
    assert (signs.shape, signs.dtype) == ((21, 4), np.float32)
    np.testing.assert_array_equal(np.abs(signs), 1.0)
    assert 0.3 < (signs[1:, 0] != signs[:-1, 0]).mean() < 0.7
