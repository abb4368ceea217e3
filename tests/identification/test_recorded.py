"""Drones whose recorded flights are identified: what the intervals hold at 500 and at 100 Hz."""

import dataclasses
from functools import cache

import jax
import numpy as np
import pytest

from maidenflight.flights.log import thinned
from maidenflight.flying import recording
from maidenflight.identification.identify import identify
from maidenflight.identification.methods import Likelihood
from maidenflight.parameters import component, crazyflie, replace
from maidenflight.simulator.realities.virtual_drone import virtual_drone

DRONE = virtual_drone(4)
OVER = ("thrust_to_weight", "motor_time_constant", "latency", "spin_down_ratio", "inertia_x")


@cache
def flights():
    return tuple(recording.record(DRONE, jax.random.key(4), 2, 30.0, 0.06))


def identified(logs):
    start = replace(crazyflie(), mass=DRONE.parameters.mass)
    return identify(logs, Likelihood(trials=1), over=OVER, start=start)


def holds(estimate, name):
    low, high = estimate.interval
    return low <= float(component(DRONE.parameters, name)) <= high


@pytest.mark.night
def test_a_log_with_every_command_tells_a_lag_that_differs_up_and_down():
    estimates = identified(flights()).estimates
    assert {name for name in OVER if holds(estimates[name], name)} >= set(OVER) - {"latency"}
    assert estimates["spin_down_ratio"].interval[0] > 1.1
    assert estimates["latency"].value == pytest.approx(0.0065, abs=0.003)


@pytest.mark.slow
def test_with_missing_commands_the_inertia_is_told_widely_or_not_at_all():
    """Its noise alone would exclude the truth."""
    sparse = [dataclasses.replace(thinned(one, 5), accelerometer=None) for one in flights()]
    held = [dataclasses.replace(one, zero_order_hold=True) for one in sparse]
    honest, narrow = identified(sparse), identified(held).estimates
    told = honest.estimates.get("inertia_x")
    low, high = honest.unidentified["inertia_x"] if told is None else told.interval
    assert low <= float(component(DRONE.parameters, "inertia_x")) <= high
    assert high / low > 1.6
    assert not holds(narrow["inertia_x"], "inertia_x")
    lag = honest.estimates["motor_time_constant"]
    assert np.ptp(lag.interval) > 1.5 * np.ptp(narrow["motor_time_constant"].interval)
