"""The check-up: each fault is named by the test that it concerns, and sound logs pass."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import maidenflight as mf
from made_flights import calm, driven
from maidenflight.errors import InputError
from maidenflight.flights import flight_csv, log
from maidenflight.flights.checkup import kinematics, motors, one_drone
from maidenflight.flights.checkup.checkup import check_up
from maidenflight.flights.checkup.result import FAILS, UNKNOWN, WARNS, CheckResult
from maidenflight.flights.log import Flight
from maidenflight.flights.reading import read_flights

FLOAT = np.float32


@cache
def recorded() -> Flight:
    """A flight of a virtual drone, with an accelerometer and rotor speeds that follow."""
    (flight,) = mf.record(mf.virtual_drone(3), jax.random.key(0), flights=1, duration=12.0)
    kept = np.exp(-flight.period / 0.05)
    speed = np.sqrt(flight.command[:1].astype(float))
    speeds = []
    for command in np.sqrt(flight.command.astype(float)):
        speed = kept * speed + (1 - kept) * command
        speeds.append(2000 * speed[0])
    return replace(flight, rotor_speed=np.array(speeds, FLOAT))


def results(flight: Flight) -> dict[str, CheckResult]:
    return {one.name: one for one in check_up([flight])}


def turned(group: str, matrix: Sequence[Sequence[float]], flight: Flight) -> Flight:
    return replace(flight, **{group: (getattr(flight, group) @ np.array(matrix).T).astype(FLOAT)})


def shifted(group: str, seconds: float, flight: Flight) -> Flight:
    """A signal that comes late."""
    rows = round(abs(seconds) / flight.period)
    values = getattr(flight, group)
    if seconds > 0:
        return replace(flight.part(rows, len(flight)), **{group: values[:-rows]})
    return replace(flight.part(0, len(flight) - rows), **{group: values[rows:]})


def ordered(order: tuple[int, ...], flight: Flight) -> Flight:
    return replace(flight, command=flight.command[:, list(order)])


def scaled(flight: Flight, **factors: float) -> Flight:
    return replace(flight, **{one: getattr(flight, one) * FLOAT(by) for one, by in factors.items()})


def faster(by: float, flight: Flight) -> Flight:
    return replace(flight, period=flight.period * by)


def other_time(flight: Flight) -> Flight:
    return replace(flight, command=np.roll(flight.command, len(flight) // 3, axis=0))


def facing_aside(flight: Flight) -> Flight:
    """The same flight in a world whose x points to the drone's right at the start."""
    turn = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    flight = turned("position", turn, turned("velocity", turn, flight))
    return replace(flight, attitude=flight.attitude + np.array([0, 0, np.pi / 2], FLOAT))


def loaded(flight: Flight) -> Flight:
    command = flight.command.copy()
    command[len(command) // 2 :] *= FLOAT(1.15)
    return replace(flight, command=command)


def frozen(flight: Flight) -> Flight:
    rates, third = flight.body_rates.copy(), len(flight) // 3
    rates[third : 2 * third] = rates[third]
    return replace(flight, body_rates=rates)


def on_a_bench(flight: Flight) -> Flight:
    """Commands of a flight, throttled up and down, and the force of a drone that stands."""
    noise = np.random.default_rng(0).normal(0.0, 0.2, (len(flight), 3))
    throttle = 1 + 0.5 * np.sin(2 * flight.period * np.arange(len(flight)))[:, None]
    return replace(
        flight,
        command=(flight.command * throttle).astype(FLOAT),
        accelerometer=(noise + np.array([0, 0, 9.81])).astype(FLOAT),
    )


def vibrating(flight: Flight) -> Flight:
    """A drone that stands for 2 s, and whose accelerometer clips what vibrates in flight."""
    seconds = flight.period * np.arange(len(flight))
    noise = np.random.default_rng(0).normal(0.0, 15.0, (len(flight), 3))
    force = np.clip(flight.arrays["accelerometer"] + noise, -16.0, 16.0)
    standing = np.array([0.0, 0.0, 9.81 * 0.93]) + 0.001 * noise
    return replace(
        flight, accelerometer=np.where(seconds[:, None] < 2.0, standing, force).astype(FLOAT)
    )


def body_velocity(flight: Flight) -> Flight:
    back = kinematics.rotations(flight).inv()
    return replace(flight, velocity=back.apply(flight.velocity.astype(float)).astype(FLOAT))


def yawing(flight: Flight) -> Flight:
    """The same way with a nose that turns to and fro by 40 deg."""
    yaw = 0.7 * np.sin(0.5 * flight.period * np.arange(len(flight)))
    return replace(flight, attitude=(flight.attitude + yaw[:, None] * [0, 0, 1]).astype(FLOAT))


X, Y, Z = ([[-1, 0, 0], [0, 1, 0], [0, 0, 1]], [[1, 0, 0], [0, -1, 0], [0, 0, 1]],
           [[1, 0, 0], [0, 1, 0], [0, 0, -1]])  # fmt: skip
SWAP, LEFT, DOWN = ([[0, 1, 0], [1, 0, 0], [0, 0, 1]], [[0, 1, 0], [-1, 0, 0], [0, 0, 1]],
                    [[1, 0, 0], [0, -1, 0], [0, 0, -1]])  # fmt: skip
SPOILINGS: Mapping[str, tuple[Callable[[Flight], Flight], str, str]] = {
    "one motor twice": (partial(ordered, (0, 1, 2, 1)), "columns", "command_2 and command_4"),
    "a weak motor": (
        lambda flight: replace(flight, command=flight.command / np.array([1, 1, 0.63, 1], FLOAT)),
        "motor balance",
        "the back left motor or its propeller gives about 3",
    ),
    "gyro frozen": (frozen, "columns", "body_rate_z stand still for 4"),
    "a bench": (on_a_bench, "flight", "This is no flight"),
    "velocity of the body": (
        lambda flight: body_velocity(facing_aside(flight)),
        "velocity",
        "turned by",
    ),
    "velocity of a body that yaws": (
        lambda flight: body_velocity(yawing(flight)),
        "velocity frame",
        "along the body's axes",
    ),
    "motors turned by one": (partial(ordered, (1, 2, 3, 0)), "motor order", "turned by"),
    "motors from the back": (partial(ordered, (2, 3, 0, 1)), "motor order", "turned by 180 deg"),
    "motors mirrored": (partial(ordered, (3, 2, 1, 0)), "motor order", "body_rate_x has the oppo"),
    "Betaflight's motors": (
        partial(ordered, (1, 0, 2, 3)),
        "motor order",
        "command_2, command_1, command_3, command_4 with",
    ),
    "gyro x": (partial(turned, "body_rates", X), "body_rate", "x with the opposite sign"),
    "gyro swapped": (partial(turned, "body_rates", SWAP), "body_rate", "x and y swapped"),
    "gyro turned": (partial(turned, "body_rates", LEFT), "body_rate", "turned by"),
    "gyro down": (partial(turned, "body_rates", DOWN), "body_rate", "y and z with opposite signs"),
    "gyro halved": (partial(scaled, body_rates=0.5), "body_rate scale", "is 0.5"),
    "gyro late": (partial(shifted, "body_rates", 0.03), "gyro delay", "late by about"),
    "attitude's pitch": (partial(turned, "attitude", Y), "tilt", "Positive pitch is nose down"),
    "velocity swapped": (partial(turned, "velocity", SWAP), "velocity", "x and y swapped"),
    "velocity in feet": (partial(scaled, velocity=3.28), "velocity scale", "velocity in ft"),
    "time": (partial(faster, 1.25), "clock", "time is 1.2"),
    "commands late": (partial(shifted, "command", 0.05), "command delay", "are late by about 5"),
    "commands a little late": (partial(shifted, "command", 0.02), "command delay", "motion begins"),
    "time, velocity by the same": (
        lambda flight: replace(
            faster(1.1, flight), velocity=np.gradient(flight.position, 0.011, axis=0).astype(FLOAT)
        ),
        "clock",
        "gravity against the bends of the path",
    ),
    "commands early": (partial(shifted, "command", -0.05), "command delay", "are early by about"),
    "force negated": (partial(scaled, accelerometer=-1.0), "accelerometer", "opposite sign"),
    "force in g": (partial(scaled, accelerometer=1 / 9.81), "accelerometer", "like g; expected"),
    "half the force": (partial(scaled, accelerometer=0.5), "accelerometer", "half the range"),
    "force clipped": (vibrating, "accelerometer", "reads 0.93 g where the drone is still"),
    "force swapped": (partial(turned, "accelerometer", SWAP), "accelerometer axes", "swapped"),
    "another time's commands": (other_time, "motors drive", "nothing to do with the motion"),
    "one ESC silent": (
        lambda flight: replace(flight, rotor_speed=np.array(flight.rotor_speed) * [1, 0, 1, 1]),
        "rotor speeds",
        "back right reads 0",
    ),
    "speeds of another time": (
        lambda flight: replace(flight, rotor_speed=np.roll(flight.arrays["rotor_speed"], 999, 0)),
        "rotor speeds",
        "follows its command to",
    ),
    "a load": (loaded, "one drone", "gave way. Cut the log there: it is of two drones"),
    "a load or a battery": (
        lambda flight: replace(loaded(flight), battery=np.full(len(flight), np.nan, FLOAT)),
        "one drone",
        "by -13 % after 6 s: it may be the battery, whose voltage is not logged, or a load or "
        "propeller. Log the battery's voltage",
    ),
}


def test_a_sound_flight_passes() -> None:
    assert {one.verdict for one in results(recorded()).values()} <= {"passes", UNKNOWN}
    assert sum(one.verdict == "passes" for one in results(recorded()).values()) >= 14


@pytest.mark.parametrize("what", SPOILINGS)
def test_a_spoilt_flight_is_named_by_the_test_that_it_concerns(what: str) -> None:
    spoil, test, words = SPOILINGS[what]
    found = results(spoil(recorded()))[test]
    assert found.verdict in (FAILS, WARNS)
    assert words in found.sentence


def stepped(by: float, flight: Flight) -> Flight:
    """Commands that are so many times as large from the middle on."""
    command = flight.command.copy()
    command[len(command) // 2 :] *= FLOAT(by)
    return replace(flight, command=command)


SIDES: Mapping[str, tuple[Callable[[float, Flight], Flight], Sequence[float], Sequence[float]]] = {
    "body_rate scale": (lambda by, one: scaled(one, body_rates=by), (0.87, 1.15), (0.8, 1.3)),
    "velocity scale": (lambda by, one: scaled(one, velocity=by), (0.8, 1.25), (0.66, 1.5)),
    "gyro delay": (partial(shifted, "body_rates"), (-0.008, 0.01), (0.03,)),
    "clock": (faster, (0.96, 1.02), (0.8, 0.9, 1.1, 1.25)),
    "accelerometer": (lambda by, one: scaled(one, accelerometer=by), (0.92, 1.08), (0.8, 1.3)),
    "command delay": (partial(shifted, "command"), (-0.02, 0.005), (0.02, -0.05, 0.06)),
    "thrust curve": (
        lambda power, one: replace(one, command=one.command ** FLOAT(power)),
        (0.9, 1.3),
        (0.5, 2.2),
    ),
    "thrust to weight": (lambda by, one: scaled(one, command=by), (0.5, 1.3), (0.05, 2.0)),
    "one drone": (stepped, (0.97, 1.03), (0.85, 1.15)),
}
"""By test: what is changed by an amount, amounts within its threshold, and beyond it."""
CERTAIN = {
    "body_rate scale": (0.6, 1.6),
    "velocity scale": (0.45, 2.2),
    "gyro delay": (0.07,),
    "accelerometer": (0.5, 1.8),
    "command delay": (0.06, -0.13),
}
"""Amounts at which a test that warns first fails."""


@pytest.mark.parametrize(
    ("test", "amount", "verdicts"),
    [
        *((test, by, {"passes"}) for test, (_, inside, _) in SIDES.items() for by in inside),
        *((test, by, {WARNS, FAILS}) for test, (*_, beyond) in SIDES.items() for by in beyond),
        *((test, by, {FAILS}) for test, amounts in CERTAIN.items() for by in amounts),
    ],
)
def test_a_test_answers_on_both_sides_of_its_threshold(
    test: str, amount: float, verdicts: set[str]
) -> None:
    flight = recorded() if test != "one drone" else replace(recorded(), rotor_speed=None)
    found = results(SIDES[test][0](amount, flight))[test]
    assert found.verdict in verdicts, found.sentence


@pytest.mark.parametrize(("test", "amount"), [("thrust curve", 0.62), ("one drone", 1.076)])
def test_what_is_beyond_its_limit_by_less_than_its_error_is_no_alarm(
    test: str, amount: float
) -> None:
    found = results(SIDES[test][0](amount, replace(recorded(), rotor_speed=None)))[test]
    assert found.verdict == UNKNOWN, found
    assert "too little to tell it from" in found.cause


def test_a_square_that_the_log_does_not_ask_for_is_the_first_cause() -> None:
    """A drone that hovers at a tenth of the throttle, to which thrust is in proportion."""
    flight = replace(recorded(), rotor_speed=None, square_since="THR_MDL_FAC is 0")
    squared = replace(flight, command=np.square(flight.command * FLOAT(0.2)))
    found = results(squared)
    weight = found["thrust to weight"]
    assert weight.verdict == WARNS
    assert "the square of the throttle, for THR_MDL_FAC is 0" in weight.cause
    hover = results(flight)["thrust to weight"].statistic
    assert hover is not None
    # Of the root of the motors' mean, which is a little more than the mean of their roots.
    said = float(weight.cause.rpartition("full thrust is ")[2].split()[0])
    assert said == pytest.approx(hover / 0.2, rel=0.05)
    curve = results(replace(squared, command=squared.command ** FLOAT(1.1)))["thrust curve"]
    assert curve.verdict == WARNS
    assert "for THR_MDL_FAC is 0, and thrust follows the throttle" in curve.cause


def test_yaw_that_answers_the_wrong_way_round_is_a_warning() -> None:
    flight = turned("attitude", Z, turned("body_rates", Z, recorded()))
    found = results(flight)["yaw direction"]
    assert found.verdict == WARNS
    assert "or yaw and body_rate_z have the opposite sign" in found.sentence


def test_rotors_that_turn_the_other_way_are_named_where_the_state_confirms_yaw() -> None:
    """Props out, the same motion takes the opposite part of the commands that turns yaw."""
    flight, turns = facing_aside(recorded()), np.array([-1, 1, -1, 1], FLOAT)
    yaw = (flight.command @ turns)[:, None] * turns / 4
    found = results(replace(flight, command=flight.command - 2 * yaw, rotor_speed=None))
    assert {name for name, one in found.items() if one.verdict in (FAILS, WARNS)} == {
        "yaw direction"
    }
    assert "confirm yaw" in found["yaw direction"].sentence
    assert "rotor_direction = [1, -1, 1, -1]" in found["yaw direction"].sentence


@pytest.mark.parametrize("rows", [51, 60, 130])
def test_short_pieces_are_checked_too(rows: int) -> None:
    pieces = [recorded().part(start, start + rows) for start in (0, rows, 2 * rows)]
    assert {one.verdict for one in check_up(pieces)} <= {"passes", UNKNOWN}


def test_sensors_alone_show_gravity_and_motors() -> None:
    unknown = np.full((len(recorded()), 3), np.nan, FLOAT)
    alone = replace(recorded(), position=unknown, velocity=unknown, attitude=unknown)
    assert not {"body_rate", "clock"} & set(results(alone))
    assert results(scaled(alone, accelerometer=0.5))["accelerometer"].verdict == FAILS
    assert results(ordered((3, 2, 1, 0), alone))["motor order"].verdict == FAILS


@settings(max_examples=20)
@given(seed=st.integers(0, 10**6), rows=st.integers(10, 1500))
def test_a_smooth_flight_raises_no_alarm(seed: int, rows: int) -> None:
    found = check_up([driven(rows, seed)])
    assert [one.sentence for one in found if one.verdict in (FAILS, WARNS)] == []


@settings(max_examples=20)
@given(seed=st.integers(0, 10**6), rows=st.integers(2, 900))
def test_commands_by_chance_name_no_order(seed: int, rows: int) -> None:
    found = {one.name: one for one in motors.check_motors([calm(rows, seed)])}
    assert "motor order" not in found or found["motor order"].verdict != FAILS


@settings(max_examples=20)
@given(seed=st.integers(0, 10**6), noise=st.floats(0.0, 1.0))
def test_noise_as_large_as_a_rate_is_no_wrong_scale(seed: int, noise: float) -> None:
    generator = np.random.default_rng(seed)
    flight = driven(900, seed)
    rates = flight.body_rates + noise * flight.body_rates.std() * generator.normal(size=(900, 3))
    found = results(replace(flight, body_rates=rates.astype(FLOAT)))
    assert found["body_rate scale"].verdict != FAILS
    assert found["clock"].verdict != FAILS


def test_a_hover_is_too_quiet_to_judge_its_signs() -> None:
    still = {
        group: getattr(calm(900), group) * FLOAT(-0.001)
        for group in ("velocity", "attitude", "body_rates")
    }
    quiet = {"position": 0.001 * calm(900).position + FLOAT(1)}
    quiet["command"] = 0.5 + 0.001 * calm(900).command
    flight = replace(calm(900), **quiet, **still)
    found = results(flight)
    assert {found[name].verdict for name in ("body_rate", "velocity", "tilt")} == {UNKNOWN}


@pytest.mark.parametrize(
    "copy",
    [
        lambda flight: flight.part(7, len(flight)),
        lambda flight: log.thinned(flight, 2),
        lambda flight: replace(flight, position=flight.position + FLOAT(1e-6)),
        lambda flight: replace(flight, body_rates=flight.body_rates + FLOAT(1e-6)),
    ],
)
def test_copies_of_a_flight_are_found(copy: Callable[[Flight], Flight]) -> None:
    known = {"one": one_drone.row_keys([driven(400)])}
    assert one_drone.find_copy(one_drone.row_keys([copy(driven(400))]), known) == "one"
    assert one_drone.find_copy(one_drone.row_keys([driven(400, 1)]), known) is None


def test_logs_of_other_loads_are_told_apart() -> None:
    assert one_drone.compare_loads({"a": 2.42, "b": 2.40, "c": 2.45}) == []
    (said,) = one_drone.compare_loads({"a": 2.42, "b": 2.07, "c": 2.43})
    assert "2.07 times the weight in b, and 2.42 times in a, c" in said.cause


def test_a_voltage_that_never_changes_is_not_believed(tmp_path) -> None:
    for number in range(7):
        flight_csv.write(tmp_path / f"{number}.csv", driven(900, number))
    assert [one.kind for one in read_flights(tmp_path / "0.csv").warnings] == []
    logs = read_flights(tmp_path)
    assert [one.kind for one in logs.warnings] == ["battery"]
    assert not any(np.isfinite(one.battery).any() for one in logs)


@pytest.mark.parametrize(("shares", "named"), [([0.63] * 3, 1), ([0.63, 1, 1.5], 0), ([1] * 3, 0)])
def test_a_motor_that_is_weak_in_several_short_logs_is_named(
    shares: Sequence[float], named: int, tmp_path
) -> None:
    for number, share in enumerate(shares):
        flight = driven(300, number)
        weak = flight.command * FLOAT(0.5) / np.array([1, 1, 1, share], FLOAT)
        flight_csv.write(tmp_path / f"{number}.csv", replace(flight, command=weak))
    logs = read_flights(tmp_path, faulty="use")
    found = [one for one in logs.warnings if one.kind == "motor balance"]
    assert len(found) == named
    assert all("in 3 logs" in one.cause and "front left" in one.cause for one in found)


def test_a_folder_with_a_faulty_log_is_refused_unless_told(tmp_path) -> None:
    flight_csv.write(tmp_path / "good.csv", driven(900))
    flight_csv.write(tmp_path / "bad.csv", ordered((3, 2, 1, 0), driven(900, 1)))
    with pytest.raises(InputError, match="1 of 2 logs contradict physics"):
        read_flights(tmp_path)
    skipped = read_flights(tmp_path, faulty="skip")
    assert len(skipped) == 1
    assert "look permuted" in skipped.refused[0]
    used = read_flights(tmp_path, faulty="use")
    assert len(used) == 2
    assert [(one.kind, one.sure) for one in used.warnings] == [("motor order", True)]
    assert used.warnings[0].file.endswith("bad.csv")


@pytest.mark.slow
@pytest.mark.parametrize(
    "folder",
    [
        "authors/flights/attitude",
        pytest.param("authors/flights/attitude_rate", marks=pytest.mark.night),
    ],
)
def test_no_real_flight_is_refused(shared_data, folder) -> None:
    read = read_flights(shared_data / folder)
    assert read.refused == ()
    assert len(read.paths) == 54
