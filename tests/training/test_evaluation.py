import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight.parameters import crazyflie
from maidenflight.policy import untrained_policy
from maidenflight.simulator import environment, stepping
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.randomization import randomize, relative_box, stacked
from maidenflight.training.evaluation import (
    Evaluation,
    evaluate,
    evaluate_together,
    starts_of,
)

BOX = relative_box(crazyflie(), 0.10)
ENV, EPISODES, STEPS = Environment(), 4, 300
"""The same in every test, so that evaluation is compiled once."""


@pytest.mark.slow
def test_a_score_is_what_a_plain_loop_counts() -> None:
    policy = untrained_policy(jax.random.key(4))
    score = evaluate(ENV, policy, BOX, jax.random.key(1), EPISODES, STEPS)
    step = jax.jit(stepping.step, static_argnums=0)
    returns, survivals, distances = [], [], []
    for key in jax.random.split(jax.random.key(1), EPISODES):
        launch_key, key = jax.random.split(key)
        drone_key, reset_key = jax.random.split(launch_key)
        drone = randomize(BOX, drone_key)
        env_state = environment.reset(ENV, drone, reset_key)
        total, alive = 0.0, True
        for now in jax.random.split(key, STEPS):
            seen = environment.observation(ENV, env_state)
            env_state, step_result = step(ENV, env_state, policy(seen), drone, now)
            total += float(step_result.reward)
            if bool(step_result.terminated):
                alive = False
                break
            distances.append(float(np.linalg.norm(step_result.setpoint - env_state.state.position)))
        returns.append(total)
        survivals.append(alive)
    np.testing.assert_allclose(float(score.episode_return), np.mean(returns), rtol=1e-4)
    np.testing.assert_allclose(float(score.survival), np.mean(survivals))
    np.testing.assert_allclose(float(score.position_error), np.mean(distances), rtol=1e-4)
    seconds = len(distances) / len(returns) / ENV.controller.interface.rate
    np.testing.assert_allclose(float(score.duration), seconds, rtol=1e-4)


@pytest.mark.slow
def test_policies_are_scored_together_as_each_alone() -> None:
    keys = jax.random.split(jax.random.key(5), 2)
    starts = starts_of(ENV, EPISODES, stacked([BOX, BOX]))
    together = evaluate_together(ENV, EPISODES, jax.vmap(untrained_policy)(keys), starts)
    for number, key in enumerate(keys):
        # Both fall within these steps of the whole episode.
        alone = evaluate(ENV, untrained_policy(key), BOX, jax.random.key(0), EPISODES, STEPS)
        for one, all_of_them in zip(alone, together, strict=True):
            np.testing.assert_allclose(one, all_of_them[number], rtol=1e-4)


@pytest.mark.parametrize(
    ("better", "worse"),
    [
        ((-236.0, 1.0, 5.0), (-182.0, 0.0, 0.3)),  # a hover that lasts, one that falls at once
        ((-8.0, 0.992, 4.9), (-9.0, 1.0, 5.0)),  # one of 128 episodes is luck
        ((-40.0, 0.8, 4.0), (-30.0, 0.7, 4.5)),
        ((-114.0, 0.0, 0.9), (-106.0, 0.01, 0.4)),  # none flies: the longer of two falls
        ((-1e9, 0.0, 0.1), (-np.inf, -np.inf, -np.inf)),
    ],
)
def test_survival_comes_first_then_return_or_time_where_none_survives(
    better: tuple[float, float, float], worse: tuple[float, float, float]
) -> None:
    one, other = (
        Evaluation(*map(jnp.asarray, (reward, survival, 0.1, duration)))
        for reward, survival, duration in (better, worse)
    )
    assert bool(one.beats(other))
    assert not bool(other.beats(one))
    assert not bool(one.beats(one))


@pytest.mark.slow
def test_failing_costs_the_terminal_penalty() -> None:
    score = evaluate(
        ENV, untrained_policy(jax.random.key(4)), BOX, jax.random.key(2), EPISODES, STEPS
    )
    assert float(score.survival) == 0.0
    assert -140.0 < float(score.episode_return) < -100.0
