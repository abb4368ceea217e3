"""Loggers of training: TensorBoard and Weights & Biases, whose packages are extras.

A logger is a context manager that gives the function for `train`'s `on_progress`. Unlike results,
event files hold the time of day and the host's name.
"""

import socket
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from importlib import import_module
from os import PathLike, environ
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight.errors import InputError, WriteError, not_installed

if TYPE_CHECKING:
    from maidenflight.training.train import Progress

Listener = Callable[["Progress"], None]


@contextmanager
def tensorboard(
    folder: str | PathLike[str], policies: int, settings: Mapping[str, Any]
) -> Iterator[Listener]:
    """Writes event files, one run per policy, over control periods of all policies together.

    Event files of an earlier training are removed at the first evaluation, because training that
    resumes reports all earlier evaluations again. Until then, as when the checkpoint is refused,
    they stay.

    Args:
        folder: event files go to `tensorboard/policy_1`, `policy_2` and so on in it.
        policies: how many learn.
        settings: plain values that are shown beside the scores.

    Raises:
        InputError: tensorboardX is not installed.
        WriteError: at a score, the folder cannot be written.
    """
    _package("tensorboardX", "tensorboard")
    runs = Path(folder) / "tensorboard"
    with ExitStack() as stack:
        writers: list[_Events] = []

        def begin() -> None:
            for old in runs.glob("policy_*/events.out.tfevents.*"):
                old.unlink()
            for number in range(1, policies + 1):
                writers.append(_Events(runs / f"policy_{number}"))
                stack.callback(writers[-1].close)
                writers[-1].text(
                    "settings",
                    "\n".join(f"    {name}: {value}" for name, value in settings.items()),
                )

        def show(progress: "Progress") -> None:
            try:
                if not writers:
                    begin()
                for number, writer in enumerate(writers):
                    for name, value in _scores(progress, number).items():
                        writer.scalar(name, value, progress.steps)
                    writer.flush()
            except OSError as error:
                raise WriteError(runs, error) from error

        yield show


class _Events:
    """An event file whose errors come when they happen.

    tensorboardX's SummaryWriter writes in a thread, which a full disk ends; training would then
    wait for it for ever.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        records, events, self._summary = (
            import_module(f"tensorboardX.{name}")
            for name in ("record_writer", "proto.event_pb2", "summary")
        )
        self._event = events.Event
        self._file = records.RecordWriter(
            str(folder / f"events.out.tfevents.{time.time():.0f}.{socket.gethostname()}")
        )
        self._write(file_version="brain.Event:2")

    def _write(self, **content: Any) -> None:
        self._file.write(self._event(wall_time=time.time(), **content).SerializeToString())

    def text(self, name: str, text: str) -> None:
        self._write(summary=self._summary.text(name, text))

    def scalar(self, name: str, value: float, step: int) -> None:
        self._write(summary=self._summary.scalar(name, value), step=step)

    def flush(self) -> None:
        self._file.flush()

    def close(self) -> None:
        # What cannot be written has been told by `flush`.
        with suppress(OSError):
            self._file.close()


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
        settings: plain values that are kept with each run.

    Raises:
        InputError: wandb is not installed, or a run cannot be begun, as without an account.
    """
    package = _package("wandb", "wandb")
    # Its arguments would win over its environment variables, and where the folder is missing it
    # would write elsewhere.
    Path(folder).mkdir(parents=True, exist_ok=True)
    place = {
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
                    **place,
                )
                runs.append(stack.enter_context(_ended(begun)))
        except package.Error as error:
            raise InputError(
                f"Weights & Biases: {error} Or set WANDB_MODE=offline, or train without --log "
                "wandb."
            ) from error

        def show(progress: "Progress") -> None:
            for number, run in enumerate(runs):
                run.log(_scores(progress, number), step=progress.steps)

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


LOGGERS: dict[
    str, Callable[[str | PathLike[str], int, Mapping[str, Any]], AbstractContextManager[Listener]]
] = {
    "tensorboard": tensorboard,
    "wandb": wandb,
}
"""Loggers by name, as the command line offers them."""


@contextmanager
def opened(
    names: Sequence[str], folder: str | PathLike[str], policies: int, settings: Mapping[str, Any]
) -> Iterator[Listener]:
    """Several loggers as one; none, where none is named.

    Args:
        names: keys of `LOGGERS`.
        folder: of the policies.
        policies: how many learn.
        settings: plain values that are kept with the scores.

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

        yield show


def _package(name: str, extra: str) -> Any:
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        raise not_installed(str(error.name), extra, f"--log {extra}") from error


def _scores(progress: "Progress", number: int) -> dict[str, float]:
    """Scores of one of the policies."""
    return {name: float(values[number]) for name, values in progress.score._asdict().items()}
