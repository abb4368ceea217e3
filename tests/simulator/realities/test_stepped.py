"""A virtual drone one command at a time is the virtual drone."""

import numpy as np
import pytest

from maidenflight.parameters import noiseless, replace
from maidenflight.simulator.realities.reality import check_reality
from maidenflight.simulator.realities.stepped import Stepped
from maidenflight.simulator.realities.virtual_drone import VirtualDrone
from numpy_drone import TWIN, NumpyDrone

pytestmark = pytest.mark.slow

START = np.array([0.1, 0.2, 1.0])


def test_it_flies_as_the_independent_transcription_in_numpy() -> None:
    stepped, twin = Stepped(TWIN), NumpyDrone()
    assert check_reality(stepped) is stepped
    commands = 0.58 + 0.05 * np.sin(np.arange(100)[:, None] / 5 + np.arange(4.0))
    for drone in (stepped, twin):
        drone.reset(START, 0)
        for command in commands:
            drone.step(command)
    for one, other in zip(stepped.observe(), twin.observe(), strict=True):
        np.testing.assert_allclose(np.asarray(one), other, atol=2e-3)
    np.testing.assert_array_equal(stepped.truth().command, commands[-1])


def test_a_seed_repeats_its_noise() -> None:
    noisy = VirtualDrone(
        "noisy", replace(noiseless(TWIN.parameters), gyro_noise=0.1), thrust_law=None
    )
    drone, seen = Stepped(noisy), []
    for seed in (1, 1, 2):
        drone.reset(START, seed)
        drone.step(np.full(4, drone.hover))
        seen.append(np.asarray(drone.observe().body_rates))
    np.testing.assert_array_equal(seen[0], seen[1])
    assert not np.array_equal(seen[0], seen[2])
