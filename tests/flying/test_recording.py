"""Recording: the firmware's PID flies a virtual drone about the circle, and the log holds what a
real one would."""

from dataclasses import replace
from functools import partial

import jax
import numpy as np
import pytest

from made_flights import same, volts
from maidenflight.errors import InputError
from maidenflight.flights import flight_csv
from maidenflight.flights.checks import checking
from maidenflight.flights.flight_plan import Block, FlightPlan
from maidenflight.flights.manoeuvres import Manoeuvre
from maidenflight.flying import recording
from maidenflight.parameters import replace as with_values
from maidenflight.simulator.realities.virtual_drone import virtual_drone
from numpy_drone import NumpyDrone
from numpy_reference import PAPER
from planted import lagged

DRONE = virtual_drone(3)
SECONDS, FLIGHTS = 4.0, 2


def recorded(seed, excitation):
    return recording.record(DRONE, jax.random.key(seed), FLIGHTS, SECONDS, excitation)


@pytest.fixture(scope="module")
def flights():
    return recorded(1, 0.05)


@pytest.fixture(scope="module")
def plain():
    return recorded(1, 0.0)


def test_the_same_key_records_the_same_flights_and_another_key_others(flights):
    again, other = recorded(1, 0.05), recorded(2, 0.05)
    assert all(same(one, two) for one, two in zip(flights, again, strict=True))
    assert not any(same(one, two) for one, two in zip(flights, other, strict=True))
    assert not same(flights[0], flights[1])


def test_flights_are_marked_simulated_and_sampled(flights):
    assert [(f.name, f.simulated, f.zero_order_hold, f.period, len(f)) for f in flights] == [
        (f"flight_{number:02d}", "virtual:3", True, 0.002, 2000) for number in (1, 2)
    ]


def test_the_drone_stays_on_the_circle(flights, plain):
    for flight in [*flights, *plain]:
        radius = np.linalg.norm(flight.position[:, :2] - [0.25, 0.0], axis=1)
        assert np.abs(radius[500:] - 0.25).max() < 0.06
        assert np.abs(flight.position[:, 2] - 1.0).max() < 0.08
        assert np.ptp(flight.position[500:, 1]) > 0.4, "it goes round"


def test_the_setpoint_is_the_papers_circle(flights):
    angle = 2 * np.pi * np.arange(2000) / 1500
    expected = np.stack([0.25 - 0.25 * np.cos(angle), 0.25 * np.sin(angle), np.ones(2000)], axis=1)
    np.testing.assert_allclose(flights[0].setpoint, expected, atol=1e-4)


def test_the_logged_command_is_the_middle_of_a_step_of_the_motors_timer(flights):
    """What the battery law makes of the command is (ratio + 1/2) / 256 of the battery's voltage,
    exactly."""
    for flight in flights:
        steps = 256 * volts(np.float64(flight.command)) / flight.battery[:, None]
        whole = (flight.command > 0.001) & (flight.command < 0.999)
        assert whole.mean() > 0.99
        np.testing.assert_allclose(steps[whole] % 1, 0.5, atol=0.02)


def test_the_logged_battery_sags_with_the_motors(flights):
    for flight in flights:
        assert 3.3 < flight.battery.min() < flight.battery.max() < 4.2
        assert np.corrcoef(flight.battery[1:], flight.command[1:].mean(axis=1))[0, 1] < -0.5


def test_excitation_moves_the_motors_by_its_strength(flights, plain):
    """Every 46 ms the commands change by 0 or twice the strength; the PID alone moves them by far
    less than that at once."""

    def jump(flight):
        change = np.abs(np.diff(flight.command, axis=0)).mean(axis=1)
        return change[22::23].mean() - change[10::23].mean()

    for excited, calm in zip(flights, plain, strict=True):
        assert jump(excited) > 0.03
        assert abs(jump(calm)) < 0.01


def test_the_accelerometer_reads_gravity_at_rest_and_follows_thrust_behind_its_filter(flights):
    for flight in flights:
        assert flight.accelerometer.mean(axis=0) == pytest.approx([0.0, 0.0, 9.8], abs=0.15)
        lag = float(DRONE.parameters.motor_time_constant)
        push = np.square(lagged(flight.speed_command, flight.period, lag, 0.006))
        late = np.interp(np.arange(2000) - 3.75, np.arange(2001), push.mean(axis=1))
        seen = flight.accelerometer[200:, 2]
        assert np.corrcoef(late[200:], seen)[0, 1] > 0.75


def test_a_slower_log_holds_every_so_many_rows_and_another_rate_is_refused(flights):
    slow = recording.record(DRONE, jax.random.key(1), FLIGHTS, SECONDS, 0.05, rate=100)
    for one, other in zip(flights, slow, strict=True):
        assert (other.period, other.zero_order_hold, len(other)) == (0.01, False, 400)
        for group, values in other.arrays.items():
            np.testing.assert_array_equal(values, one.arrays[group][::5])
    plan = FlightPlan((Block(Manoeuvre("hover"), 2.0),), (2.0, 2.0, 1.5), 0.8)
    for record in (recording.record, partial(recording.record_plan, plan=plan)):
        with pytest.raises(InputError, match="120"):
            record(DRONE, key=jax.random.key(1), rate=120)


def test_a_recorded_flight_has_nothing_to_complain_about_and_survives_its_file(flights):
    for flight in flights:
        again = flight_csv.from_csv(flight_csv.to_csv(flight), flight.name)
        kept, notes = checking.pieces(again)
        assert (len(kept), len(kept[0]), notes) == (1, 2000, [])
        np.testing.assert_allclose(kept[0].command, flight.command, atol=1e-6)
        assert kept[0].simulated == "virtual:3"


@pytest.mark.slow
def test_todays_firmware_flies_commands_above_1_and_its_log_says_the_scale():
    strong = recording.record(DRONE, jax.random.key(1), 1, 2.0, 0.15, firmware="2026.08")[0]
    old = recording.record(DRONE, jax.random.key(1), 1, 2.0, 0.15)[0]
    assert (strong.full_scale_counts, old.full_scale_counts) == (65535.0, 60000.0)
    assert 1.2 < strong.command.max() < 2.5
    assert old.command.max() == pytest.approx(65535 / 60000, rel=1e-3)
    # Between a motor that is off and one at 7,000 counts there is none.
    assert not ((strong.command > 0) & (strong.command < 0.1)).any()
    kept, _ = checking.pieces(strong)
    assert sum(map(len, kept)) > 0.9 * len(strong)


@pytest.mark.parametrize("ratio", [5.0, 0.95])
def test_a_drone_that_the_pid_cannot_hold_is_refused_and_not_flown(ratio):
    strong = replace(DRONE, parameters=with_values(DRONE.parameters, thrust_to_weight=ratio))
    with pytest.raises(InputError, match="20000 to 65535"):
        recording.record(strong, jax.random.key(0), 1, 2.0)
    by_protocol = NumpyDrone(constants=PAPER | {"k_F": ratio})
    with pytest.raises(InputError, match="numpy"):
        recording.record(by_protocol, jax.random.key(0), 1, 2.0)
    assert not by_protocol.resets


@pytest.mark.slow
def test_mellinger_flies_the_circle_too_and_another_controller_is_refused():
    key = jax.random.key(1)
    (flight,) = recording.record(DRONE, key, 1, SECONDS, 0.0, controller="mellinger")
    error = np.linalg.norm(flight.position - flight.setpoint, axis=1)
    assert error[500:].max() < 0.08
    assert error[1500:].mean() < 0.05
    with pytest.raises(InputError, match="controller"):
        recording.record(DRONE, key, 1, SECONDS, 0.0, controller="lee")
