"""A reality in NumPy, flown one command at a time, flies as the same drone in JAX does."""

from typing import Any

import jax
import numpy as np
import pytest

from maidenflight.errors import InputError
from maidenflight.flying import recording
from maidenflight.flying.engine import fly_all
from maidenflight.flying.firmware_pilot import FirmwarePilot
from maidenflight.flying.scenario import Scenario
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.realities.reality import POSITION, Truth
from maidenflight.simulator.tasks import tasks
from numpy_drone import TWIN, NumpyDrone

KEY = jax.random.key(3)


class Ideal:
    """A reality that flies its own position controller, at once and exactly."""

    name, rate, hover, takes = "ideal", 100, 0.5, POSITION

    def reset(self, position: Any, seed: int) -> None:
        self.position = position

    def step(self, command: Any) -> None:
        self.position = command[:3]

    def observe(self) -> Measurement:
        none: Any = np.zeros(3)
        return Measurement(np.array(self.position), none, np.array([0, 0, 0, 1.0]), none)  # type: ignore[arg-type]

    def truth(self) -> Truth:
        return Truth(self.position, np.array([0, 0, 0, 1.0]), np.zeros(3), np.full(4, self.hover))


@pytest.mark.slow
def test_a_recorded_flight_is_that_of_the_same_drone_in_jax() -> None:
    """To 0.1 mm and 1e-3 rad/s over 2 s of excited flight: float32 against float64."""
    drone = NumpyDrone()
    (there,) = recording.record(TWIN, KEY, 1, 2.0, 0.03)
    (here,) = recording.record(drone, KEY, 1, 2.0, 0.03)
    assert (here.simulated, here.zero_order_hold, here.period, len(here)) == (
        "numpy",
        True,
        0.002,
        1000,
    )
    assert np.ptp(here.command, axis=0).min() > 0.2
    np.testing.assert_allclose(here.setpoint, there.setpoint, atol=1e-5)
    np.testing.assert_allclose(here.position, there.position, atol=1e-4)
    np.testing.assert_allclose(here.velocity, there.velocity, atol=3e-4)
    np.testing.assert_allclose(here.attitude, there.attitude, atol=3e-4)
    np.testing.assert_allclose(here.body_rates, there.body_rates, atol=1e-3)
    np.testing.assert_allclose(here.command, there.command, atol=1e-3)
    assert np.isnan(here.battery).all()


def test_each_flight_resets_the_reality_with_a_seed_of_its_own() -> None:
    drone = NumpyDrone()
    one, two = recording.record(drone, KEY, 2, 0.1)
    assert len(set(drone.resets)) == 2
    assert not np.array_equal(one.position[0], two.position[0])


def test_a_reality_with_its_own_position_controller_follows_the_set_point() -> None:
    (flight,) = recording.record(Ideal(), KEY, 1, 0.5, excitation=0.0)
    assert (len(flight), flight.period, flight.zero_order_hold) == (50, 0.01, False)
    np.testing.assert_allclose(flight.position[1:], flight.setpoint[:-1], atol=1e-6)
    np.testing.assert_allclose(flight.command, 0.5)


def test_a_position_controller_cannot_be_excited() -> None:
    with pytest.raises(InputError, match="excitation"):
        recording.record(Ideal(), KEY, 1, 0.5, excitation=0.05)


@pytest.mark.parametrize("rate", [100, 750])
def test_a_rate_that_the_controller_does_not_divide_is_refused(rate: int) -> None:
    with pytest.raises(InputError, match=str(rate)):
        recording.record(NumpyDrone(rate=rate), KEY, 1, 0.5)


def test_arrays_of_wrong_shapes_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(NumpyDrone, "observe", lambda self: (np.zeros(3), np.zeros(2)))
    with pytest.raises(InputError, match="observe"):
        recording.record(NumpyDrone(), KEY, 1, 0.5)


@pytest.mark.parametrize(
    "asked", [{"drones": [TWIN.parameters]}, {"during": lambda drone, elapsed: drone}]
)
def test_other_drones_and_changes_are_refused_where_they_would_not_be_flown(asked: Any) -> None:
    scenario = Scenario(tasks.hover(), 1.0, **asked)
    with pytest.raises(InputError, match="ideal"):
        fly_all(Ideal(), FirmwarePilot(np.float32(0.0)), scenario, jax.random.split(KEY, 1))
