"""Scores of policies in training, as they come and the best of each."""

import time
from collections.abc import Sequence
from functools import reduce
from typing import Any

import numpy as np
import polars

from maidenflight import names
from maidenflight.training.distillation import Distillation, phase
from maidenflight.training.evaluation import Evaluation
from maidenflight.training.settings import Settings
from maidenflight.training.train import Progress


class Scores:
    """Evaluations of a training."""

    columns = {
        **{"policy": "{policy}", "return": "{episode_return:.1f}"},
        **{"survival": "{survival:.1%}", "position error": "{position_error:.1f cm}"},
    }
    """Of a table of the best, by `terminal.Table`'s rules."""

    def __init__(self, learner: Settings, resumed: bool) -> None:
        self._learner, self._resumed = learner, resumed
        self._evaluations: list[Progress] = []
        self._first: Progress | None = None
        self._began = time.perf_counter()
        self._fresh = 0

    def add(self, now: Progress) -> str:
        """Adds an evaluation; returns it as text, with the speed of training."""
        # Evaluations of a checkpoint take no time, and the first other includes compilation.
        since, first = time.perf_counter() - self._began, self._first
        speed = f", {(now.steps - first.steps) / since / 1e3:.0f} k steps/s" if first else ""
        self._fresh += now.best is not None
        # Of a checkpoint's evaluations the last one has policies.
        if first is None and self._fresh == 1 + self._resumed:
            self._first, self._began = now, time.perf_counter()
        self._evaluations.append(now)
        distilled = isinstance(self._learner, Distillation)
        doing = f"{phase(now.update, self._learner.updates)}: " if distilled else ""
        return f"{doing}{describe(now)}{speed}"

    @property
    def table(self) -> polars.DataFrame:
        """Returns a row a policy and evaluation."""
        return polars.DataFrame(
            [
                {"update": now.update, "steps": now.steps, "policy": number + 1}
                | _plain(now.score, number)
                for now in self._evaluations
                for number in _learning(now)
            ]
        )

    def has(self, now: Progress) -> bool:
        """Returns whether an evaluation is one of them."""
        return any(now.update == earlier.update for earlier in self._evaluations)

    @property
    def updates(self) -> list[int]:
        """Returns after how many updates each policy was scored last."""
        last = {number: now.update for now in self._evaluations for number in _learning(now)}
        return [last[number] for number in sorted(last)]

    @property
    def best(self) -> list[dict[str, float]]:
        """Returns each policy's best scores, which are those of the policy that training keeps."""
        return best_scores(self._evaluations)

    @property
    def rows(self) -> list[dict[str, Any]]:
        """Returns a row of a table for each policy's best scores."""
        return [{"policy": f"policy_{number}", **row} for number, row in enumerate(self.best, 1)]


def best_scores(evaluations: Sequence[Progress]) -> list[dict[str, float]]:
    """Returns the best scores of each policy among the evaluations of a training."""

    def best(number: int) -> Evaluation:
        scores = (evaluation.score for evaluation in evaluations)
        return reduce(lambda old, new: new if bool(new.beats(old)[number]) else old, scores)

    count = len(evaluations[0].score.survival)
    return [_plain(best(number), number) for number in range(count)]


SIMILAR_SURVIVAL, SIMILAR_ERROR = 0.05, 1.5
"""Difference of survival, and ratio of position errors, beyond which policies differ much; ours."""


def describe_spread(best: Sequence[dict[str, float]]) -> list[str]:
    """Returns how far policies of different seeds are apart, and what to do where that is much.

    Args:
        best: their scores; see `best_scores`.
    """
    if len(best) < 2:
        return []
    survival, error = ([scores[name] for scores in best] for name in ("survival", "position_error"))
    spread = (
        f"spread over {len(best)} seeds: survival {min(survival):.0%} to {max(survival):.0%}, "
        f"position error {100 * min(error):.1f} to {100 * max(error):.1f} cm"
    )
    much = max(survival) - min(survival) > SIMILAR_SURVIVAL
    much = much or max(error) > SIMILAR_ERROR * min(error)
    cure = "they differ much; train more of them (--policies) and fly the best"
    return [f"{spread}: {cure}." if much else f"{spread}."]


def describe_survival(over: float | str, drone: str) -> str:
    """Returns what the survival of training refers to.

    Args:
        over: drones trained over; see `experiments.drones.distribution_of`.
        drone: that which was trained for.
    """
    drones = {
        names.POSTERIOR: f"drawn from the posterior of {drone}",
        names.WIDE: f"in a wide box about {drone}",
        names.ANY_DAY: f"in a wide box about {drone}, with trims, payloads and faults of any day",
        names.ANY: "of any make",
        0.0: f"all like {drone}",
    }.get(over, f"of {over}" if isinstance(over, str) else f"within {over:.0%} of {drone}")
    return (
        f"survival: share of the training's random episodes that reach the time limit, with drones "
        f"{drones}. It does not say how your drone flies; the next commands do."
    )


def describe(now: Progress) -> str:
    """Returns mean scores of policies in training, as text; how long they fly while none lasts."""
    learning = _learning(now)
    returns, survival, errors, duration = (
        sum(float(values[number]) for number in learning) / len(learning) for values in now.score
    )
    lasting = f"survival {survival:.0%}" + (f" ({duration:.1f} s)" if survival < 0.005 else "")
    return f"return {returns:.1f}, {lasting}, error {errors * 100:.1f} cm"


def _learning(now: Progress) -> list[int]:
    """Policies that this evaluation scored: all, but where an extension trains some."""
    return np.flatnonzero(np.isfinite(np.asarray(now.score.survival))).tolist()


def _plain(score: Evaluation, number: int) -> dict[str, float]:
    return {name: round(float(value[number]), 6) for name, value in score._asdict().items()}
