"""TensorBoard as a logger of training, through tensorboardX.

Unlike results, event files hold the time of day and the host's name.
"""

import socket
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight.errors import WriteError, imported
from maidenflight.training.loggers import Listener, scores_of

if TYPE_CHECKING:
    from maidenflight.training.train import Progress


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
        settings: plain values beside the scores.

    Raises:
        InputError: tensorboardX is not installed.
        WriteError: at a score, the folder cannot be written.
    """
    imported("tensorboardX", "tensorboard", "--log tensorboard")
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
                    for name, value in scores_of(progress, number).items():
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
        # `flush` has warned of what cannot be written.
        with suppress(OSError):
            self._file.close()
