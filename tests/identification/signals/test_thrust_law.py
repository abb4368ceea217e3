"""Thrust that stops following its curve is found, and one that follows it is left alone."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.signal import lfilter

from made_flights import calm
from maidenflight.flights.log import Flight
from maidenflight.identification.likelihood.sensor_signals import low_pass
from maidenflight.identification.signals.thrust_law import (
    ThrustLaw,
    beyond,
    note_unexplained,
    thrust_law,
)
from maidenflight.parameters import crazyflie
from maidenflight.parameters import replace as replace_values

PERIOD, LAG = 0.004, 0.03


def punched(knee: float, slope: float, seed: int = 0, sag: float = 0.0) -> Flight:
    """A flight about hover with full throttle now and then, of thrust 12 g at full speed.

    Beyond a speed its rotors gain only a share of what commands ask for, and its battery sags by
    a share at full throttle, to which they are in proportion.
    """
    generator, rows = np.random.default_rng(seed), 9000
    speed = 0.29 + 0.04 * np.repeat(generator.normal(size=rows // 50), 50)
    for start in range(500, rows, 1500):
        speed[start : start + 100] = 1.0
    kept = np.exp(-PERIOD / LAG)
    turned = lfilter([1 - kept], [1.0, -kept], np.minimum(speed, knee + slope * (speed - knee)))
    force = 12 * 9.81 * np.asarray(turned) ** 2 + 0.5 * generator.normal(size=rows)
    share = 1.0 - sag * np.asarray(turned)
    force *= share**2
    command = np.repeat((speed**2)[:, None], 4, axis=1).astype(np.float32)
    across = np.zeros(rows)
    return replace(
        calm(rows=rows, command=command, zero_order_hold=True),
        period=PERIOD,
        accelerometer=np.column_stack([across, across, force]).astype(np.float32),
        accelerometer_delay=0.0,
        battery=(16.0 * share).astype(np.float32),
        by_battery_law=False,
    )


def test_motors_at_their_limit_are_found() -> None:
    law = thrust_law([punched(0.6, 0.25)], LAG)
    assert law.limit in (0.6, 0.7, 0.8, 0.9)
    assert law.volts is None
    assert len(law.notes()) == 1


@pytest.mark.parametrize("seed", range(3))
def test_one_curve_is_no_limit(seed: int) -> None:
    assert thrust_law([punched(2.0, 1.0, seed)], LAG) == ThrustLaw()
    assert ThrustLaw().notes() == []


def test_a_battery_that_sags_is_in_the_law() -> None:
    flight = punched(2.0, 1.0, sag=0.4)
    law = thrust_law([flight], LAG)
    assert law.volts == pytest.approx(float(np.median(flight.battery)))
    assert np.isinf(law.limit)
    ratio = law.read([flight])[0].command / flight.command
    assert_allclose(ratio[:, 0], (flight.battery / law.volts) ** 2, rtol=1e-5)
    assert len(law.notes()) == 1


def test_what_no_law_explains_is_said() -> None:
    flights, law = [punched(2.0, 1.0)], ThrustLaw()
    drone = replace_values(crazyflie(), thrust_to_weight=12.0, motor_time_constant=LAG)
    assert note_unexplained(flights, law, drone) == []
    assert note_unexplained(flights, law, replace_values(drone, thrust_to_weight=10.0)) != []


def test_what_a_command_beyond_the_limit_acts_on_comes_after_it() -> None:
    command = np.zeros(100)
    command[40] = 1.0
    rows = np.flatnonzero(beyond(command, 0.9, 0.05))
    assert_array_equal(rows, np.arange(40, 50))
    assert_array_equal(beyond(command[:, None], 0.9, 0.05)[:, 0], beyond(command, 0.9, 0.05))


@pytest.mark.parametrize("delay", [0.0125, 0.0225, 0.05])
def test_a_slow_filter_is_late_by_its_delay(delay: float) -> None:
    ramp = np.arange(300)[:, None] * 0.01
    late = (ramp - low_pass(ramp, delay, 0.01))[-1, 0]
    assert late == pytest.approx(delay, rel=1e-3)
