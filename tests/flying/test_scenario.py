"""First states of predicted flights, against the distribution that they are drawn from."""

import jax
import numpy as np
from scipy import stats

from maidenflight.experiments.conditions import read_conditions
from maidenflight.parameters import crazyflie
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.tasks import tasks
from pages import ROOT

PUBLISHED_START = read_conditions(ROOT / "paper" / "settings" / "gronauer_2021.toml").start


def test_starts_follow_a_multivariate_t_distribution() -> None:
    drone = crazyflie()
    env = Environment.matching(drone, tasks.paper_circle())
    keys = jax.random.split(jax.random.key(0), 20_000)
    states = jax.jit(jax.vmap(lambda key: PUBLISHED_START.draw(env, drone, key)))(keys)
    start = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), PUBLISHED_START)
    origin = np.asarray(env.task.reference(jax.numpy.zeros(())))
    offsets = (np.asarray(states.position) - origin - [0.0, 0.0, start.above]) / start.position
    speeds = np.asarray(states.velocity) / start.velocity
    law = stats.t(4)
    rolling = np.asarray(states.body_rates)[:, 0] / start.body_rates[0]
    for component in (*offsets.T, *speeds.T, rolling):
        assert stats.kstest(component, law.cdf).pvalue > 1e-3
    # One factor for all: where the height is far off, so are the rates, whose signs are free.
    assert np.corrcoef(abs(offsets[:, 2]), abs(speeds[:, 2]))[0, 1] > 0.15
    towards = [stats.kendalltau(offsets[:, axis], speeds[:, axis])[0] for axis in (0, 1)]
    # Of elliptical distributions: sin(pi / 2 tau) is the correlation (Lindskog et al. 2003).
    np.testing.assert_allclose(np.sin(np.pi / 2 * np.array(towards)), -start.homeward, atol=0.02)
