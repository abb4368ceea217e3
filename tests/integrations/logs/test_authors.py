"""The authors' logs: commands recovered through the battery, flights told apart, and the signs and
units that we believe in."""

import gzip

import numpy as np
import pytest

from made_flights import AUTHORS, authors_columns, authors_text, motors, volts
from maidenflight.errors import InputError
from maidenflight.flights import tables
from maidenflight.flights.reading import read_flights
from maidenflight.integrations.logs import authors


def read(text, name="made"):
    return [flight for flight, _ in authors.flights(tables.from_text(text, name))[0]]


def one(columns):
    (flight,) = read(authors_text(columns))
    return flight


def test_the_command_is_recovered_within_one_step_of_the_timer():
    columns = authors_columns()
    u, battery = (np.clip(columns[:, 12:16], -1, 1) + 1) / 2, columns[:, 20]
    flight = one(columns)
    slope = (volts(u + 1e-6) - volts(u - 1e-6)) / 2e-6
    step = battery[:, None] / 256 / slope
    free = motors(u, battery) < 65280
    assert free.mean() > 0.5
    assert (np.abs(flight.command - u)[free] <= step[free] + 1e-4).all()
    assert np.abs(flight.command - u)[free].mean() < 0.5 * step[free].mean()


def test_a_saturated_motor_is_credited_with_what_the_battery_could_give():
    weak = authors_columns()
    weak[:, 20] = 2.75
    wanted = (np.clip(weak[:, 12:16], -1, 1) + 1) / 2
    weak[:, 16:20] = motors(wanted, weak[:, 20])
    command = one(weak).command.astype(np.float64)
    full = volts(wanted) > 2.75
    assert full.mean() > 0.05
    assert (np.abs(volts(command[full]) - 2.75) < 2.75 / 256).all()
    assert (command[full] < wanted[full] + 0.01).all()


def test_a_motor_that_is_off_has_no_command():
    columns = authors_columns()
    columns[:, 16:20] = 0.0
    assert (one(columns).command == 0).all()


def test_commands_of_a_network_that_drives_the_motors_are_held():
    assert one(authors_columns()).zero_order_hold


def test_commands_are_held_even_where_a_weak_battery_saturates_most_motors():
    weak = authors_columns()
    weak[:, 12:16] = np.float16(np.abs(weak[:, 12:16]))
    weak[:, 20] = 2.2
    weak[:, 16:20] = motors((np.clip(weak[:, 12:16], -1, 1) + 1) / 2, weak[:, 20])
    assert (weak[:, 16:20] == 65280).mean() > 0.5
    assert one(weak).zero_order_hold


def test_commands_of_a_cascade_below_the_network_are_samples_up_to_full_pwm():
    commanded = np.random.default_rng(1).uniform(0.3, 65535 / 60000, (400, 4))
    flight = one(authors_columns(commanded=commanded))
    assert not flight.zero_order_hold
    assert 1.08 < flight.command.max() <= np.float32(65535 / 60000)


def test_columns_keep_their_meaning():
    columns = authors_columns()
    flight = one(columns)
    rows = np.concatenate(
        [
            flight.position,
            flight.velocity,
            flight.attitude,
            flight.body_rates,
            flight.battery[:, None],
        ],
        axis=1,
    )
    np.testing.assert_array_equal(rows, np.float32(columns[:, [*range(12), 20]]))
    assert (flight.period, len(flight), flight.simulated) == (0.01, 400, "")


def test_columns_are_found_by_name_not_by_place():
    columns, names = authors_columns(), AUTHORS.split(",")
    order = np.random.default_rng(2).permutation(len(names))
    text = authors_text(columns[:, order]).replace(
        AUTHORS, ",".join(names[place] for place in order)
    )
    (flight,) = read(text)
    np.testing.assert_array_equal(flight.command, one(columns).command)
    np.testing.assert_array_equal(flight.position, one(columns).position)


@pytest.mark.parametrize("begins", [0.0101, 0.021])
def test_the_setpoint_is_the_circle_that_began_with_the_clock(begins):
    flight = one(authors_columns(begins=begins))
    angle = 2 * np.pi * (round(100 * begins) + np.arange(400)) / 300
    expected = np.stack([0.25 - 0.25 * np.cos(angle), 0.25 * np.sin(angle), np.ones(400)], axis=1)
    np.testing.assert_allclose(flight.setpoint, expected, atol=1e-5)


def test_time_that_runs_backwards_begins_another_flight():
    first, second = authors_columns(rows=130, seed=1), authors_columns(rows=90, seed=2)
    flights = read(authors_text(np.concatenate([first, second])))
    assert [(len(flight), flight.name) for flight in flights] == [
        (130, "made part 1"),
        (90, "made part 2"),
    ]
    np.testing.assert_array_equal(flights[1].position, np.float32(second[:, :3]))
    np.testing.assert_array_equal(flights[1].setpoint, one(second).setpoint)


def test_a_missing_column_is_named():
    with pytest.raises(InputError, match="missing column mot3;"):
        read(authors_text(authors_columns()).replace("mot3", "mot4"))


@pytest.fixture(scope="module")
def real(shared_data):
    """All PWM flights."""
    return read_flights(shared_data / "authors" / "flights" / "pwm")


def moving_mean(values, rows):
    return np.stack(
        [np.convolve(column, np.full(rows, 1 / rows), mode="valid") for column in values.T], axis=1
    )


def correlation(one, other):
    return np.corrcoef(np.concatenate(one), np.concatenate(other))[0, 1]


@pytest.mark.slow
def test_every_real_pwm_file_is_read(real):
    assert len(real.paths) == 108
    assert len({path.parent for path in real.paths}) == 36
    assert len(real) > 60
    assert all(not flight.simulated and flight.period == 0.01 for flight in real)


@pytest.mark.slow
def test_every_real_pwm_flight_holds_its_commands(real):
    assert [flight.name for flight in real if not flight.zero_order_hold] == []


def test_the_real_command_is_the_networks_own(shared_data):
    files = sorted((shared_data / "authors" / "flights" / "pwm").rglob("*.csv.gz"))[::9]
    assert len(files) == 12
    for file in files:
        text = gzip.decompress(file.read_bytes()).decode()
        table = np.loadtxt(text.splitlines()[1:], delimiter=",", ndmin=2)
        network, motor = table[:, 12:16], table[:, 16:20]
        error = (
            np.concatenate([flight.command for flight in read(text, file.name)])
            - (np.clip(network, -1, 1) + 1) / 2
        )
        assert np.median(np.abs(error[motor < 65280])) < 0.005, file


@pytest.mark.slow
def test_real_velocity_is_the_change_of_position(real):
    rows = 15
    long = [flight for flight in real if len(flight) > 300]
    slopes = [(flight.position[rows:] - flight.position[:-rows]) / (rows * 0.01) for flight in long]
    means = [moving_mean((flight.velocity[1:] + flight.velocity[:-1]) / 2, rows) for flight in long]
    for axis, least in enumerate((0.85, 0.85, 0.9)):
        assert (
            correlation([slope[:, axis] for slope in slopes], [mean[:, axis] for mean in means])
            > least
        )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("axis", "signs", "lag", "least"),
    [(0, [-1, -1, 1, 1], 4, 0.5), (1, [-1, 1, 1, -1], 4, 0.5), (2, [-1, 1, -1, 1], 0, 0.4)],
)
def test_real_motors_turn_the_drone_the_way_of_the_papers_torques(real, axis, signs, lag, least):
    accelerations, torques = [], []
    for flight in real:
        rate = moving_mean(flight.body_rates[:, axis : axis + 1], 9)[:, 0]
        torque = moving_mean(flight.command @ np.array(signs)[:, None], 9)[:, 0]
        accelerations.append(np.gradient(rate)[lag:])
        torques.append(torque[: len(torque) - lag])
    assert correlation(accelerations, torques) > least


@pytest.mark.slow
def test_a_real_nose_that_points_down_accelerates_forward(real):
    tilts, accelerations = [], []
    for flight in real:
        roll, pitch, yaw = flight.attitude.T
        forward = 9.81 * (np.cos(yaw) * np.tan(pitch) + np.sin(yaw) * np.tan(roll))
        tilts.append(moving_mean(forward[:, None], 9)[:, 0])
        accelerations.append(np.gradient(moving_mean(flight.velocity[:, :1], 9)[:, 0]) / 0.01)
    assert correlation(tilts, accelerations) > 0.7
