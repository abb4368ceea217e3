"""Drones in l2f: they hover, their motors and axes are ours, and our equations agree with it."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from arrays import float32
from maidenflight import parameters
from maidenflight.errors import InputError
from maidenflight.flights.log import TORQUES
from maidenflight.flying import recording
from maidenflight.integrations.simulators.l2f import BODIES, L2F
from maidenflight.parameters import replace
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.realities.reality import check_reality, reality

START = np.array([0.2, -0.1, 1.0])


@pytest.fixture(scope="module")
def l2f() -> None:
    pytest.importorskip("l2f", reason="l2f is not installed (extra [l2f]; pip compiles it)")


def flown(drone: Any, command: np.ndarray, steps: int) -> Any:
    """What is observed after holding a command from hover."""
    drone.reset(START, 0)
    for _ in range(steps):
        drone.step(command)
    return drone.observe()


@pytest.mark.parametrize("name", BODIES)
def test_the_numbers_of_a_drone_are_plausible(name: str) -> None:
    drone = parameters.check(BODIES[name].parameters(), name)
    assert 0.0 < float(dynamics.hover_command(drone)) < 1.0


def test_an_unknown_drone_is_told_with_those_that_are() -> None:
    with pytest.raises(InputError, match="crazyflie"):
        reality("l2f:crazyfly")


@pytest.mark.usefixtures("l2f")
@pytest.mark.parametrize("name", BODIES)
def test_it_hovers_at_its_hover_command(name: str) -> None:
    drone = L2F(name)
    assert check_reality(drone) is drone
    seen = flown(drone, np.full(4, drone.hover), 500)
    np.testing.assert_allclose(seen.position, START, atol=1e-3)
    np.testing.assert_allclose(seen.velocity, 0.0, atol=2e-3)
    np.testing.assert_allclose(seen.quaternion, [0, 0, 0, 1], atol=1e-5)


@pytest.mark.usefixtures("l2f")
@pytest.mark.parametrize("name", BODIES)
@pytest.mark.parametrize("motor", range(4))
def test_each_motor_turns_the_body_as_ours_does(name: str, motor: int) -> None:
    drone = L2F(name)
    command = np.full(4, drone.hover)
    command[motor] += 0.05
    seen = flown(drone, command, 25)
    np.testing.assert_array_equal(np.sign(seen.body_rates), TORQUES[motor])
    assert seen.velocity[2] > 0
    np.testing.assert_array_equal(drone.truth().command, command)


@pytest.mark.usefixtures("l2f")
@pytest.mark.parametrize("name", ["crazyflie", "x500"])
def test_our_equations_fly_the_same(name: str) -> None:
    """Roll, pitch, yaw and thrust for 0.6 s, by RK4 in both with the same step, in float32."""
    drone = L2F(name)
    swing = 0.04 * np.sin(np.arange(300)[:, None] / 20.0 + np.arange(4.0) ** 2)
    commands = float32(np.clip(drone.hover + 0.02 + swing, 0.0, 1.0))
    ours = replace(drone.parameters, time_step=np.float32(1 / drone.rate))

    def one(state: dynamics.State, command: jax.Array) -> tuple[dynamics.State, None]:
        return dynamics.rk4(state, jnp.sqrt(command), ours), None

    start = dynamics.at_hover(float32(START), ours)
    expected = jax.jit(lambda: lax.scan(one, start, commands)[0])()
    drone.reset(START, 0)
    for command in np.asarray(commands):
        drone.step(command)
    seen = drone.observe()
    assert np.abs(np.asarray(expected.body_rates)).max() > 0.05
    np.testing.assert_allclose(seen.position, expected.position, atol=2e-4)
    np.testing.assert_allclose(seen.velocity, expected.velocity, atol=1e-3)
    np.testing.assert_allclose(seen.quaternion, expected.quaternion, atol=1e-3)
    np.testing.assert_allclose(seen.body_rates, expected.body_rates, atol=5e-3)


@pytest.mark.usefixtures("l2f")
def test_a_flight_leaves_nothing_behind() -> None:
    drone = L2F("crazyflie")
    command = np.array([0.75, 0.7, 0.65, 0.7])
    first, again = (flown(drone, command, 50) for _ in range(2))
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.usefixtures("l2f")
@pytest.mark.parametrize("name", ["l2f:crazyflie", "l2f:x500+sensors"])
def test_the_firmwares_pid_flies_it(name: str) -> None:
    (flight,) = recording.record(reality(name), jax.random.key(0), flights=1, duration=3.0)
    assert flight.simulated == name
    assert np.linalg.norm(flight.position - flight.setpoint, axis=1).max() < 0.3
