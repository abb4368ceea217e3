"""Scores of policies in training, as they come and the best of each."""

import time
from collections.abc import Sequence
from functools import reduce
from typing import Any

import polars

from maidenflight import names
from maidenflight.training.distillation import Distillation, phase
from maidenflight.training.evaluation import FLIGHT_S, FLIGHTS, Evaluation, OwnFlights
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
                for number in range(len(now.score.survival))
            ]
        )

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


def find_falls(flights: Sequence[OwnFlights], drone: str) -> dict[int, str]:
    """Returns a sentence on each policy that falls on the drone itself, by its number from 1."""
    return {
        number: f"policy_{number} falls on {drone} itself, without randomization: "
        f"{FLIGHTS - flight.lasting} of {FLIGHTS} flights end before {FLIGHT_S:g} s "
        f"({flight.seconds:.1f} s in the mean). Do not fly it; train on with --resume and more "
        "--updates, or fly another."
        for number, flight in enumerate(flights, 1)
        if flight.lasting < FLIGHTS
    }


def describe_own_flights(flights: Sequence[OwnFlights], drone: str) -> list[str]:
    """Returns a line on how a training's policies fly the drone itself, and one on each fall."""
    lasting = [flight for flight in flights if flight.lasting == FLIGHTS]
    line = (
        f"on {drone} itself, without randomization: {len(lasting)} of {len(flights)} policies fly "
        f"{FLIGHT_S:g} s"
    )
    errors = [100 * flight.position_error for flight in lasting]
    much = (
        f", {min(errors):.1f} to {max(errors):.1f} cm from the set-point by its estimate"
        if errors
        else ""
    )
    return [f"{line}{much}.", *find_falls(flights, drone).values()]


def describe_training(
    best: Sequence[dict[str, float]],
    over: float | str,
    flights: Sequence[OwnFlights],
    drone: str,
) -> list[str]:
    """Returns how far policies are apart, what their survival is of, and how they fly the drone.

    Args:
        best: see `describe_spread`.
        over: see `describe_survival`.
        flights: on the drone itself.
        drone: its name.
    """
    of = describe_survival(over, drone)
    return [*describe_spread(best), of, *describe_own_flights(flights, drone)]


def describe(now: Progress) -> str:
    """Returns mean scores of policies in training, as text; how long they fly while none lasts."""
    returns, survival, errors, duration = (
        sum(map(float, values)) / len(values) for values in now.score
    )
    lasting = f"survival {survival:.0%}" + (f" ({duration:.1f} s)" if survival < 0.005 else "")
    return f"return {returns:.1f}, {lasting}, error {errors * 100:.1f} cm"


def _plain(score: Evaluation, number: int) -> dict[str, float]:
    return {name: round(float(value[number]), 6) for name, value in score._asdict().items()}
