"""One update of the firmware's PID controllers, by hand."""

import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight.parameters.platforms import Gains
from maidenflight.simulator.controllers.pid import PIDMemory, pid

GENERATIONS = ("2021.10", "2026.08")


def updated(memory, desired, measured, limit, generation, heading=False):
    """Three PIDs with gains and limits of our own; the third has no integral part."""
    rows = (2, 3, 4), (0.5, 1, 0), (0.1, 0, 0.2), (0.3, 0.2, 0.1), (limit, limit, limit)
    return pid(memory, desired, measured, Gains(*rows), generation, 100, heading)


@pytest.mark.parametrize(
    ("generation", "slope"), [("2021.10", [50, -200, -50]), ("2026.08", [-50, 200, 50])]
)
def test_a_pid_is_proportional_integral_and_derivative_by_hand(generation, slope):
    before = PIDMemory(jnp.array([0.1, 0.1, 0.0]), jnp.array([0.5, 0.0, 1.0]))
    memory, output = updated(
        before, jnp.array([2.0, -4.0, 1.0]), jnp.array([1.0, -2.0, 0.5]), 1000, generation
    )
    np.testing.assert_allclose(memory.integral, [0.11, 0.08, 0.005], atol=1e-6)
    np.testing.assert_allclose(memory.last, [1.0, -2.0, 0.5])
    np.testing.assert_allclose(
        output, [2 + 0.055 + 0.1 * slope[0], -6 + 0.08, 2 + 0.2 * slope[2]], rtol=1e-5
    )


@pytest.mark.parametrize("generation", GENERATIONS)
@pytest.mark.parametrize("sign", [1, -1])
def test_integral_and_output_stop_at_their_limits(sign, generation):
    memory, output = PIDMemory(jnp.zeros(3), jnp.zeros(3)), jnp.zeros(3)
    for _ in range(5):
        memory, output = updated(memory, jnp.full(3, 10.0 * sign), jnp.zeros(3), 35, generation)
    np.testing.assert_allclose(memory.integral, sign * np.array([0.3, 0.2, 0.1]), rtol=1e-6)
    np.testing.assert_allclose(output, sign * np.array([20 + 0.15, 30 + 0.2, 35]), rtol=1e-6)


@pytest.mark.parametrize("generation", GENERATIONS)
def test_yaw_turns_the_short_way_and_its_derivative_sees_no_jump(generation):
    def output(desired, first, then):
        memory = PIDMemory(jnp.zeros(3), jnp.zeros(3))
        for measured in (first, then):
            memory, out = updated(
                memory,
                jnp.array([0, 0, desired]),
                jnp.array([0, 0, measured]),
                1000,
                generation,
                True,
            )
        return float(out[2])

    assert output(-170.0, 179.5, -179.5) == pytest.approx(output(10.0, -0.5, 0.5), rel=1e-4)
