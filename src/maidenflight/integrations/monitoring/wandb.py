"""Weights & Biases as a logger of training."""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from os import PathLike, environ
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight.errors import InputError, imported
from maidenflight.training.loggers import Listener, scores_of

if TYPE_CHECKING:
    from maidenflight.training.train import Progress


@contextmanager
def wandb(
    folder: str | PathLike[str], policies: int, settings: Mapping[str, Any]
) -> Iterator[Listener]:
    """Sends evaluations to Weights & Biases, one run per policy, in one group.

    The horizontal axis is control periods, all policies together.

    Its own environment variables say where: `WANDB_PROJECT` (`maidenflight` unless set),
    `WANDB_ENTITY`, `WANDB_RUN_GROUP` (the folder's name unless set), `WANDB_DIR` (the folder unless
    set), and with `WANDB_MODE=offline` it needs neither a network nor an account. Runs of
    interrupted training end as failed; resumed training is a new run with all evaluations.

    Args:
        folder: of the policies.
        policies: how many learn.
        settings: plain values to store with each run.

    Raises:
        InputError: wandb is not installed, or a run cannot be begun, as without an account.
    """
    package = imported("wandb", "wandb", "--log wandb")
    # Its arguments would win over its environment variables, and where the folder is missing it
    # would write elsewhere.
    Path(folder).mkdir(parents=True, exist_ok=True)
    destination = {
        "project": environ.get("WANDB_PROJECT", "maidenflight"),
        "group": environ.get("WANDB_RUN_GROUP", Path(folder).resolve().name),
        "dir": environ.get("WANDB_DIR", str(folder)),
    }
    # Its console would hold what the progress bar writes.
    own = package.Settings(console="off")
    with ExitStack() as stack:
        runs = []
        try:
            for number in range(1, policies + 1):
                begun = package.init(
                    name=f"policy_{number}",
                    config=dict(settings),
                    reinit="create_new",
                    settings=own,
                    **destination,
                )
                runs.append(stack.enter_context(_ended(begun)))
        except package.Error as error:
            raise InputError(
                f"Weights & Biases: {error} Or set WANDB_MODE=offline, or train without --log "
                "wandb."
            ) from error

        def show(progress: "Progress") -> None:
            for number, run in enumerate(runs):
                run.log(scores_of(progress, number), step=progress.steps)

        yield show


@contextmanager
def _ended(run: Any) -> Iterator[Any]:
    """A run of Weights & Biases that ends as failed where what is done with it fails.

    As a context of its own it prints tracebacks.
    """
    try:
        yield run
    except BaseException:
        run.finish(exit_code=1)
        raise
    run.finish()
