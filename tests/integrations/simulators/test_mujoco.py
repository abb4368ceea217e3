"""Drones in MuJoCo: they hover, motors and axes are ours, and the flight is that of the MJCF."""

from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from maidenflight import parameters
from maidenflight.errors import InputError
from maidenflight.experiments.drones import find_reality
from maidenflight.flights.log import TORQUES
from maidenflight.flying import recording
from maidenflight.integrations.simulators.mujoco import MuJoCo
from maidenflight.parameters import crazyflie, replace
from maidenflight.simulator.realities.reality import check_reality, reality

pytest.importorskip("mujoco", reason="not installed (extra [mujoco])")
START = np.array([0.2, -0.1, 1.0])
WEAK = replace(crazyflie(), thrust_offset=0.03, thrust_linear=0.2, rotor_thrust=(1, 0.9, 1, 0.95))


def flown(drone: Any, command: np.ndarray, steps: int) -> Any:
    """What is observed after holding a command from hover."""
    drone.reset(START, 0)
    for _ in range(steps):
        drone.step(command)
    return drone.observe()


@pytest.mark.parametrize("name", ["crazyflie", "x500"])
def test_it_hovers_at_its_hover_command(name: str) -> None:
    drone = reality(f"mujoco:{name}")
    assert check_reality(drone) is drone
    seen = flown(drone, np.full(4, drone.hover), 500)  # pyright: ignore
    np.testing.assert_allclose(seen.position, START, atol=1e-5)
    np.testing.assert_allclose(seen.velocity, 0.0, atol=1e-4)


@pytest.mark.parametrize("motor", range(4))
def test_each_motor_turns_the_body_as_ours_does_once_its_command_has_arrived(motor: int) -> None:
    drone = MuJoCo("crazyflie")
    command = np.full(4, drone.hover)
    command[motor] += 0.05
    late = int(float(drone.parameters.latency) * drone.rate)
    np.testing.assert_array_equal(flown(drone, command, late).body_rates, 0.0)
    seen = flown(drone, command, late + 15)
    np.testing.assert_array_equal(np.sign(seen.body_rates), TORQUES[motor])
    assert seen.velocity[2] > 0
    np.testing.assert_array_equal(drone.truth().command, command)


def test_thrust_at_rest_follows_the_curve_and_the_share_of_each_rotor(tmp_path: Path) -> None:
    path = parameters.write_drone(tmp_path / "weak.toml", WEAK)
    drone = MuJoCo(str(path))
    command = np.array([0.2, 0.4, 0.6, 0.8])
    flown(drone, command, 1000)
    full = 0.028 * 9.81 * 1.725 / 4 * np.array([1, 0.9, 1, 0.95])
    expected = full * (0.03 + 0.2 * np.sqrt(command) + 0.77 * command)
    np.testing.assert_allclose(drone._data.actuator_force, expected, rtol=1e-5)


def test_two_flights_from_one_start_are_one_and_no_command_of_the_first_is_left() -> None:
    drone = MuJoCo("crazyflie")
    seen = [flown(drone, np.full(4, 0.9), 40) for _ in range(2)]
    for one, other in zip(*seen, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.slow
def test_the_firmware_flies_it_and_its_log_says_so() -> None:
    (flight,) = recording.record(MuJoCo("crazyflie_2.0"), jax.random.key(0), flights=1, duration=4)
    assert flight.simulated
    assert np.abs(flight.position - flight.setpoint).max() < 0.5


def test_a_drone_that_is_none_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such drone"):
        find_reality("mujoco:crazyfly")
