"""Random numbers from one draw are what their distributions say."""

import jax
import numpy as np
from scipy import stats

from maidenflight.simulator.physics import sensors

NORMAL, UNIFORM = jax.jit(
    lambda key: jax.vmap(lambda key: sensors.draw_noise(key, 3, 2))(jax.random.split(key, 20_000))
)(jax.random.key(0))


def test_normal_and_uniform_numbers_follow_their_distributions():
    for column in np.asarray(NORMAL, np.float64).T:
        assert stats.kstest(column, stats.norm.cdf).pvalue > 1e-3
    for column in np.asarray(UNIFORM, np.float64).T:
        assert stats.kstest(column, stats.uniform(-1, 2).cdf).pvalue > 1e-3


def test_all_of_them_are_independent_and_finite():
    together = np.concatenate([NORMAL, UNIFORM], axis=1)
    assert np.isfinite(together).all()
    np.testing.assert_allclose(np.corrcoef(together.T), np.eye(5), atol=0.03)


def test_another_key_draws_other_numbers_and_the_same_key_the_same():
    first, same, other = (sensors.draw_noise(jax.random.key(seed), 2, 2) for seed in (1, 1, 2))
    np.testing.assert_array_equal(np.concatenate(first), np.concatenate(same))
    assert not np.any(np.concatenate(first) == np.concatenate(other))
