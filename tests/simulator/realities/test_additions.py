"""What a reality's name adds: latency that is the same as in the simulator, and sensors."""

from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from maidenflight import parameters
from maidenflight.errors import InputError
from maidenflight.registry import REALITIES
from maidenflight.simulator.controllers import control
from maidenflight.simulator.realities.additions import (
    AIR_FORCE,
    AIR_TORQUE,
    jump_of,
    split,
    with_additions,
)
from maidenflight.simulator.realities.around import (
    SENSORS,
    DelayWrapper,
    MotorBiasWrapper,
    SensorWrapper,
)
from maidenflight.simulator.realities.reality import check_reality, reality, seed_of
from maidenflight.simulator.realities.stepped import Stepped
from maidenflight.simulator.realities.virtual_drone import VirtualDrone, virtual_drone
from maidenflight.simulator.tasks import tasks
from numpy_drone import NumpyDrone

START = np.array([0.1, 0.2, 1.0])


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("virtual:7", ("virtual:7", [])),
        ("virtual:7+10ms", ("virtual:7", ["10ms"])),
        ("l2f:x500+sensors+2.5ms", ("l2f:x500", ["sensors", "2.5ms"])),
        ("near:1@crazyflie_2.1++10ms", ("near:1@crazyflie_2.1+", ["10ms"])),
        ("virtual:7+noise", ("virtual:7+noise", [])),
        ("near:7+air+10ms", ("near:7", ["air", "10ms"])),
        ("far:2+yaw-6000+weak10", ("far:2", ["yaw-6000", "weak10"])),
        ("virtual:3+payload15+yaw4000@5", ("virtual:3", ["payload15", "yaw4000@5"])),
        ("near:1@own.toml+weak10@2.5+10ms", ("near:1@own.toml", ["weak10@2.5", "10ms"])),
        ("virtual:3+yaw4000@own.toml", ("virtual:3+yaw4000@own.toml", [])),
    ],
)
def test_additions_are_read_from_the_end(name: str, expected: tuple[str, list[str]]) -> None:
    assert split(name) == expected


def test_a_virtual_drone_gets_other_parameters() -> None:
    plain, added = reality("near:7"), reality("near:7+sensors+10ms")
    assert isinstance(plain, VirtualDrone)
    assert isinstance(added, VirtualDrone)
    assert added.name == "near:7+sensors+10ms"
    assert added.parameters.latency == pytest.approx(float(plain.parameters.latency) + 0.01)
    for name, value in SENSORS.items():
        assert getattr(added.parameters, name) == np.float32(value)
    assert added.parameters.mass == plain.parameters.mass


def test_moving_air_disturbs_by_shares_of_weight_and_arm_or_as_the_drone_has_it() -> None:
    calm, moved = reality("near:7"), reality("near:7+air")
    assert isinstance(calm, VirtualDrone)
    assert isinstance(moved, VirtualDrone)
    assert moved.name == "near:7+air"
    weight, arm = calm.parameters.mass * calm.parameters.gravity, 0.0396
    torque, force = moved.parameters.disturbance_torque, moved.parameters.disturbance_force
    np.testing.assert_allclose(torque, weight * arm * np.array(AIR_TORQUE), rtol=1e-5)
    np.testing.assert_allclose(force, weight * np.array(AIR_FORCE), rtol=1e-5)
    for plain, disturbed in ((calm, False), (moved, True)):
        assert plain.environment(tasks.circle(), control.pwm()).disturbed is disturbed
    own = parameters.replace(calm.parameters, disturbance_torque=(1e-5, 0.0, 0.0))
    about = with_additions(VirtualDrone("own", own), ["air"])
    jax.tree.map(np.testing.assert_array_equal, about.parameters, own)
    inherits = virtual_drone(3, "far", own).parameters
    np.testing.assert_array_equal(inherits.disturbance_torque, own.disturbance_torque)
    with pytest.raises(InputError, match="air"):
        with_additions(Stepped(calm), ["air"])


def test_a_name_that_ends_like_an_addition_is_a_drone(tmp_path: Path) -> None:
    file = tmp_path / "heavy+10ms"
    parameters.write_drone(file, parameters.crazyflie(), {})
    plain = reality(str(file))
    assert isinstance(plain, VirtualDrone)
    assert plain.parameters.latency == parameters.crazyflie().latency
    assert reality("crazyflie_2.1+").name == "crazyflie_2.1+"
    assert reality("crazyflie_2.1++10ms").name == "crazyflie_2.1++10ms"


@pytest.mark.parametrize(
    "name",
    [
        "near:7+10ms+5ms",
        "near:7+sensors+sensors",
        "near:7+45ms",
        "near:7+yaw600+yaw-6000",
        "near:7+weak10+weak5",
        "near:7+weak10+weak5@1",
        "near:7+payload90",
        "near:7+payload90@5",
        "near:7+sensors@5",
        "near:7+10ms@5",
        "near:7+yaw600@1+payload15@2",
    ],
)
def test_what_cannot_be_added_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="near:7"):
        reality(name)


def test_a_payload_beyond_the_thrust_names_the_ratio() -> None:
    heavy = 1.0 + 90 / 100
    plain: Any = reality("near:7")
    ratio = float(plain.parameters.thrust_to_weight) / heavy
    with pytest.raises(InputError, match=f"cannot lift 90 % more.*{ratio:.3f} with this payload"):
        reality("near:7+payload90")


def test_a_latency_between_two_steps_is_refused() -> None:
    with pytest.raises(InputError, match="2 ms"):
        DelayWrapper(NumpyDrone(), 0.003)


def test_a_wrapped_latency_is_that_of_the_simulator(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(REALITIES.own, "numpy", lambda seed: NumpyDrone(latency_steps=2))
    late, twin = reality("numpy:0+10ms"), NumpyDrone(latency_steps=12)
    assert isinstance(late, DelayWrapper)
    assert check_reality(late) is late
    assert late.name == "numpy+10ms"
    commands = 0.58 + 0.05 * np.sin(np.arange(60)[:, None] / 5 + np.arange(4.0))
    for drone in (late, twin):
        drone.reset(START, 0)
        for command in commands:
            drone.step(command)
    for one, other in zip(late.truth(), twin.truth(), strict=True):
        np.testing.assert_array_equal(one, other)
    late.reset(START, 0)
    np.testing.assert_array_equal(late.truth().command, np.full(4, late.hover))


def test_a_trim_in_yaw_is_the_torque_of_motors_that_differ_by_it() -> None:
    plain, added = reality("near:7"), reality("near:7+yaw6000")
    assert isinstance(plain, VirtualDrone)
    assert isinstance(added, VirtualDrone)
    own = plain.parameters
    each = 0.5 + 6000 / 65535 * np.asarray(own.rotor_direction)
    full = own.thrust_to_weight * own.mass * own.gravity / 4
    torque = np.sum(own.rotor_direction * own.torque_to_thrust * full * each)
    np.testing.assert_allclose(
        added.parameters.torque_bias - own.torque_bias, [0.0, 0.0, torque], rtol=1e-5
    )


def test_a_weak_motor_gives_less_thrust() -> None:
    plain, added = reality("near:7"), reality("near:7+weak10")
    assert isinstance(plain, VirtualDrone)
    assert isinstance(added, VirtualDrone)
    np.testing.assert_allclose(
        added.parameters.rotor_thrust, plain.parameters.rotor_thrust * [0.9, 1, 1, 1], rtol=1e-6
    )


def test_a_payload_leaves_thrust_torques_and_air_drag_in_newtons() -> None:
    drones = reality("virtual:7"), reality("virtual:7+payload15")
    plain, added = (one.parameters for one in drones if isinstance(one, VirtualDrone))
    assert added.mass == pytest.approx(1.15 * plain.mass)
    thrusts = [one.thrust_to_weight * one.mass * one.gravity for one in (plain, added)]
    assert thrusts[1] == pytest.approx(thrusts[0], rel=1e-6)
    np.testing.assert_allclose(added.drag * added.mass, plain.drag * plain.mass, rtol=1e-6)
    np.testing.assert_array_equal(added.inertia, plain.inertia)


def test_what_appears_in_flight_is_what_would_hold_from_the_start() -> None:
    plain, jumps = reality("near:7+10ms"), reality("near:7+yaw4000@2.50+10ms+payload15@2.5")
    assert isinstance(plain, VirtualDrone)
    assert isinstance(jumps, VirtualDrone)
    assert jumps.name == "near:7+yaw4000@2.5+10ms+payload15@2.5"
    assert jump_of(jumps.name) == 2.5
    assert jump_of(plain.name) is None
    assert plain.later is None
    assert jumps.later is not None
    assert jumps.later.at == 2.5
    constant = reality("near:7+yaw4000+payload15+10ms")
    assert isinstance(constant, VirtualDrone)
    for name in parameters.QUANTITIES:
        was, becomes = getattr(jumps.parameters, name), getattr(jumps.later.parameters, name)
        np.testing.assert_array_equal(was, getattr(plain.parameters, name))
        np.testing.assert_array_equal(becomes, getattr(constant.parameters, name))


@pytest.mark.parametrize(
    "use",
    [
        lambda drone: drone.environment(tasks.circle(), control.pwm()),
        Stepped,
    ],
    ids=["environment", "stepped"],
)
def test_where_a_change_in_flight_is_not_simulated_it_is_refused(use) -> None:
    with pytest.raises(InputError, match="near:7"):
        use(reality("near:7+weak10@5"))


@pytest.mark.parametrize("addition", ["payload15", "yaw4000@5"])
def test_another_reality_has_no_payload_and_does_not_change_in_flight(addition: str) -> None:
    with pytest.raises(InputError, match="numpy"):
        with_additions(NumpyDrone(), [addition])


@pytest.mark.parametrize(
    ("addition", "acting"),
    [
        ("weak10", [0.45, 0.5, 0.5, 0.5]),
        ("yaw6553.5", None),
        ("yaw-13107", [0.7, 0.3, 0.7, 0.3]),
    ],
)
def test_motors_of_other_realities_differ_by_it(
    addition: str, acting: list[float] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(
        REALITIES.own, "numpy", lambda seed: NumpyDrone(resets=[seed_of(f"numpy:{seed}")])
    )
    if acting is None:
        with pytest.raises(InputError):
            reality(f"numpy:0+{addition}")
        return
    uneven, twin = reality(f"numpy:0+{addition}"), NumpyDrone()
    assert isinstance(uneven, MotorBiasWrapper)
    uneven.reset(START, 0)
    twin.reset(START, 0)
    for _ in range(30):
        uneven.step(np.full(4, 0.5))
        twin.step(np.array(acting))
    for one, other in zip(uneven.truth()[:3], twin.truth()[:3], strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(uneven.truth().command, np.full(4, 0.5))


def test_a_reality_that_is_not_given_motor_commands_has_no_trim() -> None:
    drone = NumpyDrone()
    drone.takes = "attitude"
    with pytest.raises(InputError):
        with_additions(drone, ["yaw6000"])


@pytest.mark.slow
def test_sensors_read_with_the_noise_that_they_are_said_to_have() -> None:
    drone = with_additions(NumpyDrone(latency_steps=0), ["sensors"])
    assert isinstance(drone, SensorWrapper)
    seen = []
    for seed in range(40):
        drone.reset(START, seed)
        for _ in range(50):
            drone.step(np.full(4, drone.hover))
            seen.append([*drone.observe()[:2], drone.observe().body_rates])
    # A reading of the gyro and the one 2 ms before have noise in common.
    position, velocity, gyro = (
        np.array(part).reshape(40, 50, 3)[:, 4::5] for part in zip(*seen, strict=True)
    )
    estimates = (position - START).ravel()
    expected = np.hypot(SENSORS["position_noise"], SENSORS["position_noise_uniform"] / np.sqrt(3))
    assert estimates.std() == pytest.approx(expected, rel=0.2)
    assert velocity.std() == pytest.approx(SENSORS["velocity_noise"], rel=0.2)
    within = gyro - gyro.mean(axis=1, keepdims=True)
    assert within.std() * np.sqrt(10 / 9) == pytest.approx(SENSORS["gyro_noise"], rel=0.1)
    biases = gyro.mean(axis=1)
    assert biases.std() == pytest.approx(SENSORS["gyro_turn_on_bias"], rel=0.3)


def test_estimates_come_at_100_hz_the_gyro_at_each_step_and_a_seed_repeats_them() -> None:
    drone = SensorWrapper(NumpyDrone())
    flights = []
    for seed in (3, 3, 4):
        drone.reset(START, seed)
        rows = []
        for _ in range(10):
            rows.append(np.concatenate(drone.observe()))
            drone.step(np.full(4, drone.hover + 0.01))
        flights.append(np.array(rows))
    first, again, other = flights
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    changed = np.any(np.diff(first[:, :10], axis=0) != 0, axis=1)
    np.testing.assert_array_equal(np.flatnonzero(changed), [4])
    assert np.all(np.diff(first[:, 10:], axis=0) != 0)
    np.testing.assert_array_equal(drone.truth().position, drone.inner.truth().position)


@pytest.mark.slow
def test_estimates_are_as_late_as_they_are_said_to_be() -> None:
    """Falling at a constant speed, the estimate lags by its age."""
    drone = SensorWrapper(NumpyDrone(latency_steps=0))
    gaps = []
    for seed in range(30):
        drone.reset(START, seed)
        for _ in range(100):
            drone.step(np.full(4, 0.3))
        gaps.append(drone.observe().position[2] - drone.truth().position[2])
    speed = drone.inner.observe().velocity[2]
    assert np.mean(gaps) == pytest.approx(-speed * SENSORS["estimator_delay"], rel=0.3)
