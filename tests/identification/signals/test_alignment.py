"""Commands that a log holds late are moved back, and those that act late are not."""

from dataclasses import replace

import numpy as np
import pytest

from closed_loops import LATENCY, flown
from maidenflight.flights.log import Flight
from maidenflight.identification.signals.alignment import align_commands
from maidenflight.identification.signals.motor_response import estimate_motor_response
from maidenflight.parameters import crazyflie

LAG = 0.06


def late(flight: Flight, seconds: float) -> Flight:
    """The flight with commands that were logged so much too late."""
    rows = round(seconds / flight.period)
    return replace(flight.part(rows, len(flight)), command=flight.command[:-rows])


@pytest.mark.slow
def test_late_commands_are_moved_back_so_that_lag_and_inertia_are_right() -> None:
    flight = flown(1, LAG, answer=0.2)
    sound, moved = [flight], [late(flight, 0.02)]
    assert align_commands(sound, crazyflie()) == (sound, [])
    aligned, (warning,) = align_commands(moved, crazyflie())
    assert warning.kind == "command delay"
    assert warning.measured == pytest.approx(1e3 * (LATENCY - 0.02), abs=1.5)
    found, wrong, right = (
        estimate_motor_response(each, np.random.default_rng(0), crazyflie())
        for each in (aligned, moved, sound)
    )
    assert found is not None
    assert right is not None
    # What this loop made of them before is not its lag.
    assert wrong is None or np.median(wrong.lag) < 0.7 * LAG
    low, high = np.quantile(found.lag, [0.025, 0.975])
    assert low < LAG < high
    for name, samples in found.inertia_per_thrust.items():
        usual = np.median(right.inertia_per_thrust[name])
        assert np.median(samples) == pytest.approx(usual, rel=0.1)


def test_a_long_way_to_the_motors_and_measured_speeds_are_left_as_they_are() -> None:
    slow = [flown(1, LAG, latency=0.012)]
    assert align_commands(slow, crazyflie()) == (slow, [])
    measured = [late(flown(1, LAG, seconds=4.0, rotor_speed=True), 0.02)]
    assert align_commands(measured, crazyflie()) == (measured, [])
    assert align_commands([], crazyflie()) == ([], [])
