import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from maidenflight.errors import InputError
from maidenflight.policy import Actor, untrained_policy
from maidenflight.simulator.gru import Gru, untrained_gru
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.policy_spec import PolicySpec

KEY = jax.random.key(0)
UNIT = untrained_gru(KEY, 7, 4)


def in_numpy(unit: Gru, values: np.ndarray, memory: np.ndarray) -> np.ndarray:
    """Cho et al. 2014, gate by gate, in float64."""

    def gate(number: int) -> tuple[np.ndarray, np.ndarray]:
        rows = slice(number * unit.size, (number + 1) * unit.size)
        weights, recurrent, biases, recurrent_biases = (
            np.asarray(array, np.float64)[rows]
            for array in (unit.weights, unit.recurrent, unit.biases, unit.recurrent_biases)
        )
        return weights @ values + biases, recurrent @ memory + recurrent_biases

    (a, b), (c, d), (e, f) = gate(0), gate(1), gate(2)
    reset, update = 1 / (1 + np.exp(-(a + b))), 1 / (1 + np.exp(-(c + d)))
    return (1 - update) * np.tanh(e + reset * f) + update * memory


def test_a_step_is_that_of_the_equations() -> None:
    random = np.random.default_rng(0)
    unit = dataclasses.replace(UNIT, recurrent_biases=jnp.linspace(-1.0, 1.0, 12))
    for _ in range(10):
        values, memory = random.normal(size=7), random.uniform(-1, 1, size=4)
        found = unit(jnp.asarray(values, jnp.float32), jnp.asarray(memory, jnp.float32))
        np.testing.assert_allclose(found, in_numpy(unit, values, memory), rtol=0, atol=1e-6)


@given(
    st.lists(st.floats(-1e3, 1e3, width=32), min_size=7, max_size=7),
    st.lists(st.floats(-1, 1, width=32), min_size=4, max_size=4),
)
def test_a_memory_stays_within_one(values: list[float], memory: list[float]) -> None:
    found = UNIT(jnp.array(values, jnp.float32), jnp.array(memory, jnp.float32))
    assert np.abs(found).max() <= 1.0


def test_an_untrained_unit_keeps_most_of_its_memory() -> None:
    kept = UNIT(jnp.zeros(7), jnp.ones(4)) - UNIT(jnp.zeros(7), jnp.zeros(4))
    assert np.all((np.asarray(kept) > 0.5) & (np.asarray(kept) < 1.0))


def test_a_policy_that_remembers_counts_its_unit_and_others_have_none() -> None:
    policy = untrained_policy(KEY, spec=PolicySpec(memory=5, hidden=(8, 6)))
    assert policy.spec.memory == 5
    assert policy.multiplications == 40 * 8 + 15 * 8 + 15 * 5 + 13 * 6 + 6 * 4
    assert untrained_policy(KEY, spec=PolicySpec(hidden=(8, 6))).gru is None


@pytest.mark.parametrize("field", ["weights", "recurrent", "biases", "recurrent_biases"])
def test_a_damaged_unit_is_refused(field: str) -> None:
    policy = untrained_policy(KEY, spec=PolicySpec(memory=5, hidden=(8, 6)))
    assert policy.gru is not None
    for array in (getattr(policy.gru, field)[:-1], getattr(policy.gru, field) * np.nan):
        unit = dataclasses.replace(policy.gru, **{field: array})
        with pytest.raises(InputError):
            dataclasses.replace(policy, gru=unit).check()


def test_a_memory_needs_a_hidden_layer() -> None:
    with pytest.raises(InputError):
        untrained_policy(KEY, spec=PolicySpec(memory=5, hidden=()))
    short = untrained_policy(KEY, spec=PolicySpec(hidden=()))
    with pytest.raises(InputError):
        dataclasses.replace(short, gru=untrained_gru(KEY, 40, 3)).check()


def test_an_actor_carries_the_memory_over_and_begins_each_flight_without() -> None:
    policy = untrained_policy(KEY, spec=PolicySpec(memory=5, hidden=(8, 6)))
    actor = Actor(policy, 0.5)
    level = Measurement(jnp.ones(3), jnp.ones(3), jnp.array([0.0, 0.0, 0.0, 1.0]), jnp.ones(3))
    actions = [actor.act(level, np.ones(3)).action for _ in range(3)]
    assert not np.array_equal(actions[1], actions[2])
    actor.reset()
    np.testing.assert_array_equal(actor.act(level, np.ones(3)).action, actions[0])
