"""Drones in crazyflow, in its own process: they hover, and motors and axes are ours."""

import importlib.util
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from arrays import float32
from maidenflight.errors import InputError
from maidenflight.flights.log import TORQUES
from maidenflight.integrations.simulators.crazyflow import Crazyflow
from maidenflight.parameters import replace
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.realities.reality import check_reality, reality

START = np.array([0.2, -0.1, 1.0])
needed = pytest.mark.skipif(
    importlib.util.find_spec("crazyflow") is None,
    reason="crazyflow is not installed (extra [crazyflow])",
)


@pytest.fixture(scope="module", params=["cf21B_500", "cf2x_L250"])
def drone(request: pytest.FixtureRequest) -> Iterator[Any]:
    made = Crazyflow(request.param)
    yield made
    made.close()


def flown(drone: Any, command: np.ndarray, steps: int) -> Any:
    drone.reset(START, 0)
    for _ in range(steps):
        drone.step(command)
    return drone.observe()


@needed
def test_an_unknown_drone_is_refused_and_those_that_are_are_named() -> None:
    with pytest.raises(InputError, match="cf2x_L250"):
        reality("crazyflow:cf3")


@needed
def test_it_hovers_at_its_hover_command(drone: Any) -> None:
    assert check_reality(drone) is drone
    seen = flown(drone, np.full(4, drone.hover), 500)
    np.testing.assert_allclose(seen.position, START, atol=1e-3)
    np.testing.assert_allclose(seen.velocity, 0.0, atol=2e-3)


@needed
@pytest.mark.parametrize("motor", range(4))
def test_each_motor_turns_the_body_as_ours_does(drone: Any, motor: int) -> None:
    command = np.full(4, drone.hover)
    command[motor] += 0.05
    seen = flown(drone, command, 25)
    np.testing.assert_array_equal(np.sign(seen.body_rates), TORQUES[motor])
    assert seen.velocity[2] > 0
    np.testing.assert_array_equal(drone.truth().command, command)


@needed
def test_our_equations_fly_nearly_the_same(drone: Any) -> None:
    """Where motors move little, since their lag is that about hover; explicit Euler in both."""
    swing = 0.01 * np.sin(np.arange(200)[:, None] / 20.0 + np.arange(4.0) ** 2)
    commands = float32(drone.hover + 0.01 + swing)
    ours = replace(drone.parameters, time_step=np.float32(1 / drone.rate))

    def one(state: dynamics.State, command: jax.Array) -> tuple[dynamics.State, None]:
        return dynamics.euler(state, jnp.sqrt(command), ours), None

    start = dynamics.at_hover(float32(START), ours)
    expected = jax.jit(lambda: lax.scan(one, start, commands)[0])()
    drone.reset(START, 0)
    for command in np.asarray(commands):
        drone.step(command)
    seen, size = drone.observe(), np.abs(np.asarray(expected.body_rates)).max()
    assert size > 0.05
    np.testing.assert_allclose(seen.body_rates, expected.body_rates, atol=0.05 * size)
    tilt = np.abs(np.asarray(expected.quaternion[:3])).max()
    np.testing.assert_allclose(seen.quaternion, expected.quaternion, atol=0.05 * tilt)
    moved = np.abs(np.asarray(expected.velocity)).max()
    np.testing.assert_allclose(seen.velocity, expected.velocity, atol=0.05 * moved)


@needed
def test_a_process_that_ends_is_told() -> None:
    drone = Crazyflow("cf2x_P250")
    drone._process.kill()
    with pytest.raises(InputError, match="crazyflow:cf2x_P250"):
        drone.step(np.full(4, 0.5))
