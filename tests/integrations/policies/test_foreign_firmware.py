"""Controllers of the firmware fly beside policies, as the same controller in JAX does."""

import jax
import numpy as np
import pytest

from maidenflight.experiments.transfer import transfer
from maidenflight.flying.foreign_policy import foreign_policy
from maidenflight.flying.pilots import ForeignPolicy
from maidenflight.integrations.policies.firmware import CONTROLLERS, FirmwareController
from maidenflight.simulator.tasks import tasks
from numpy_drone import NumpyDrone

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", CONTROLLERS)
def test_it_flies_by_name(name: str) -> None:
    policy = foreign_policy(name)
    assert isinstance(policy, FirmwareController)
    assert isinstance(policy, ForeignPolicy)
    assert (policy.name, policy.rate, policy.command_rate) == (name, 100, 500)
    flown = transfer(policy, NumpyDrone(), 1, jax.random.key(0), task=tasks.hover(), duration=2.0)
    assert flown.table["duration"].item() == pytest.approx(2.0)
    assert flown.table["position_error"].item() < 0.1


def test_flights_begin_anew() -> None:
    policy = foreign_policy("mellinger")
    assert policy is not None
    drone, setpoint = NumpyDrone(), np.array([0.0, 0.0, 1.0])
    drone.reset(np.array([0.1, 0.0, 0.9]), 0)
    seen = drone.observe()
    fly = policy.begin(0.5, tasks.circle())
    first, second = fly(seen, setpoint), fly(seen, setpoint)
    assert np.shape(first) == (4,)
    assert not np.array_equal(first, second)
    np.testing.assert_array_equal(policy.begin(0.5, tasks.circle())(seen, setpoint), first)
