"""RAPTOR sees and commands what its package documents, and flies beside ours."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight.errors import InputError
from maidenflight.experiments.transfer import transfer
from maidenflight.flying.foreign_policy import foreign_policy, reference_velocity
from maidenflight.flying.pilots import ForeignPolicy
from maidenflight.integrations.raptor.foundation_policy import _network, observed
from maidenflight.policy import untrained_policy
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.realities.reality import reality
from maidenflight.simulator.realities.virtual_drone import virtual_drone
from maidenflight.simulator.tasks import tasks
from maidenflight.verbs.transfer import Transfer


@pytest.fixture(scope="module")
def raptor() -> None:
    pytest.importorskip("foundation_policy", reason="not installed (extra [raptor])")


def test_without_its_package_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "foundation_policy", None)
    from maidenflight.integrations.raptor import foundation_policy as raptor

    raptor._network.cache_clear()
    with pytest.raises(InputError, match="raptor"):
        foreign_policy("raptor")


def test_other_names_are_no_policies_by_others(tmp_path: Path) -> None:
    assert foreign_policy("policies/policy_1.json") is None
    assert foreign_policy(tmp_path) is None


def test_it_sees_errors_in_the_world_the_rotation_by_rows_and_its_last_action() -> None:
    quarter = np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])
    parts = ([0.1, 0.2, 1.9], [0.0, 0.3, -2.0], quarter, [1.0, 2.0, 3.0])
    measurement = Measurement(*map(jnp.asarray, parts))
    last = np.array([0.5, -3.0, 0.0, 0.1])
    seen = observed(measurement, np.array([0.0, 0.0, 1.0]), np.array([0.1, 0.0, 0.0]), last)
    assert seen.shape == (22,)
    np.testing.assert_allclose(seen[:3], [0.1, 0.2, 0.5], atol=1e-6)
    np.testing.assert_allclose(seen[3:12], [0, -1, 0, 1, 0, 0, 0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(seen[12:15], [-0.1, 0.3, -1.0], atol=1e-6)
    np.testing.assert_allclose(seen[15:18], [1, 2, 3], atol=1e-6)
    np.testing.assert_allclose(seen[18:], [0.5, -1.0, 0.0, 0.1], atol=1e-6)


def test_the_velocity_of_the_set_point_is_its_derivative() -> None:
    task = tasks.circle()
    later, earlier = (np.asarray(task.reference(jnp.float32(0.7 + d))) for d in (0.01, -0.01))
    measured = (later - earlier) / 0.02
    np.testing.assert_allclose(reference_velocity(task)(0.7), measured, atol=1e-3)


@pytest.mark.usefixtures("raptor")
def test_its_memory_advances_at_100_hz_while_it_commands_at_500() -> None:
    level = Measurement(*map(jnp.asarray, ([0, 0, 1.0], [0.0] * 3, [0, 0, 0, 1.0], [0.0] * 3)))
    policy = foreign_policy("raptor:500hz")
    assert isinstance(policy, ForeignPolicy)
    fly, (memory,) = (
        policy.begin(0.6, tasks.hover()),
        [one for one in _network().layers if hasattr(one, "state")],
    )
    entered, commands = [], []
    step = memory.evaluate_step

    def watched(numbers: np.ndarray) -> np.ndarray:
        entered.append(memory.state)
        return step(numbers)

    memory.evaluate_step = watched
    try:
        commands = [fly(level, np.array([0.0, 0.0, 1.0])) for _ in range(15)]
    finally:
        del memory.evaluate_step
    assert entered[0] is None
    for tick in (1, 6):
        assert all(one is entered[tick] for one in entered[tick : tick + 5])
    assert not np.array_equal(entered[1], entered[6])
    assert np.all((np.array(commands) > 0.1) & (np.array(commands) < 0.95))


@pytest.mark.usefixtures("raptor")
def test_it_flies_beside_ours_in_one_table() -> None:
    policies = [untrained_policy(jax.random.key(0)), foreign_policy("raptor:500hz")]
    flown = transfer(policies, [virtual_drone(7)], 1, duration=1.0, names=["ours", "raptor"])  # pyright: ignore
    assert flown.table["policy"].to_list() == ["ours", "raptor"]
    assert flown.table["duration"][1] == 1.0
    assert [flight.period for flight in flown.flights] == [0.01, 0.01]


@pytest.mark.usefixtures("raptor")
@pytest.mark.parametrize("name", ["raptor", "raptor:500hz"])
def test_it_flies_the_circle_in_l2f_where_it_was_trained(name: str) -> None:
    pytest.importorskip("l2f", reason="l2f is not installed (extra [l2f])")
    places = [reality("l2f:crazyflie"), reality("l2f:x500")]
    flown = transfer(foreign_policy(name), places, 1, duration=6.0)  # pyright: ignore
    assert set(flown.table["end_reason"]) == {"time limit"}
    assert flown.table["position_error"].max() < 0.2  # pyright: ignore


@pytest.mark.usefixtures("raptor")
def test_the_command_line_flies_it(tmp_path: Path) -> None:
    flown = Transfer(policies=("raptor",), trials=1, duration=0.2).run(tmp_path).value
    assert set(flown.table["policy"]) == {"raptor"}
    assert (tmp_path / "flights.csv").exists()
