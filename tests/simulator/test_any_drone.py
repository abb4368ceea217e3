"""Drones of any make, and a drone of any day, could be built and fill their ranges."""

import jax
import numpy as np
import pytest

from maidenflight import parameters
from maidenflight.parameters import QUANTITIES, crazyflie, replace
from maidenflight.simulator.any_drone import ANY_RANGES, MOST_THRUST, DayToDay, GenericQuadrotor
from maidenflight.simulator.physics.balance import balanced_shares
from maidenflight.simulator.randomization import randomize, wide_box

PAPER = crazyflie()
many = jax.jit(jax.vmap(randomize, (None, 0)))
KEYS = jax.random.split(jax.random.key(0), 2000)


def test_drones_of_any_make_could_be_built_and_fill_their_ranges():
    """Bodies of one shape: inertia over mass and arm squared does not depend on the size."""
    drawn = many(GenericQuadrotor(PAPER), KEYS)
    for number in range(20):
        parameters.check(jax.tree.map(lambda leaf, number=number: leaf[number], drawn))
    np.testing.assert_array_equal(drawn.gyro_noise, np.full(len(KEYS), PAPER.gyro_noise))
    for name in ("thrust_to_weight", "motor_time_constant", "spin_down_ratio", "latency"):
        low, high, _ = ANY_RANGES[name]
        values = np.asarray(getattr(drawn, name))
        assert np.all((values >= low) & (values <= high * (1 + 1e-6))), name
        assert np.ptp(values) > 0.95 * (high - low), name
    arm = np.hypot(drawn.rotor_x, drawn.rotor_y)
    np.testing.assert_allclose(arm, arm[:, :1] * np.ones(4), rtol=1e-5)
    heavier = np.asarray(drawn.mass) / PAPER.mass
    longer = arm[:, 0] / np.hypot(PAPER.rotor_x, PAPER.rotor_y)[0]
    shape = np.asarray(drawn.inertia) / PAPER.inertia / (heavier * longer**2)[:, None]
    assert np.all((shape > 0.7 - 1e-3) & (shape < 1.5 + 1e-3))
    assert abs(np.corrcoef(np.log(heavier), np.log(shape[:, 0]))[0, 1]) < 0.1
    weak = np.sort(np.asarray(drawn.rotor_thrust), axis=1)
    np.testing.assert_array_equal(weak[:, 1:], np.ones((len(KEYS), 3)))
    assert 0.45 < np.mean(weak[:, 0] < 1) < 0.55
    assert 0.8 <= weak.min() < 0.81
    thrust = np.asarray(drawn.thrust_to_weight * drawn.mass * drawn.gravity)
    trim = np.asarray(drawn.torque_bias) / thrust[:, None]
    assert np.abs(trim[:, :2] / arm[:, :1]).max() == pytest.approx(0.04, rel=0.02)
    assert np.abs(trim[:, 2] / drawn.torque_to_thrust).max() == pytest.approx(0.1, rel=0.02)
    assert "motor_time_constant ~ log U(0.015, 0.15) s" in str(GenericQuadrotor(PAPER))


@pytest.mark.slow
def test_a_drone_of_any_day_has_trims_payload_and_latency_about_its_own():
    box = wide_box(replace(PAPER, latency=0.04), "pwm")
    drawn = many(DayToDay(box), KEYS)
    for number in range(20):
        parameters.check(jax.tree.map(lambda leaf, number=number: leaf[number], drawn))
    np.testing.assert_array_equal(drawn.rotor_x, np.tile(PAPER.rotor_x, (len(KEYS), 1)))
    low, high = (np.asarray(side.mass) for side in (box.lower, box.upper))
    assert np.all((drawn.mass >= low) & (drawn.mass <= 1.2 * high))
    assert np.asarray(drawn.mass).max() > 1.15 * high
    assert np.asarray(drawn.latency).max() == np.float32(QUANTITIES["latency"].upper)
    assert np.asarray(drawn.latency).min() < 0.04
    # A payload changes neither thrust nor, in shares of it, the trims.
    force = np.asarray(drawn.thrust_to_weight * drawn.mass)
    lower, upper = (
        np.asarray(each.thrust_to_weight) * PAPER.mass for each in (box.lower, box.upper)
    )
    assert force.min() >= 0.9 * lower
    assert force.max() <= 1.1 * upper
    trim = np.asarray(drawn.torque_bias)[:, 2] / (force * PAPER.gravity * drawn.torque_to_thrust)
    assert np.abs(trim).max() == pytest.approx(0.1, rel=0.05)
    assert 0.45 < np.mean(np.asarray(drawn.rotor_thrust).min(axis=1) < 1) < 0.55
    assert "mass + U(0, 0.2) of it" in str(DayToDay(box))


@pytest.mark.parametrize("ratio", [1.4, 1.0])
def test_no_day_takes_the_thrust_to_hover_except_from_a_drone_that_has_none(ratio: float):
    """Trims, a weak rotor and a payload that leave less count as if the drone were stronger."""
    weak = replace(PAPER, thrust_to_weight=ratio)
    drawn = many(DayToDay(wide_box(weak, "attitude_rate")), KEYS)
    shares = np.asarray(jax.jit(jax.vmap(balanced_shares))(drawn)).max(axis=1)
    centre = wide_box(weak, "attitude_rate").centre
    most = max(MOST_THRUST, 1.0 / float(centre.thrust_to_weight))
    assert shares.max() == pytest.approx(most, rel=1e-3)
    assert (shares < 0.99 * most).any(), "the others are as they were drawn"
