"""PX4 logs: written by a writer of our own and read back through pyulog."""

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import made_ulogs as made
import numpy as np
import pytest
from numpy.testing import assert_allclose

import maidenflight as mf
from made_flights import driven, sensed
from maidenflight.errors import InputError
from maidenflight.flights import formats
from maidenflight.flights.reading import Flights, read_flights
from maidenflight.flights.tables import Table
from maidenflight.identification.identify import identify
from maidenflight.identification.methods import Likelihood
from maidenflight.parameters import component, crazyflie, replace

pytest.importorskip("pyulog")
SENSED = ("body_rates", "accelerometer")
STATE = ("position", "velocity", "attitude")


def read(tmp_path: Path, topics: Any, parameters: Any = None, **settings: Any) -> Flights:
    path = tmp_path / "log_1.ulg"
    path.write_bytes(made.ulog(topics, made.placed() if parameters is None else parameters))
    return read_flights(path, **settings)


@pytest.mark.parametrize("state", [True, False])
def test_a_flight_comes_back(state: bool, tmp_path: Path) -> None:
    flight = sensed()
    (found,) = read(tmp_path, made.topics_of(flight, state=state))
    assert found.has_state is state
    assert found.period == pytest.approx(0.01)
    for group in (*SENSED, *(STATE if state else ()), "battery"):
        assert_allclose(getattr(found, group), getattr(flight, group), atol=1e-5, err_msg=group)
    assert_allclose(found.command, flight.command, atol=1e-5)
    assert_allclose(found.arrays["rotor_speed"], flight.arrays["rotor_speed"], atol=0.11)
    assert not found.zero_order_hold


def test_rare_motors_follow_from_set_points(tmp_path: Path) -> None:
    flight = sensed()
    made_topics = made.by_default_profile(made.topics_of(flight, state=False))
    found = read(tmp_path, made_topics)
    assert_allclose(found.flights[0].command, flight.command, atol=1e-5)
    assert any("100.00 %" in note or "99.99 %" in note for note in found.notes)


def test_old_logs_follow_from_their_controls(tmp_path: Path) -> None:
    flight = sensed()
    topics = made.by_default_profile(made.topics_of(flight, state=False))
    *timed, (_, _, torque) = topics.pop("vehicle_torque_setpoint")
    thrust = topics.pop("vehicle_thrust_setpoint")[2][2][:, 2:]
    controls = np.concatenate([torque, -thrust], axis=1)
    topics["actuator_controls_0"] = [*timed, ("control", "float", controls)]
    rare, _, (_, _, motors) = topics.pop("actuator_motors")
    topics["actuator_outputs"] = [rare, ("output", "float", 1000 + 1000 * motors)]
    (found,) = read(tmp_path, topics, {"MAV_TYPE": 2})
    assert_allclose(found.command, flight.command, atol=1e-5)


def test_rows_of_rare_motors_hold_means_of_the_sensors(tmp_path: Path) -> None:
    flight = sensed(1200, period=0.005)
    topics = made.by_default_profile(made.topics_of(flight, state=False), setpoints=4)
    (found,) = read(tmp_path, topics)
    assert found.period == pytest.approx(0.02)
    # The mean of five samples a step about the row, of which the outer two count half.
    about = np.lib.stride_tricks.sliding_window_view(flight.body_rates, 5, axis=0)[2::4]
    means = about @ [0.125, 0.25, 0.25, 0.25, 0.125]
    assert_allclose(found.body_rates, means[: len(found)], atol=1e-5)


@pytest.mark.parametrize("name", ["quadrotor_local.ulg", "battery_brownout.ulg", "events.ulg"])
def test_set_points_explain_the_motors_of_real_logs(name: str, shared_data: Path) -> None:
    path = shared_data / "real" / "px4" / name
    if not path.is_file():
        pytest.skip("the logs are not here")
    logs = formats.logged(path)
    assert not isinstance(logs, Table)
    notes = next(logs).notes
    (said,) = (re.search(r"explain ([\d.]+) %", note) for note in notes if "explain" in note)
    assert said is not None
    assert float(said[1]) >= 99.98


@pytest.mark.parametrize("order", [(0, 3, 1, 2), (1, 2, 0, 3), (3, 2, 1, 0)])
def test_motors_are_ordered_by_their_places(order: tuple[int, ...], tmp_path: Path) -> None:
    flight = sensed()
    corners = {
        number + 1: place
        for number, place in zip(
            order, [(0.1, 0.12), (-0.1, 0.12), (-0.1, -0.12), (0.1, -0.12)], strict=True
        )
    }
    turns = [0.0] * 4
    for number, turn in zip(order, (0.05, -0.05, 0.05, -0.05), strict=True):
        turns[number] = turn
    placed = made.placed(dict(sorted(corners.items())), tuple(turns))
    (found,) = read(tmp_path, made.topics_of(flight, order), placed)
    assert_allclose(found.command, flight.command, atol=1e-5)
    assert_allclose(found.arrays["rotor_speed"], flight.arrays["rotor_speed"], atol=0.11)


def test_without_places_motors_are_in_px4s_default_order(tmp_path: Path) -> None:
    flight = sensed()
    (found,) = read(tmp_path, made.topics_of(flight), {})
    assert_allclose(found.command, flight.command, atol=1e-5)


@pytest.mark.parametrize(
    ("changed", "reversed_"),
    [({}, False), ({"CA_ROTOR0_KM": -0.05, "CA_ROTOR1_KM": -0.05}, True)],
)
def test_rotors_that_turn_the_other_way_are_a_note(
    changed: dict[str, float], reversed_: bool, tmp_path: Path
) -> None:
    turned = {"CA_ROTOR2_KM": 0.05, "CA_ROTOR3_KM": 0.05} if changed else {}
    notes = read(tmp_path, made.topics_of(sensed()), made.placed() | changed | turned).notes
    assert any("CA_ROTORn_KM" in note for note in notes) is reversed_


@pytest.mark.parametrize("factor", [0.0, 0.3, 1.0])
def test_thrust_is_by_the_thrust_models_factor(factor: float, tmp_path: Path) -> None:
    """Motors and the outputs made of them by PX4's inverted curve tell the same thrust."""
    flight = sensed()
    parameters = made.placed() | {"THR_MDL_FAC": factor} if factor else made.placed()
    thrust: Callable[..., Any] = np.asarray if factor else np.sqrt
    topics = made.topics_of(flight, thrust=thrust)
    (by_motors,) = read(tmp_path, topics, parameters)
    control = topics.pop("actuator_motors")[1][2]
    # FunctionMotors.hpp: x = -b / 2a + sqrt((b / 2a)^2 + control / a), a = f, b = 1 - f.
    half = (1 - factor) / (2 * factor) if factor else 0.0
    sent = np.sqrt(half**2 + control / factor) - half if factor else control
    outputs = 1100 + 800 * sent
    stamps = topics["sensor_combined"][0][2]
    topics["actuator_outputs"] = [
        ("timestamp", "uint64_t", stamps),
        ("output", "float", np.concatenate([np.zeros((len(flight), 2)), outputs], axis=1)),
    ]
    for motor in range(1, 5):
        parameters[f"PWM_AUX_FUNC{motor + 2}"] = 100 + motor
        parameters[f"PWM_AUX_MIN{motor + 2}"] = 1100
        parameters[f"PWM_AUX_MAX{motor + 2}"] = 1900
    (by_outputs,) = read(tmp_path, topics, parameters)
    assert by_motors.square_since == ("" if factor else "THR_MDL_FAC is not logged")
    assert_allclose(by_motors.command, flight.command, atol=1e-5)
    assert_allclose(by_outputs.command, flight.command, atol=1e-4)


def test_what_flies_counts_more_than_what_is_displayed(tmp_path: Path) -> None:
    parameters = made.placed() | {"CA_AIRFRAME": 0, "MAV_TYPE": 13}
    assert len(read(tmp_path, made.topics_of(sensed()), parameters).flights) == 1


@pytest.mark.parametrize(
    "parameters",
    [{"DSHOT_CONFIG": 600, "PWM_MAIN_MIN": 1000, "PWM_MAIN_MAX": 2000}, {"PWM_MAIN_TIM0": -3}],
)
def test_outputs_of_dshot_are_known(parameters: dict[str, int], tmp_path: Path) -> None:
    topics = made.topics_of(sensed())
    control = topics.pop("actuator_motors")[1][2]
    stamps = topics["sensor_combined"][0]
    topics["actuator_outputs"] = [stamps, ("output", "float", 1 + 1998 * control)]
    flights = read(tmp_path, topics, parameters)
    assert_allclose(flights.flights[0].command, sensed().command, atol=1e-4)
    assert any("(DShot)" in note for note in flights.notes)


def test_a_ulog_that_was_cut_off_is_a_note(tmp_path: Path) -> None:
    raw = made.ulog(made.topics_of(sensed()), made.placed())
    (tmp_path / "log.ulg").write_bytes(raw[:-5])
    assert any("cut off in its last message" in note for note in read_flights(tmp_path).notes)
    (tmp_path / "log.ulg").write_bytes(raw)
    assert not any("cut off" in note for note in read_flights(tmp_path).notes)


def test_every_command_of_the_loop_is_averaged_over_the_rows(tmp_path: Path) -> None:
    """Motors at 400 Hz, rows at 100 Hz: the mean of rotor speeds until the next row."""
    flight = sensed(rows=600)
    topics = made.topics_of(flight)
    stamps = topics["sensor_combined"][0][2]
    fast = np.arange(stamps[0], stamps[-1] + 10_000, 2500)
    speed = 0.7 + 0.05 * np.random.default_rng(0).normal(size=(len(fast), 4))
    control = speed[:, [0, 2, 3, 1]]
    topics["actuator_motors"] = [("timestamp", "uint64_t", fast), ("control", "float", control)]
    (found,) = read(tmp_path, topics, faulty="use")  # commands by chance
    assert found.zero_order_hold
    mean = speed[: 4 * 599].reshape(599, 4, 4).mean(axis=1)
    assert_allclose(np.sqrt(found.command[:599]), mean, atol=1e-5)


def test_a_mean_over_the_integration_time_belongs_to_its_middle(tmp_path: Path) -> None:
    topics = made.topics_of(sensed(), state=False, integral=4000)
    (found,) = read(tmp_path, topics)
    assert len(found) >= 599  # The first may lie before the first command by rounding.
    assert_allclose(found.body_rates, sensed().body_rates[-len(found) :], atol=1e-5)
    assert_allclose(found.command, sensed().command[-len(found) :], atol=1e-5)


TOPICS = made.topics_of(sensed())


def changed(topic: str, change: Callable[[str, Any], Any], topics: Any = TOPICS) -> Any:
    """Topics of which one's fields are changed, by name."""
    return topics | {
        topic: [(name, typed, change(name, rows)) for name, typed, rows in topics[topic]]
    }


def rarely(topic: str, every: int) -> Any:
    return changed(topic, lambda _, rows: rows[::every], made.topics_of(sensed(), state=False))


def without_motors(**outputs: Any) -> Any:
    """Topics without motors, but perhaps with outputs."""
    rest = {name: fields for name, fields in TOPICS.items() if name != "actuator_motors"}
    stamps, (_, typed, control) = TOPICS["actuator_motors"]
    sent = [stamps, ("output", typed, outputs.get("most", 1.0) * control)]
    return rest | ({"actuator_outputs": sent} if outputs else {})


def turned(name: str, rows: Any) -> Any:
    return rows * np.array([1, -1, 1, 1])[: rows.shape[1]] if name in ("gyro_rad", "q") else rows


PLACES = {"CA_ROTOR_COUNT": 4, "CA_ROTOR0_PX": 0.1, "CA_ROTOR1_PX": -0.1, "CA_ROTOR2_PY": 0.1}
REFUSED: dict[str, tuple[Any, dict[str, Any] | None, str]] = {
    "motors that contradict set-points": (
        changed(
            "actuator_motors",
            lambda name, rows: rows[:, [1, 0, 2, 3]] if name == "control" else rows,
            made.by_default_profile(made.topics_of(sensed(), state=False)),
        ),
        None,
        "SDLOG_PROFILE",
    ),
    "motors in another order": (made.topics_of(sensed(), (0, 1, 2, 3)), None, "look permuted"),
    "a gyro with a wrong sign": (changed("sensor_combined", turned), None, "opposite sign"),
    "an attitude with a wrong sign": (changed("vehicle_attitude", turned), None, "opposite sign"),
    "six rotors": (TOPICS, {"CA_ROTOR_COUNT": 6, "CA_ROTOR0_PX": 0.1}, "6 rotors at"),
    "rotors in no X": (TOPICS, PLACES, "expected four in X"),
    "hexarotor": (without_motors(), {"MAV_TYPE": 13, "SYS_AUTOSTART": 6001}, "hexarotor"),
    "VTOL": (without_motors(), {"MAV_TYPE": 22}, "another: VTOL"),
    "fixed wing": (without_motors(), {"MAV_TYPE": 1}, "another: fixed wing"),
    "octorotor": (without_motors(), {"SYS_AUTOSTART": 8001}, "another: octorotor"),
    "quadrotor in +": (without_motors(), {"SYS_AUTOSTART": 5001}, "another: quadrotor in +"),
    "tilt-rotor": (without_motors(), {"CA_AIRFRAME": 3, "CA_ROTOR_COUNT": 4}, "tilt-rotor"),
    "tail-sitter": (
        without_motors(),
        {"CA_AIRFRAME": 4, "CA_ROTOR_COUNT": 4, "MAV_TYPE": 20},
        "another: tail-sitter",
    ),
    "raw commands of a CAN bus": (without_motors(most=8191), None, "CAN bus"),
    "outputs beyond their bounds": (without_motors(most=3000), None, "do not lie between"),
    "slow motors": (rarely("actuator_motors", 20), None, "It holds body rates 100 Hz, motors 5 Hz"),
    "slower motors than needed": (rarely("actuator_motors", 10), None, "SDLOG_PROFILE"),
    "slow sensors": (rarely("sensor_combined", 4), None, "SDLOG_PROFILE"),
    "no motors": (without_motors(), None, "reboot"),
}
"""Topics, parameters and what is said of them."""


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_used_is_refused_with_its_reason(what: str, tmp_path: Path) -> None:
    topics, parameters, says = REFUSED[what]
    with pytest.raises(InputError, match=re.escape(says)):
        read(tmp_path, topics, parameters)


def test_a_slow_or_invalid_position_leaves_sensors_alone(tmp_path: Path) -> None:
    slow, invalid = made.topics_of(sensed()), made.topics_of(sensed())
    place = slow["vehicle_local_position"]
    slow["vehicle_local_position"] = [(field, kind, values[::10]) for field, kind, values in place]
    invalid["vehicle_local_position"] = [
        (field, kind, np.zeros_like(values) if field in made.VALID else values)
        for field, kind, values in place
    ]
    for topics in (slow, invalid):
        (found,) = read(tmp_path, topics)
        assert not found.has_state


def test_disarmed_and_landed_rows_are_left_out(tmp_path: Path) -> None:
    flight = sensed(rows=2000)
    topics = made.topics_of(flight)
    stamps = topics["sensor_combined"][0][2]
    about = stamps[::10]
    landed = about < stamps[0] + 3_000_000
    topics["vehicle_land_detected"] = [
        ("timestamp", "uint64_t", about),
        ("landed", "bool", landed),
    ]
    topics["vehicle_status"] = [
        ("timestamp", "uint64_t", about),
        ("arming_state", "uint8_t", np.where(about > stamps[0] + 15_000_000, 1, 2)),
    ]
    (found,) = read(tmp_path, topics)
    # A second after take-off, one and a half before it disarms.
    assert found.duration == pytest.approx(15.0 - 3.0 - 1.0 - 1.5, abs=0.25)
    first = int(np.argmin(np.abs(flight.position - found.position[0]).sum(axis=1)))
    assert first == pytest.approx(400, abs=12)


def test_what_never_armed_is_told_so_and_not_to_log_motors(tmp_path: Path) -> None:
    topics = made.topics_of(sensed(rows=600))
    stamps = topics["sensor_combined"][0][2]
    disarmed = np.ones(len(stamps), int)
    topics["vehicle_status"] = [
        ("timestamp", "uint64_t", stamps),
        ("arming_state", "uint8_t", disarmed),
    ]
    del topics["actuator_motors"]
    with pytest.raises(InputError, match="never armed"):
        read(tmp_path, topics)


def filtered(topics: dict[str, Any]) -> dict[str, Any]:
    """Topics whose sensors PX4 has low-pass filtered."""
    combined = {field: values for field, _, values in topics.pop("sensor_combined")}
    stamps = combined["timestamp"]
    return topics | {
        topic: [
            ("timestamp", "uint64_t", stamps + 100),
            ("timestamp_sample", "uint64_t", stamps),
            ("xyz", "float", values),
        ]
        for topic, values in (
            ("vehicle_angular_velocity", combined["gyro_rad"]),
            ("vehicle_acceleration", combined["accelerometer_m_s2"]),
        )
    }


def test_filtered_topics_serve_where_there_are_no_others(tmp_path: Path) -> None:
    flight = sensed()
    topics = filtered(made.topics_of(flight, state=False))
    (found,) = read(tmp_path, topics)
    assert_allclose(found.body_rates, flight.body_rates, atol=1e-5)
    assert_allclose(found.arrays["accelerometer"], flight.arrays["accelerometer"], atol=1e-5)
    # Of Butterworth filters at PX4's 30 and 40 Hz; none of what is not filtered.
    assert found.accelerometer_delay == pytest.approx(0.0075, abs=1e-4)
    assert not found.by_battery_law
    assert found.gyro_delay == pytest.approx(0.0056, abs=1e-4)
    (plain,) = read(tmp_path, made.topics_of(flight, state=False))
    assert (plain.accelerometer_delay, plain.gyro_delay) == (0.0, 0.0)


def test_damaged_files_are_refused_or_named(tmp_path: Path) -> None:
    raw = made.ulog(made.topics_of(sensed()), made.placed())
    path = tmp_path / "cut.ulg"
    path.write_bytes(raw[: 3 * len(raw) // 4])
    assert 400 < sum(map(len, read_flights(path))) < 500
    torn = bytearray(raw)
    torn[len(raw) // 2 : len(raw) // 2 + 400] = bytes(400)
    path.write_bytes(bytes(torn))
    flights = read_flights(path)
    assert sum(map(len, flights)) > 400
    for content in (b"ULog", raw[:40], raw[:2000], b"text", b""):
        path.write_bytes(content)
        with pytest.raises(InputError):
            read_flights(path)


def test_in_a_folder_it_stands_beside_others(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    for name, seed in (("A.ULG", 0), ("b.ulg", 1)):
        flight = dataclasses.replace(sensed(), body_rates=driven(600, seed).body_rates)
        flight = dataclasses.replace(
            driven(600, seed), accelerometer=flight.arrays["accelerometer"]
        )
        (tmp_path / "one" / name).write_bytes(made.ulog(made.topics_of(flight), made.placed()))
    (tmp_path / "bad.ulg").write_bytes(b"no")
    flights = read_flights(tmp_path)
    assert len(flights.paths) == 2
    assert len(flights.refused) == 1
    with pytest.raises(InputError):
        read_flights(tmp_path / "one", battery_law="legacy propellers")


@pytest.mark.parametrize(
    "default_profile",
    [
        pytest.param(False, marks=pytest.mark.slow),
        pytest.param(True, marks=pytest.mark.night),
    ],
)
def test_a_planted_drone_comes_back_through_a_ulog(default_profile: bool, tmp_path: Path) -> None:
    drone = mf.virtual_drone(1)
    flown = mf.record(drone, jax.random.key(1), flights=2, duration=12.0, excitation=0.05)
    for number, flight in enumerate(flown):
        topics = made.topics_of(flight, state=False)
        # Motors at 10 Hz, and set-points at 50 Hz.
        topics = made.by_default_profile(topics, setpoints=2) if default_profile else topics
        topics = filtered(topics)
        parameters = made.placed() | {"IMU_ACCEL_CUTOFF": 30.0, "IMU_GYRO_CUTOFF": 80.0}
        (tmp_path / f"log_{number}.ulg").write_bytes(made.ulog(topics, parameters))
    flights = read_flights(tmp_path)
    assert len(flights) == 2
    start = replace(crazyflie(), mass=drone.parameters.mass)
    found = identify(list(flights), Likelihood(trials=1), start=start).parameters
    errors = {"thrust_to_weight": 0.04, "inertia_x": 0.06, "inertia_y": 0.06}
    # At 50 Hz so calm a flight shows no inertia.
    names = ["thrust_to_weight"] if default_profile else list(errors)
    for name in names:
        value = float(component(drone.parameters, name))
        assert float(component(found, name)) == pytest.approx(value, rel=errors[name]), name
