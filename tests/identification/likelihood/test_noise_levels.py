"""How noisy a drone is, from sequences of errors that NumPy makes of noise of known size."""

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter

from maidenflight.flights.log import Flight, flight_of
from maidenflight.identification.likelihood.noise_levels import (
    WALKS,
    against_tilt,
    correct_walks,
    drift_by_turns,
    noise_levels,
)
from maidenflight.identification.likelihood.one_step_errors import ORDER
from maidenflight.parameters import QUANTITIES, check, crazyflie, replace
from maidenflight.simulator.physics.sensors import TURN_LEAD, TURNING

PAPER = crazyflie()
PERIOD, ROWS = 0.01, 100_000
POSITION, VELOCITY, TURN = slice(0, 3), slice(3, 6), slice(9, 12)


def products(errors):
    """Mean products of each column with itself 0 ... P rows before."""
    late = np.array([errors[ORDER - lag : len(errors) - lag] for lag in range(ORDER + 1)])
    return np.einsum("itc,jtc->cij", late, late) / late.shape[1]


def white(generator, size):
    return size * generator.normal(size=(ROWS, 3))


def difference(readings):
    """What a reading's white noise adds to errors: it is in a row, and in the row that is predicted
    from it."""
    return np.diff(readings, axis=0, prepend=0.0)


def ornstein_uhlenbeck(generator, size, rate):
    kept = np.exp(-rate * PERIOD)
    return lfilter(
        [1.0], [1.0, -kept], size * np.sqrt(1 - kept**2) * generator.normal(size=(ROWS, 3)), axis=0
    )


def found(drone=PAPER, **columns):
    """Noise told from errors, and a little of it everywhere."""
    generator = np.random.default_rng(9)
    errors = 1e-6 * generator.normal(size=(ROWS, 12))
    for name, values in columns.items():
        errors[:, {"position": POSITION, "velocity": VELOCITY, "turn": TURN}[name]] += values
    return noise_levels(products(errors), drone, PERIOD)


@pytest.fixture(scope="module")
def generator():
    return np.random.default_rng(4)


def test_a_random_walk_is_as_strong_as_its_steps_add_up(generator):
    """Steps of w sqrt(t) each, by the definition of `position_walk` and `velocity_walk`."""
    told = found(
        position=white(generator, 0.08 * np.sqrt(PERIOD)),
        velocity=white(generator, 0.3 * np.sqrt(PERIOD)),
    )
    assert told["position_walk"] == pytest.approx(0.08, rel=0.15)
    assert told["velocity_walk"] == pytest.approx(0.3, rel=0.15)
    assert told["position_noise"] < 0.15 * 0.08 * np.sqrt(PERIOD)
    assert told["velocity_noise"] < 0.15 * 0.3 * np.sqrt(PERIOD)


def test_height_walks_as_a_ranger_errs_not_as_optical_flow(generator):
    steps = white(generator, 0.08 * np.sqrt(PERIOD)) * [1.0, 1.0, 0.1]
    told = found(position=steps)
    assert told["position_walk"] == pytest.approx(0.08, rel=0.15)
    assert told["height_walk"] == pytest.approx(0.008, rel=0.15)


def test_white_noise_of_a_reading_is_no_walk(generator):
    told = found(
        position=difference(white(generator, 0.002)), velocity=difference(white(generator, 0.02))
    )
    assert told["position_noise"] == pytest.approx(0.002, rel=0.15)
    assert told["velocity_noise"] == pytest.approx(0.02, rel=0.15)
    assert told["position_walk"] * np.sqrt(PERIOD) < 0.15 * 0.002
    assert told["velocity_walk"] * np.sqrt(PERIOD) < 0.15 * 0.02


def test_a_walk_and_white_noise_together_are_told_apart(generator):
    told = found(
        velocity=white(generator, 0.2 * np.sqrt(PERIOD)) + difference(white(generator, 0.02))
    )
    assert told["velocity_walk"] == pytest.approx(0.2, rel=0.15)
    assert told["velocity_noise"] == pytest.approx(0.02, rel=0.15)


@pytest.mark.slow
def test_a_gyros_noise_is_told_from_a_disturbance_that_lasts(generator):
    """Thrusts that wander by a share s of full thrust turn the body by 2 L / sqrt(2) s F / I, four
    independent rotors together."""
    drone = replace(PAPER, inertia=(1.6e-5, 1.6e-5, 2.6e-5), thrust_to_weight=1.9)
    full = 0.028 * 9.81 / 4 * 1.9
    turning = 2 * 0.0396 / np.sqrt(2) * full / 1.6e-5 * 0.02
    lasting = ornstein_uhlenbeck(generator, turning * PERIOD, 20.0)
    for gyro in (0.0, 0.05, 0.2):
        told = found(drone, turn=lasting + difference(white(generator, gyro)))
        assert told["gyro_noise"] == pytest.approx(gyro, rel=0.15, abs=0.15 * turning * PERIOD)
        assert told["actuator_noise"] == pytest.approx(0.02, rel=0.15)
        if gyro < 0.1:
            assert told["actuator_noise_rate"] == pytest.approx(20.0, rel=0.15)


@pytest.mark.parametrize("rate", [10.0, 32.5])
def test_how_fast_a_disturbance_forgets_is_read_off_its_covariance(generator, rate):
    told = found(turn=ornstein_uhlenbeck(generator, 0.3, rate))
    assert told["actuator_noise_rate"] == pytest.approx(rate, rel=0.15)


def test_what_is_found_makes_a_physical_drone(generator):
    for levels in (
        found(),
        found(turn=white(generator, 0.05), velocity=ornstein_uhlenbeck(generator, 0.01, 5.0)),
    ):
        assert set(levels) <= set(QUANTITIES)
        check(replace(PAPER, **{name: np.float32(value) for name, value in levels.items()}))


def tilting(generator, walk, tilt=None):
    """Forty seconds of a drone that goes where its tilt takes it, and an estimate that walks."""
    rows = 4000
    if tilt is None:
        tilt = 0.1 * np.sin(np.cumsum(0.05 * generator.normal(size=(rows, 2)), axis=0))
    velocity = np.cumsum(9.81 * tilt * PERIOD, axis=0)
    place = np.cumsum(velocity * PERIOD, axis=0)
    place += walk * np.sqrt(PERIOD) * np.cumsum(generator.normal(size=(rows, 2)), axis=0)
    attitude = np.stack([-tilt[:, 1], tilt[:, 0], 0 * tilt[:, 0]], axis=1)
    height = np.ones((rows, 1))
    return flight_of(
        "tilting",
        PERIOD,
        position=np.concatenate([place, height], axis=1),
        velocity=np.concatenate([velocity, 0 * height], axis=1),
        attitude=attitude,
        body_rates=np.zeros((rows, 3)),
        command=np.full((rows, 4), 0.5),
        zero_order_hold=True,
    )


def test_what_bends_a_path_without_a_tilt_is_a_walk(generator):
    assert against_tilt([tilting(generator, 0.08)]) == pytest.approx(0.08, rel=0.25)
    assert against_tilt([tilting(generator, 0.0)]) < 0.002


def turned(generator, walk, drift):
    """A drone that rocks at 2 and 3 Hz, with a gyro, and an estimate that turns move."""
    angle = 2.0 * np.pi * np.array([2.0, 3.0]) * PERIOD * np.arange(4000)[:, None]
    lean = 0.1 * np.sin(angle)
    flight = tilting(generator, walk, lean)
    change = np.gradient(lean, PERIOD, axis=0)
    rates = np.stack([-change[:, 1], change[:, 0], 0 * change[:, 0]], axis=1)
    moved = drift * (lean + TURN_LEAD * change)
    position = flight.position + np.pad(moved, ((0, 0), (0, 1)))
    return dataclasses.replace(flight, position=position, body_rates=rates)


def test_what_turns_move_is_told_from_what_walks(generator):
    for drift in (0.0, 0.2, -0.1):
        flights = [turned(generator, 0.04, drift) for _ in range(2)]
        assert drift_by_turns(flights) == pytest.approx(drift, abs=0.02)
    assert drift_by_turns([flights[0].part(0, 4)]) == 0.0


def test_walks_that_the_tilt_does_not_confirm_are_none(generator):
    noise = {**dict.fromkeys(WALKS, 0.05), "gyro_noise": 0.1}
    still: list[Flight] = [tilting(generator, 0.0)]
    assert correct_walks(noise, still) == {**dict.fromkeys(WALKS, 0.0), "gyro_noise": 0.1}
    assert correct_walks(noise, [tilting(generator, 0.05)]) == noise
    short = [one.part(0, 20) for one in still]
    assert correct_walks(noise, short) == noise
    walking = tilting(generator, 0.05)
    turning = dataclasses.replace(
        walking, body_rates=walking.body_rates + np.array([TURNING, 0, 9])
    )
    # Its steps have twice the variance of those at rest; a ranger's height has not.
    at_rest = 0.05 / np.sqrt(2.0)
    assert correct_walks(noise, [turning]) == pytest.approx(
        {**noise, "position_walk": at_rest, "velocity_walk": at_rest}
    )
