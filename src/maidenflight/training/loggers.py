"""Loggers of training, which show its scores elsewhere while it runs."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from os import PathLike
from typing import TYPE_CHECKING, Any

from maidenflight import events
from maidenflight.registry import LOGGERS

if TYPE_CHECKING:
    from maidenflight.training.train import Progress

Listener = Callable[["Progress"], None]
Logger = Callable[[str | PathLike[str], int, Mapping[str, Any]], AbstractContextManager[Listener]]
"""Of the policies' folder, their number and the settings: a context that gives what to call with
each score, `train`'s `on_progress`."""


@contextmanager
def opened(
    names: Sequence[str], folder: str | PathLike[str], policies: int, settings: Mapping[str, Any]
) -> Iterator[Listener]:
    """Joins several loggers into one; none, where none is named.

    Args:
        names: of `registry.LOGGERS`.
        folder: of the policies.
        policies: how many learn.
        settings: plain values to store with the scores.

    Raises:
        InputError: a logger's package is not installed, or it cannot be opened.
    """
    with ExitStack() as stack:
        loggers = [
            stack.enter_context(LOGGERS[name](folder, policies, settings))
            for name in dict.fromkeys(names)
        ]

        def show(progress: "Progress") -> None:
            for logger in loggers:
                logger(progress)
            if events.listened_to():
                _tell_scores(progress, settings)

        yield show


def scores_of(progress: "Progress", number: int) -> dict[str, float]:
    """Returns the scores of one of the policies by name."""
    return {name: float(values[number]) for name, values in progress.score._asdict().items()}


def _tell_scores(progress: "Progress", settings: Mapping[str, Any]) -> None:
    """Tells a program that listens each policy's scores, and the first policy's best so far."""
    from jax import tree

    from maidenflight import policy_file

    scores = [scores_of(progress, number) for number in range(len(progress.score.survival))]
    best = ""
    if progress.best is not None:
        first = tree.map(lambda leaf: leaf[0], progress.best)
        best = policy_file.to_json(first, {"settings": settings})
    events.tell(update=progress.update, steps=progress.steps, scores=scores, policy=best)
