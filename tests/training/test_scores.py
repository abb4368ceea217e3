"""The scores of a training."""

import jax.numpy as jnp

from maidenflight.training.evaluation import Evaluation
from maidenflight.training.scores import best_scores
from maidenflight.training.train import Progress


def test_best_scores_are_those_of_the_policy_that_is_kept() -> None:
    heard = [
        Progress(1, 1, Evaluation(*(jnp.array([value, -value]) for _ in Evaluation._fields)))
        for value in (1.0, 3.0, 2.0)
    ]
    first, second = best_scores(heard)
    assert set(first.values()) == {3.0}
    assert set(second.values()) == {-1.0}
