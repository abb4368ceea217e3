"""Logs of accelerometer, gyro and commands alone: planted drones come back, with what they hide."""

import dataclasses
from pathlib import Path

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import butter, lfilter, sosfilt

import maidenflight as mf
from maidenflight.errors import InputError
from maidenflight.flights.log import Flight
from maidenflight.flights.reading import read_flights
from maidenflight.identification import drone_file
from maidenflight.identification.identify import identify, of_one_kind
from maidenflight.identification.likelihood import without_state
from maidenflight.identification.likelihood.sensor_errors import AccelerometerErrors, GyroErrors
from maidenflight.identification.likelihood.sensor_signals import signals
from maidenflight.identification.methods import Likelihood, Replay
from maidenflight.identification.outcome.about_z import RATIO_SD
from maidenflight.identification.outcome.estimates import Identification
from maidenflight.identification.outcome.plausible import prior_ranges
from maidenflight.identification.unknowns import physical_bounds
from maidenflight.parameters import Parameters, component, crazyflie, replace
from maidenflight.simulator.physics.battery import MOST_COUNTS
from maidenflight.simulator.realities.virtual_drone import virtual_drone
from planted import lagged

pytestmark = pytest.mark.slow

IMU = Path(__file__).parents[4] / "shared" / "data" / "usd_imu"
ONCE = Likelihood(trials=1)
DRONE = virtual_drone(1)


def bare(flight: Flight) -> Flight:
    """A flight without its state."""
    unknown = np.full_like(flight.position, np.nan)
    return dataclasses.replace(flight, position=unknown, velocity=unknown, attitude=unknown)


def recorded(excitation: float) -> list[Flight]:
    key = jax.random.key(1)
    flights = mf.record(DRONE, key, flights=2, duration=12.0, excitation=excitation)
    return [bare(flight) for flight in flights]


@pytest.fixture(scope="module")
def excited() -> list[Flight]:
    return recorded(0.05)


@pytest.fixture(scope="module")
def found(excited: list[Flight]) -> Identification:
    return identify(excited, ONCE, start=replace(crazyflie(), mass=DRONE.parameters.mass))


PLANTED = replace(
    crazyflie(),
    thrust_to_weight=2.1,
    thrust_linear=0.3,
    motor_time_constant=0.07,
    motor_coasting=0.07,
    latency=0.004,
    torque_to_thrust=0.0065,
    inertia=np.array([1.1e-5, 1.6e-5, 2.64e-5], np.float32),
    torque_bias=np.array([5e-5, -1e-4, 2e-5], np.float32),
)


def low_pass(values: np.ndarray, cutoff: float) -> np.ndarray:
    """Butterworth of second order at 1 kHz."""
    return np.asarray(sosfilt(butter(2, cutoff, fs=1e3, output="sos"), values, axis=0))


def piloted(drone: Parameters, seconds: float, seed: int) -> Flight:
    """A flight by hand at 1 kHz: throttle, throttle cuts, and turns, with a rate controller.

    Of the sensors' filters it has those of a Crazyflie, Butterworth at 30 and 80 Hz.
    """
    generator, period, rows = np.random.default_rng(seed), 1e-3, round(1e3 * seconds)
    signs = np.array([[1, 1, 1, 1], [-1, -1, 1, 1], [-1, 1, 1, -1], [-1, 1, -1, 1]], float)
    hold = np.repeat(generator.uniform(-1, 1, (rows // 250 + 1, 4)), 250, axis=0)[:rows]
    wanted = np.asarray(low_pass(hold, 4.0)) * [0.15, 5.0, 5.0, 3.0]
    noise = np.asarray(
        lfilter([0.2], [1.0, -0.98], 0.004 * generator.normal(size=(rows, 4)), axis=0)
    )
    lag, coasting = float(drone.motor_time_constant), float(drone.motor_coasting)
    linear, full = float(drone.thrust_linear), 9.81 / 4 * float(drone.thrust_to_weight)
    lever = float(drone.rotor_x[0])
    arms = float(drone.mass) * np.array([lever, lever, float(drone.torque_to_thrust)])
    inertia, bias = np.asarray(drone.inertia, float), np.asarray(drone.torque_bias, float)
    late = round(float(drone.latency) / period)
    speed, rates, climb = np.full(4, 0.65), np.zeros(3), 0.0
    commands, forces, turns = np.empty((rows, 4)), np.zeros((rows, 3)), np.empty((rows, 3))
    for row in range(rows):
        lift = 0.45 + wanted[row, 0] - 0.05 * climb
        twist = np.clip((wanted[row, 1:] - rates) * [0.02, 0.03, 0.05], -0.2, 0.2)
        cut = 0.0 if row % 4000 > 3800 else 1.0
        commands[row] = cut * np.clip(signs.T @ [lift, *twist], 0.0, 1.0)
        change = np.sqrt(commands[max(row - late, 0)]) - speed
        slower = lag * speed**2 + coasting * np.maximum(-change, 0.0) + 1e-6
        speed = speed + period * change * speed**2 / slower
        thrust = full * (linear * speed + (1 - linear) * speed**2) * (1 + noise[row])
        forces[row, 2] = thrust.sum() - 0.3 * climb
        p, q, r = rates
        gyroscopic = np.diff(inertia[[1, 2, 0, 1]]) * [q * r, r * p, p * q]
        turns[row] = rates
        trim = bias * thrust.sum() / 9.81
        rates = rates + period * (arms * (signs[1:] @ thrust) + trim - gyroscopic) / inertia
        climb = 0.9999 * climb + period * (forces[row, 2] - 9.81)
    force = forces + 0.3 * generator.normal(size=forces.shape)
    measured = turns + 0.02 * generator.normal(size=turns.shape)
    unknown = np.full((rows, 3), np.nan, np.float32)
    return Flight(
        name=f"by hand {seed}",
        period=period,
        position=unknown,
        velocity=unknown,
        attitude=unknown,
        body_rates=np.asarray(low_pass(measured, 80.0), np.float32),
        command=commands.astype(np.float32),
        battery=unknown[:, 0],
        setpoint=unknown,
        zero_order_hold=True,
        full_scale_counts=MOST_COUNTS,
        accelerometer=np.asarray(low_pass(force, 30.0), np.float32),
    )


@pytest.fixture(scope="module")
def by_hand() -> Identification:
    return identify([piloted(PLANTED, 12.0, seed) for seed in range(2)], ONCE)


def as_identified(found: Identification) -> Parameters:
    """The virtual drone; with one lag where speeding up and slowing down are not told apart."""
    truth = DRONE.parameters
    if {"spin_down_ratio", "motor_coasting"} & set(found.estimates):
        return truth
    mean = float(truth.motor_time_constant) * (1 + float(truth.spin_down_ratio)) / 2
    return replace(truth, motor_time_constant=mean)


def holds(found: Identification, truth: Parameters) -> dict[str, bool]:
    """Whether each interval holds the truth; torques about z as shares of the inertia."""
    share = float(found.parameters.inertia[2]) / float(truth.inertia[2])
    held = {}
    for name, estimate in found.estimates.items():
        about_z = name in ("torque_to_thrust", "rotor_momentum", "torque_bias_z", "inertia_z")
        value = float(component(truth, name)) * (share if about_z else 1.0)
        held[name] = estimate.interval[0] <= value <= estimate.interval[1]
    return held


def test_a_drone_flown_by_hand_at_1_khz_comes_back(by_hand: Identification) -> None:
    truth = replace(PLANTED, drag=np.array([0.0, 0.0, 0.3], np.float32))
    held = holds(by_hand, truth)
    assert sum(held.values()) >= len(held) - 1, held
    drone = by_hand.parameters
    for name, error in {
        "thrust_to_weight": 0.02,
        "motor_time_constant": 0.05,
        "motor_coasting": 0.1,
        "inertia_x": 0.05,
        "inertia_y": 0.05,
    }.items():
        assert component(drone, name) == pytest.approx(float(component(truth, name)), rel=error)
    speed = np.linspace(0.2, 0.9, 8)

    def curve(drone: Parameters) -> np.ndarray:
        linear = float(drone.thrust_linear)
        return float(drone.thrust_to_weight) * (linear * speed + (1 - linear) * speed**2)

    assert_allclose(curve(drone), curve(truth), rtol=0.04)
    ratio = float(drone.torque_to_thrust) / float(drone.inertia[2])
    assert ratio == pytest.approx(float(truth.torque_to_thrust) / 2.64e-5, rel=0.04)
    assert_allclose(drone.torque_bias, truth.torque_bias, atol=1e-5)


def test_a_virtual_drone_at_500_hz_comes_back(found: Identification) -> None:
    truth = as_identified(found)
    held = holds(found, truth)
    assert sum(held.values()) >= len(held) - 1, held
    for name, error in {
        "thrust_to_weight": 0.04,
        "motor_time_constant": 0.1,
        "inertia_x": 0.06,
        "inertia_y": 0.06,
    }.items():
        value = float(component(found.parameters, name))
        assert value == pytest.approx(float(component(truth, name)), rel=error), name


def test_a_lag_of_the_gyro_is_that_of_both_ways(
    excited: list[Flight], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the accelerometer tells neither lag nor the ratio."""
    monkeypatch.setattr(without_state, "FORCE_GROUPS", {})
    monkeypatch.setattr(without_state, "_lag_is_identifiable", lambda *_: False)
    start = replace(
        crazyflie(), mass=DRONE.parameters.mass, motor_time_constant=0.02, spin_down_ratio=2.0
    )
    found = identify(excited, ONCE, start=start)
    assert float(found.parameters.spin_down_ratio) == 1.0
    truth = as_identified(found)
    for name, error in {"thrust_to_weight": 0.03, "motor_time_constant": 0.1}.items():
        value = float(component(found.parameters, name))
        assert value == pytest.approx(float(component(truth, name)), rel=error), name


def test_inertia_about_z_keeps_the_starts_ratio(found: Identification) -> None:
    start, inertia = crazyflie().inertia, found.parameters.inertia
    mean = 0.5 * (inertia[0] / start[0] + inertia[1] / start[1])
    assert inertia[2] / start[2] == pytest.approx(float(mean), rel=1e-5)
    draws = found.posterior
    scaled = start[2] * 0.5 * (draws["inertia_x"] / start[0] + draws["inertia_y"] / start[1])
    # As well as that ratio is known of any drone.
    doubt = np.log(draws["inertia_z"] / scaled)
    assert np.std(doubt) == pytest.approx(RATIO_SD, rel=0.15)
    shares = draws["torque_bias_z"] / draws["inertia_z"] * start[2]
    assert np.std(shares) < np.std(draws["torque_bias_z"]) * 1.01


def test_the_drone_file_holds_it_all(found: Identification, tmp_path: Path) -> None:
    file = drone_file.read(found.write(tmp_path / "mine.toml"))
    assert set(file.estimates) == set(found.estimates)
    assert set(file.posterior) == set(found.estimates) | set(found.unidentified)
    assert file.search is not None
    assert file.search.windows == found.windows
    assert {len(draws) for draws in found.posterior.values()} == {500}


def test_what_a_calm_flight_hides_keeps_the_starts_value() -> None:
    start = replace(
        crazyflie(),
        mass=DRONE.parameters.mass,
        inertia=np.array([2.5e-5, 2.5e-5, 5e-5], np.float32),
    )
    flights = recorded(0.0)
    found = identify(flights, ONCE, start=start)
    # What is left out was one with the thrust, and every drone that is left must hover as they did.
    model = AccelerometerErrors.of(flights)
    for number in (None, 0, 1, 2):
        draw = {} if number is None else {name: of[number] for name, of in found.posterior.items()}
        force = model.errors(replace(found.parameters, **draw))[model.signals.used]
        assert abs(float(force.mean())) < (0.01 if number is None else 0.05) * 9.81, number
    held = holds(found, as_identified(found))
    assert sum(held.values()) >= len(held) - 1, held
    assert "torque_to_thrust" in found.unidentified
    assert not set(found.unidentified) & set(found.estimates)
    for name, (low, high) in found.unidentified.items():
        assert component(found.parameters, name) == component(start, name)
        draws = found.posterior[name]
        assert low <= draws.min() < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < draws.max() <= high


def test_nothing_is_found_that_flights_did_not_change(found: Identification) -> None:
    start = replace(crazyflie(), mass=DRONE.parameters.mass)
    priors = prior_ranges(start, physical_bounds(start))
    for name in found.estimates.keys() & priors.keys() - {"thrust_to_weight", "inertia_z"}:
        assert np.std(found.posterior[name]) < np.ptp(priors[name]) / np.sqrt(12), name


def test_parameters_can_be_named(excited: list[Flight]) -> None:
    found = identify(excited, ONCE, over=["thrust_to_weight", "torque_bias_x"])
    assert list(found.estimates) == ["thrust_to_weight", "torque_bias_x"]
    assert found.parameters.motor_time_constant == crazyflie().motor_time_constant
    assert found.gains == ()


def test_a_lag_can_be_named_without_a_latency(excited: list[Flight]) -> None:
    found = identify(excited, ONCE, over=["motor_time_constant"])
    assert list(found.estimates) == ["motor_time_constant"]
    assert found.parameters.latency == crazyflie().latency


@pytest.mark.parametrize(
    "over", [["drag_x"], ["inertia_z", "torque_to_thrust"], ["flapping_moment_x", "inertia_x"]]
)
def test_what_these_sensors_do_not_show_is_refused(excited: list[Flight], over: list[str]) -> None:
    with pytest.raises(InputError, match=over[0]):
        identify(excited, ONCE, over=over)


def test_a_replay_is_refused(excited: list[Flight]) -> None:
    with pytest.raises(InputError):
        identify(excited, Replay())


def test_too_little_flight_is_refused(excited: list[Flight]) -> None:
    with pytest.raises(InputError):
        identify([excited[0].part(0, 300)], ONCE)


def test_flights_of_two_rates_are_refused(excited: list[Flight]) -> None:
    with pytest.raises(InputError):
        signals([excited[0], dataclasses.replace(excited[1], period=0.004)], GyroErrors.sensor)


def test_flights_with_a_state_are_taken_and_others_named(excited: list[Flight]) -> None:
    zeros = np.zeros_like(excited[0].position)
    whole = dataclasses.replace(excited[0], position=zeros, velocity=zeros, attitude=zeros)
    other = dataclasses.replace(excited[0], name="another")
    taken, notes = of_one_kind([whole, other])
    assert taken == [whole]
    assert len(notes) == 1
    assert "another" in notes[0]
    assert of_one_kind([other]) == ([other], [])


def test_rotors_follow_a_lag_and_a_latency(excited: list[Flight]) -> None:
    drone = replace(crazyflie(), motor_time_constant=0.05, latency=0.007)
    seen = signals(excited[:1], AccelerometerErrors.sensor)
    speed = lagged(excited[0].speed_command, excited[0].period, 0.05, 0.007)
    steps = 0.5 * (speed[1:] + speed[:-1])
    mean = steps[: len(steps) // 5 * 5].reshape(-1, 5, 4).mean(axis=1)
    used = seen.used[:, 0]
    ours = seen.rotors(drone).mean[used, 0]
    first = round(0.5 / seen.step)
    assert_allclose(ours, mean[first : first + len(ours)], atol=2e-4)


@pytest.mark.parametrize("sensor", [AccelerometerErrors, GyroErrors])
def test_scores_are_the_values_slope(
    excited: list[Flight], sensor: type[AccelerometerErrors | GyroErrors]
) -> None:
    target = sensor.of(excited)
    names = ("motor_time_constant", "thrust_linear", "inertia_x", "rotor_momentum")
    drone = replace(DRONE.parameters, rotor_momentum=2e-5, thrust_linear=0.1)
    _, scores, curvatures = target.derivatives(drone, names)
    for place, name in enumerate(names):
        value = float(component(drone, name))
        by = 0.02 * value
        ahead, behind = (
            target(replace(drone, **{name: np.float32(value + sign * by)})) for sign in (1, -1)
        )
        slope, scale = (ahead - behind) / (2 * by), curvatures[:, place, place].sum() * by
        assert scores[:, place].sum() == pytest.approx(slope, rel=0.05, abs=0.2 * scale + 1e-9)


@pytest.mark.skipif(not IMU.exists(), reason="no logs of accelerometer and gyro alone here")
@pytest.mark.night
def test_logs_of_a_crazyflie_flown_by_hand() -> None:
    found = identify(read_flights(IMU), start=replace(crazyflie(), mass=0.027))
    drone = found.parameters
    assert float(drone.motor_time_constant) == pytest.approx(0.0716, abs=0.003)
    assert_allclose(drone.inertia[:2], [1.099e-5, 1.163e-5], rtol=0.08)
    assert {"motor_coasting", "rotor_momentum"} <= set(found.estimates)
